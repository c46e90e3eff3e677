"""Nothing of a held-out row reaches its prediction: not through breaks, the level, or a repeated posture."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.identification.cross_validation import assign_folds, group_rows, same_postures
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.judgement import judge_rows
from cellcal.calibration.identification.selection import IdentificationOptions
from tests.unit.helpers.simulated_arm import random_joints, tracker_points, wire_lengths

UR10 = load_model("ur10")


def test_the_prediction_of_a_fold_does_not_know_its_values():
    simulated = wire_lengths(count=72)
    rows = simulated.observations
    grouping = group_rows(rows.joints_rad)
    is_held_out = assign_folds(grouping, 10, 0) == 3
    shifted = replace(rows, lengths_m=rows.lengths_m + np.where(is_held_out, 5.0, 0.0))
    first = judge_rows(simulated.model, rows, grouping, IdentificationOptions(level=1)).held_out_m[
        is_held_out
    ]
    second = judge_rows(simulated.model, shifted, grouping, IdentificationOptions(level=1)).held_out_m[
        is_held_out
    ]
    assert np.allclose(np.abs(second - 5.0), first, atol=1e-9)


def test_rows_of_another_mounting_are_judged_there_though_breaks_are_found_anew():
    simulated = tracker_points("ur10", 120)
    moved = np.where(np.arange(120)[:, None] >= 50, [0.004, -0.003, 0.002], 0.0)
    rows = replace(simulated.observations, positions_m=simulated.observations.positions_m + moved)
    found = identify_arm(simulated.model, rows, options=IdentificationOptions(level=2))
    assert [item.row for item in found.breaks] == [50]
    assert all(len(breaks) == 1 and abs(breaks[0] - 50) <= 3 for breaks in found.judgement.breaks)
    assert found.held_out.max_m < 1.5e-3


def test_without_judging_there_is_no_held_out_figure():
    simulated = tracker_points("ur10", 60)
    found = identify_arm(
        simulated.model, simulated.observations, options=IdentificationOptions(level=1, judge=False)
    )
    assert found.held_out.n == found.before_errors.n == 0
    assert found.fit_errors.n > 0


@pytest.mark.parametrize("cycles", [3, 30])
def test_postures_measured_again_and_again_are_held_out_as_a_whole(cycles):
    joints = np.tile(random_joints(UR10, np.random.default_rng(5), 20), (cycles, 1))
    joints = joints + np.random.default_rng(0).normal(0, 5e-5, joints.shape)
    grouping = group_rows(joints)
    assert grouping.group_count == 20
    assert (grouping.groups.reshape(cycles, 20) == grouping.groups[:20]).all()


def test_a_few_repeats_join_the_group_of_the_first():
    joints = random_joints(UR10, np.random.default_rng(6), 200)
    joints[150] = joints[3]
    joints[199] = joints[60] + 2e-4
    groups = group_rows(joints).groups
    assert groups[150] == groups[3]
    assert groups[199] == groups[60]
    assert groups[151] != groups[3]


def test_every_fold_is_spread_over_the_series():
    joints = random_joints(UR10, np.random.default_rng(7), 400)
    grouping = group_rows(joints)
    folds = assign_folds(grouping, 5, 1)
    assert set(np.bincount(folds)) == {80}
    for start in range(0, 400, 50):
        assert len(set(folds[start : start + 50])) == 5


def test_postures_are_equal_within_a_tolerance_and_not_through_a_chain():
    line = np.zeros((50, 6))
    line[:, 0] = np.arange(50) * 6e-4
    assert 15 <= same_postures(line).max() + 1 <= 30
