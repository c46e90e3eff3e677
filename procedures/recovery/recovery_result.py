"""What a mastering recovery concludes, as pure functions of its findings."""

from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.mastering.counts import MasteringRecord, WireCapture
from cellcal.calibration.mastering.drawn_walk import DrawnWalk
from cellcal.calibration.mastering.flank_check import FlankCheck, compare_flanks
from cellcal.calibration.mastering.hypothesis_report import BLIND_SIGMAS
from cellcal.calibration.mastering.turn_hypotheses import LossProblem
from cellcal.calibration.mastering.turn_recovery import (
    GateCheck,
    TurnRecovery,
    recover_turns,
    verify_recovery,
)
from cellcal.calibration.mastering.turn_verification import motor_estimates
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Counts, Instruction, MasteringData
from cellcal.procedures.recovery.record_seal import seal_record
from cellcal.procedures.recovery.recovery_pages import correction_page

POWER_CHECK = "verification power"
SHARP_CHECK = "sharpness"
LENGTH_CHECK = "verification"
ALONE_CHECK = "each motor alone"
MEMORY_POWER = 27.0  # deviations of a whole turn at which a fraction of 0.15 turn shows at four …
HIDDEN_SIGMAS = 4.0  # … and what a few lengths may hide from their chi square
ALONE_SIGMAS = 3.5  # of the turns that one motor would have to be off to explain the lengths best
SAME_JOINT_RAD = 1e-5  # controllers show joints as float32 degrees


@dataclass(frozen=True, slots=True)
class JointRecovery:
    """One joint: what its motor had lost, and what the correction is worth."""

    name: str
    turns_restored: int
    offset_rad: float  # by which the joint would have been wrong
    offset_u_rad: float  # of the restored zero, k = 2; 0.0 where all motors that turn it are exact
    exact: bool  # its own motor lost whole turns only


@dataclass(frozen=True, slots=True)
class RecoveryResult:
    """The end of a recovery: what was restored and how sure that is, or why nothing was."""

    verdict: str  # restored, refused
    mode: str  # memory, turns, motor, all, geometry, undecided
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
    set_aside: tuple[str, ...] = ()  # captures that did not fit the others; measured again
    final_captures: int = 0
    flanks: FlankCheck | None = None  # check poses gone to again, some from the other side
    drawn: DrawnWalk | None = None  # None by places, of memory alone, and in results older than it
    jog_speed_rad_s: float = 0.0


def widest_u_rad(recovery: TurnRecovery) -> float:
    """Return the uncertainty (k = 2) of the least certain offset; 0 where whole turns were lost."""
    return max(recovery.offset_u_rad)


@dataclass(frozen=True, slots=True)
class RecoveryEffort:
    """The effort of a recovery."""

    captures: int
    check_captures: int
    measured_again: int
    robot_seconds: float
    set_aside: tuple[str, ...] = ()
    final_captures: int = 0
    drawn: DrawnWalk | None = None
    jog_speed_rad_s: float = 0.0


def judge_captures(
    record: MasteringRecord,
    captures: tuple[WireCapture, ...],
    provisional: tuple[int, ...],
    exchanged: tuple[int, ...] = (),
) -> TurnRecovery:
    """Find the lost turns from the captures, or say what is missing."""
    model = load_model(record.model)
    return recover_turns(model, record, captures, provisional_turns=provisional, replaced_axes=exchanged)


def confirm_recovery(
    record: MasteringRecord, recovery: TurnRecovery, checks: tuple[WireCapture, ...]
) -> TurnRecovery:
    """Judge a recovery at poses it was not fitted to."""
    return verify_recovery(load_model(record.model), record, recovery, checks)


def tooth_flanks(
    record: MasteringRecord,
    recovery: TurnRecovery,
    checks: tuple[WireCapture, ...],
    again: tuple[WireCapture, ...],
) -> FlankCheck:
    """Compare check poses with themselves, from the same side and from the other one."""
    return compare_flanks(load_model(record.model), record, recovery, checks, again)


def nothing_lost_recovery(record: MasteringRecord) -> TurnRecovery:
    """Return the story that the controller forgot its mastering and the encoders forgot nothing."""
    motors = len(record.counts_at_zero)
    none = (0.0,) * motors
    return TurnRecovery(
        mode="memory",
        accepted=True,
        reason="the encoders kept their position; the controller had lost or changed its mastering data",
        turns=(0,) * motors,
        replaced_axes=(),
        offset_turns=none,
        offset_u_rad=none,
        counts_at_zero=record.counts_at_zero,
        gate=(),
        poses_needed=0,
        next_joints_rad=(),
        suspect_capture=None,
        changed_part="",
        success_probability=1.0,
        sigma_turns=none,
        chi_square=0.0,
        degrees_of_freedom=0,
        captures=0,
        offset_covariance=(none,) * motors,
    )


def confirm_memory(
    record: MasteringRecord, recovery: TurnRecovery, checks: tuple[WireCapture, ...]
) -> TurnRecovery:
    """Judge by check poses alone that nothing was lost: a fraction of a turn must show, too."""
    verified = confirm_recovery(record, recovery, checks)
    problem = LossProblem(load_model(record.model), record, checks)
    power, found = motor_estimates(problem, np.zeros(len(recovery.turns)))
    weakest, farthest = float(power.min()), float(np.abs(found * power).max())
    words = make_message(
        "the check poses see a whole turn of any motor at {weakest:.0f} deviations or more", weakest=weakest
    )
    sharp = GateCheck(SHARP_CHECK, weakest >= MEMORY_POWER, weakest, MEMORY_POWER, words)
    message = make_message(
        "no motor alone explains the lengths better by more than {farthest:.1f} deviations", farthest=farthest
    )
    alone = GateCheck(ALONE_CHECK, farthest <= ALONE_SIGMAS, farthest, ALONE_SIGMAS, message)
    blind = tuple(float(HIDDEN_SIGMAS / max(p, 1e-9)) for p in power)
    accepted = verified.accepted and sharp.passed and alone.passed
    return replace(verified, accepted=accepted, gate=(*verified.gate, sharp, alone), blind_turns=blind)


def is_controller_right(record: MasteringRecord, recovery: TurnRecovery, mastering: MasteringData) -> bool:
    """Return whether the measurement agrees with what the controller holds, and not with the record.

    The record is older than the robot's last mastering then, or of another robot.
    """
    if (
        not mastering.mastered
        or not recovery.replaced_axes
        or recovery.counts_at_zero == mastering.counts_at_zero
    ):
        return False
    moved = np.subtract(mastering.counts_at_zero, recovery.counts_at_zero)
    apart_rad = np.abs(np.array(record.drive.radians_per_count) @ moved)
    return bool((apart_rad <= np.maximum(np.array(recovery.offset_u_rad), SAME_JOINT_RAD) * 1.5).all())


def is_only_underpowered(recovery: TurnRecovery) -> bool:
    """Return whether the check poses agree and merely do not see enough."""
    failed = [check.name for check in recovery.gate if not check.passed]
    return bool(failed) and set(failed) <= {POWER_CHECK, SHARP_CHECK}


def lengths_agree(recovery: TurnRecovery) -> bool:
    """Return whether lengths at poses not fitted agree with the record."""
    return all(check.passed for check in recovery.gate if check.name == LENGTH_CHECK)


def next_record(record: MasteringRecord, recovery: TurnRecovery, epoch: int) -> MasteringRecord:
    """Return the same record in the counts the controller counts from now on: it serves the next loss."""
    shift = np.subtract(recovery.counts_at_zero, record.counts_at_zero)

    def move_counts(counts: Counts) -> Counts:
        return tuple(int(c) for c in np.add(counts, shift))

    return seal_record(
        replace(
            record,
            epoch=epoch,
            counts_at_zero=recovery.counts_at_zero,
            reference_counts=move_counts(record.reference_counts),
            captures=tuple(replace(c, counts=move_counts(c.counts)) for c in record.captures),
            kit=None
            if record.kit is None
            else replace(
                record.kit,
                places=tuple(replace(place, counts=move_counts(place.counts)) for place in record.kit.places),
            ),
            taken_by="mastering_recovery 1",
        )
    )


def restored_result(
    record: MasteringRecord,
    recovery: TurnRecovery,
    effort: RecoveryEffort,
    mastering: MasteringData,
    epoch: int,
) -> RecoveryResult:
    """Return the result of a recovery that was written and confirmed."""
    result = _make_result(record, recovery, effort, "restored", recovery.reason)
    return replace(result, mastering=mastering, record=next_record(record, recovery, epoch))


def refused_result(
    record: MasteringRecord, recovery: TurnRecovery, effort: RecoveryEffort, reason: str
) -> RecoveryResult:
    """Return the evidence of a recovery that did not end in a correction."""
    return _make_result(record, recovery, effort, "refused", reason)


def _make_result(
    record: MasteringRecord, recovery: TurnRecovery, effort: RecoveryEffort, verdict: str, reason: str
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
        set_aside=effort.set_aside,
        final_captures=effort.final_captures,
        drawn=effort.drawn,
        jog_speed_rad_s=effort.jog_speed_rad_s,
    )


def correction_instruction(recovery: TurnRecovery, record: MasteringRecord | None = None) -> Instruction:
    """Return the question before the mastering is written: what was found, and what no measurement tells.

    With the record, a screen shows old and new counts and what they are worth at the tool.
    """
    instruction = Instruction(
        "accept_mastering",
        make_message(
            "{entry_text}. The check poses confirm it. {proviso_text}Write the mastering data to the "
            "controller?",
            entry_text=recovery.reason,
            proviso_text=_proviso_text(recovery),
        ),
    )
    return instruction if record is None else correction_page(instruction, record, recovery)


def _proviso_text(recovery: TurnRecovery) -> str:
    """Say what no measurement tells from lost turns."""
    if recovery.mode == "motor":
        others = [
            sigma for axis, sigma in enumerate(recovery.sigma_turns) if axis not in recovery.replaced_axes
        ]
        return make_message(
            "Whole turns of the other motors are exact only if no part of them was exchanged, too (a new one within "
            "{blind_turns:.2f} turn of a whole one looks the same); if one was, leave the mastering as it was and "
            "start again with exchanged_axes. ",
            blind_turns=BLIND_SIGMAS * max(others, default=0.0),
        )
    if recovery.mode not in ("turns", "memory"):
        return ""
    return make_message(
        "Whole turns are exact only if no motor, encoder, belt or gear was exchanged (a new one within "
        "{blind_turns:.2f} turn of a whole one looks the same); if one was, leave the mastering as it was and start "
        "again with exchanged_axes. ",
        blind_turns=max(recovery.blind_turns),
    )
