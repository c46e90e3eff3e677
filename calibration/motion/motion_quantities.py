"""The quantities that a move must keep, for many postures at once, and by how much each breaks its limit."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel, chain_frames
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.position_uncertainty import AxisUncertainty, PositionUncertainty

Triple = tuple[float, float, float]

_SLIGHT_S = 1e-5  # central differences of points along a path: exact to about 1e-10
_NEAR_AXIS = 0.1  # of the wire's length: nearer to the flange's axis an anchor has no side
SHOWN_UNITS = {"rad": ("deg", float(np.rad2deg(1.0)))}  # in which people read what is not shown as it is


@dataclass(frozen=True, slots=True)
class LimitExcess:
    """Quantities per posture (N, Q) and by how much each breaks its limit (> 0: broken)."""

    check: str
    found: Array
    limit: Array
    excess: Array
    unit: str
    quantity_names: tuple[str, ...] = ()  # (Q,) what each quantity is, where they differ
    uncertainty: Array | None = (
        None  # (N, Q) of the limit: what is kept only because joints are not known better
    )
    lengths: NDArray[np.bool_] | None = (
        None  # (Q,) which of them are metres, where ``unit`` is that of the others
    )

    def shown_as(self, column: int) -> tuple[str, float]:
        """Return the unit in which people read a quantity, and how many of it make its SI unit."""
        if self.lengths is not None and self.lengths[column]:
            return "mm", 1e3
        return SHOWN_UNITS.get(self.unit, (self.unit, 1.0))

    def is_broken(self) -> NDArray[np.bool_]:
        """Return (N,): which postures break any."""
        return np.asarray((self.excess > 0).any(axis=1))

    def forgive_start(self, stays: NDArray[np.bool_]) -> "LimitExcess":
        """Drop the start, the first row; forgive each quantity on the way what it breaks there, not at a stay."""
        start_excess = np.where(stays[:, None], 0.0, np.maximum(self.excess[0], 0.0))
        limit = np.broadcast_to(self.limit, self.excess.shape)[1:]
        uncertainty = None if self.uncertainty is None else self.uncertainty[1:]
        return LimitExcess(
            self.check,
            self.found[1:],
            limit,
            self.excess[1:] - start_excess,
            self.unit,
            self.quantity_names,
            uncertainty,
            self.lengths,
        )


def joint_limit_excess(model: RobotModel, joints: Array, margin_rad: Array) -> LimitExcess:
    """Return every joint against its limits less a margin per axis (n,) [rad]."""
    low, high = model.lower_rad + margin_rad, model.upper_rad - margin_rad
    lengths = np.zeros(model.axis_count + len(model.combined_limits), dtype=bool)
    if model.sliding is not None:
        lengths[: model.axis_count] = model.sliding
    if model.combined_limits:
        weights = np.array([limit.weights for limit in model.combined_limits]).T
        margins = margin_rad @ np.abs(weights)
        low = np.concatenate([low, [each.lower_rad for each in model.combined_limits] + margins])
        high = np.concatenate([high, [each.upper_rad for each in model.combined_limits] - margins])
        joints = np.concatenate([joints, joints @ weights], axis=1)
    below, above = low - joints, joints - high
    limit = np.where(below > above, low, high)
    names = _limit_names(model.axis_count, tuple(each.name for each in model.combined_limits))
    return LimitExcess("joint limits", joints, limit, np.maximum(below, above), "rad", names, lengths=lengths)


@cache
def _limit_names(axis_count: int, sums: tuple[str, ...]) -> tuple[str, ...]:
    """Return what a refusal calls the limits of each joint and of each sum of joints."""
    names = (*(f"J{axis}" for axis in range(1, axis_count + 1)), *sums)
    return tuple(make_message("joint limits of {name}", name=name) for name in names)


def workspace_excess(
    model: RobotModel,
    joints: Array,
    box_m: tuple[Triple, Triple],
    tip_m: Triple,
    position_uncertainty: PositionUncertainty | None = None,
) -> LimitExcess:
    """Return the coordinates of tip, flange and every joint's centre from the second on, against a box.

    With a doubt about the posture the box shrinks by as much as each point may be elsewhere.
    """
    points = body_points(model, joints, tip_m)
    more = (
        np.zeros(points.shape)
        if position_uncertainty is None
        else _point_uncertainties(model, joints, points, position_uncertainty.bodies_rad)
    )
    low, high = np.array(box_m[0]) + more, np.array(box_m[1]) - more
    below, above = low - points, points - high
    limit = np.where(below > above, low, high)
    flat = [part.reshape(len(joints), -1) for part in (points, limit, np.maximum(below, above), more)]
    quantity_names = [
        make_message("workspace box of {name}, {axis}", name=name, axis=axis)
        for name in _point_names(model)
        for axis in "xyz"
    ]
    uncertainties = None if position_uncertainty is None else flat[3]
    return LimitExcess("workspace box", flat[0], flat[1], flat[2], "m", tuple(quantity_names), uncertainties)


def _point_uncertainties(
    model: RobotModel, joints: Array, points: Array, uncertainty_rad: Sequence[float]
) -> Array:
    """Return (N, P, 3): how far each of ``body_points`` may be elsewhere [m]."""
    uncertainty = AxisUncertainty.from_joints(model, joints, uncertainty_rad)
    links = [*range(2, model.axis_count + 1), model.axis_count]
    far = [uncertainty.displacement_between([points[:, k].T], 0, link) for k, link in enumerate(links)]
    return np.broadcast_to(np.array(far).T[:, :, None], points.shape)


def _point_names(model: RobotModel) -> tuple[str, ...]:
    return (*(make_message("link {link}", link=link) for link in range(2, model.axis_count)), "flange", "tip")


def singularity_excess(model: RobotModel, joints: Array, limit: float) -> LimitExcess:
    """Return the smallest singular value of the flange's Jacobian against its limit."""
    values = np.linalg.svd(model.flange_jacobian(joints)[1], compute_uv=False)
    return quantity_at_least("singularity", np.asarray(values[:, -1], dtype=np.float64), limit, "m/rad")


def wire_range_excesses(
    model: RobotModel,
    joints: Array,
    places_m: tuple[Triple, Triple],
    zero_m: float,
    reach_m: tuple[float, float],
) -> list[LimitExcess]:
    """Return the wire's length against the part of its range that may be used; places: anchor, hook in flange."""
    anchor, hook = (np.array(place) for place in places_m)
    lengths = zero_m + np.linalg.norm(model.tip_positions(joints, hook) - anchor, axis=1)
    low, high = reach_m
    return [
        quantity_at_least("wire too short", lengths, low, "m"),
        quantity_at_most("wire too long", lengths, high, "m"),
    ]


def wire_winding(model: RobotModel, path: Array, places_m: tuple[Triple, Triple]) -> Array:
    """Return (N,) how far the wire has wound about the flange's axis since the first posture of a path [rad].

    The side on which the anchor is, seen from the flange, is followed along the path. While the anchor is
    nearly on the flange's axis it has no side, and the last one holds.
    """
    side, has_side = wire_side(model, path, places_m)
    last = np.maximum.accumulate(np.where(has_side, np.arange(len(side)), 0))
    return np.asarray(np.unwrap(side[last]) - side[last[0]], dtype=np.float64)


def wire_side(
    model: RobotModel, postures: Array, places_m: tuple[Triple, Triple]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return (N,) the angle at which the flange sees the anchor about its axis [rad], and (N,) where it has one."""
    rotations, origins = chain_frames(model, postures)
    away = np.array(places_m[0])[:, None] - origins[-1]
    directions = np.einsum("jin,jn->in", rotations[-1], away)
    beside = np.hypot(directions[0], directions[1]) > _NEAR_AXIS * np.linalg.norm(away, axis=0)
    return np.asarray(np.arctan2(directions[1], directions[0]), dtype=np.float64), beside


def wire_wrap_excess(
    model: RobotModel, path: Array, places_m: tuple[Triple, Triple], limit_rad: float
) -> LimitExcess:
    """Return how far the wire has wound about the flange's axis since the first posture, against its limit."""
    return quantity_at_most("wire wrap", np.abs(wire_winding(model, path, places_m)), limit_rad, "rad")


def speed_excess(
    model: RobotModel, path: Array, rates: Array, tip_m: Triple, limit_m_s: float
) -> LimitExcess:
    """Return the speed of the fastest of tip, flange and joints' centres, for joint rates (N, n) [rad/s]."""
    ahead, behind = (body_points(model, path + sign * _SLIGHT_S * rates, tip_m) for sign in (1.0, -1.0))
    fastest = np.linalg.norm(ahead - behind, axis=2).max(axis=1) / (2.0 * _SLIGHT_S)
    return quantity_at_most("tip speed", fastest, limit_m_s, "m/s")


def quantity_at_most(check: str, found: Array, limit: float, unit: str) -> LimitExcess:
    """Return one quantity per posture (N,) that may not be above its limit."""
    column = found[:, None]
    return LimitExcess(check, column, np.full(column.shape, limit), column - limit, unit)


def quantity_at_least(check: str, found: Array, limit: float, unit: str) -> LimitExcess:
    """Return one quantity per posture (N,) that may not be below its limit."""
    column = found[:, None]
    return LimitExcess(check, column, np.full(column.shape, limit), limit - column, unit)


def body_points(model: RobotModel, joints: Array, tip_m: Triple) -> Array:
    """Return (N, n, 3): the centres of the joints from the second on, the flange, and the tip [m]."""
    rotations, origins = chain_frames(model, joints)
    tip = np.einsum("ijn,j->in", rotations[-1], np.array(tip_m)) + origins[-1]
    return np.asarray(np.concatenate([origins[2:], tip[None]]).transpose(2, 0, 1), dtype=np.float64)
