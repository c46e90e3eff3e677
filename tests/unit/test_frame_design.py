"""Which points of a user frame are touched again: foreseen is what the fit says, and few touches do."""

from itertools import combinations_with_replacement

import numpy as np
import pytest

from cellcal.calibration.geometry import (
    Pose,
    exp_rotation,
    homogeneous_matrix,
    inverse_transform,
    log_transform,
)
from cellcal.calibration.points.frame_design import (
    FrameGoal,
    FramePoint,
    FrameRole,
    predict_frame,
    touches_needed_in_turn,
)
from cellcal.calibration.points.frames import TaughtFrame, frame_from_more_points

SIGMA_M = 0.0005
ROLES: tuple[FrameRole, ...] = ("origin", "on_x", "in_plane")


def _draw_triangle(seed: int) -> tuple[Pose, list[FramePoint]]:
    rng = np.random.default_rng(seed)
    matrix = homogeneous_matrix(exp_rotation(rng.uniform(-2, 2, 3)), rng.uniform(-1, 1, 3))
    local = [
        (0.0, 0.0, 0.0),
        (rng.uniform(0.1, 0.8), 0.0, 0.0),
        (rng.uniform(-0.2, 0.5), rng.uniform(0.1, 0.6), 0.0),
    ]
    at = [matrix[:3, :3] @ np.array(place) + matrix[:3, 3] for place in local]
    points = [FramePoint(role, tuple(map(float, place))) for role, place in zip(ROLES, at, strict=True)]
    return Pose.from_matrix(matrix), points


def _fit_frame(points: list[FramePoint], noise: np.ndarray | None = None) -> TaughtFrame:
    shift = np.zeros((len(points), 3)) if noise is None else noise
    at = {
        role: [np.array(p.at_m) + d for p, d in zip(points, shift, strict=True) if p.role == role]
        for role in ROLES
    }
    return frame_from_more_points(at["origin"], at["on_x"], at["in_plane"], sigma_m=SIGMA_M)


def _frame_u(taught: TaughtFrame) -> tuple[float, float]:
    return 2.0 * max(taught.origin_sigma_m), 2.0 * max(taught.rotation_sigma_rad)


@pytest.mark.parametrize("seed", range(12))
def test_what_is_foreseen_is_what_the_fit_says(seed: int) -> None:
    base_frame, points = _draw_triangle(seed)
    goal = FrameGoal(SIGMA_M, 0.0006, 0.003)
    prediction = predict_frame(base_frame, points, goal, 60)
    origin_u, angle_u = _frame_u(_fit_frame([*points, *(points[k] for k in prediction.again)]))
    assert (prediction.origin_u_m, prediction.angle_u_rad) == pytest.approx((origin_u, angle_u), rel=1e-6)
    assert prediction.reached
    assert origin_u <= goal.origin_u_m
    assert angle_u <= goal.angle_u_rad
    if prediction.again:  # the last touch was needed
        origin_u, angle_u = _frame_u(_fit_frame([*points, *(points[k] for k in prediction.again[:-1])]))
        assert origin_u > goal.origin_u_m or angle_u > goal.angle_u_rad


@pytest.mark.parametrize("seed", range(8))
def test_few_touches_do(seed: int) -> None:
    base_frame, points = _draw_triangle(100 + seed)
    goal = FrameGoal(SIGMA_M, 0.0008, 0.004)
    found = len(predict_frame(base_frame, points, goal, 40).again)
    in_turn = touches_needed_in_turn(base_frame, points, goal)
    assert 3 + found <= in_turn
    least = next(count for count in range(40) if _some_choice_does(points, goal, count))
    assert found <= least + 1


def _some_choice_does(points: list[FramePoint], goal: FrameGoal, count: int) -> bool:
    return any(
        all(
            u <= limit
            for u, limit in zip(
                _frame_u(_fit_frame([*points, *more])), (goal.origin_u_m, goal.angle_u_rad), strict=True
            )
        )
        for more in combinations_with_replacement(points, count)
    )


def test_in_turn_is_the_count_at_which_the_fit_meets_the_goal() -> None:
    base_frame, points = _draw_triangle(7)
    goal = FrameGoal(SIGMA_M, 0.0005, 0.002)
    rounds, rest = divmod(touches_needed_in_turn(base_frame, points, goal), 3)
    assert rest == 0
    met = [
        all(np.array(_frame_u(_fit_frame(points * n))) <= (goal.origin_u_m, goal.angle_u_rad))
        for n in (rounds - 1, rounds)
    ]
    assert met == [False, True]


def test_out_of_reach_is_reported_with_what_could_be_reached() -> None:
    base_frame, points = _draw_triangle(3)
    prediction = predict_frame(base_frame, points, FrameGoal(SIGMA_M, 1e-5, 1e-5), 12)
    assert not prediction.reached
    assert len(prediction.again) == 9
    assert prediction.origin_u_m == pytest.approx(
        _frame_u(_fit_frame([*points, *(points[k] for k in prediction.again)]))[0]
    )
    three = predict_frame(base_frame, points, FrameGoal(SIGMA_M, 1e-5, 1e-5), 3)
    assert three.again == ()
    assert three.origin_u_m > prediction.origin_u_m


def test_the_truth_lies_inside_u() -> None:
    base_frame, points = _draw_triangle(11)
    goal = FrameGoal(SIGMA_M, 0.0006, 0.002)
    points += [points[k] for k in predict_frame(base_frame, points, goal, 60).again]
    rng, inside, runs = np.random.default_rng(5), np.zeros(6), 2000
    for _ in range(runs):
        taught = _fit_frame(points, rng.normal(0.0, SIGMA_M * 0.9, (len(points), 3)))
        error = log_transform(inverse_transform(base_frame.to_matrix()) @ taught.base_frame.to_matrix())
        inside += np.abs(error) <= 2.0 * 0.9 * np.array([*taught.origin_sigma_m, *taught.rotation_sigma_rad])
    assert (inside / runs > 0.935).all()
    assert (inside / runs < 0.97).all()
