"""What touching known points again will tell of a moved frame, against what a fit states and how far it is off."""

import numpy as np
import pytest

from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Pose
from cellcal.calibration.points.fixture import place_points
from cellcal.calibration.points.offset_design import (
    OffsetGoal,
    point_covariance,
    predict_offset,
    touches_needed_in_rounds,
)

POINTS = ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.0, 0.4, 0.0))
MOVED = Pose((0.3, -0.2, 0.1), (0.9238795325112867, 0.0, 0.0, 0.3826834323650898))


def _move_points(points: np.ndarray) -> np.ndarray:
    moved: np.ndarray = points @ MOVED.rotation_matrix().T + np.array(MOVED.position_m)
    return moved


def test_the_fit_states_what_was_foretold_and_is_off_by_that() -> None:
    goal = OffsetGoal(sigma_m=0.0004, given_sigma_m=0.0001, origin_u_m=0.0007, angle_u_rad=0.05)
    foretold = predict_offset(POINTS, (1, 1, 1), goal, 12)
    assert foretold.reached
    assert foretold.again  # three touches are not enough
    counts = [1 + foretold.again.count(k) for k in range(3)]
    covariance = point_covariance(counts, goal.sigma_m, goal.given_sigma_m)
    rng, points, inside = np.random.default_rng(3), np.array(POINTS), 0
    for _ in range(300):
        drawing_points = points + rng.normal(0.0, goal.given_sigma_m, points.shape)
        touches = [
            _move_points(points[k]) + rng.normal(0.0, goal.sigma_m, (counts[k], 3)).mean(axis=0)
            for k in range(3)
        ]
        placed = place_points(drawing_points, touches, covariance, sigma_point_m=0.0)
        assert placed.origin_u_m == pytest.approx(foretold.origin_u_m, rel=0.02)
        off = np.subtract(placed.outer_inner.position_m, MOVED.position_m)
        inside += bool(np.abs(off).max() <= placed.origin_u_m)
    assert inside > 0.85 * 300  # three coordinates at once, each at 95 % or better


def test_only_as_many_touches_as_the_goal_takes_and_no_more_than_the_points_in_turn() -> None:
    goal = OffsetGoal(sigma_m=0.0005, given_sigma_m=0.0, origin_u_m=0.0006, angle_u_rad=0.1)
    found = predict_offset(POINTS, (1, 1, 1), goal, 60)
    one_less = predict_offset(POINTS, (1, 1, 1), goal, 2 + len(found.again))
    in_turn = touches_needed_in_rounds(POINTS, goal)
    assert found.reached
    assert not one_less.reached
    assert in_turn is not None
    assert 3 + len(found.again) < in_turn  # the origin asks for its own point first
    assert found.again.count(0) > found.again.count(1)


def test_what_is_wrong_with_the_given_points_stays_however_often_they_are_touched() -> None:
    goal = OffsetGoal(sigma_m=0.0005, given_sigma_m=0.0005, origin_u_m=0.0004, angle_u_rad=0.1)
    assert not predict_offset(POINTS, (1, 1, 1), goal, 100).reached
    assert touches_needed_in_rounds(POINTS, goal) is None


def test_points_that_fix_no_frame_are_refused() -> None:
    goal = OffsetGoal(0.0005, 0.0005, 0.002, 0.01)
    with pytest.raises((DegenerateDataError, np.linalg.LinAlgError)):
        predict_offset(((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.0, 0.0)), (1, 1, 1), goal, 12)
