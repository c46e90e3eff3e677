"""Numbers that cannot be metres, points in another order, frames that hang: refused where they come in."""

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Pose, exp_rotation, exp_twist
from cellcal.calibration.mastering.counts import RecoveryKit
from cellcal.calibration.points.end_effector import refuse_tool_points
from cellcal.calibration.points.fixture import refuse_bad_points
from cellcal.calibration.points.frames import frame_from_three_points, is_pointing_down
from cellcal.calibration.points.tool_point import locate_tool_point, tool_pose
from cellcal.calibration.registration import best_fit_transform, trilaterate_point
from cellcal.calibration.wires.model import WirePrior
from cellcal.procedures.three_point_frame import DEFINITION, FrameSetup, ThreePointFrame
from tests.unit.test_tool_point import noisy_touches

TRIANGLE = [(0.4, 0.1, 0.2), (0.7, 0.1, 0.2), (0.4, 0.35, 0.2)]


@pytest.mark.parametrize(
    "refuses",
    [
        lambda: frame_from_three_points(*(1e3 * np.array(TRIANGLE))),
        lambda: refuse_bad_points(1e3 * np.array(TRIANGLE)),
        lambda: refuse_tool_points([(10.0, 0.0, 180.0)]),
        lambda: tool_pose((0.0, 0.0, 180.0)),
        lambda: WirePrior((900.0, -700.0, -400.0), (0.0, 0.0, 0.1)),
        lambda: WirePrior((0.9, -0.7, -0.4), (0.0, 0.0, 180.0)),
        lambda: RecoveryKit((0.0, 0.0, 180.0), ()),
        lambda: locate_tool_point(
            [Pose(tuple(1e3 * np.array(t.position_m)), t.quaternion) for t in noisy_touches(1, 0.0)]
        ),
    ],
)
def test_millimetres_for_metres_are_refused(refuses):
    with pytest.raises(CalibrationError, match="m cannot be right"):
        refuses()


def drawing_and_places(count, seed=0):
    rng = np.random.default_rng(seed)
    drawing = rng.uniform(-0.4, 0.4, (count, 3))
    frame = exp_twist(rng.uniform(-1, 1, 6))
    return drawing, drawing @ frame[:3, :3].T + frame[:3, 3] + 1e-4 * rng.standard_normal((count, 3))


@pytest.mark.parametrize(
    ("count", "order"),
    [
        (3, [1, 0, 2]),
        (4, [0, 2, 1, 3]),
        (6, [5, 4, 3, 2, 1, 0]),
        (12, [0, 7, 2, 3, 4, 5, 6, 1, 8, 9, 10, 11]),
    ],
)
def test_an_order_that_fits_twenty_times_better_is_named(count, order):
    drawing, places = drawing_and_places(count)
    best_fit_transform(drawing, places)
    with pytest.raises(CalibrationError, match="times better in another order") as refused:
        best_fit_transform(drawing, places[order])
    expected_order = ", ".join(str(order.index(at) + 1) for at in range(count))
    assert expected_order in refused.value.message


def test_points_that_no_order_mends_are_left_to_others():
    drawing, places = drawing_and_places(5)
    places[2] += 0.02
    assert best_fit_transform(drawing, places).max_m > 5e-3


def test_a_frame_that_hangs_has_two_points_swapped():
    origin, x, y = TRIANGLE
    up = (0.0, 0.0, 1.0)
    assert not is_pointing_down(frame_from_three_points(origin, x, y).base_frame, up)
    tilted = exp_rotation(np.array([np.deg2rad(80.0), 0.0, 0.0]))
    assert not is_pointing_down(frame_from_three_points(*(np.array(TRIANGLE) @ tilted.T)).base_frame, up)
    for swapped in ((origin, y, x), (x, origin, y)):
        taught = frame_from_three_points(*swapped)
        assert is_pointing_down(taught.base_frame, up)
        with pytest.raises(CalibrationError, match="z points the wrong way"):
            frame_from_three_points(*swapped, above_m=(0.5, 0.2, 0.3))


@pytest.mark.parametrize(("order", "hangs"), [((0, 1, 2), 0), ((0, 2, 1), 1), ((1, 0, 2), 1)])
def test_a_verdict_on_a_frame_says_that_it_hangs(order, hangs):
    taught = frame_from_three_points(*(TRIANGLE[at] for at in order), sigma_m=1e-4)
    spec = ThreePointFrame(1, (0.0, 0.0, 0.1))
    setup = FrameSetup(1, taught, Pose((0.0, 0.0, 0.0)), taught.base_frame)
    not_verified = DEFINITION.verdict(spec, setup).not_verified
    assert sum("points down" in each for each in not_verified) == hangs


def test_a_kit_in_metres_is_taken():
    assert not RecoveryKit((0.0, 0.0, 0.18), ()).places


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_two_corners_of_a_rectangle_that_changed_places_are_named(turn):
    corners = np.array([(0, 0, 0), (0.5, 0, 0), (0.5, 0.3, 0), (0, 0.3, 0)], dtype=float)
    places = corners @ exp_rotation(np.array([0.3, 0.2, turn])).T + np.array([1.2, 0.1, 0.4])
    with pytest.raises(CalibrationError, match="times better in another order: 1, 3, 2, 4"):
        best_fit_transform(corners, places[[0, 2, 1, 3]])


def test_points_that_fit_no_rotation_are_refused_with_a_cure():
    corners = np.array([(0, 0, 0), (0.5, 0, 0), (0.5, 0.3, 0), (0, 0.3, 0)], dtype=float)
    with pytest.raises(CalibrationError, match="fit no rotation") as refused:
        best_fit_transform(corners, np.ones((4, 3)))
    assert refused.value.remedy


@pytest.mark.parametrize("count", [8, 12, 30])
@pytest.mark.parametrize("seed", range(4))
def test_any_order_of_many_points_is_named(count, seed):
    drawing, places = drawing_and_places(count, seed)
    order = np.random.default_rng(100 + seed).permutation(count).tolist()
    with pytest.raises(CalibrationError, match="times better in another order") as refused:
        best_fit_transform(drawing, places[order])
    expected_order = ", ".join(str(order.index(at) + 1) for at in range(count))
    assert expected_order in refused.value.message


@pytest.mark.parametrize("scales", [(1.0, 1e3), (1e3, 1.0), (1e3, 1e3)])
def test_millimetres_in_a_fit_of_points_are_refused(scales):
    drawing, places = drawing_and_places(5)
    with pytest.raises(CalibrationError, match="m cannot be right"):
        best_fit_transform(drawing * scales[0], (places + np.array([2.0, 0.0, 0.0])) * scales[1])


@pytest.mark.parametrize("scales", [(1.0, 1e3), (1e3, 1.0), (1e3, 1e3)])
def test_millimetres_in_a_place_from_lengths_are_refused(scales):
    stations = np.array([(0, 0, 0), (2, 0, 0), (0, 2, 0), (0, 0, 2)], dtype=float)
    lengths = np.linalg.norm(stations - (0.7, 0.6, 0.3), axis=1)
    with pytest.raises(CalibrationError, match="m cannot be right"):
        trilaterate_point(stations * scales[0], lengths * scales[1])
