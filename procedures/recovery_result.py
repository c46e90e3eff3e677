"""What a mastering recovery concludes, as pure functions of its findings."""

from dataclasses import dataclass, replace

import numpy as np

from calibration.kinematics import load_model
from calibration.mastering import MasteringRecord, WireCapture
from calibration.turn_recovery import GateCheck, TurnRecovery, recover_turns, verify_recovery
from drivers.interfaces import Counts, MasteringData
from procedures.mastering_record import seal

POWER_CHECK = "verification power"
LENGTH_CHECK = "verification"
SAME_JOINT_RAD = 1e-5  # controllers show joints as float32 degrees


@dataclass(frozen=True, slots=True)
class JointRecovery:
    """One joint: what its motor had lost, and what the correction is worth."""

    name: str
    turns_restored: int
    offset_rad: float  # by which the joint would have been wrong
    offset_u_rad: float  # of the restored zero, k = 2; 0.0 where whole turns were restored
    exact: bool  # its motor lost whole turns only


@dataclass(frozen=True, slots=True)
class RecoveryResult:
    """The end of a recovery: what was restored and how sure that is, or why nothing was."""

    verdict: str  # restored, refused
    mode: str  # turns, motor, all, geometry, undecided
    reason: str
    joints: tuple[JointRecovery, ...]
    counts_at_zero_before: Counts
    counts_at_zero: Counts
    captures: int
    check_captures: int
    measured_again: int
    robot_seconds: float
    gate: tuple[GateCheck, ...]
    poses_needed: int
    mastering: MasteringData | None = None  # as read back
    record: MasteringRecord | None = None  # the old record in the new counts


@dataclass(frozen=True, slots=True)
class Effort:
    """What a recovery cost."""

    captures: int
    check_captures: int
    measured_again: int
    robot_seconds: float


def judge(
    record: MasteringRecord,
    captures: tuple[WireCapture, ...],
    provisional: tuple[int, ...],
    exchanged: tuple[int, ...] = (),
) -> TurnRecovery:
    """Find the lost turns from the captures, or say what is missing."""
    model = load_model(record.model)
    return recover_turns(model, record, captures, provisional_turns=provisional, replaced_axes=exchanged)


def confirmed(
    record: MasteringRecord, recovery: TurnRecovery, checks: tuple[WireCapture, ...]
) -> TurnRecovery:
    """Judge a recovery at poses it was not fitted to."""
    return verify_recovery(load_model(record.model), record, recovery, checks)


def lacks_only_power(recovery: TurnRecovery) -> bool:
    """Tell whether the check poses agree and merely do not see enough."""
    failed = [check.name for check in recovery.gate if not check.passed]
    return failed == [POWER_CHECK]


def lengths_agree(recovery: TurnRecovery) -> bool:
    """Tell whether lengths at poses not fitted agree with the record."""
    return all(check.passed for check in recovery.gate if check.name == LENGTH_CHECK)


def next_record(record: MasteringRecord, recovery: TurnRecovery, epoch: int) -> MasteringRecord:
    """Return the same record in the counts the controller counts from now on: it serves the next loss."""
    shift = np.subtract(recovery.counts_at_zero, record.counts_at_zero)

    def moved(counts: Counts) -> Counts:
        return tuple(int(c) for c in np.add(counts, shift))

    return seal(
        replace(
            record,
            epoch=epoch,
            counts_at_zero=recovery.counts_at_zero,
            reference_counts=moved(record.reference_counts),
            captures=tuple(replace(c, counts=moved(c.counts)) for c in record.captures),
            taken_by="mastering_recovery 1",
        )
    )


def restored(
    record: MasteringRecord, recovery: TurnRecovery, effort: Effort, mastering: MasteringData, epoch: int
) -> RecoveryResult:
    """Return the result of a recovery that was written and confirmed."""
    result = _result(record, recovery, effort, "restored", recovery.reason)
    return replace(result, mastering=mastering, record=next_record(record, recovery, epoch))


def refused(record: MasteringRecord, recovery: TurnRecovery, effort: Effort, reason: str) -> RecoveryResult:
    """Return the evidence of a recovery that did not end in a correction."""
    return _result(record, recovery, effort, "refused", reason)


def _result(
    record: MasteringRecord, recovery: TurnRecovery, effort: Effort, verdict: str, reason: str
) -> RecoveryResult:
    names = load_model(record.model).joint_names
    offsets = record.drive.radians_per_turn() @ np.array(recovery.offset_turns)
    real = set(range(len(names))) if recovery.mode == "all" else set(recovery.replaced_axes)
    joints = tuple(
        JointRecovery(name, recovery.turns[j], float(offsets[j]), recovery.offset_u_rad[j], j not in real)
        for j, name in enumerate(names)
    )
    return RecoveryResult(
        verdict=verdict,
        mode=recovery.mode,
        reason=reason,
        joints=joints,
        counts_at_zero_before=record.counts_at_zero,
        counts_at_zero=recovery.counts_at_zero,
        captures=effort.captures,
        check_captures=effort.check_captures,
        measured_again=effort.measured_again,
        robot_seconds=effort.robot_seconds,
        gate=recovery.gate,
        poses_needed=recovery.poses_needed,
    )
