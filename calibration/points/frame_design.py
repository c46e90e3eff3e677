"""How well touched points will tell a user frame, and which one is worth touching again.

A point of the origin misses zero in x, y and z, one on +x in y and z, one of the plane in z. With touches of standard
uncertainty s the frame's covariance is ``s^2 (sum J_i^T J_i)^-1``, J_i the rows of what point i misses by the frame's
twist: what `frames.frame_from_more_points` solves, known before anything is touched.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.points.frames import miss_rows
from cellcal.calibration.points.most_informative import most_informative_touch

Triple = tuple[float, float, float]
FrameRole = Literal["origin", "on_x", "in_plane"]
FIRST_FIXED: dict[FrameRole, int] = {
    "origin": 0,
    "on_x": 1,
    "in_plane": 2,
}  # coordinates from here on are zero
FIXING = 3  # so many points fix a frame, and say nothing of how well they were touched


@dataclass(frozen=True, slots=True)
class FramePoint:
    """A point of a frame: what it is, and where, in any frame common to all."""

    role: FrameRole
    at_m: Triple


@dataclass(frozen=True, slots=True)
class FrameGoal:
    """The uncertainty of touches, and the expanded uncertainties that are asked for, k = 2."""

    sigma_m: float  # of one coordinate of one touch
    origin_u_m: float
    angle_u_rad: float


@dataclass(frozen=True, slots=True)
class FramePrediction:
    """The points to touch again, in order, until the goal is met; and the uncertainty then."""

    again: tuple[int, ...]  # indices of points; may hold one several times
    reached: bool
    origin_u_m: float
    angle_u_rad: float


def predict_frame(
    base_frame: Pose, points: Sequence[FramePoint], goal: FrameGoal, most: int
) -> FramePrediction:
    """Return which points to touch again so that the goal is met with few touches, and one is to spare.

    Parameters
    ----------
    base_frame : Pose
        The frame as the points tell it so far.
    points : three or more points
        In the base frame; an origin, one on +x and one of the plane among them.
    most : int
        Touches in all, those of ``points`` included.

    Notes
    -----
    Greedy: each touch is the one that lowers the worst of the six uncertainties, over their limits, most. Where three
    would do, the origin is touched once more: all its coordinates can be compared.
    """
    local = _in_frame(base_frame, points)
    each = np.array([_touch_information(point.role, at) for point, at in zip(points, local, strict=True)])
    information, again = each.sum(axis=0), list[int]()
    shares = _goal_shares(information, goal)
    while shares.max() > 1.0 and len(points) + len(again) < most:
        after = [_goal_shares(information + one, goal) for one in each]
        best = most_informative_touch(after)
        information, shares = information + each[best], after[best]
        again.append(best)
    if shares.max() <= 1.0 and len(points) + len(again) <= FIXING < most:
        spare = next(i for i, point in enumerate(points) if point.role == "origin")
        information = information + each[spare]
        shares = _goal_shares(information, goal)
        again.append(spare)
    return FramePrediction(
        again=tuple(again),
        reached=bool(shares.max() <= 1.0),
        origin_u_m=float(shares[:3].max()) * goal.origin_u_m,
        angle_u_rad=float(shares[3:].max()) * goal.angle_u_rad,
    )


def touches_needed_in_turn(base_frame: Pose, points: Sequence[FramePoint], goal: FrameGoal) -> int:
    """Return how many touches meet the goal, one to spare, if the three points are touched in turn."""
    local = _in_frame(base_frame, points)
    information = sum(_touch_information(point.role, at) for point, at in zip(points, local, strict=True))
    rounds = math.ceil(float(_goal_shares(np.asarray(information), goal).max()) ** 2 - 1e-9)
    return max(len(points) * rounds, FIXING + 1)


def _in_frame(base_frame: Pose, points: Sequence[FramePoint]) -> Array:
    local: Array = (
        np.array([point.at_m for point in points]) - base_frame.position_m
    ) @ base_frame.rotation_matrix()
    return local


def _touch_information(role: FrameRole, local_m: Array) -> Array:
    rows = miss_rows(local_m)[FIRST_FIXED[role] :]
    information: Array = rows.T @ rows
    return information


def _goal_shares(information: Array, goal: FrameGoal) -> Array:
    """Return the six expanded uncertainties (shift, turn) over their limits."""
    u = 2.0 * goal.sigma_m * np.sqrt(np.diag(np.linalg.inv(information)))
    shares: Array = u / np.repeat([goal.origin_u_m, goal.angle_u_rad], 3)
    return shares
