"""Best-fit transforms and trilateration."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Pose, exp_rotation, exp_twist, homogeneous_matrix, log_transform
from cellcal.calibration.points.frames import frame_from_three_points
from cellcal.calibration.points.tool_point import locate_tool_point
from cellcal.calibration.registration import best_fit_transform, trilaterate_point

RNG = np.random.default_rng(5)
POINTS = RNG.uniform(-1, 1, (8, 3))
TRUTH = homogeneous_matrix(exp_rotation(np.array([0.4, -1.3, 2.2])), np.array([2.0, -1.0, 0.5]))


def transform_points(points, matrix=TRUTH):
    return points @ matrix[:3, :3].T + matrix[:3, 3]


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(-4, 4), min_size=3, max_size=3),
    st.lists(st.floats(-5, 5), min_size=3, max_size=3),
    st.integers(3, 8),
)
def test_exact_pairs_give_the_exact_transform(turn, shift, count):
    matrix = homogeneous_matrix(exp_rotation(np.array(turn)), np.array(shift))
    fit = best_fit_transform(POINTS[:count], transform_points(POINTS[:count], matrix))
    assert np.allclose(fit.target_source.to_matrix(), matrix, atol=1e-12)
    assert fit.max_m < 1e-12


def test_three_points_in_a_plane_are_enough_and_no_reflection():
    flat = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.1, 0.4, 0]])
    assert np.allclose(
        best_fit_transform(flat, transform_points(flat)).target_source.to_matrix(), TRUTH, atol=1e-12
    )


def test_no_other_transform_is_closer():
    target = transform_points(POINTS) + RNG.normal(scale=1e-2, size=POINTS.shape)
    fit = best_fit_transform(POINTS, target)
    least = ((transform_points(POINTS, fit.target_source.to_matrix()) - target) ** 2).sum()
    for axis in np.vstack([np.eye(6), -np.eye(6)]) * 1e-4:
        other = fit.target_source @ Pose.from_matrix(homogeneous_matrix(exp_rotation(axis[3:]), axis[:3]))
        assert ((transform_points(POINTS, other.to_matrix()) - target) ** 2).sum() > least


def test_covariance_is_the_scatter_of_repeated_fits():
    twists, stated = [], None
    for seed in range(1500):
        noise = np.random.default_rng(seed).normal(scale=1e-3, size=POINTS.shape)
        fit = best_fit_transform(POINTS, transform_points(POINTS) + noise, sigma_m=1e-3)
        twists.append(log_transform(np.linalg.inv(TRUTH) @ fit.target_source.to_matrix()))
        stated = np.array(fit.covariance)
    scatter = np.cov(np.array(twists).T)
    assert np.allclose(np.sqrt(np.diag(scatter)), np.sqrt(np.diag(stated)), rtol=0.08)


def test_a_far_point_is_less_sure_than_one_among_the_measured():
    fit = best_fit_transform(POINTS, transform_points(POINTS), sigma_m=1e-3)
    centre = POINTS.mean(axis=0)
    assert fit.sigma_at(centre) == pytest.approx(1e-3 * np.sqrt(3 / 8), rel=1e-6)
    assert fit.sigma_at(centre + np.array([5, 0, 0])) > 4 * fit.sigma_at(centre)


def test_the_worst_pair_is_named():
    target = transform_points(POINTS)
    target[5] += [0, 0, 0.02]
    fit = best_fit_transform(POINTS, target)
    assert fit.worst_pair == 5
    assert fit.max_m > 3 * fit.rms_m


@pytest.mark.parametrize(
    ("source", "target", "kind"),
    [
        (POINTS[:2], POINTS[:2], DegenerateDataError),
        (np.outer([0, 1, 2, 3.0], [1, 2, 3.0]), np.outer([0, 1, 2, 3.0], [1, 2, 3.0]), DegenerateDataError),
        (np.zeros((4, 3)), np.zeros((4, 3)), DegenerateDataError),
        (POINTS, POINTS[:4], CalibrationError),
        (POINTS, np.full((8, 3), np.nan), CalibrationError),
        (POINTS, POINTS * [1, 1, -1], CalibrationError),
    ],
    ids=["two", "line", "one place", "unpaired", "nan", "mirror"],
)
def test_pairs_that_make_no_frame_are_refused(source, target, kind):
    with pytest.raises(kind):
        best_fit_transform(source, target)


STATIONS = np.array([[0.0, 0, 0], [1.5, 0.1, 0], [0.2, 1.4, 0.1], [0.6, 0.5, 0.9], [1.2, 1.1, 0.4]])
ANCHOR = np.array([0.9, -0.7, -0.45])
LENGTHS = np.linalg.norm(STATIONS - ANCHOR, axis=1)


@pytest.mark.parametrize("zero", [0.0, 0.013, -0.2])
def test_an_anchor_and_a_zero_are_found(zero):
    found = trilaterate_point(STATIONS, LENGTHS + zero, fit_zero=True)
    assert np.allclose(found.point_m, ANCHOR, atol=1e-9)
    assert found.zero_m == pytest.approx(zero, abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_any_anchor_is_found_from_stations_in_space(anchor):
    lengths = np.linalg.norm(STATIONS - anchor, axis=1)
    if lengths.min() > 0.05:
        found = trilaterate_point(STATIONS, lengths, sigma_m=1e-4, near_m=anchor)
        assert np.allclose(found.point_m, anchor, atol=1e-7)


def test_stations_in_a_plane_see_two_places_and_a_hint_decides():
    flat = STATIONS * [1, 1, 0]
    lengths = np.linalg.norm(flat - ANCHOR, axis=1)
    with pytest.raises(DegenerateDataError, match=r"two places.*-0\.45"):
        trilaterate_point(flat, lengths)
    found = trilaterate_point(flat, lengths, near_m=(1.0, -0.5, -1.0))
    assert np.allclose(found.point_m, ANCHOR, atol=1e-9)
    mirrored = trilaterate_point(flat, lengths, near_m=(1.0, -0.5, 1.0))
    assert np.allclose(mirrored.point_m, ANCHOR * [1, 1, -1], atol=1e-9)


def test_three_lengths_say_how_sure_only_with_a_known_sigma():
    with pytest.raises(DegenerateDataError, match="no residual"):
        trilaterate_point(STATIONS[:3], LENGTHS[:3], near_m=ANCHOR)
    found = trilaterate_point(STATIONS[:3], LENGTHS[:3], near_m=ANCHOR, sigma_m=1e-4)
    assert np.allclose(found.point_m, ANCHOR, atol=1e-9)
    assert min(found.point_sigma_m) > 1e-5


def test_the_stated_sigma_is_the_scatter():
    rng = np.random.default_rng(11)
    found = [
        trilaterate_point(STATIONS, LENGTHS + rng.normal(scale=2e-4, size=5), sigma_m=2e-4)
        for _ in range(800)
    ]
    scatter = np.std([f.point_m for f in found], axis=0)
    assert np.allclose(scatter, found[0].point_sigma_m, rtol=0.1)


@pytest.mark.parametrize(
    ("stations", "lengths"),
    [
        (STATIONS[:2], LENGTHS[:2]),
        (np.outer([0, 1, 2, 3.0], [1, 0, 0.0]), [1, 1, 2, 3.0]),
        (STATIONS, [*LENGTHS[:4], -1.0]),
        (STATIONS, LENGTHS[:4]),
    ],
    ids=["two", "line", "negative", "unpaired"],
)
def test_lengths_that_fix_no_point_are_refused(stations, lengths):
    with pytest.raises(CalibrationError):
        trilaterate_point(stations, lengths)


@pytest.mark.parametrize(
    "found",
    [
        best_fit_transform(POINTS, transform_points(POINTS)),
        trilaterate_point(STATIONS, LENGTHS),
        frame_from_three_points(*POINTS[:3], sigma_m=1e-4),
        locate_tool_point([Pose.from_matrix(exp_twist(np.array([0, 0, 0, *turn]))) for turn in np.eye(3)]),
    ],
    ids=["fit", "trilateration", "frame", "tool point"],
)
def test_every_result_survives_the_journal(found):
    adapter = TypeAdapter(type(found))
    assert adapter.validate_json(adapter.dump_json(found)) == found
