"""Mastering recovery: a robot that lost its encoders gets its zero back, exactly where turns were lost.

The gate of calibration/mastering/turn_recovery.py decides; this procedure brings it the captures it asks for, writes
only what check poses have confirmed, and says why when it refuses.
"""

from dataclasses import replace

from pydantic_core import to_jsonable_python

from cellcal.calibration.mastering.counts import MasteringRecord, WireCapture, provisional_turns
from cellcal.calibration.mastering.flank_check import OTHER_SIDE, FlankCheck
from cellcal.calibration.mastering.place_recovery import FITTED
from cellcal.calibration.mastering.turn_recovery import TurnRecovery
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Instruction, MasteringData
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.forecast import Forecast, Knowledge
from cellcal.procedures.mastering_record import HOOK_WIRE
from cellcal.procedures.motion.lost_plans import FinalPlan, plan_finals
from cellcal.procedures.motion.turn_uncertainty import Turns, first_uncertainty, sure_turns
from cellcal.procedures.motors import MotorState
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance, ask_confirmation
from cellcal.procedures.recovery.mastering_forecasts import forecast_place_recovery, forecast_recovery
from cellcal.procedures.recovery.place_recovery import OLD_RECORD, recover_by_places
from cellcal.procedures.recovery.position_alarms import (
    AlarmRound,
    ClearedEncoders,
    IndexTurning,
    clear_position_alarms,
    end_battery_alarms,
)
from cellcal.procedures.recovery.recovery_campaign import (
    RecoveryCampaign,
    check_memory,
    compare_with_drawn,
    confirm_elsewhere,
    measure_until_decided,
)
from cellcal.procedures.recovery.recovery_pages import levers_page
from cellcal.procedures.recovery.recovery_result import (
    RecoveryResult,
    confirm_recovery,
    correction_instruction,
    is_controller_right,
    lengths_agree,
    restored_result,
    tooth_flanks,
)
from cellcal.procedures.recovery.recovery_spec import (
    MasteringRecoverySpec,
    fewest_captures,
    refuse_other_gears,
    refuse_unknown_axes,
)
from cellcal.procedures.recovery.recovery_verdict import saving_texts, verdict_on_recovery
from cellcal.procedures.recovery.saved_counts import confirm_newest, saved_counts_page
from cellcal.procedures.run import Run
from cellcal.procedures.steps.capture import capture_still
from cellcal.procedures.steps.mastering import check_same_epoch, read_motors, stored_record
from cellcal.procedures.steps.motion import CountsToJoints, go_to, go_to_from_above
from cellcal.procedures.steps.write import check_still_in_force, restore_mastering, write_mastering
from cellcal.procedures.verdict import ProcedureVerdict

__all__ = ["DEFINITION", "MasteringRecoverySpec", "mastering_recovery"]

MOST_CAPTURES, FEWEST_FINALS = 19, 2  # of a loss of turns, all together

AT_REFERENCE = Instruction(
    "at_reference",
    "The robot's last position is unknown. Bring it near the pose where its record was taken, by the marks.",
)


async def mastering_recovery(run: Run, spec: MasteringRecoverySpec) -> RecoveryResult:
    """Wake the encoders, measure until the gate holds, confirm elsewhere, write, confirm what was written."""
    if run.is_jogged_by_hand:
        spec = fewest_captures(spec)
    record = await run.step("read the stored record", stored_record)
    await run.step("the saved counts", confirm_newest, saved_counts_page(record, spec.last_counts))
    alarms_before = AlarmRound()
    if spec.last_counts is None:
        alarms_before = await end_battery_alarms(run, spec.alarms)
        await run.step("near the reference pose", ask_confirmation, levers_page(AT_REFERENCE, record))
    last_counts = record.reference_counts if spec.last_counts is None else spec.last_counts
    by_places = spec.evidence == "places" or record.wire is None  # which then has places only
    if not by_places:
        await run.ensure("the wire is hooked", ask_confirmation, HOOK_WIRE)
    doubt = first_uncertainty(spec.room, len(last_counts), is_measured=spec.last_counts is not None)
    turning = IndexTurning(spec.index_speed_rad_s, spec.room, doubt)
    woken = await clear_position_alarms(run, record, last_counts, spec.alarms, turning, alarms_before)
    if by_places:
        return await recover_by_places(run, spec, record, woken.counts)
    return await _recover_by_wire(run, spec, record, woken, doubt)


async def _recover_by_wire(
    run: Run, spec: MasteringRecoverySpec, record: MasteringRecord, woken: ClearedEncoders, doubt_turns: Turns
) -> RecoveryResult:
    """Measure until the gate holds, confirm elsewhere, write, confirm what was written."""
    state = await run.step("read the motors", read_motors)
    refuse_other_gears(record, state.drive)
    refuse_unknown_axes(spec, len(state.counts))
    await run.ensure("the encoders kept their position", check_same_epoch, state.epoch)

    guess = provisional_turns(record.drive, woken.counts, state.counts)
    mapping = CountsToJoints(record.drive, record.counts_at_zero, guess)
    campaign = RecoveryCampaign(
        run, spec, record, state, mapping, mapping.joints_at(state.counts), doubt_turns
    )
    remembered = not woken.lost and _is_data_different(record, state)
    recovery = await check_memory(campaign) if remembered else None
    if recovery is None:
        found = await measure_until_decided(campaign, guess)
        await _refuse_wrong_record(campaign, found)
        recovery = await confirm_elsewhere(campaign, found)

    finals = await _plan_finals(campaign, recovery)
    await compare_with_drawn(campaign, recovery)
    await run.step(
        "accept the correction",
        ask_acceptance,
        correction_instruction(recovery, record),
        _recovery_hash(recovery),
    )
    written = await run.write("write the mastering", write_mastering, recovery.counts_at_zero)
    await run.ensure("the written mastering is in force", check_still_in_force, recovery.counts_at_zero)
    flanks = await _confirm_written(campaign, recovery, finals)
    done = replace(campaign.make_effort(), final_captures=len(finals.motion.poses_rad))
    return replace(restored_result(record, recovery, done, written, state.epoch), flanks=flanks)


async def _plan_finals(campaign: RecoveryCampaign, recovery: TurnRecovery) -> FinalPlan:
    """Plan to go to check poses again: fewer from the other side where the recovery took many captures."""
    places = tuple(campaign.mapping.joints_at(check.counts) for check in campaign.checks)
    captures_open = MOST_CAPTURES - campaign.taken - len(campaign.checks)
    most = max(FEWEST_FINALS, min(campaign.spec.final_captures, captures_open))
    known_values = (campaign.record, campaign.state, campaign.spec.room, places)
    left_turns = sure_turns(recovery.offset_covariance)
    return await campaign.run.solve("plan the final checks", plan_finals, *known_values, most, left_turns)


async def _confirm_written(
    campaign: RecoveryCampaign, recovery: TurnRecovery, finals: FinalPlan
) -> FlankCheck:
    """Move by the written mastering to check poses again; put the old data back if the lengths disagree.

    Some are reached from the other side: the difference tells the gears' play, and whether something is loose.
    """
    run, spec, plan = campaign.run, campaign.spec, finals.motion
    again: list[WireCapture] = []
    campaign.seconds += plan.moving_s
    goals = zip(plan.poses_rad, plan.speeds_rad_s, finals.other_side, strict=True)
    for k, (pose, speed_rad_s, other) in enumerate(goals, 1):
        go, side = (go_to_from_above, OTHER_SIDE) if other else (go_to, "record")
        await run.move(f"go to final check {k}", go, pose, speed_rad_s, plan.doubt)
        what = make_message("final check {k}", k=k)
        still = await run.step(what, capture_still, what, spec.samples, spec.tolerance_counts, side)
        again.append(campaign.add_capture(still))
    name = "confirm the written mastering"
    final = await run.solve(name, confirm_recovery, campaign.record, recovery, tuple(again))
    if not lengths_agree(final):
        old: MasteringData = campaign.state.mastering
        await run.write("put the old mastering back", restore_mastering, old)
        reason = "with the new mastering the lengths no longer agree; the old data were put back"
        remedy = "The robot is not mastered, as before. Start the recovery again."
        raise campaign.refused_error(final, reason, remedy, "procedure.not_confirmed")
    looked = (campaign.record, recovery, tuple(campaign.checks), tuple(again))
    return await run.solve("compare the tooth flanks", tooth_flanks, *looked)


def _is_data_different(record: MasteringRecord, state: MotorState) -> bool:
    """Return whether the controller holds other mastering data than the record, or none."""
    return state.mastering != MasteringData(record.counts_at_zero, mastered=True)


async def _refuse_wrong_record(campaign: RecoveryCampaign, recovery: TurnRecovery) -> None:
    """Refuse a record that is older than the robot's mastering; where all is new, have the plate looked at."""
    record, present = campaign.record, campaign.state.mastering
    if is_controller_right(record, recovery, present):
        reason = "the lengths agree with the mastering that the controller holds, and not with the record"
        raise campaign.refused_error(recovery, reason, OLD_RECORD, "procedure.wrong_record")
    if recovery.mode == "all":
        await campaign.run.step("compare the arm's plate", ask_confirmation, _plate_instruction(record))


def _plate_instruction(record: MasteringRecord) -> Instruction:
    return Instruction(
        "compare_plate",
        make_message(
            "No motor stands at a whole turn of the record: every reference was lost, or this is "
            "another arm, or the record is of another one. Read the plate on the arm itself: is it "
            "{robot_serial}, with no new arm or link since the record was taken?",
            robot_serial=record.robot_serial,
        ),
    )


def _recovery_hash(recovery: TurnRecovery) -> str:
    return sha256_of(to_jsonable_python(recovery.counts_at_zero))


def _outline_phases(spec: MasteringRecoverySpec) -> tuple[Phase, ...]:
    return (
        Phase("read the stored record"),
        Phase("the saved counts"),
        *(Phase(name, times, adaptive=True) for name, times in _BATTERIES),
        *((Phase("near the reference pose"),) if spec.last_counts is None else ()),
        *(Phase(name, times, adaptive=True) for name, times in _INDICES),
        *(_wire_phases(spec) if spec.evidence == "wire" else _BY_PLACES),
        *(Phase("accept the correction"), Phase("write the mastering")),
        *(_final_phases(spec) if spec.evidence == "wire" else _FINALLY_PLACES),
        *(Phase("confirm the written mastering"), Phase("put the old mastering back", 0, adaptive=True)),
    )


_BATTERIES = (
    *(("look at the alarms", 3), ("new battery", 1), ("acknowledge the lost position", 1)),
    *(("power cycle", 1), ("wait for the robot", 1)),
)
_INDICES = (
    *(("plan the turns", 1), ("slow motion", 1)),
    ("reset the alarms", 0),
    ("counts before the turns", 1),
    *((f"turn J{axis} past its encoder mark,", 1) for axis in range(1, 7)),
    ("clear the alarms", 1),
)
_BY_PLACES = (
    *(Phase("read the motors alone"), Phase("choose the places"), Phase("nest", 0, adaptive=True)),
    *(Phase("place", FITTED, adaptive=True), Phase("judge the places", 1, adaptive=True)),
    *(Phase("place again", 0, adaptive=True), Phase("check place", 2, adaptive=True)),
    Phase("confirm at the places"),
)
_FINALLY_PLACES = (Phase("final place"), Phase("read the motors after writing"))


def _final_phases(spec: MasteringRecoverySpec) -> tuple[Phase, ...]:
    return (
        Phase("go to final check", spec.final_captures, adaptive=True),
        Phase("final check", spec.final_captures, adaptive=True),
        Phase("compare the tooth flanks"),
    )


def _wire_phases(spec: MasteringRecoverySpec) -> tuple[Phase, ...]:
    memory = (
        *(("plan the memory checks", 0), ("accept the memory checks", 0), ("go to memory check", 0)),
        *(("memory check", 0), ("confirm the memory", 0)),
    )
    measuring = (
        *(("go to capture", spec.first_captures), ("capture", spec.first_captures)),
        *(("judge the captures", 1), ("plan one more pose", 0), ("compare the arm's plate", 0)),
        ("plan the checks", 1),
        *(("go to check", spec.check_captures), ("check", spec.check_captures), ("confirm by checks", 1)),
    )
    return (
        Phase("read the motors"),
        *(Phase(name, times, adaptive=True) for name, times in memory),
        *(Phase("plan the first poses", adaptive=True), Phase("accept the plan", adaptive=True)),
        *(Phase(name, times, adaptive=True) for name, times in measuring),
        *(Phase("plan the final checks"), Phase("compare with drawn poses")),
    )


def _results_to_store(spec: MasteringRecoverySpec, result: RecoveryResult) -> StoredResult | None:
    del spec
    if result.record is None:
        return None
    return StoredResult("mastering_record", result.record.robot_serial, result.record)


def _make_verdict(spec: MasteringRecoverySpec, result: RecoveryResult) -> ProcedureVerdict:
    verdict = verdict_on_recovery(spec.accuracy_class, spec.limits, result)
    return replace(verdict, remarks=(*verdict.remarks, *saving_texts(spec, result)))


def _forecast_run(spec: MasteringRecoverySpec, knowledge: Knowledge) -> Forecast:
    captures = (spec.first_captures, spec.check_captures, spec.final_captures)
    knowledge = replace(knowledge, last_counts=spec.last_counts)
    if spec.evidence == "places" or (knowledge.record is not None and knowledge.record.wire is None):
        return forecast_place_recovery(knowledge, spec.room, spec.index_speed_rad_s)
    return forecast_recovery(knowledge, spec.room, captures, spec.samples, spec.index_speed_rad_s)


DEFINITION = ProcedureDefinition(
    name="mastering_recovery",
    title="Mastering recovery",
    version=9,
    procedure=mastering_recovery,
    spec_type=MasteringRecoverySpec,
    needs=("writes_mastering", "evidence", "model"),
    wants=("record",),
    outline=_outline_phases,
    results_to_store=_results_to_store,
    epoch_may_change=True,
    needs_position=False,
    verdict=_make_verdict,
    forecast=_forecast_run,
)
