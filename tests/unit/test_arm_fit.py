"""Fits while measuring: true within their uncertainty; the pose that tells most; what stays hidden, and why."""

import numpy as np
import pytest

from cellcal.calibration.accuracy import cube_positions
from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.line_accuracy import evaluate_lengths
from cellcal.calibration.mastering.pose_design import candidate_joints
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath
from cellcal.calibration.poses.arm_fit import (
    ArmTask,
    errors_at,
    fit_arm,
    fit_placement,
    found_parameters,
    predict_from_fit,
    predict_task,
    predicted_sigma,
    reading_sigma,
    target_expanded_u,
)
from cellcal.calibration.poses.enough_poses import AcceptanceLimits
from cellcal.calibration.poses.measurement_prediction import TestPoses
from cellcal.calibration.poses.next_pose import choose_in_turn, random_poses_needed, spread_order
from cellcal.calibration.poses.shortfall import find_shortfall

ANCHOR, HOOK = (0.9, -0.7, -0.45), (0.06, 0.05, 0.12)
MODEL = load_model("fanuc_m6ib")
WIRE = ArmTask("fanuc_m6ib", "length", 1e-4, HOOK, ANCHOR)
POINTS = ArmTask("fanuc_m6ib", "point", 5e-5, HOOK)
LIMITS = MotionLimits(wire=WirePath(ANCHOR, HOOK, 3.0, lowest_fraction=0.08))
POOL = candidate_joints(MODEL, LIMITS, 260, seed=4, hook_in_flange_m=HOOK)
TESTS = TestPoses(POOL[200:240])


def _measure_arm(
    task: ArmTask, joints: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return readings of an arm drawn from the task's own priors, and the DH errors."""
    errors = rng.normal(size=(6, 5)) * np.array([2e-3, 5e-4, 5e-4, 5e-4, 5e-4])
    tips = MODEL.with_dh_errors(errors).tip_positions(joints, np.array(HOOK))
    if task.kind == "point":
        return tips + rng.normal(size=tips.shape) * task.sigma_m, errors
    lengths = np.linalg.norm(tips - np.array(ANCHOR) - 0.004, axis=1) + 0.0003
    return (lengths + rng.normal(size=len(tips)) * task.sigma_m)[:, None], errors


@pytest.mark.parametrize("task", [WIRE, POINTS], ids=["wire", "points"])
def test_held_out_readings_lie_within_what_a_fit_predicts(task: ArmTask) -> None:
    rng, squares = np.random.default_rng(5), []
    for _ in range(8):
        values, _ = _measure_arm(task, POOL[:80], rng)
        rows = task.to_observations(POOL[:80], values)
        robust = fit_arm(task, rows.select_rows(np.arange(50)))
        held_out_rows = rows.select_rows(np.arange(50, 80))
        sigma = np.hypot(predicted_sigma(robust.fit, task, held_out_rows.joints_rad), task.sigma_m)
        squares.append(np.mean((errors_at(robust.fit.state, held_out_rows) / sigma) ** 2))
        assert reading_sigma(task, robust) >= task.sigma_m
    assert 0.5 < np.mean(squares) < 1.4


def test_known_zeros_are_found_and_placements_are_not_listed() -> None:
    values, errors = _measure_arm(POINTS, POOL[:60], np.random.default_rng(6))
    found = {
        p.name: p for p in found_parameters(fit_arm(POINTS, POINTS.to_observations(POOL[:60], values)).fit)
    }
    assert abs(found["J3 offset"].value - errors[2, 0]) < 4 * found["J3 offset"].sigma
    assert not any(name.startswith(("base", "tool")) for name in found)


def test_a_known_arm_is_only_placed() -> None:
    values, errors = _measure_arm(POINTS, POOL[:40], np.random.default_rng(7))
    rows = POINTS.to_observations(POOL[:40], values)
    names = {
        f"J{i + 1} {what}": errors[i, k]
        for i in range(6)
        for k, what in enumerate(("offset", "d", "a", "alpha", "beta"))
    }
    nominal, known_state = fit_placement(POINTS, rows, {}).state, fit_placement(POINTS, rows, names).state
    assert np.std(errors_at(known_state, rows)) < 1.3 * POINTS.sigma_m
    assert np.std(errors_at(nominal, rows)) > 5 * POINTS.sigma_m


def test_chosen_poses_tell_more_than_drawn_ones_and_the_need_is_counted() -> None:
    before = predict_task(WIRE, POOL[:0])
    turn = choose_in_turn(before, POOL[:200], TESTS, lambda *_: False, most=30)
    chosen, drawn = (
        target_expanded_u(turn.after, TESTS)[0],
        target_expanded_u(before.with_measured(POOL[:30]), TESTS)[0],
    )
    assert len(set(turn.order)) == 30
    assert chosen < drawn
    needed = random_poses_needed(
        before, POOL[:200], lambda candidate: target_expanded_u(candidate, TESTS)[0] <= chosen
    )
    assert needed is not None
    assert 30 < needed <= 60
    assert random_poses_needed(before, POOL[:20], lambda _: False) is None


def test_readings_worse_than_stated_widen_the_uncertainty() -> None:
    rng = np.random.default_rng(8)
    values, _ = _measure_arm(WIRE, POOL[:70], rng)
    worse = values + rng.normal(size=values.shape) * 4 * WIRE.sigma_m
    good, bad = (fit_arm(WIRE, WIRE.to_observations(POOL[:70], v)) for v in (values, worse))
    assert reading_sigma(WIRE, bad) > 2.5 * reading_sigma(WIRE, good)
    assert (
        target_expanded_u(predict_from_fit(WIRE, bad), TESTS)[0]
        > 1.5 * target_expanded_u(predict_from_fit(WIRE, good), TESTS)[0]
    )


def test_what_no_number_of_readings_brings_out_is_named_with_partner_and_cure() -> None:
    before = predict_task(WIRE, POOL[:0])
    found = find_shortfall(before, POOL[:200], AcceptanceLimits(tip_rms_m=2e-5, margin=1.0), TESTS)
    assert found is not None
    assert found.hidden_behind == "wire scale"
    assert "certificate" in found.shortfall_text
    assert find_shortfall(before, POOL[:200], AcceptanceLimits(tip_rms_m=0.001, margin=1.0), TESTS) is None
    zero = find_shortfall(
        before, POOL[:200], AcceptanceLimits(offset_rad=1e-4, offsets_of=("J1 offset",), margin=1.0), TESTS
    )
    assert zero is not None
    assert zero.hidden_behind.startswith("anchor")


def test_spread_poses_are_far_apart() -> None:
    places = MODEL.tip_positions(POOL, np.array(HOOK))
    chosen = spread_order(POOL, places, 10)
    assert len(set(chosen)) == 10
    others = spread_order(POOL, places, 10, first=chosen)
    assert not set(others) & set(chosen)
    gaps = np.linalg.norm(places[list(chosen)][:, None] - places[list(chosen)][None], axis=2)
    drawn = np.linalg.norm(places[:10][:, None] - places[:10][None], axis=2)
    assert np.sort(gaps, axis=1)[:, 1].mean() > np.sort(drawn, axis=1)[:, 1].mean()


def test_readings_of_another_kind_are_refused() -> None:
    with pytest.raises(CalibrationError, match="lengths"):
        fit_arm(WIRE, POINTS.to_observations(POOL[:40], np.zeros((40, 3))))


def test_errors_along_a_line_are_means_and_scatters() -> None:
    joints = POOL[: len(cube_positions((0.8, 0.0, 0.5), 0.3))]
    expected_means = np.full(5, 1.0)
    found = expected_means[:, None] + np.array([0.0009, 0.001, 0.0011])[None]
    test = evaluate_lengths(expected_means, found, joints, device_sigma_m=5e-5, fitted_joints_rad=POOL[10:20])
    assert test.ap_m == pytest.approx(0.001)
    assert test.rp_m == pytest.approx(0.0003)
    with pytest.raises(CalibrationError, match="fitted"):
        evaluate_lengths(expected_means, found, joints, device_sigma_m=0.0, fitted_joints_rad=POOL[:3])
    with pytest.raises(CalibrationError, match="one cycle"):
        evaluate_lengths(
            expected_means, found[:, :1], joints, device_sigma_m=0.0, fitted_joints_rad=POOL[10:20]
        )
    with pytest.raises(CalibrationError, match="finite"):
        evaluate_lengths(
            expected_means, found * np.nan, joints, device_sigma_m=0.0, fitted_joints_rad=POOL[10:20]
        )
