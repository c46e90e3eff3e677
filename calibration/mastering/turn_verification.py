"""Whether recovered turns are right, judged at captures that were not fitted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import MasteringRecord, WireCapture
from cellcal.calibration.mastering.turn_hypotheses import LocalResiduals, LossProblem, TurnEvidence
from cellcal.calibration.mastering.turn_results import GateCheck, TurnRecovery
from cellcal.calibration.message import make_message
from cellcal.calibration.uncertainty import chi_square_limit
from cellcal.calibration.wires.model import WirePoses
from cellcal.calibration.wires.reference import WirePredictor

VERIFICATION_POWER = 6.0


def verify_recovery(
    model: RobotModel, record: MasteringRecord, recovery: TurnRecovery, check_captures: Sequence[WireCapture]
) -> TurnRecovery:
    """Judge a recovery at captures that were not fitted: the fifth condition of the gate.

    The counts of the captures are the controller's before the correction. The poses must be able to see one
    wrong turn of every motor, and of every two motors in either sense, at six deviations; and the lengths
    must agree with the record at 99.9 %.

    Parameters
    ----------
    model : RobotModel
        Nominal model of the record.
    record : MasteringRecord
        Taken while the robot was healthy.
    recovery : TurnRecovery
        Of ``recover_turns``.
    check_captures : sequence of WireCapture
        At other poses than those fitted.

    Returns
    -------
    TurnRecovery
        The same with two more gate checks; ``accepted`` only if they and all earlier ones passed.

    Raises
    ------
    CalibrationError
        No check captures.
    """
    if not check_captures:
        raise CalibrationError("nothing was captured to verify the recovery with")
    return verify_evidence(LossProblem(model, record, check_captures), recovery)


def verify_evidence(problem: TurnEvidence, recovery: TurnRecovery) -> TurnRecovery:
    """Judge a recovery by any captures that were not fitted, as ``verify_recovery`` does by lengths."""
    local = problem.linearise_at(np.array(recovery.offset_turns))
    spread = local.by_turn @ np.array(recovery.offset_covariance) @ local.by_turn.T
    local = replace(local, scatter=local.scatter + spread)
    if recovery.equipment_change:
        columns = local.equipment.columns
        local = replace(
            local,
            residuals=local.residuals - columns @ np.array(recovery.equipment_change),
            scatter=local.scatter + columns @ np.array(recovery.equipment_covariance) @ columns.T,
        )
    found, limit = local.chi_square(), chi_square_limit(len(local.residuals))
    power = float(detection_deviations(problem, local).max(axis=0).min())
    largest_mm = 1e3 * float(np.abs(local.residuals).max())
    checks = (
        GateCheck(
            "verification power",
            power >= VERIFICATION_POWER,
            power,
            VERIFICATION_POWER,
            make_message(
                "the check poses see a wrong turn of any one or two motors at {power:.0f} deviations or more",
                power=power,
            ),
        ),
        GateCheck(
            "verification",
            found <= limit,
            found,
            limit,
            make_message(
                "{capture_count} captures that were not fitted agree within {largest_mm:.2f} mm",
                capture_count=problem.capture_count,
                largest_mm=largest_mm,
            ),
        ),
    )
    passed = all(check.passed for check in checks)
    reason = recovery.reason if passed else "the check poses do not confirm the result"
    accepted = recovery.accepted and passed
    return replace(recovery, accepted=accepted, reason=reason, gate=(*recovery.gate, *checks))


def verification_power(
    model: RobotModel,
    record: MasteringRecord,
    joints_rad: Array,
    offset_covariance: Sequence[Sequence[float]] | None = None,
) -> Array:
    """Return (V, m): by how many deviations each wrong story would show at each check pose.

    The first n stories are one wrong turn of each motor, the others one wrong turn of two motors in either sense.
    ``offset_covariance`` (n, n) [turns^2] is what a recovery does not know of offsets that are no whole turns.
    """
    predictor = WirePredictor(model, *record.wire_lengths())
    terms = predictor.wire_terms(WirePoses.from_record_side(joints_rad, predictor.sigma_m))
    variances = predictor.scatter_of_sets(terms, 1)[:, 0, 0]  # each capture by itself
    if offset_covariance is not None:
        by_turn = terms.by_joint @ record.drive.radians_per_turn()
        variances = variances + np.einsum("vi,ij,vj->v", by_turn, np.array(offset_covariance), by_turn)
    deviations = np.sqrt(variances)
    shifts = []
    for turn in _wrong_turns(model.axis_count) @ record.drive.radians_per_turn().T:
        moved = predictor.wire_terms(
            WirePoses.from_record_side(terms.poses.joints_rad + turn, predictor.sigma_m)
        ).lengths
        shifts.append(np.abs(moved - terms.lengths) / deviations)
    return np.stack(shifts, axis=1)


def motor_estimates(problem: TurnEvidence, turns: Array) -> tuple[Array, Array]:
    """Return what all captures together say of each motor, the others taken as they are.

    Parameters
    ----------
    problem : Evidence
        The captures.
    turns : (n,)
        Where the motors are taken to be [turns].

    Returns
    -------
    sharpness : (n,)
        By how many deviations a whole turn of that motor would show.
    found : (n,)
        The turns by which that motor would have to be off to explain the residuals best; its standard deviation is
        one over the sharpness.
    """
    local = problem.linearise_at(turns)
    weighted = np.linalg.solve(local.scatter, local.by_turn)
    information = np.einsum("mi,mi->i", local.by_turn, weighted)
    return np.sqrt(information), weighted.T @ local.residuals / np.maximum(information, 1e-12)


def _wrong_turns(motors: int) -> Array:
    """Return (m, n) [turns]: one motor wrong by one turn, then two motors in either sense."""
    unit = np.eye(motors)
    pairs = [(i, j) for i in range(motors) for j in range(i)]
    return np.array([*unit, *(unit[i] + unit[j] for i, j in pairs), *(unit[i] - unit[j] for i, j in pairs)])


def detection_deviations(problem: TurnEvidence, local: LocalResiduals) -> Array:
    """Return (V, m): by how many deviations each story of wrong turns would show in each row of any evidence.

    The stories are those of ``verification_power``; the deviations are those of ``local.scatter``.
    """
    deviations = np.sqrt(np.diag(local.scatter))
    hypotheses = local.turns + _wrong_turns(len(local.turns))
    shifted = [np.abs(problem.model_values(turns) - local.values) / deviations for turns in hypotheses]
    return np.stack(shifted, axis=1)
