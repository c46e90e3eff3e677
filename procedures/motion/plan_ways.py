"""Ways between planned poses: their corners, whether they may be gone, and in which order. Pure functions."""

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.motion_check import MotionLimits, MotionVerdict, check_moves, sample_motion
from cellcal.calibration.motion.motion_quantities import wire_side, wire_winding
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.motion.approach import axis_by_axis, from_below
from cellcal.procedures.motion.detours import SAME_WINDING_RAD

_SPARE_WINDING_RAD = 0.2  # between places a detour goes straight, not from below


def travel_order(
    model: RobotModel, start_rad: Joints, poses: Array, limits: MotionLimits, *, one_by_one: bool = False
) -> list[Array]:
    """Order poses by nearest neighbour along allowed ways; poses that cannot be reached are left out.

    A wire winds up over many legs: each leg is looked at with all before it.
    """
    start = np.array(start_rad)
    here, remaining = start, list(poses)
    ordered: list[Array] = []
    while remaining:
        remaining.sort(key=lambda pose: travel_rad(here, pose, one_by_one))
        reachable = (
            k
            for k, pose in enumerate(remaining)
            if walk_allowed(model, start, [*ordered, pose], limits, one_by_one=one_by_one)
        )
        nearest = next(reachable, None)
        if nearest is None:
            break
        here = remaining.pop(nearest)
        ordered.append(here)
    return ordered


def travel_rad(here: Array, there: Array, one_by_one: bool) -> float:
    """Return how far joints turn on a way: added over the axes, or the farthest one."""
    apart = np.abs(there - here)
    return float(apart.sum() if one_by_one else apart.max())


def corners_of(here: Array, there: Array, one_by_one: bool) -> Array:
    """Return the corners of the way: all joints at once, or one after the other; both end turning upwards."""
    return (
        axis_by_axis(here, there) if one_by_one else np.array(from_below(as_joints(here), as_joints(there)))
    )


def winding_after(
    model: RobotModel, limits: MotionLimits, here: Array, there: Array, wound: float
) -> float | None:
    """Return how far the wire is wound after a joint move; None where the move, or the way back, is not free.

    The wire is followed at the samples at which a plan is checked, so that what is wound leg by leg is what the
    plan finds as a whole. A posture from which the anchor has no side, and a way back that does not unwind what
    the way there wound, would not add up: they count as not free.
    """
    way = np.vstack([corners_of(here, there, False), here])  # and straight back, as a later detour may go
    stops = [False] * (len(way) - 2) + [True, False]
    if (
        limits.wire is None
        or not check_moves(model, here, way, limits, speed_rad_s=1e-3, stops=stops).allowed
    ):
        return None
    places = (limits.wire.anchor_in_base_m, limits.wire.hook_in_flange_m)
    owner, path, _ = sample_motion(here, way, limits.clearances)
    winds = wire_winding(model, np.vstack([here, path]), places)
    is_unwound = abs(winds[-1]) < SAME_WINDING_RAD and wire_has_side(model, there[None], limits)[0]
    if not is_unwound or np.abs(wound + winds).max() > limits.wire.wrap_rad - _SPARE_WINDING_RAD:
        return None
    return wound + float(winds[np.count_nonzero(owner < len(way) - 1)])


def wire_has_side(model: RobotModel, postures: Array, limits: MotionLimits) -> NDArray[np.bool_]:
    """Return (N,): in which postures it is sure on which side of the flange's axis the wire leaves."""
    if limits.wire is None:
        return np.ones(len(postures), dtype=bool)
    return wire_side(model, postures, (limits.wire.anchor_in_base_m, limits.wire.hook_in_flange_m))[1]


def walk_allowed(
    model: RobotModel, here: Array, walk: list[Array], limits: MotionLimits, *, one_by_one: bool = True
) -> bool:
    """Return whether a walk from pose to pose keeps every limit as a whole: a wire winds up over many legs."""
    legs, at = [], here
    for there in walk:
        legs.append(corners_of(at, there, one_by_one))
        at = there
    return corners_allowed(model, here, legs, limits)


def allowed_start(model: RobotModel, here: Array, walk: list[Array], limits: MotionLimits) -> list[Array]:
    """Return the poses of a walk, axis by axis, up to the last before the first that breaks a limit."""
    count = 0
    while count < len(walk) and walk_allowed(model, here, walk[: count + 1], limits):
        count += 1
    return walk[:count]


def corners_allowed(model: RobotModel, here: Array, legs: list[Array], limits: MotionLimits) -> bool:
    """Return whether legs, each the corners of a way to a stop, keep every limit one after the other."""
    stops = [last for leg in legs for last in [*(False for _ in leg[1:]), True]]
    return check_moves(model, here, np.concatenate(legs), limits, speed_rad_s=1e-3, stops=stops).allowed


def way_allowed(
    model: RobotModel, here: Array | Joints, there: Array, limits: MotionLimits, *, one_by_one: bool
) -> bool:
    """Return whether a way keeps every limit; speeds are lowered later."""
    start = np.array(here)
    ways = corners_of(start, there, one_by_one)
    stops = [False] * (len(ways) - 1) + [True]
    return check_moves(model, start, ways, limits, speed_rad_s=1e-3, stops=stops).allowed


def refuse_broken(verdict: MotionVerdict) -> None:
    """Refuse a plan that breaks a limit as a whole; a speed above its cap is lowered instead."""
    broken = [
        finding.sentence for finding in verdict.findings if finding.check not in ("tip speed", "joint speed")
    ]
    if broken:
        raise DegenerateDataError(
            make_message(
                "the plan would break {broken_count} limits, first: {broken}",
                broken_count=len(broken),
                broken=broken[0],
            ),
            remedy="Jog the robot towards the middle of its range, then start again.",
        )


def as_joints(pose: Array) -> Joints:
    """Return a posture as plain numbers."""
    return tuple(float(v) for v in pose)


def as_way(corners: list[Array]) -> tuple[Joints, ...]:
    """Return corners as plain numbers."""
    return tuple(as_joints(corner) for corner in corners)
