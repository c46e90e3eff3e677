"""Exits and hooks of one wire, frames from their points, and what cannot be told apart."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Pose, exp_twist, log_transform
from cellcal.calibration.points.alignment import Alignment, alignment_text, read_alignments
from cellcal.calibration.points.fixture import (
    base_through_fixture,
    mirror_gaps,
    mirror_image,
    place_points,
    refuse_bad_points,
)
from cellcal.calibration.wires.network_fit import fit_network
from tests.unit.helpers.fixture_world import (
    MODEL,
    MOUTH,
    POINTS,
    ROUGH,
    FixtureWorld,
    align_world,
    designed_poses,
    fixture_network_prior,
    wire_mounting,
)

DIAGONAL = np.diag([1e-4**2] * 12)


def test_the_fixture_of_the_hidden_world_is_found_and_its_uncertainty_holds() -> None:
    found = [align_world(FixtureWorld(seed), 16) for seed in range(1, 7)]
    errors, us = np.array([f.pose_error for f in found]), np.array([f.stated_u_of_axes for f in found])
    assert (np.abs(errors) <= us).mean() > 0.8  # 36 axes; the campaign says 95 % of hundreds
    assert np.linalg.norm(errors[:, :3], axis=1).max() < 0.0004
    assert max(f.placed.origin_u_m for f in found) < 0.0003
    assert max(f.placed.angle_u_rad for f in found) < math.radians(0.03)
    assert all(f.network.is_consistent() and f.placed.is_consistent() for f in found)


def _make_mountings(world: FixtureWorld) -> list:
    record, *spots = designed_poses(False, 16)
    mountings = [wire_mounting(0, 0, record, world.measure_lengths(record), another_day=True)]
    for point, poses in enumerate(spots, 1):
        world.gauge.mount_exit(point, MOUTH)
        mountings.append(wire_mounting(point, 0, poses, world.measure_lengths(poses), MOUTH))
    return mountings


def test_one_wrong_length_is_named_with_its_mounting_and_capture() -> None:
    mountings = _make_mountings(FixtureWorld(2))
    lengths = list(mountings[3].lengths_m)
    lengths[5] += 0.004
    mountings[3] = replace(mountings[3], lengths_m=tuple(lengths))
    network = fit_network(MODEL, fixture_network_prior(), mountings)
    assert not network.is_consistent()
    assert (network.worst_mounting, network.worst_capture) == (3, 5)


def test_an_adaptor_on_another_seat_shows_as_a_wrong_shape_with_the_pair_named() -> None:
    world = FixtureWorld(3)
    mountings = _make_mountings(world)
    found = fit_network(MODEL, fixture_network_prior(), mountings)
    exits = [np.array(e) for e in found.exits_m[1:]]
    exits[2][1] += 0.003
    covariance = found.exit_covariance([1, 2, 3, 4])
    placed = place_points(POINTS, [tuple(e) for e in exits], covariance, sigma_point_m=2e-5)
    assert not placed.is_consistent()
    assert 2 in placed.worst_pair
    assert abs(placed.worst_gap_m) > 0.001


@pytest.mark.parametrize(
    ("field", "value"),
    [("lengths_m", math.nan), ("lengths_m", math.inf), ("sigma_m", 0.0), ("sigma_m", math.nan)],
)
def test_numbers_that_cannot_be_measured_are_refused(field: str, value: float) -> None:
    mountings = _make_mountings(FixtureWorld(1))
    values = (value, *getattr(mountings[1], field)[1:])
    with pytest.raises(CalibrationError):
        fit_network(MODEL, fixture_network_prior(), [replace(mountings[1], **{field: values})])


def test_two_lengths_or_an_undescribed_place_are_refused() -> None:
    joints = designed_poses(False, 16)[1]
    few = wire_mounting(1, 0, joints[:2], np.ones(2))
    with pytest.raises(DegenerateDataError, match="fewer than three"):
        fit_network(MODEL, fixture_network_prior(), [few])
    with pytest.raises(CalibrationError, match="is not described"):
        fit_network(MODEL, fixture_network_prior(), [wire_mounting(9, 0, joints, np.ones(len(joints)))])
    with pytest.raises(DegenerateDataError):
        fit_network(MODEL, fixture_network_prior(), [])


def test_a_frame_from_points_weighs_them_by_their_covariance() -> None:
    true = Pose.from_matrix(exp_twist(np.array([0.9, 0.1, -0.2, 0.1, -0.2, 0.3])))
    found = [tuple(true.rotation_matrix() @ np.array(p) + np.array(true.position_m)) for p in POINTS]
    exact = place_points(POINTS, found, DIAGONAL, sigma_point_m=1e-6)
    assert np.allclose(exact.outer_inner.to_matrix(), true.to_matrix(), atol=1e-12)
    found[0] = (found[0][0] + 0.01, *found[0][1:])
    loose = DIAGONAL.copy()
    loose[:3, :3] = np.eye(3)
    weighed = place_points(POINTS, found, loose, sigma_point_m=1e-6)
    assert np.allclose(weighed.outer_inner.to_matrix(), true.to_matrix(), atol=1e-6)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (POINTS[:2], "do not fix"),
        (((0, 0, 0), (0.3, 0, 0), (0.6, 0.01, 0)), "one line"),
        (((0, 0, 0), (0.3, 0, 0), (0.31, 0.02, 0)), "apart"),
        (((0, 0, 0), (0.3, 0, 0), (0.3, math.nan, 0)), "finite"),
    ],
)
def test_points_that_fix_no_frame_are_refused(points, words: str) -> None:
    with pytest.raises(CalibrationError, match=words):
        refuse_bad_points(points)


def test_stations_in_a_plane_leave_two_places_and_the_station_off_it_tells() -> None:
    rng = np.random.default_rng(4)
    flat = np.column_stack([rng.uniform(-0.5, 0.5, (8, 2)), np.zeros(8)])
    place = (0.1, 0.2, -0.7)
    mirror = mirror_image(flat, place, 3e-4)
    assert not mirror.is_excluded
    assert np.allclose(mirror.at_m, (0.1, 0.2, 0.7), atol=1e-6)
    others = np.array([[0.3, 0.3, 0.0], [0.3, 0.3, 0.4]])
    gaps_m = mirror_gaps(others, place, mirror)
    assert gaps_m[0] < 1e-6
    assert gaps_m[1] > 0.1
    assert mirror_image(np.vstack([flat, others[1:]]), place, 3e-4).is_excluded


def test_nearly_flat_stations_are_ambiguous_and_a_volume_is_not() -> None:
    rng = np.random.default_rng(5)
    spread = rng.uniform(-0.5, 0.5, (12, 3))
    assert mirror_image(spread, (0.2, 0.1, -1.0), 3e-4).is_excluded
    assert not mirror_image(spread * (1, 1, 1e-4), (0.2, 0.1, -1.0), 3e-4).is_excluded
    with pytest.raises(DegenerateDataError):
        mirror_image(spread[:2], (0, 0, 1), 3e-4)


def test_a_base_through_a_fixture_carries_both_uncertainties_as_monte_carlo_does() -> None:
    rng = np.random.default_rng(6)
    one = Pose.from_matrix(exp_twist(np.array([0.9, 0.1, -0.2, 0.1, -0.2, 0.3])))
    other = Pose.from_matrix(exp_twist(np.array([-0.4, 0.8, 0.1, 0.5, 0.2, -1.3])))
    spread = rng.normal(size=(2, 6, 6)) * 1e-4
    ours, theirs = (s @ s.T for s in spread)
    chained = base_through_fixture(one, ours, other, theirs)
    assert np.allclose(
        chained.other_base_base.to_matrix(), other.to_matrix() @ np.linalg.inv(one.to_matrix())
    )
    draws = rng.normal(size=(4000, 2, 6))
    base = one.to_matrix() @ exp_twist(draws[:, 0] @ spread[0].T)
    drawn_bases = other.to_matrix() @ exp_twist(draws[:, 1] @ spread[1].T)
    expected = np.linalg.inv(chained.other_base_base.to_matrix())
    twists = log_transform(expected @ drawn_bases @ np.linalg.inv(base))
    found, stated = np.cov(twists.T), np.array(chained.covariance)
    assert np.allclose(np.sqrt(np.diag(found)), np.sqrt(np.diag(stated)), rtol=0.1)
    assert chained.origin_u_m == pytest.approx(2 * math.sqrt(np.linalg.eigvalsh(found[:3, :3])[-1]), rel=0.1)


def test_an_alignment_goes_through_its_text_file_unchanged() -> None:
    rows = tuple(tuple(float(v) for v in row) for row in np.diag([1e-9] * 6))
    alignment = Alignment("table", "F-1", "fanuc_m6ib", POINTS, ROUGH, rows, (1, -2, 3))
    text = alignment_text([alignment])
    assert read_alignments(text) == (alignment,)
    for wrong in ("", "{}", text.replace("alignment 1", "alignment 9"), text.replace("-0.2", "NaN"), "[]"):
        with pytest.raises(CalibrationError):
            read_alignments(wrong)
