"""Bases from all alignments in one fit: what robots share counts once, and what U says holds."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import log_transform
from cellcal.calibration.points.alignment import Alignment, alignment_text, read_alignments
from cellcal.calibration.points.fixture import place_points
from cellcal.calibration.points.joint_bases import bases_together
from tests.unit.helpers.two_robots import POINTS, MeasuringEffort, two_robots

EFFORT = MeasuringEffort(POINTS, per_spot=8, record=30, samples=5)


@cache
def aligned_pair(seed: int) -> tuple[Alignment, Alignment, np.ndarray]:
    left_robot, right_robot = two_robots(seed, EFFORT)
    return (
        left_robot.align_robot(),
        right_robot.align_robot(),
        left_robot.true_fixture() @ np.linalg.inv(right_robot.true_fixture()),
    )


def _base_error(alignments: list[Alignment], truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    (base,) = bases_together(alignments).bases
    error = log_transform(np.linalg.inv(base.other_base_base.to_matrix()) @ truth)
    return error, np.sqrt(np.diag(np.array(base.covariance)))


def test_bases_are_where_they_are_within_their_uncertainty() -> None:
    for seed in (1, 2, 3):
        left_robot, right_robot, truth = aligned_pair(seed)
        error, sigma = _base_error([left_robot, right_robot], truth)
        assert np.abs(error / sigma).max() < 4.0
        assert np.linalg.norm(error[:3]) < 0.001
        assert bases_together([left_robot, right_robot]).is_consistent()


def test_seen_from_the_other_robot_it_is_the_same_place() -> None:
    left_robot, right_robot, _ = aligned_pair(1)
    (forth,), (back,) = (
        bases_together([left_robot, right_robot]).bases,
        bases_together([right_robot, left_robot]).bases,
    )
    assert np.allclose((forth.other_base_base @ back.other_base_base).to_matrix(), np.eye(4), atol=1e-9)


def test_without_wire_data_the_alignments_are_chained() -> None:
    left_robot, right_robot, truth = aligned_pair(1)
    found = bases_together([left_robot, replace(right_robot, points=None)])
    assert (found.jointly, found.is_consistent()) == (False, True)
    error, sigma = _base_error([left_robot, replace(right_robot, points=None)], truth)
    assert np.abs(error / sigma).max() < 4.0


def test_two_wires_are_two_beliefs() -> None:
    left_robot, right_robot, _ = aligned_pair(1)
    assert right_robot.points is not None
    other = replace(right_robot, points=replace(right_robot.points, wire="another"))
    shared, apart = (bases_together([left_robot, r]).bases[0] for r in (right_robot, other))
    assert not np.allclose(shared.covariance, apart.covariance, rtol=1e-3, atol=0.0)  # of 1e-8 m^2
    chained = bases_together([left_robot, replace(right_robot, points=None)]).bases[0]
    assert apart.origin_u_m == pytest.approx(chained.origin_u_m, rel=1e-3)


def _with_drawing(alignment: Alignment, off_m: np.ndarray, sigma_m: float) -> Alignment:
    """Return the alignment as found on a fixture whose points are off their drawing."""
    points = alignment.points
    assert points is not None
    found = np.array(points.found_m) + off_m @ alignment.base_fixture.rotation_matrix().T
    drawn_points = replace(points, found_m=tuple(map(tuple, found.tolist())), sigma_drawing_m=sigma_m)
    size = found.size
    placed = place_points(
        alignment.points_in_fixture_m,
        drawn_points.found_m,
        np.array(points.covariance)[:size, :size],
        sigma_point_m=float(np.hypot(points.sigma_seat_m, sigma_m)),
    )
    return replace(
        alignment, base_fixture=placed.outer_inner, covariance=placed.covariance, points=drawn_points
    )


def test_what_the_drawing_has_wrong_falls_out_between_bases() -> None:
    left_robot, right_robot, _ = aligned_pair(1)
    off = np.random.default_rng(4).normal(size=(len(POINTS), 3)) * 2e-4
    before = bases_together([left_robot, right_robot]).bases[0]
    spoilt = [_with_drawing(one, off, 2e-4) for one in (left_robot, right_robot)]
    after = bases_together(spoilt).bases[0]
    gap = log_transform(np.linalg.inv(before.other_base_base.to_matrix()) @ after.other_base_base.to_matrix())
    assert np.linalg.norm(gap[:3]) < before.origin_u_m  # the fixture no longer tells the scale of the wire
    chained = bases_together([replace(one, points=None) for one in spoilt]).bases[0]
    assert after.origin_u_m < 0.6 * chained.origin_u_m


def test_a_robot_that_found_another_shape_is_noticed() -> None:
    left_robot, right_robot, _ = aligned_pair(1)
    off = np.zeros((len(POINTS), 3))
    off[2, 0] = 0.003
    assert not bases_together([left_robot, _with_drawing(right_robot, off, 0.0)]).is_consistent()


def test_uncertainties_along_axes_and_in_space_belong_together() -> None:
    left_robot, right_robot, _ = aligned_pair(1)
    (base,) = bases_together([left_robot, right_robot]).bases
    along = np.array(base.origin_axes_u_m)
    assert along.max() <= base.origin_u_m <= base.origin_space_u_m <= 1.45 * np.linalg.norm(along)
    turned = np.array(base.covariance)[3:, 3:]
    assert np.sum(np.square(base.angle_axes_u_rad)) == pytest.approx(4.0 * np.trace(turned))


def test_an_alignment_survives_its_text_file_and_a_spoilt_one_does_not() -> None:
    left_robot, right_robot, _ = aligned_pair(1)
    text = alignment_text([left_robot, replace(right_robot, points=None)])
    assert read_alignments(text) == (left_robot, replace(right_robot, points=None))
    assert left_robot.points is not None
    for spoilt in (
        replace(left_robot.points, covariance=left_robot.points.covariance[:-1]),
        replace(left_robot.points, sigma=(*left_robot.points.sigma[:-1], 0.0)),
        replace(left_robot.points, believed=left_robot.points.believed[:-1]),
    ):
        with pytest.raises(CalibrationError):
            read_alignments(alignment_text([replace(left_robot, points=spoilt)]))


def test_one_alignment_or_two_fixtures_are_refused() -> None:
    left_robot, right_robot, _ = aligned_pair(1)
    with pytest.raises(CalibrationError, match="two alignments"):
        bases_together([left_robot])
    other = replace(right_robot, points_in_fixture_m=tuple(reversed(POINTS)))
    with pytest.raises(CalibrationError, match="different points"):
        bases_together([left_robot, other])
