"""Accuracy and repeatability: the standard's formulas by hand, titles that cannot be bought, no fitted pose."""

import math
import statistics
from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.accuracy import (
    FULL_TITLE,
    REDUCED_TITLE,
    AccuracyConditions,
    AttainedPoses,
    cube_positions,
    evaluate_accuracy,
    refuse_fitted,
)
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import exp_rotation

FULL = AccuracyConditions(load_share=1.0, speed_share=1.0, warmed_up=True, one_direction=True)
NONE_FITTED = np.empty((0, 6))
JOINTS = np.random.default_rng(0).uniform(-2, 2, (5, 6))
COMMANDED = cube_positions((0.8, 0.1, 0.6), 0.5)


def attained_poses(seed=1, cycles=30, shift=(3e-4, -2e-4, 1e-4), scatter=2e-5, **fields):
    rng = np.random.default_rng(seed)
    positions = COMMANDED[:, None] + np.array(shift) + rng.normal(scale=scatter, size=(5, cycles, 3))
    return AttainedPoses(COMMANDED, positions, JOINTS, **fields)


def test_the_formulas_by_hand():
    positions_m = np.array([[[3.0, 0, 0], [1.0, 0, 0], [2.0, 1, 0], [2.0, -1, 2]]]) * 1e-3
    pose = evaluate_accuracy(
        AttainedPoses(np.zeros((1, 3)), positions_m, JOINTS[:1]), FULL, fitted_joints_rad=NONE_FITTED
    ).poses[0]
    # mean (2, 0, 0.5); squared distances 1.25, 1.25, 1.25, 3.25
    lengths = [math.sqrt(1.25)] * 3 + [math.sqrt(3.25)]
    assert pose.ap_m == pytest.approx(math.sqrt(4.25) * 1e-3, rel=1e-12)
    assert pose.ap_parts_m == pytest.approx((2e-3, 0, 0.5e-3), abs=1e-15)
    expected = statistics.fmean(lengths) + 3 * statistics.stdev(lengths)
    assert pose.rp_m == pytest.approx(expected * 1e-3, rel=1e-12)


def test_two_cycles_either_side_are_their_half_distance():
    positions_m = np.array([[[1.0, 0, 0], [-1.0, 0, 0]]]) * 1e-3
    test = evaluate_accuracy(
        AttainedPoses(np.zeros((1, 3)), positions_m, JOINTS[:1]), FULL, fitted_joints_rad=NONE_FITTED
    )
    assert test.rp_m == pytest.approx(1e-3, rel=1e-12)
    assert test.ap_m == 0.0


def test_turns_are_mean_and_three_deviations_about_the_base_axes():
    commanded = np.stack([exp_rotation(v) for v in np.random.default_rng(2).normal(size=(5, 3))])
    tilt = np.array([[1e-3, 0, 0], [3e-3, 0, 0], [2e-3, 0, 1e-3]])
    turned = exp_rotation(tilt)[None] @ commanded[:, None]
    data = replace(attained_poses(cycles=3), commanded_rotations=commanded, rotations=turned)
    pose = evaluate_accuracy(data, FULL, fitted_joints_rad=NONE_FITTED).poses[0]
    assert pose.ap_turns_rad == pytest.approx((2e-3, 0, 1e-3 / 3), abs=1e-9)
    assert pose.rp_turns_rad == pytest.approx((3e-3, 0, 3 * statistics.stdev([0, 0, 1e-3])), abs=1e-9)


def test_the_total_is_the_worst_pose():
    data = attained_poses()
    data.positions_m[3] += [1e-3, 0, 0]
    test = evaluate_accuracy(data, FULL, fitted_joints_rad=NONE_FITTED)
    assert test.ap_m == test.poses[3].ap_m
    assert test.rp_m == max(pose.rp_m for pose in test.poses)
    assert np.mean([pose.ap_m for pose in test.poses]) < test.ap_m


@pytest.mark.parametrize(
    ("conditions", "cycles", "departure"),
    [
        (FULL, 5, "5 cycles"),
        (replace(FULL, load_share=0.5), 30, "50 % of the rated load"),
        (replace(FULL, speed_share=0.1), 30, "10 % of the rated speed"),
        (replace(FULL, warmed_up=False), 30, "not warmed up"),
        (replace(FULL, one_direction=False), 30, "different sides"),
    ],
)
def test_what_is_less_than_the_full_test_says_so_in_its_title(conditions, cycles, departure):
    test = evaluate_accuracy(attained_poses(cycles=cycles), conditions, fitted_joints_rad=NONE_FITTED)
    assert test.title == REDUCED_TITLE
    assert len(test.departures) == 1
    assert departure in test.departures[0]


def test_the_full_test_bears_its_name():
    test = evaluate_accuracy(attained_poses(), FULL, fitted_joints_rad=NONE_FITTED)
    assert (test.title, test.departures) == (FULL_TITLE, ())


def test_fewer_poses_are_a_departure():
    whole = attained_poses()
    four = AttainedPoses(whole.commanded_m[:4], whole.positions_m[:4], whole.joints_rad[:4])
    assert evaluate_accuracy(four, FULL, fitted_joints_rad=NONE_FITTED).departures == (
        "4 poses instead of 5",
    )


def test_fitted_poses_are_refused_even_where_the_controller_rounded():
    fitted = np.random.default_rng(3).uniform(-2, 2, (200, 6))
    fitted[17] = np.radians(np.round(np.degrees(JOINTS[2]), 1))
    with pytest.raises(CalibrationError, match="pose 2 is row 17") as caught:
        evaluate_accuracy(attained_poses(), FULL, fitted_joints_rad=fitted)
    assert caught.value.code == "calibration.leakage"
    fitted[17] += np.radians(0.5)
    evaluate_accuracy(attained_poses(), FULL, fitted_joints_rad=fitted)


def test_one_joint_apart_is_another_pose():
    refuse_fitted(JOINTS, JOINTS + np.radians([0, 0, 0, 0, 0, 1.0]))
    with pytest.raises(CalibrationError, match="5 of 5"):
        refuse_fitted(JOINTS, JOINTS)


def test_the_uncertainties_are_the_scatter_of_repeated_tests():
    tests = [
        evaluate_accuracy(attained_poses(seed), FULL, fitted_joints_rad=NONE_FITTED).poses[0]
        for seed in range(600)
    ]
    ap, rp = np.array([t.ap_m for t in tests]), np.array([t.rp_m for t in tests])
    stated_ap = np.sqrt(np.mean([t.ap_sigma_m**2 for t in tests]))
    stated_rp = np.sqrt(np.mean([t.rp_sigma_m**2 for t in tests]))
    assert ap.std() == pytest.approx(stated_ap, rel=0.1)
    assert rp.std() == pytest.approx(stated_rp, rel=0.1)


def test_an_instruments_uncertainty_does_not_average_out():
    test = evaluate_accuracy(attained_poses(device_sigma_m=1e-4), FULL, fitted_joints_rad=NONE_FITTED)
    assert all(1e-4 < pose.ap_sigma_m < 1.01e-4 for pose in test.poses)


@pytest.mark.parametrize("plane", range(4))
def test_the_test_poses_lie_on_an_inclined_plane_a_tenth_from_the_corners(plane):
    centre, side = np.array([0.8, 0.1, 0.6]), 0.5
    poses = cube_positions(tuple(centre), side, plane)
    offsets = poses - centre
    assert np.array_equal(offsets[0], np.zeros(3))
    assert np.linalg.matrix_rank(offsets, tol=1e-9) == 2
    diagonal = side * math.sqrt(3)
    assert np.allclose(np.linalg.norm(offsets[1:], axis=1), 0.4 * diagonal)
    # Each corner's distance to its pose is a tenth of the diagonal.
    corners = np.sign(offsets[1:]) * side / 2
    assert np.allclose(np.linalg.norm(corners - offsets[1:], axis=1), 0.1 * diagonal)


def test_the_four_planes_differ():
    normals = set()
    for plane in range(4):
        offsets = cube_positions((0.0, 0.0, 0.0), 1.0, plane)[1:]
        normal = np.cross(offsets[0], offsets[1])
        normals.add(tuple(np.round(np.abs(normal @ np.array([1, 2, 4])), 6).ravel()) + tuple(np.sign(normal)))
    assert len(normals) == 4


@pytest.mark.parametrize(
    "change",
    [
        {"positions_m": np.zeros((5, 1, 3))},
        {"positions_m": np.full((5, 4, 3), np.nan)},
        {"commanded_m": np.zeros((4, 3))},
        {"joints_rad": np.zeros((4, 6))},
        {"rotations": np.zeros((5, 30, 3, 3))},
        {"device_sigma_m": -1.0},
        {"positions_m": np.zeros((5, 3))},
    ],
)
def test_invalid_test_data_are_refused(change):
    with pytest.raises(CalibrationError):
        replace(attained_poses(), **change)


def test_a_cube_without_a_side_is_refused():
    with pytest.raises(CalibrationError):
        cube_positions((0.0, 0.0, 0.0), 0.0)
