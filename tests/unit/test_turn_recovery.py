"""Turn recovery in a world with hidden compliance, harmonics, backlash, wire errors; and its refusals."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import TypeAdapter

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.mastering.turn_recovery import (
    TurnRecovery,
    predict_turns,
    verification_power,
    verify_recovery,
)
from tests.unit.helpers.recovery_cases import DRIVE, MODEL, lose_turns, record_poses


def check_names(recovery):
    return {check.name: check for check in recovery.gate}


@pytest.mark.parametrize("captures", [14, 20])
def test_whole_turns_come_back_exactly(captures):
    for seed in range(12):
        loss = lose_turns(seed, captures)
        recovery = loss.recover_turns()
        assert (recovery.mode, recovery.accepted) == ("turns", True), recovery.reason
        assert recovery.offset_turns == tuple(loss.true_turns)
        assert recovery.counts_at_zero == tuple(
            zero - per_turn * turns
            for zero, per_turn, turns in zip(
                loss.record.counts_at_zero, DRIVE.counts_per_turn, recovery.turns, strict=True
            )
        )
        assert recovery.offset_u_rad == (0.0,) * 6
        assert all(check.passed for check in recovery.gate)


def test_backlash_on_either_flank_changes_no_turn():
    for seed in range(8):
        loss = lose_turns(seed, 16, either_flank=True)
        recovery = loss.recover_turns()
        assert recovery.accepted, recovery.reason
        assert recovery.offset_turns == tuple(loss.true_turns)


def test_few_poses_in_a_small_box_are_refused_with_the_poses_still_needed():
    for seed in range(8):
        rng = np.random.default_rng(seed)
        recovery = lose_turns(
            seed, poses=record_poses()[0] + rng.uniform(-0.05, 0.05, (6, 6))
        ).recover_turns()
        assert (recovery.mode, recovery.accepted) == ("undecided", False)
        assert recovery.poses_needed == len(recovery.next_joints_rad) >= 6
        assert f"measure {recovery.poses_needed} more" in recovery.reason


def test_many_poses_in_a_small_box_are_refused_for_their_geometry():
    rng = np.random.default_rng(3)
    recovery = lose_turns(3, poses=record_poses()[2] + rng.uniform(-0.03, 0.03, (16, 6))).recover_turns()
    assert not recovery.accepted
    assert not check_names(recovery)["success probability"].passed
    assert any(name in recovery.reason for name in MODEL.joint_names)


def test_the_poses_asked_for_decide_the_case():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        loss = lose_turns(seed, poses=record_poses()[0] + rng.uniform(-0.05, 0.05, (6, 6)))
        next_joints_rad = np.array(loss.recover_turns().next_joints_rad)
        loss.captures += loss.capture_poses(next_joints_rad)
        recovery = loss.recover_turns()
        assert recovery.accepted, recovery.reason
        assert recovery.offset_turns == tuple(loss.true_turns)


def test_an_outlier_of_8_mm_is_refused_and_named_and_its_repeat_is_accepted():
    for seed in range(12):
        loss = lose_turns(seed, 16)
        good, wrong = loss.captures[seed % 16], seed % 16
        loss.captures[wrong] = replace(good, length_m=good.length_m + (0.008 if seed % 2 else -0.008))
        recovery = loss.recover_turns()
        assert not recovery.accepted
        assert recovery.suspect_capture == wrong
        assert f"capture {wrong + 1} " in recovery.reason
        loss.captures[wrong] = good
        assert loss.recover_turns().accepted


def test_an_exchanged_motor_is_found_and_its_offset_lies_within_its_uncertainty():
    inside = []
    for seed in range(18):
        axis, rng = seed % 6, np.random.default_rng(seed)
        loss = lose_turns(seed, 16, fractions=np.eye(6)[axis] * rng.uniform(0.1, 0.9))
        # A hook that moved looks like a new J6, so that only a report tells them apart.
        recovery = loss.recover_turns(replaced_axes=[5] if axis == 5 else [])
        assert (recovery.mode, recovery.accepted) == ("motor", True), recovery.reason
        assert recovery.replaced_axes == (axis,)
        others = np.arange(6) != axis
        assert (np.array(recovery.offset_turns)[others] == loss.true_turns[others]).all()
        inside.append(abs(loss.joint_error_rad(recovery)[axis]) <= recovery.offset_u_rad[axis])
    assert np.mean(inside) >= 0.93


def test_a_reported_exchange_gets_a_real_offset_even_near_a_whole_turn():
    for seed in range(6):
        loss = lose_turns(seed, 16, fractions=np.eye(6)[seed] * 0.004)
        recovery = loss.recover_turns(replaced_axes=[seed])
        assert (recovery.mode, recovery.accepted) == ("motor", True), recovery.reason
        assert recovery.offset_u_rad[seed] > 0
        assert abs(loss.joint_error_rad(recovery)[seed]) <= 1.5 * recovery.offset_u_rad[seed]
        units = {check.name: check.unit for check in recovery.gate}
        assert (units["uncertainty"], units["redundancy"], units["chi square"]) == ("rad", "m", "1")


def test_all_references_lost_are_measured_with_a_stated_uncertainty():
    inside = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        loss = lose_turns(seed, 20, fractions=rng.uniform(0.15, 0.85, 6))
        recovery = loss.recover_turns()
        assert (recovery.mode, recovery.accepted) == ("all", True), recovery.reason
        inside += list(np.abs(loss.joint_error_rad(recovery)) <= recovery.offset_u_rad)
    assert np.mean(inside) >= 0.9


def test_a_bent_link_is_refused_as_a_change_of_geometry():
    refused = []
    for seed in range(20):
        rng = np.random.default_rng([seed, 5])
        shift, turn = rng.normal(size=2), rng.normal(size=3)
        shift, turn = shift / np.linalg.norm(shift) * 0.0015, turn / np.linalg.norm(turn) * np.deg2rad(0.3)
        bend = np.array([turn[0], *shift, turn[1], turn[2]])
        loss = lose_turns(seed, 20, crash={int(rng.integers(6)): bend})
        recovery = loss.recover_turns()
        refused.append(not recovery.accepted)
        if recovery.accepted:
            assert recovery.mode == "turns"
            assert recovery.offset_turns == tuple(loss.true_turns)
            assert not recovery.equipment_change
        elif recovery.mode == "geometry":
            assert "full calibration advised" in recovery.reason
            assert recovery.changed_part
        else:  # the first and the last link may as well be the wire's anchor and hook
            assert "the wire is not as recorded, or link" in recovery.reason
    assert np.mean(refused) >= 0.95


def test_check_poses_confirm_a_right_recovery_and_expose_a_wrong_turn():
    loss = lose_turns(4, 16)
    recovery = loss.recover_turns()
    rest = loss.capture_poses(record_poses()[np.random.default_rng([4, 1]).permutation(30)[16:24]])
    confirmed = verify_recovery(MODEL, loss.record, recovery, rest)
    assert confirmed.accepted
    assert {"verification", "verification power"} <= check_names(confirmed).keys()
    for axis in range(6):
        turns = tuple(t + (j == axis) for j, t in enumerate(recovery.offset_turns))
        wrong = verify_recovery(MODEL, loss.record, replace(recovery, offset_turns=turns), rest)
        assert not wrong.accepted
        assert not check_names(wrong)["verification"].passed


def test_check_poses_without_power_confirm_nothing():
    loss = lose_turns(4, 16)
    blind = loss.capture_poses(record_poses()[:1] + np.zeros((2, 6)))
    checked = verify_recovery(MODEL, loss.record, loss.recover_turns(), blind)
    assert not check_names(checked)["verification power"].passed
    assert not checked.accepted


def test_verification_power_is_the_change_of_length_by_one_turn_in_deviations():
    loss = lose_turns(2, 12)
    power = verification_power(MODEL, loss.record, record_poses()[:5])
    moved = loss.world.sagged_joints(record_poses()[:5]) + DRIVE.radians_per_turn().T[3]
    *_, flange = loss.world.link_frames(moved)
    *_, before = loss.world.link_frames(loss.world.sagged_joints(record_poses()[:5]))
    lengths = [
        np.linalg.norm(f[:, :3, :3] @ loss.world.hook + f[:, :3, 3] - loss.world.anchor, axis=1)
        for f in (flange, before)
    ]
    deviations = np.abs(lengths[0] - lengths[1]) / power[:, 3]
    assert power.shape == (5, 6 + 2 * 15)
    assert ((deviations > 1e-4) & (deviations < 1e-3)).all()


def test_the_prediction_before_measuring_is_what_the_recovery_finds():
    loss = lose_turns(1, poses=record_poses()[:16])
    surprise = (loss.true_turns - np.array(loss.provisional)) @ DRIVE.radians_per_turn().T
    probability, sigma = predict_turns(MODEL, loss.record, record_poses()[:16] + surprise)
    assert probability > 0.9999
    assert np.array(loss.recover_turns().sigma_turns) == pytest.approx(sigma, rel=0.02)


def test_results_survive_the_journal():
    adapter = TypeAdapter(TurnRecovery)
    for recovery in (
        lose_turns(1, 14).recover_turns(),
        lose_turns(1, 6).recover_turns(),
        lose_turns(2, 20, fractions=[0.4] * 6).recover_turns(),
    ):
        assert adapter.validate_json(adapter.dump_json(recovery)) == recovery


def test_captures_of_another_robot_are_refused():
    loss = lose_turns(0, 14)
    short = [replace(c, counts=c.counts[:5]) for c in loss.captures]
    for captures, guess in ((short, loss.provisional), ([], loss.provisional), (loss.captures, (0,) * 5)):
        loss.captures, loss.provisional = captures, guess
        with pytest.raises(CalibrationError):
            loss.recover_turns()
