"""Outliers, moved devices, rounded joints, lost signs: found, reported, and not allowed to bend the answer."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.identification import lints
from cellcal.calibration.identification.break_choice import choose_breaks
from cellcal.calibration.identification.cross_validation import assign_folds, compare_models, group_rows
from cellcal.calibration.identification.frame_fits import FrameFits
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.parameters import GEOMETRY
from cellcal.calibration.identification.selection import IdentificationOptions
from cellcal.calibration.identification.series_breaks import assign_mountings, candidate_breaks
from cellcal.calibration.identification.unrounding import find_resolution, unround_joints
from tests.unit.helpers.simulated_arm import ANCHOR, random_joints, tracker_points, wire_lengths
from tests.unit.test_identification import fit_at_level, tip_error_m


def with_outliers(simulated, share, size_m, seed):
    rng = np.random.default_rng(seed)
    count = len(simulated.observations)
    bad = np.sort(rng.choice(count, int(share * count), replace=False))
    positions = simulated.observations.positions_m.copy()
    kick = rng.standard_normal((len(bad), 3))
    positions[bad] += size_m * kick / np.linalg.norm(kick, axis=1, keepdims=True)
    return replace(simulated, observations=replace(simulated.observations, positions_m=positions)), bad


def test_outliers_are_rejected_and_hardly_cost_anything():
    joints = random_joints(load_model("ur10"), np.random.default_rng(9), 200)
    clean, dirty = [], []
    for seed in range(5):
        simulated = tracker_points(count=60, seed=seed, sigma_m=1e-4)
        spoilt, bad = with_outliers(simulated, 0.15, 5e-3, seed)
        robust = fit_at_level(spoilt)
        assert set(bad) <= set(robust.rejected)
        assert len(robust.rejected) <= len(bad) + 2
        clean.append(np.mean(tip_error_m(simulated, fit_at_level(simulated).fit.state, joints) ** 2))
        dirty.append(np.mean(tip_error_m(simulated, robust.fit.state, joints) ** 2))
    assert np.sqrt(np.mean(dirty)) < 1.25 * np.sqrt(np.mean(clean))


def test_rejected_rows_still_count_in_the_held_out_error():
    spoilt, bad = with_outliers(tracker_points(count=100), 0.05, 0.02, 1)
    found = identify_arm(spoilt.model, spoilt.observations, options=IdentificationOptions(level=GEOMETRY))
    assert set(bad) <= set(found.rejected)
    assert found.held_out.n == 100
    assert found.held_out.max_m > 0.01
    assert found.fit_errors.max_m < 0.001


def test_a_moved_anchor_is_found_to_the_row():
    moved = [ANCHOR, ANCHOR + np.array([0.004, -0.003, 0.002]), ANCHOR + np.array([0.001, 0.003, 0.003])]
    simulated = wire_lengths(count=240, anchors=moved, breaks=(90, 150), sigma_m=1e-4)
    found = identify_arm(
        simulated.model, simulated.observations, options=IdentificationOptions(level=GEOMETRY)
    )
    assert [item.row for item in found.breaks] == [90, 150]
    assert found.held_out.rmse_m < 2.5e-4


def test_no_break_is_seen_where_nothing_moved():
    for seed in range(3):
        simulated = wire_lengths(count=160, seed=seed, sigma_m=1e-4)
        found = identify_arm(
            simulated.model, simulated.observations, options=IdentificationOptions(level=GEOMETRY)
        )
        assert found.breaks == ()


@pytest.mark.parametrize(
    ("moved_by", "expected"),
    [("step", [26]), ("drift", []), ("there and back", []), ("nothing", []), ("put back", [18, 36])],
)
def test_a_move_smaller_than_the_errors_of_the_arm_is_found_to_the_row(moved_by, expected):
    simulated = tracker_points("fanuc_m6ib", 52, seed=3)
    rows = np.arange(52)
    share = {
        "step": rows >= 26,
        "drift": rows / 51.0,
        "there and back": np.sin(np.pi * rows / 51.0),
        "nothing": 0.0 * rows,
        "put back": (rows >= 18) & (rows < 36),
    }[moved_by]
    moved = simulated.observations.positions_m + share[:, None] * np.array([4e-4, -5e-4, 3e-4])
    observations = replace(simulated.observations, positions_m=moved)
    breaks, _ = choose_breaks(
        FrameFits(simulated.model, observations), group_rows(observations.joints_rad), 0
    )
    assert [item.row for item in breaks] == expected


def test_break_candidates_stop_on_a_short_series():
    simulated = wire_lengths(count=30)
    assert list(candidate_breaks(simulated.model, simulated.observations)) == []


def test_check_rows_are_put_on_the_mounting_they_belong_to():
    errors = np.full((3, 50), 5e-3)
    truth = np.repeat([1, 2], 25)
    errors[truth, np.arange(50)] = 1e-4
    errors[0, 7] = 0.0  # one lucky row is no reason to change
    assert (assign_mountings(errors, 2e-4) == truth).all()


def test_rounded_joints_are_sharpened_by_printed_positions_with_one_typing_error():
    model, rng = load_model("abb_irb120"), np.random.default_rng(0)
    true_joints = random_joints(model, rng, 200, reach=1.2)
    step = np.deg2rad(0.1)
    written = np.round(true_joints / step) * step
    printed = np.round(model.tip_positions(true_joints, np.zeros(3)) / 1e-4) * 1e-4
    printed[17] += [0.0, 0.1, 0.0]
    sharp = unround_joints(model, written, np.full(6, step), printed, 1e-4)
    assert sharp.useful
    assert sharp.doubtful_rows == (17,)
    assert np.abs(sharp.joints_rad - written).max() <= step / 2 + 1e-12
    assert (sharp.joints_rad[17] == written[17]).all()
    tips = [
        np.delete(model.tip_positions(q, np.zeros(3)), 17, axis=0)
        for q in (true_joints, written, sharp.joints_rad)
    ]
    before, after = (np.sqrt(np.mean((other - tips[0]) ** 2)) for other in tips[1:])
    assert after < 0.25 * before


def test_positions_of_another_arm_sharpen_nothing():
    model, rng = load_model("ur10"), np.random.default_rng(0)
    joints = random_joints(model, rng, 80)
    other = load_model("ur5e").tip_positions(joints, np.zeros(3))
    sharp = unround_joints(model, joints, np.full(6, 1e-3), other, 1e-4)
    assert not sharp.useful
    assert (sharp.joints_rad == joints).all()


def test_resolution_of_columns():
    assert find_resolution(np.array([0.1, -3.7, 12.0])) == 0.1
    assert find_resolution(np.array([509.19, 498.04])) == 0.01
    assert find_resolution(np.array([0.5, 1.5, 2.0])) == 0.5
    assert find_resolution(np.random.default_rng(0).standard_normal(50)) == 0.0
    assert find_resolution(np.zeros(4)) == 0.0
    # In a surveyor's frame, kilometres away: the distance is no rounding.
    far = 5_678_000.0 + 1e3 * np.random.default_rng(0).standard_normal(50)
    assert find_resolution(far) == 0.0
    assert find_resolution(np.round(far, -1)) == 10.0


def test_a_lost_minus_sign_is_reported_and_left_alone():
    joints = np.deg2rad(np.random.default_rng(0).uniform(-75, -55, (300, 6)))
    joints[40:60, 5] *= -1
    (found,) = lints.sign_flips(joints, [f"J{i}" for i in range(1, 7)])
    assert found.rows == tuple(range(40, 60))
    assert "J6" in found.message
    assert "40-59" in found.message


def test_random_poses_raise_no_sign_warning():
    joints = random_joints(load_model("ur10"), np.random.default_rng(0), 500)
    assert lints.sign_flips(joints, [str(i) for i in range(6)]) == []


def test_duplicates_and_leakage():
    joints = random_joints(load_model("ur10"), np.random.default_rng(0), 20)
    twice = np.concatenate([joints, joints[3:5]])
    assert lints.find_duplicates(twice)[0].rows == (20, 21)
    assert lints.find_duplicates(joints) == []
    assert lints.find_leakage(joints[:10], joints[8:12])[0].rows == (0, 1)
    assert lints.find_leakage(joints[:10], joints[10:]) == []


def test_the_rounding_floor_is_stated_in_millimetres():
    model = load_model("abb_irb120")
    joints = random_joints(model, np.random.default_rng(0), 200)
    assert "0.1 deg" in lints.rounding_floor(model, joints, np.full(6, np.deg2rad(0.1)), 1e-5)[0].message
    assert lints.rounding_floor(model, joints, np.full(6, 1e-9), 1e-6) == []


def test_readings_of_one_posture_one_after_the_other_are_no_drift():
    rng = np.random.default_rng(0)
    of_posture, postures = rng.standard_normal((3, 40)), np.repeat(np.arange(40), 5)
    residuals = of_posture[:, postures] + 0.1 * rng.standard_normal((3, 200))
    assert lints.find_alike_neighbours(residuals, postures) == []
    drifting = np.cumsum(of_posture, axis=1)[:, postures]
    assert lints.find_alike_neighbours(drifting, postures)[0].code == "drift"


def test_other_lints_speak_only_when_there_is_something():
    rng = np.random.default_rng(0)
    assert lints.find_alike_neighbours(rng.standard_normal((3, 200))) == []
    assert lints.find_alike_neighbours(np.cumsum(rng.standard_normal((3, 200)), axis=1))[0].code == "drift"
    assert lints.find_nominal_positions(np.full(10, 1e-5), 1e-4)[0].code == "not_measured"
    assert lints.find_nominal_positions(np.full(10, 1e-3), 1e-4) == []
    assert (
        lints.find_nominal_positions(np.full(10, 1.6e-3), 1e-3) == []
    )  # a real arm, read to whole millimetres
    assert lints.find_nominal_positions(np.full(10, 5e-4), 1e-3)[0].code == "not_measured"


def test_runs_of_constant_wrist_are_groups_and_folds_never_split_one():
    rng = np.random.default_rng(0)
    joints = random_joints(load_model("ur10"), rng, 200)
    joints[:, 3:] = np.repeat(random_joints(load_model("ur10"), rng, 20)[:, 3:], 10, axis=0)
    grouping = group_rows(joints)
    assert grouping.kind == "runs of constant wrist"
    assert grouping.group_count == 20
    folds = assign_folds(grouping, 7, seed=3)
    assert all(len(set(folds[grouping.groups == g])) == 1 for g in range(20))
    assert set(folds) == set(range(7))
    assert group_rows(random_joints(load_model("ur10"), rng, 30)).kind == "single rows"


def test_a_gain_that_one_group_makes_alone_is_none():
    errors = np.full(100, 1e-3)
    groups = np.arange(100) // 10
    lucky = errors.copy()
    lucky[:10] = 1e-5
    assert not compare_models(("a", errors), ("b", lucky), groups).better
    assert compare_models(("a", errors), ("b", 0.9 * errors * (1 + 0.01 * groups / 10)), groups).better
    assert not compare_models(("a", errors), ("b", 0.995 * errors), groups).better
