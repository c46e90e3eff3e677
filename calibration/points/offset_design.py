"""How well known points, touched again, will tell where their frame has gone, and which one is worth another touch.

The points' own places were found once: what is wrong with them stays, however often they are touched now. With n_i
touches of standard uncertainty s and given places of s_0, point i counts with ``s_0^2 + s^2 / n_i`` in what
`fixture.place_points` solves; its covariance is known before anything is touched.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.points.fixture import placing_covariance, worst_expanded_u
from cellcal.calibration.points.frame_design import FramePrediction
from cellcal.calibration.points.most_informative import most_informative_touch

Triple = tuple[float, float, float]
_MOST_ROUNDS = 100
_HERE = Pose((0.0, 0.0, 0.0))  # of touches alike in all directions the frame's own place says nothing


@dataclass(frozen=True, slots=True)
class OffsetGoal:
    """The uncertainty of touches and given places, one coordinate each, and the U that is asked for, k = 2."""

    sigma_m: float
    given_sigma_m: float
    origin_u_m: float
    angle_u_rad: float


def point_covariance(touches: Sequence[int], sigma_m: float, given_sigma_m: float) -> Array:
    """Return (3n, 3n) [m^2] of points that were touched so many times each, against where they were given."""
    variances = given_sigma_m**2 + sigma_m**2 / np.array(touches, dtype=float)
    covariance: Array = np.diag(np.repeat(variances, 3))
    return covariance


def predict_offset(
    points_in_frame_m: Sequence[Triple], touches: Sequence[int], goal: OffsetGoal, most: int
) -> FramePrediction:
    """Return which points to touch again so that the goal is met with few touches.

    Parameters
    ----------
    points_in_frame_m : n >= 3 points
        Not on one line.
    touches : n numbers
        How often each was touched, or will be in any case.
    most : int
        Touches in all, those included.

    Notes
    -----
    Greedy: each touch is the one that lowers origin and angle, over their limits, most.

    Raises
    ------
    DegenerateDataError
        Points that cannot fix a frame.
    """
    counts, again = list(touches), list[int]()
    shares = _goal_shares(points_in_frame_m, counts, goal)
    while shares.max() > 1.0 and sum(counts) < most:
        after = [_goal_shares(points_in_frame_m, _add_touch(counts, k), goal) for k in range(len(counts))]
        best = most_informative_touch(after)
        counts, shares = _add_touch(counts, best), after[best]
        again.append(best)
    return FramePrediction(
        again=tuple(again),
        reached=bool(shares.max() <= 1.0),
        origin_u_m=float(shares[0]) * goal.origin_u_m,
        angle_u_rad=float(shares[1]) * goal.angle_u_rad,
    )


def touches_needed_in_rounds(points_in_frame_m: Sequence[Triple], goal: OffsetGoal) -> int | None:
    """Return how many touches meet the goal if all points are touched in turn; None where no number does."""
    count = len(points_in_frame_m)
    for rounds in range(1, _MOST_ROUNDS + 1):
        if _goal_shares(points_in_frame_m, [rounds] * count, goal).max() <= 1.0:
            return rounds * count
    return None


def _add_touch(counts: list[int], index: int) -> list[int]:
    return [count + (k == index) for k, count in enumerate(counts)]


def _goal_shares(points: Sequence[Triple], counts: Sequence[int], goal: OffsetGoal) -> Array:
    """Return origin and angle, expanded uncertainties over their limits."""
    total = point_covariance(counts, goal.sigma_m, goal.given_sigma_m)
    spread = placing_covariance(_HERE, points, total, 0.0)
    u = np.array([worst_expanded_u(spread[:3, :3]), worst_expanded_u(spread[3:, 3:])])
    shares: Array = u / [goal.origin_u_m, goal.angle_u_rad]
    return shares
