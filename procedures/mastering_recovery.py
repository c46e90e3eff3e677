"""Mastering recovery: a robot that lost its encoders gets its zero back, exactly where turns were lost.

The gate of calibration/mastering/turn_recovery.py decides; this procedure brings it the captures it asks for, writes
only what check poses have confirmed, and says why when it refuses.
"""

from dataclasses import replace

from pydantic_core import to_jsonable_python

from calibration.mastering.counts import MasteringRecord, WireCapture, provisional_turns
from calibration.mastering.place_recovery import FITTED
from calibration.mastering.turn_recovery import TurnRecovery
from drivers.interfaces import Instruction, MasteringData
from procedures.canonical import sha256_of
from procedures.entry import Entry, Keepsake, Phase
from procedures.forecast import Forecast, Knowledge
from procedures.mastering_record import HOOK_WIRE
from procedures.motion.plans import MotionPlan, plan_finals
from procedures.recovery.mastering_forecasts import forecast_recovery
from procedures.recovery.place_recovery import recover_by_places
from procedures.recovery.recovery_campaign import (
    Campaign,
    check_the_memory,
    confirm_elsewhere,
    measure_until_decided,
)
from procedures.recovery.recovery_result import (
    RecoveryResult,
    confirmed,
    controller_was_right,
    lengths_agree,
    restored,
    told_correction,
)
from procedures.recovery.recovery_spec import MasteringRecoverySpec
from procedures.recovery.recovery_verdict import verdict_on_recovery
from procedures.recovery.waking import wake_encoders
from procedures.run import RefusalError, Run
from procedures.steps.ask import accept, ask
from procedures.steps.capture import capture
from procedures.steps.mastering import MotorState, read_motors, same_epoch, stored_record
from procedures.steps.motion import CountsToJoints, go_to
from procedures.steps.write import restore_mastering, write_mastering
from procedures.verdict import Verdict

__all__ = ["ENTRY", "MasteringRecoverySpec", "mastering_recovery"]

AT_REFERENCE = Instruction(
    "at_reference",
    "Nobody saw the robot's last position. Bring it near the pose where its record was taken, by the marks.",
)


async def mastering_recovery(run: Run, spec: MasteringRecoverySpec) -> RecoveryResult:
    """Wake the encoders, measure until the gate holds, confirm elsewhere, write, confirm what was written."""
    record = await run.step("read the stored record", stored_record)
    if spec.last_counts is None:
        await run.step("near the reference pose", ask, AT_REFERENCE)
    last_counts = record.reference_counts if spec.last_counts is None else spec.last_counts
    if spec.evidence == "wire":
        await run.ensure("the wire is hooked", ask, HOOK_WIRE)
    woken = await wake_encoders(run, record, last_counts, spec.alarms, spec.index_speed_rad_s)
    if spec.evidence == "places":
        return await recover_by_places(run, spec, record, woken.counts)

    state = await run.step("read the motors", read_motors)
    _refuse_other_gears(record, state)
    _refuse_unknown_axes(spec, state)
    await run.ensure("the encoders kept their position", same_epoch, state.epoch)

    guess = provisional_turns(record.drive, woken.counts, state.counts)
    mapping = CountsToJoints(record.drive, record.counts_at_zero, guess)
    campaign = Campaign(run, spec, record, state, mapping, mapping.joints(state.counts))
    held = await check_the_memory(campaign) if not woken.lost and _data_differ(record, state) else None
    if held is None:
        found = await measure_until_decided(campaign, guess)
        await _refuse_wrong_record(campaign, found)
        held = await confirm_elsewhere(campaign, found)
    recovery = held

    places = tuple(campaign.mapping.joints(check.counts) for check in campaign.checks)
    known = (record, state, spec.room, places)
    finals = await run.solve("plan the final checks", plan_finals, *known, spec.final_captures)
    await run.step("accept the correction", accept, told_correction(recovery), _hash_of(recovery))
    written = await run.write("write the mastering", write_mastering, recovery.counts_at_zero)
    await _confirm_written(campaign, recovery, finals)
    return restored(record, recovery, campaign.effort(), written, state.epoch)


async def _confirm_written(campaign: Campaign, recovery: TurnRecovery, plan: MotionPlan) -> None:
    """Move by the written mastering to check poses again; put the old data back if the lengths disagree."""
    run, spec = campaign.run, campaign.spec
    again: list[WireCapture] = []
    campaign.seconds += plan.travel_rad / plan.speed_rad_s
    for k, pose in enumerate(plan.poses_rad, 1):
        await run.move(f"go to final check {k}", go_to, pose, plan.speed_rad_s)
        still = await run.step(
            f"final check {k}", capture, f"final check {k}", spec.samples, spec.tolerance_counts
        )
        again.append(campaign.arrived(still))
    name = "confirm the written mastering"
    final = await run.solve(name, confirmed, campaign.record, recovery, tuple(again))
    if not lengths_agree(final):
        old: MasteringData = campaign.state.mastering
        await run.write("put the old mastering back", restore_mastering, old)
        reason = "with the new mastering the lengths no longer agree; the old data were put back"
        remedy = "The robot is not mastered, as before. Start the recovery again."
        raise campaign.refusal(final, reason, remedy, "procedure.not_confirmed")


def _data_differ(record: MasteringRecord, state: MotorState) -> bool:
    """Tell whether the controller holds other mastering data than the record, or none."""
    return state.mastering != MasteringData(record.counts_at_zero, mastered=True)


async def _refuse_wrong_record(campaign: Campaign, recovery: TurnRecovery) -> None:
    """Refuse a record that is older than the robot's mastering; where all is new, have the plate looked at."""
    record, present = campaign.record, campaign.state.mastering
    if controller_was_right(record, recovery, present):
        reason = "the lengths agree with the mastering that the controller holds, and not with the record"
        remedy = (
            "The record is older than the robot's last mastering: take a new one. Nothing is to be recovered."
        )
        raise campaign.refusal(recovery, reason, remedy, "procedure.wrong_record")
    if recovery.mode == "all":
        await campaign.run.step("compare the arm's plate", ask, _plate(record))


def _plate(record: MasteringRecord) -> Instruction:
    return Instruction(
        "compare_plate",
        "No motor stands at a whole turn of the record: every reference was lost, or this is another arm, or the "
        f"record is of another one. Read the plate on the arm itself: is it {record.robot_serial}, with no new "
        "arm or link since the record was taken?",
    )


def _refuse_other_gears(record: MasteringRecord, state: MotorState) -> None:
    if record.drive != state.drive:
        raise RefusalError(
            "the controller's gear data are not those of the record",
            code="procedure.wrong_record",
            remedy="Compare the gear ratios with the data sheet; restore the controller's backup.",
        )


def _refuse_unknown_axes(spec: MasteringRecoverySpec, state: MotorState) -> None:
    axes = len(state.counts)
    if not all(1 <= axis <= axes for axis in spec.exchanged_axes):
        raise RefusalError(
            f"exchanged_axes names an axis that is not there: {spec.exchanged_axes}",
            remedy=f"Axes count from 1 to {axes}.",
        )


def _hash_of(recovery: TurnRecovery) -> str:
    return sha256_of(to_jsonable_python(recovery.counts_at_zero))


def _outline(spec: MasteringRecoverySpec) -> tuple[Phase, ...]:
    return (
        Phase("read the stored record"),
        *((Phase("near the reference pose"),) if spec.last_counts is None else ()),
        *(Phase(name, times, adaptive=True) for name, times in _WAKING),
        *(_by_wire(spec) if spec.evidence == "wire" else _BY_PLACES),
        *(Phase("accept the correction"), Phase("write the mastering")),
        *(_finally(spec) if spec.evidence == "wire" else _FINALLY_PLACES),
        *(Phase("confirm the written mastering"), Phase("put the old mastering back", 0, adaptive=True)),
    )


_WAKING = (
    *(("look at the alarms", 3), ("new battery", 1), ("acknowledge the lost position", 1)),
    *(("power cycle", 1), ("wait for the robot", 1), ("slow motion", 1), ("reset the alarms", 0)),
    ("counts before the turns", 1),
    *((f"pass the index of J{axis},", 1) for axis in range(1, 7)),
    ("clear the alarms", 1),
)
_BY_PLACES = (
    *(Phase("read the motors alone"), Phase("choose the places"), Phase("nest", 0, adaptive=True)),
    *(Phase("place", FITTED, adaptive=True), Phase("judge the places", 1, adaptive=True)),
    *(Phase("place again", 0, adaptive=True), Phase("check place", 2, adaptive=True)),
    Phase("confirm at the places"),
)
_FINALLY_PLACES = (Phase("final place"), Phase("read the motors after writing"))


def _finally(spec: MasteringRecoverySpec) -> tuple[Phase, ...]:
    return (
        Phase("go to final check", spec.final_captures, adaptive=True),
        Phase("final check", spec.final_captures, adaptive=True),
    )


def _by_wire(spec: MasteringRecoverySpec) -> tuple[Phase, ...]:
    memory = (
        *(("plan the memory checks from", 0), ("accept the memory checks", 0), ("go to memory check", 0)),
        *(("memory check", 0), ("confirm the memory with", 0)),
    )
    measuring = (
        *(("go to capture", spec.first_captures), ("capture", spec.first_captures)),
        *(("judge after", 1), ("plan after", 0), ("compare the arm's plate", 0)),
        ("plan the checks from", 1),
        *(("go to check", spec.check_captures), ("check", spec.check_captures), ("confirm with", 1)),
    )
    return (
        Phase("read the motors"),
        *(Phase(name, times, adaptive=True) for name, times in memory),
        *(Phase("plan the first poses", adaptive=True), Phase("accept the plan", adaptive=True)),
        *(Phase(name, times, adaptive=True) for name, times in measuring),
        Phase("plan the final checks"),
    )


def _keeps(spec: MasteringRecoverySpec, result: RecoveryResult) -> Keepsake | None:
    del spec
    if result.record is None:
        return None
    return Keepsake("mastering_record", result.record.robot_serial, result.record)


def _verdict(spec: MasteringRecoverySpec, result: RecoveryResult) -> Verdict:
    return verdict_on_recovery(spec.accuracy_class, spec.limits, result)


def _forecast(spec: MasteringRecoverySpec, known: Knowledge) -> Forecast:
    captures = (spec.first_captures, spec.check_captures, spec.final_captures)
    known = replace(known, last_counts=spec.last_counts)
    return forecast_recovery(known, spec.room, captures, spec.samples, spec.index_speed_rad_s)


ENTRY = Entry(
    name="mastering_recovery",
    title="Mastering recovery",
    version=3,
    procedure=mastering_recovery,
    spec_type=MasteringRecoverySpec,
    needs=("jogs_single_axes", "writes_mastering", "evidence", "model"),
    wants=("record",),
    outline=_outline,
    keeps=_keeps,
    epoch_may_change=True,
    verdict=_verdict,
    forecast=_forecast,
)
