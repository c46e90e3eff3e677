"""Counts, turns and zeros; the healthy record and what it predicts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.mastering.counts import DriveTrain, MasteringRecord, WireCapture, provisional_turns
from cellcal.calibration.motion.motion_check import allowed_postures
from cellcal.calibration.wires.model import WirePoses, WirePrior, wire_terms
from cellcal.calibration.wires.reference import WirePredictor, fit_wire_reference, parameter_sigmas
from tests.unit.helpers.recovery_cases import (
    DRIVE,
    LIMITS,
    MODEL,
    PRIOR,
    SIGMA_M,
    healthy_record,
    record_poses,
)
from tests.unit.helpers.wire_world import COUNTS_PER_TURN, WireWorld, interaction_matrix

ZERO = np.array([1_000_000, -2_000_000, 5, 0, 77_777, -1])


@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6))
def test_counts_and_joints_are_inverse_within_half_a_count(joints):
    back = DRIVE.to_joints(DRIVE.to_counts(np.array(joints), ZERO), ZERO)
    assert np.abs(back - joints).max() <= 0.51 * np.abs(interaction_matrix()).sum(axis=1).max()


def test_a_motor_turn_moves_its_joint_by_one_over_the_ratio_and_the_wrist_along():
    moved = DRIVE.to_joints(ZERO + COUNTS_PER_TURN * np.eye(6, dtype=int)[3], ZERO)
    assert moved == pytest.approx([0, 0, 0, 2 * np.pi / 80.25, 2 * np.pi / 160, -2 * np.pi / 100])
    assert DRIVE.radians_per_turn()[:, 3] == pytest.approx(moved)


def test_whole_turns_move_the_zero_by_whole_turns():
    shifted = DRIVE.shifted_zero(tuple(ZERO.tolist()), (3.0, -40.0, 0.0, 1.0, 0.0, 0.25))
    assert np.subtract(ZERO, shifted).tolist() == [3 * 2**19, -40 * 2**19, 0, 2**19, 0, 2**17]
    true = ZERO + np.array([3, -40, 0, 1, 0, 0.25]) * COUNTS_PER_TURN + 12345
    read = true - np.array([3, -40, 0, 1, 0, 0.25]) * COUNTS_PER_TURN
    assert DRIVE.to_joints(read, np.array(shifted)) == pytest.approx(DRIVE.to_joints(true, ZERO))


def test_provisional_turns_survive_a_small_sag():
    healthy = (2**19 * 20 + 1000, -5, 0, 0, 0, 0)
    read = (1000 - 40_000, -5 + 2**19, 100_000, 0, 0, 0)
    assert provisional_turns(DRIVE, healthy, read) == (20, -1, 0, 0, 0, 0)


@pytest.mark.parametrize("matrix", [np.zeros((2, 2)), np.full((2, 2), np.nan), np.eye(3)])
def test_a_drive_that_cannot_be_is_refused(matrix):
    with pytest.raises(CalibrationError):
        DriveTrain(tuple(map(tuple, matrix.tolist())), (100, 100))


@pytest.mark.parametrize("numbers", [(float("nan"), 1e-4), (1.0, 0.0), (1.0, float("inf"))])
def test_a_capture_without_a_sound_length_is_refused(numbers):
    with pytest.raises(CalibrationError):
        WireCapture((0,) * 6, *numbers)


def test_the_wire_terms_are_the_derivatives_of_the_length():
    x = np.zeros(38)
    x[:8] = [*PRIOR.anchor_in_base_m, *PRIOR.hook_in_flange_m, 0.003, 1.001]
    wire_poses = WirePoses.from_record_side(record_poses()[:4], SIGMA_M)
    terms = wire_terms(MODEL, x, wire_poses)
    for j in range(38):
        step = 1e-6 * np.eye(38)[j]
        slope = (
            wire_terms(MODEL, x + step, wire_poses).lengths - wire_terms(MODEL, x - step, wire_poses).lengths
        ) / 2e-6
        assert terms.by_parameter[:, j] == pytest.approx(slope, abs=1e-7)
    for j in range(6):
        step = 1e-6 * np.eye(6)[j]
        ahead, behind = (
            wire_terms(MODEL, x, WirePoses.from_record_side(record_poses()[:4] + s, SIGMA_M))
            for s in (step, -step)
        )
        assert terms.by_joint[:, j] == pytest.approx((ahead.lengths - behind.lengths) / 2e-6, abs=1e-7)


def test_the_record_finds_anchor_and_hook_within_its_uncertainty():
    deviations = []
    for seed in range(10):
        world = WireWorld(seed)
        wire = healthy_record(world).wire
        sigma = np.sqrt(np.diag(np.array(wire.covariance)))[3:6]
        deviations.append((np.array(wire.hook_in_flange_m) - world.hook) / sigma)
        # The lip of the exit moves the anchor that the wire seems to have.
        assert np.linalg.norm(np.array(wire.anchor_in_base_m) - world.anchor) < world.exit_radius
        assert wire.is_consistent()
        assert wire.residual_rms_m < 0.0004
    assert np.sqrt(np.mean(np.square(deviations))) < 1.5


def test_the_record_predicts_new_lengths_within_its_covariance():
    squares = []
    for seed in range(8):
        world = WireWorld(seed)
        record = healthy_record(world)
        poses = record_poses() + np.random.default_rng(seed).uniform(-0.3, 0.3, record_poses().shape)
        poses = poses[allowed_postures(MODEL, poses, LIMITS, PRIOR.hook_in_flange_m)]
        predictor = WirePredictor(MODEL, record.wire, record.prior)
        expected, scatter = predictor.expected_lengths(
            predictor.wire_terms(WirePoses.from_record_side(poses, SIGMA_M))
        )
        residuals = world.measure_lengths(poses) - expected
        squares.append(residuals @ np.linalg.solve(scatter, residuals) / len(poses))
    assert 0.2 < np.mean(squares) < 1.1
    assert max(squares) < 2.0


def test_a_record_with_a_wrong_length_is_inconsistent_and_names_it():
    world = WireWorld(3)
    joints, lengths = record_poses(), world.measure_lengths(record_poses())
    lengths[11] += 0.008
    wire = fit_wire_reference(MODEL, joints, lengths, SIGMA_M, PRIOR)
    assert not wire.is_consistent()
    assert wire.worst_capture == 11


def test_the_order_of_captures_does_not_matter():
    world = WireWorld(5)
    joints, lengths = record_poses(), world.measure_lengths(record_poses())
    order = np.random.default_rng(1).permutation(len(joints))
    plain = fit_wire_reference(MODEL, joints, lengths, SIGMA_M, PRIOR)
    mixed = fit_wire_reference(MODEL, joints[order], lengths[order], SIGMA_M, PRIOR)
    assert mixed.parameter_vector() == pytest.approx(plain.parameter_vector(), abs=1e-9)
    assert mixed.chi_square == pytest.approx(plain.chi_square, rel=1e-6)


def test_a_model_without_a_dh_table_is_fitted_with_twists():
    bare = MODEL.with_twists(np.zeros((7, 6)))
    world = WireWorld(6)
    wire = fit_wire_reference(bare, record_poses(), world.measure_lengths(record_poses()), SIGMA_M, PRIOR)
    assert isinstance(bare, RobotModel)
    assert len(wire.covariance) == 8 + 42 == len(parameter_sigmas(bare, PRIOR))
    assert np.linalg.norm(np.array(wire.anchor_in_base_m) - world.anchor) < 0.006


def test_records_that_say_nothing_are_refused():
    lengths = np.ones(30)
    with pytest.raises(DegenerateDataError):
        fit_wire_reference(MODEL, record_poses()[:7], lengths[:7], SIGMA_M, PRIOR)
    with pytest.raises(CalibrationError):
        fit_wire_reference(MODEL, record_poses(), lengths[:20], SIGMA_M, PRIOR)
    with pytest.raises(CalibrationError):
        fit_wire_reference(MODEL, record_poses(), lengths * np.nan, SIGMA_M, PRIOR)
    with pytest.raises(CalibrationError):
        fit_wire_reference(MODEL, record_poses(), lengths, 0.0, PRIOR)
    with pytest.raises(CalibrationError):
        WirePrior((0.0, 0.0, float("nan")), (0.0, 0.0, 0.1))
    with pytest.raises(CalibrationError):
        WirePrior((0.0, 0.0, 0.0), (0.0, 0.0, 0.1), sigma_angle_rad=0.0)


def test_a_record_survives_the_journal():
    record = healthy_record(WireWorld(7))
    adapter = TypeAdapter(MasteringRecord)
    assert adapter.validate_json(adapter.dump_json(record)) == record
