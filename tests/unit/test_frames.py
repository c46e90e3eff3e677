"""Frames from points, and Equations 7 to 12 of the textbook."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Pose, exp_rotation, homogeneous_matrix, log_transform
from cellcal.calibration.points.frames import (
    base_to_base,
    clone_frame_change,
    frame_from_many_points,
    frame_from_six_points,
    frame_from_three_points,
    frame_offset,
    moved_point,
)

TRUTH = homogeneous_matrix(exp_rotation(np.array([0.2, -0.5, 1.4])), np.array([1.2, -0.3, 0.4]))


def transform_point(*point, matrix=TRUTH):
    return matrix[:3, :3] @ np.array(point, dtype=float) + matrix[:3, 3]


def draw_pose(seed: int) -> Pose:
    rng = np.random.default_rng(seed)
    return Pose.from_matrix(
        homogeneous_matrix(exp_rotation(rng.uniform(-1.5, 1.5, 3)), rng.uniform(-1, 1, 3))
    )


@settings(max_examples=50, deadline=None)
@given(st.floats(0.05, 2), st.floats(-1, 1), st.floats(0.3, 2))
def test_three_points_give_the_frame(length, skew, height):
    found = frame_from_three_points(
        transform_point(0, 0, 0),
        transform_point(length, 0, 0),
        transform_point(skew, height, 0),
        above_m=transform_point(0.3, 0.2, 0.1),
    )
    assert np.allclose(found.base_frame.to_matrix(), TRUTH, atol=1e-12)
    assert found.opening_rad == pytest.approx(math.atan2(height, skew))
    assert found.x_length_m == pytest.approx(length)


def test_a_point_below_shows_the_wrong_order():
    with pytest.raises(CalibrationError, match=r"100\.0 mm below"):
        frame_from_three_points(
            transform_point(0, 0, 0),
            transform_point(1, 0, 0),
            transform_point(0, 1, 0),
            above_m=transform_point(0.3, 0.2, -0.1),
        )


def test_the_fourth_point_moves_the_origin_and_keeps_the_axes():
    found = frame_from_three_points(
        transform_point(0, 0, 0),
        transform_point(1, 0, 0),
        transform_point(0, 1, 0),
        origin_at_m=transform_point(0.1, 0.2, 0.3),
    )
    assert np.allclose(found.base_frame.rotation_matrix(), TRUTH[:3, :3])
    assert np.allclose(found.base_frame.position_m, transform_point(0.1, 0.2, 0.3))


@pytest.mark.parametrize(
    "points",
    [
        (transform_point(0, 0, 0), transform_point(0.01, 0, 0), transform_point(0, 1, 0)),
        (transform_point(0, 0, 0), transform_point(1, 0, 0), transform_point(0.01, 0.01, 0)),
        (transform_point(0, 0, 0), transform_point(1, 0, 0), transform_point(2, 0.05, 0)),
        (transform_point(0, 0, 0), transform_point(1, 0, 0), transform_point(-2, 0, 0)),
    ],
)
def test_points_too_close_or_on_a_line_are_refused(points):
    with pytest.raises(DegenerateDataError) as refused:
        frame_from_three_points(*points)
    assert refused.value.remedy


@pytest.mark.parametrize("bad", [(math.nan, 0, 0), (math.inf, 0, 0), (0.0, 0.0)])
def test_bad_coordinates_are_refused(bad):
    with pytest.raises(ValueError):  # noqa: PT011  # numpy refuses a ragged list with its own ValueError
        frame_from_three_points(bad, (1, 0, 0), (0, 1, 0))


def test_the_stated_uncertainty_is_the_scatter():
    points = [transform_point(0, 0, 0), transform_point(0.5, 0, 0), transform_point(0.1, 0.3, 0)]
    stated = frame_from_three_points(*points, sigma_m=1e-4)
    rng = np.random.default_rng(3)
    twists = []
    for _ in range(1500):
        found = frame_from_three_points(*(p + rng.normal(scale=1e-4, size=3) for p in points))
        twists.append(log_transform(np.linalg.inv(TRUTH) @ found.base_frame.to_matrix()))
    sigma = np.concatenate([stated.origin_sigma_m, stated.rotation_sigma_rad])
    assert np.allclose(np.std(twists, axis=0), sigma, rtol=0.08)


def test_about_y_and_z_the_frame_turns_by_point_error_over_length():
    found = frame_from_three_points((0, 0, 0), (0.5, 0, 0), (0, 0.5, 0), sigma_m=1e-4)
    assert found.rotation_sigma_rad[1] == pytest.approx(math.sqrt(2) * 1e-4 / 0.5, rel=1e-6)
    assert found.rotation_sigma_rad[2] == pytest.approx(math.sqrt(2) * 1e-4 / 0.5, rel=1e-6)


PLANE = [transform_point(0.1, 0.1, 0), transform_point(0.6, 0.15, 0), transform_point(0.2, 0.5, 0)]
LINE = [transform_point(0.05, 0, -0.02), transform_point(0.55, 0, -0.03)]
STOP = transform_point(0, 0.3, -0.02)


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2), (2, 1, 0)])
def test_three_two_one_points_give_the_frame_in_any_order_on_the_plane(order):
    found = frame_from_six_points(
        [PLANE[i] for i in order], LINE, STOP, above_m=transform_point(0, 0, 1), sigma_m=1e-4
    )
    assert np.allclose(found.base_frame.to_matrix(), TRUTH, atol=1e-12)
    # The stop is 0.3 m from the origin, and the line, 0.5 m long, turns the frame under it.
    assert found.origin_sigma_m[0] == pytest.approx(1e-4 * math.sqrt(1 + 2 * (0.3 / 0.5) ** 2), rel=1e-2)


@pytest.mark.parametrize(
    ("plane", "line"),
    [
        ([PLANE[0], PLANE[1], transform_point(1.1, 0.2, 0)], LINE),
        (PLANE, [LINE[0], transform_point(0.06, 0, 0.4)]),
        (PLANE[:2], LINE),
    ],
    ids=["plane on a line", "line along the normal", "two points"],
)
def test_six_points_that_make_no_frame_are_refused(plane, line):
    with pytest.raises(CalibrationError):
        frame_from_six_points(plane, line, STOP, above_m=transform_point(0, 0, 1))


def test_many_points_of_a_drawing_give_the_frame():
    drawn = np.random.default_rng(1).uniform(0, 0.5, (6, 3))
    fit = frame_from_many_points(drawn, [transform_point(*p) for p in drawn])
    assert np.allclose(fit.target_source.to_matrix(), TRUTH, atol=1e-12)


def test_a_moved_workpiece_carries_its_points_along():
    base_frame, base_frame_moved, frame_tcp = draw_pose(1), draw_pose(2), draw_pose(3)
    in_old_frame = moved_point(frame_offset(base_frame, base_frame_moved), frame_tcp)
    assert np.allclose(
        (base_frame @ in_old_frame).to_matrix(), (base_frame_moved @ frame_tcp).to_matrix(), atol=1e-12
    )


def test_a_frame_that_did_not_move_leaves_the_points():
    assert np.allclose(frame_offset(draw_pose(1), draw_pose(1)).to_matrix(), np.eye(4), atol=1e-12)


def test_a_cloned_point_is_at_the_same_place_on_the_fixture():
    base_fix, other_fix, base_frame, other_frame, frame_tcp = (draw_pose(i) for i in range(10, 15))
    change = clone_frame_change(base_frame, other_frame, base_to_base(base_fix, other_fix))
    on_fixture = base_fix.inverse() @ base_frame @ frame_tcp
    on_other_fixture = other_fix.inverse() @ other_frame @ change @ frame_tcp
    assert np.allclose(on_fixture.to_matrix(), on_other_fixture.to_matrix(), atol=1e-12)
