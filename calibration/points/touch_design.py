"""Which attitudes tell a tool's tip: how well they will, which are too alike, and which one tells most next.

With attitudes R_i and touches of standard uncertainty s, the tip's covariance is ``s^2 [n (I - M^T M)]^-1`` with
``M = mean(R_i)``: what is left of the normal equations of `tool_point` once the pin is eliminated.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array, Pose, exp_rotation, log_rotation
from cellcal.calibration.message import make_message
from cellcal.calibration.uncertainty import coverage_in_space, effective_degrees_of_freedom

_D = math.sqrt(0.5)
AXES = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
TURNS = AXES | {
    "the line midway between +x and +y": (_D, _D, 0.0),
    "the line midway between -x and -y": (-_D, -_D, 0.0),
    "the line midway between +x and -y": (_D, -_D, 0.0),
    "the line midway between -x and +y": (-_D, _D, 0.0),
}
_STEP_RAD = math.radians(5.0)
_FRESH_RAD = math.radians(12.0)  # an attitude used before shows nothing of what changes with it
_MOST_TURN_RAD = math.radians(120.0)
_NEVER = 1e6


@dataclass(frozen=True, slots=True)
class ToolTurn:
    """A turn of the tool about an axis of its flange."""

    about: str
    angle_rad: float

    def describe_turn(self) -> str:
        """Return it in words: 60 degrees about +x."""
        return make_message(
            "{angle_deg:.0f} degrees about {about}", angle_deg=math.degrees(self.angle_rad), about=self.about
        )

    def rotation_matrix(self) -> Array:
        """Return it as a matrix."""
        return exp_rotation(np.array(TURNS[self.about]) * self.angle_rad)


@dataclass(frozen=True, slots=True)
class AlikeTouch:
    """A touch whose attitude tells too little beside the ones before, and the least turn that mends it."""

    touch: int  # counted from 0
    like: int | None  # the touch it is like; None where all are turned about one axis
    apart_rad: float  # from that touch; for one axis, the largest turn beside it
    turn: ToolTurn


def tip_gain(attitudes: Sequence[Array]) -> Array | None:
    """Return the covariance (3, 3) of the tip for touches good to one metre; None where they do not fix it."""
    count = len(attitudes)
    mean = np.mean(attitudes, axis=0)
    information = count * (np.eye(3) - mean.T @ mean)
    if count < 3 or float(np.linalg.eigvalsh(information)[0]) * _NEVER < 1.0:
        return None
    gain: Array = np.linalg.inv(information)
    return gain


def predicted_u_m(
    attitudes: Sequence[Array],
    sigma_m: float,
    degrees_of_freedom: float = math.inf,
    *,
    arm_sigma_m: float = 0.0,
) -> float | None:
    """Return U (95 %, in space) of the tip that touches in these attitudes would give [m]; None: none at all.

    Parameters
    ----------
    attitudes : n rotations (3, 3)
        base_flange at each touch.
    sigma_m : float
        Standard uncertainty of one coordinate of one touch [m].
    degrees_of_freedom : float
        With which the scatter will tell sigma; unlimited where it is known.
    arm_sigma_m : float
        By how much the arm's own errors shift a coordinate of the tip [m]; see `locate_tool_point`.
    """
    gain = tip_gain(attitudes)
    if gain is None:
        return None
    covariance = sigma_m**2 * gain + arm_sigma_m**2 * np.eye(3)
    by_touches = sigma_m * math.sqrt(float(np.trace(gain)))
    effective_freedom = effective_degrees_of_freedom(
        [(by_touches, degrees_of_freedom), (math.sqrt(3.0) * arm_sigma_m, math.inf)]
    )
    k = coverage_in_space(np.linalg.eigvalsh(covariance).clip(0.0).tolist(), effective_freedom)
    return k * math.sqrt(float(np.trace(covariance)))


def alike_touch(touches: Sequence[Pose], *, min_turn_rad: float, worst_gain: float) -> AlikeTouch | None:
    """Return whether the last touch's attitude is too like the ones before.

    Parameters
    ----------
    touches : n poses
        base_flange.
    min_turn_rad : float
        Least angle between the last touch and every one before.
    worst_gain : float
        Largest accepted standard uncertainty of the tip, in its worst direction, over that of a touch [1]; looked
        at from the third touch on.
    """
    attitudes = [touch.rotation_matrix() for touch in touches]
    last, before = attitudes[-1], attitudes[:-1]
    if not before:
        return None
    angles = [_angle_between(last, one) for one in before]
    nearest = int(np.argmin(angles))

    def is_different(attitude: Array) -> bool:
        return min(_angle_between(attitude, one) for one in before) >= min_turn_rad

    def is_informative(attitude: Array) -> bool:
        gain = tip_gain([*before, attitude])
        is_determined = gain is not None and math.sqrt(float(np.linalg.eigvalsh(gain)[-1])) <= worst_gain
        return is_different(attitude) and (is_determined or len(before) < 2)

    if not is_different(last):
        return AlikeTouch(len(before), nearest, angles[nearest], _least_turn(last, is_informative))
    return (
        None
        if is_informative(last)
        else AlikeTouch(len(before), None, max(angles), _least_turn(last, is_informative))
    )


def next_turn(touches: Sequence[Pose], most_rad: float) -> ToolTurn:
    """Return the turn from the first touch's attitude that makes the tip best known (least trace)."""
    attitudes = [touch.rotation_matrix() for touch in touches]
    turns = [ToolTurn(about, share * most_rad) for about in TURNS for share in (1.0, 0.5)]
    candidates = [(turn, attitudes[0] @ turn.rotation_matrix()) for turn in turns]
    fresh = [
        (turn, a) for turn, a in candidates if min(_angle_between(a, one) for one in attitudes) > _FRESH_RAD
    ]
    return min(fresh or candidates, key=lambda pair: _covariance_trace([*attitudes, pair[1]]))[0]


def planned_attitudes(count: int, most_rad: float) -> list[Array]:
    """Return the attitudes that `next_turn` asks for one after the other, from a first one square to the base."""
    poses = [Pose((0.0, 0.0, 0.0))]
    while len(poses) < count:
        w = next_turn(poses, most_rad).rotation_matrix()
        poses.append(_attitude_pose(w))
    return [pose.rotation_matrix() for pose in poses]


def cone_attitudes(count: int, tilt_rad: float) -> list[Array]:
    """Return attitudes as a manual's fixed plan has them: one upright, the others evenly round a cone."""
    around = 2.0 * np.pi * np.arange(count - 1) / max(count - 1, 1)
    return [np.eye(3), *(exp_rotation(tilt_rad * np.array([np.cos(a), np.sin(a), 0.0])) for a in around)]


def fixed_plan_touches(
    limit_m: float, sigma_m: float, tilt_rad: float, *, arm_sigma_m: float = 0.0, most: int = 60
) -> int | None:
    """Return how many touches a plan fixed beforehand takes for this U [m]; None: more than ``most``.

    Its attitudes are those of `cone_attitudes`; the scatter of its own touches must prove the U.
    """
    for count in range(4, most + 1):
        attitudes = cone_attitudes(count, tilt_rad)
        u_m = predicted_u_m(attitudes, sigma_m, 3.0 * count - 6.0, arm_sigma_m=arm_sigma_m)
        if u_m is not None and u_m <= limit_m:
            return count
    return None


def _least_turn(attitude: Array, good: Callable[[Array], bool]) -> ToolTurn:
    steps = np.arange(_STEP_RAD, _MOST_TURN_RAD, _STEP_RAD)
    for angle in steps.tolist():
        for about in AXES:
            turn = ToolTurn(about, angle)
            if good(attitude @ turn.rotation_matrix()):
                return turn
    return ToolTurn("+x", math.radians(60.0))


def _covariance_trace(attitudes: list[Array]) -> float:
    """Return the trace of the tip's covariance, also where two touches leave a direction all but open."""
    mean = np.mean(attitudes, axis=0)
    information = len(attitudes) * (np.eye(3) - mean.T @ mean)
    return float(np.sum(1.0 / np.maximum(np.linalg.eigvalsh(information), 1.0 / _NEVER)))


def _angle_between(one: Array, other: Array) -> float:
    return float(np.linalg.norm(log_rotation(one.T @ other)))


def _attitude_pose(rotation: Array) -> Pose:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return Pose.from_matrix(matrix)
