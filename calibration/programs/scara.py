"""Postures of a SCARA for poses of its flange, in closed form: two, one for each side of the elbow.

Three joints turn about parallel axes, one slides along them. Nothing is known of the arm but its axes at zero, so
that the order of the joints, their signs and a screw that couples the spline with its slide are met alike.
"""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, frames_of_placements
from cellcal.calibration.geometry import Array, inverse_transform

_PARALLEL = 1e-6  # of unit vectors' products
_TOUCHES = 1e-9  # how far beyond its reach a pose may be by rounding, as a cosine
_SHORTEST_M = 1e-6


@dataclass(frozen=True, eq=False)
class ScaraAxes:
    """The axes of a SCARA with its joints at zero, seen from the base."""

    model: RobotModel
    turning: tuple[int, int, int]  # joints from the base: shoulder, elbow, spline
    slide: int
    signs: Array  # (4,) of each axis along the first
    up: Array  # (3,) unit, along axis 1 of those that turn
    across: Array  # (2, 3) unit, square to it and to one another
    places: Array  # (3, 2) of shoulder, elbow and spline [m] in that plane
    spline_m: Array  # (3,) a point of the spline's axis
    base_flange: Array  # (4, 4)

    @property
    def upper_m(self) -> Array:
        """From shoulder to elbow (2,)."""
        return np.asarray(self.places[1] - self.places[0])

    @property
    def fore_m(self) -> Array:
        """From elbow to spline (2,)."""
        return np.asarray(self.places[2] - self.places[1])


def scara_axes(model: RobotModel) -> ScaraAxes | None:
    """Return the axes of a SCARA; None of any other arm."""
    slides = model.sliding
    if model.axis_count != 4 or slides is None or slides.sum() != 1:
        return None
    rotations, origins = frames_of_placements(model.placements, np.zeros((4, 1)))
    axes, points = rotations[:-1, :, 2, 0], origins[:-1, :, 0]
    slide = int(np.flatnonzero(slides)[0])
    first, second, third = (joint for joint in range(4) if joint != slide)
    up = axes[first]
    signs = axes @ up
    if (np.abs(np.abs(signs) - 1.0) > _PARALLEL).any():
        return None
    some = np.eye(3)[np.argmin(np.abs(up))]
    side = np.cross(up, some) / np.linalg.norm(np.cross(up, some))
    across = np.stack([np.cross(side, up), side])
    base_flange = np.eye(4)
    base_flange[:3, :3], base_flange[:3, 3] = rotations[-1, :, :, 0], origins[-1, :, 0]
    found = ScaraAxes(
        model,
        (first, second, third),
        slide,
        np.sign(signs),
        up,
        across,
        points[[first, second, third]] @ across.T,
        points[third],
        base_flange,
    )
    lengths = np.linalg.norm([found.upper_m, found.fore_m], axis=1)
    return found if lengths.min() > _SHORTEST_M else None


def scara_postures(arm: ScaraAxes, base_flange: Array) -> tuple[Array, Array]:
    """Return the postures that bring the flange to poses, and how far the poses lean.

    Parameters
    ----------
    base_flange : (N, 4, 4)
        Poses of the flange in the base.

    Returns
    -------
    joints : (2, N, 4)
        What the controller shows [rad, m], angles within half a turn; NaN beyond the reach.
    lean_rad : (N,)
        Angle between the spline in the pose and the direction that it always has.
    """
    motion = base_flange @ inverse_transform(arm.base_flange)
    yaw, lean = _turn_about(arm, motion[:, :3, :3])
    spline = motion[:, :3, :3] @ arm.spline_m + motion[:, :3, 3]
    away = spline @ arm.across.T - arm.places[0]
    lengths = np.linalg.norm(arm.upper_m), np.linalg.norm(arm.fore_m)
    reach = np.einsum("ni,ni->n", away, away)
    cosine = (reach - lengths[0] ** 2 - lengths[1] ** 2) / (2 * lengths[0] * lengths[1])
    bend = np.arccos(np.where(np.abs(cosine) <= 1 + _TOUCHES, np.clip(cosine, -1.0, 1.0), np.nan))
    angles = np.empty((2, len(motion), 4))
    angles[:, :, arm.slide] = (spline - arm.spline_m) @ arm.up * arm.signs[arm.slide]
    first, second, third = arm.turning
    for i, opening in enumerate((bend, -bend)):
        turned = opening - _direction(arm.fore_m) + _direction(arm.upper_m)
        cos, sin = np.cos(turned), np.sin(turned)
        fore = np.stack(
            [cos * arm.fore_m[0] - sin * arm.fore_m[1], sin * arm.fore_m[0] + cos * arm.fore_m[1]]
        )
        span = arm.upper_m[:, None] + fore
        shoulder = np.arctan2(away[:, 1], away[:, 0]) - np.arctan2(span[1], span[0])
        angles[i, :, first] = shoulder
        angles[i, :, second] = turned * arm.signs[second]
        angles[i, :, third] = (yaw - shoulder - turned) * arm.signs[third]
    shown = angles - arm.model.theta0_rad
    turns = list(arm.turning)
    shown[:, :, turns] = np.remainder(shown[:, :, turns] + np.pi, 2 * np.pi) - np.pi
    back = np.linalg.inv(arm.model.joint_coupling)
    return np.ascontiguousarray(shown @ back.T), lean


def elbow_side(arm: ScaraAxes, joints_rad: Array) -> Array:
    """Return the sine of the elbow's bend (N,): its sign is the side, zero the stretched arm."""
    angles = joints_rad @ arm.model.joint_coupling.T + arm.model.theta0_rad
    second = arm.turning[1]
    bend = angles[:, second] * arm.signs[second] + _direction(arm.fore_m) - _direction(arm.upper_m)
    return np.asarray(np.sin(bend))


def _turn_about(arm: ScaraAxes, rotations: Array) -> tuple[Array, Array]:
    """Return the nearest turns about the vertical axis (N,), and what is left as an angle (N,)."""
    x, y = arm.across
    turned_x, turned_y = rotations @ x, rotations @ y
    yaw = np.arctan2(turned_x @ y - turned_y @ x, turned_x @ x + turned_y @ y)
    turned_up = rotations @ arm.up
    lean = np.arctan2(np.linalg.norm(np.cross(turned_up, arm.up), axis=1), turned_up @ arm.up)
    return yaw, lean


def _direction(vector: Array) -> float:
    return float(np.arctan2(vector[1], vector[0]))
