"""Mastering recovery: a robot that lost its encoders gets its zero back, exactly where turns were lost.

The gate of calibration/turn_recovery.py decides; this procedure brings it the captures it asks for, writes
only what check poses have confirmed, and says why when it refuses.
"""

from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field
from pydantic_core import to_jsonable_python

from calibration.mastering import MasteringRecord, WireCapture, provisional_turns
from calibration.turn_recovery import TurnRecovery
from drivers.interfaces import Counts, Instruction, Joints, MasteringData
from procedures.canonical import sha256_of
from procedures.entry import Entry, Keepsake, Phase
from procedures.mastering_record import HOOK_WIRE, shown
from procedures.plans import MotionPlan, Room, plan_checks, plan_finals, plan_first, plan_next
from procedures.recovery_result import (
    Effort,
    RecoveryResult,
    confirmed,
    judge,
    lacks_only_power,
    lengths_agree,
    refused,
    restored,
)
from procedures.run import RefusalError, Run
from procedures.steps.ask import accept, ask
from procedures.steps.capture import StillCapture, capture
from procedures.steps.mastering import MotorState, read_motors, same_epoch, stored_record
from procedures.steps.motion import CountsToJoints, go_to, jog_to
from procedures.steps.write import restore_mastering, write_mastering
from procedures.waking import AlarmCodes, wake_encoders

AT_REFERENCE = Instruction(
    "at_reference",
    "Nobody saw the robot's last position. Bring it near the pose where its record was taken, by the marks.",
)
FULL_CALIBRATION = "Have the robot inspected; a full calibration is advised before it works again."


# A new motor that happens to stand within about 0.05 turn of a whole one cannot be told from lost turns.
_PROVISO = (
    "Whole turns are exact only if no motor, encoder, belt or gear was exchanged; if one was, say no and start "
    "again with exchanged_axes. "
)


@dataclass(frozen=True, slots=True)
class MasteringRecoverySpec:
    """What is known of the time before the loss, and how much may be measured."""

    last_counts: Counts | None = None  # the last healthy counts, from the watch
    exchanged_axes: tuple[
        Annotated[int, Field(ge=1)], ...
    ] = ()  # from 1: motor, encoder, belt or gear exchanged, as far as known
    first_captures: Annotated[int, Field(ge=6, le=200)] = 10
    max_captures: Annotated[int, Field(ge=6, le=200)] = 30
    check_captures: Annotated[int, Field(ge=1, le=50)] = 4
    max_check_captures: Annotated[int, Field(ge=1, le=100)] = 8
    final_captures: Annotated[int, Field(ge=1, le=50)] = 2
    samples: Annotated[int, Field(ge=1, le=1000)] = 5
    tolerance_counts: Annotated[int, Field(ge=0)] = 50
    index_speed_rad_s: Annotated[float, Field(gt=0, le=0.25)] = 0.035
    room: Room = field(default_factory=Room)
    alarms: AlarmCodes = field(default_factory=AlarmCodes)


@dataclass
class _Campaign:
    """What is known so far; rebuilt from the findings on every entry."""

    run: Run
    spec: MasteringRecoverySpec
    record: MasteringRecord
    state: MotorState
    mapping: CountsToJoints
    here: Joints
    kept: list[WireCapture] = field(default_factory=list)
    checks: list[WireCapture] = field(default_factory=list)
    visited: list[Joints] = field(default_factory=list)
    taken: int = 0
    again: int = 0
    seconds: float = 0.0

    async def jog_and_capture(self, pose: Joints, plan: MotionPlan, what: str, k: int) -> WireCapture:
        speed = plan.speed_rad_s
        self.seconds += sum(abs(a - b) for a, b in zip(pose, self.here, strict=True)) / speed
        await self.run.move(f"go to {what} {k}", jog_to, pose, self.mapping, speed)
        spec = self.spec
        still = await self.run.step(
            f"{what} {k}", capture, f"{what} {k}", spec.samples, spec.tolerance_counts
        )
        return self.arrived(still)

    def arrived(self, still: StillCapture) -> WireCapture:
        self.here = self.mapping.joints(still.wire.counts)
        self.visited.append(self.here)
        return still.wire

    def effort(self) -> Effort:
        return Effort(self.taken, len(self.checks), self.again, self.seconds)

    def refusal(self, recovery: TurnRecovery, reason: str, remedy: str, code: str) -> RefusalError:
        evidence = refused(self.record, recovery, self.effort(), reason)
        return RefusalError(f"nothing was written: {reason}", remedy=remedy, code=code, evidence=evidence)


async def mastering_recovery(run: Run, spec: MasteringRecoverySpec) -> RecoveryResult:
    """Wake the encoders, measure until the gate holds, confirm elsewhere, write, confirm what was written."""
    record = await run.step("read the stored record", stored_record)
    if spec.last_counts is None:
        await run.step("near the reference pose", ask, AT_REFERENCE)
    last_counts = record.reference_counts if spec.last_counts is None else spec.last_counts
    await run.ensure("the wire is hooked", ask, HOOK_WIRE)
    await wake_encoders(run, record, last_counts, spec.alarms, spec.index_speed_rad_s)

    state = await run.step("read the motors", read_motors)
    _refuse_other_gears(record, state)
    _refuse_unknown_axes(spec, state)
    await run.ensure("the encoders kept their position", same_epoch, state.epoch)

    guess = provisional_turns(record.drive, last_counts, state.counts)
    mapping = CountsToJoints(record.drive, record.counts_at_zero, guess)
    campaign = _Campaign(run, spec, record, state, mapping, mapping.joints(state.counts))
    recovery = await _measure_until_decided(campaign, guess)
    recovery = await _confirm_elsewhere(campaign, recovery)

    places = tuple(campaign.mapping.joints(check.counts) for check in campaign.checks)
    known = (record, state, spec.room, places)
    finals = await run.solve("plan the final checks", plan_finals, *known, spec.final_captures)
    await run.step("accept the correction", accept, _correction(recovery), _hash_of(recovery))
    written = await run.write("write the mastering", write_mastering, recovery.counts_at_zero)
    await _confirm_written(campaign, recovery, finals)
    return restored(record, recovery, campaign.effort(), written, state.epoch)


async def _measure_until_decided(campaign: _Campaign, guess: tuple[int, ...]) -> TurnRecovery:
    run, spec = campaign.run, campaign.spec
    known = (campaign.record, campaign.state, spec.room)
    plan = await run.solve("plan the first poses", plan_first, *known, campaign.here, spec.first_captures)
    await run.step("accept the plan", accept, shown(plan), sha256_of(to_jsonable_python(plan)))
    for pose in plan.poses_rad:
        await _one_more(campaign, pose, plan)

    changed = False
    while True:
        captures = tuple(campaign.kept)
        name, known_new = f"judge after {campaign.taken}", tuple(axis - 1 for axis in spec.exchanged_axes)
        recovery = await run.solve(name, judge, campaign.record, captures, guess, known_new)
        if recovery.accepted:
            return recovery
        if (
            recovery.mode == "geometry" and changed
        ):  # two judgements in a row, the second with one capture more
            raise campaign.refusal(recovery, recovery.reason, FULL_CALIBRATION, "procedure.geometry_changed")
        if campaign.taken >= spec.max_captures:
            reason = f"not decidable after {campaign.taken} captures: {recovery.reason}"
            remedy = "Check the wire's places and the hook, then start again or master by the marks."
            raise campaign.refusal(recovery, reason, remedy, "procedure.undecided")
        changed = recovery.mode == "geometry"
        await _measure_next(campaign, recovery)


async def _measure_next(campaign: _Campaign, recovery: TurnRecovery) -> None:
    """Measure a suspect capture again, once; otherwise the pose that tells most."""
    suspect = recovery.suspect_capture
    known = (campaign.record, campaign.state, campaign.spec.room)
    name = f"plan after {campaign.taken}"
    plan = await campaign.run.solve(name, plan_next, *known, campaign.here, tuple(campaign.visited))
    target = plan.poses_rad[0]
    if suspect is not None:
        target = campaign.mapping.joints(campaign.kept.pop(suspect).counts)
        campaign.again += 1
    await _one_more(campaign, target, plan)


async def _one_more(campaign: _Campaign, pose: Joints, plan: MotionPlan) -> None:
    campaign.taken += 1
    campaign.kept.append(await campaign.jog_and_capture(pose, plan, "capture", campaign.taken))


async def _confirm_elsewhere(campaign: _Campaign, recovery: TurnRecovery) -> TurnRecovery:
    """Measure at poses that were not fitted, until a wrong turn of any motor would show."""
    run, spec, record = campaign.run, campaign.spec, campaign.record
    campaign.mapping = CountsToJoints(record.drive, recovery.counts_at_zero, (0,) * len(recovery.turns))
    count = spec.check_captures
    while True:
        visited, room = tuple(campaign.visited), spec.room
        name = f"plan the checks from {len(campaign.checks) + 1}"
        here = campaign.here
        plan = await run.solve(name, plan_checks, record, campaign.state, room, here, visited, count)
        for pose in plan.poses_rad:
            k = len(campaign.checks) + 1
            campaign.checks.append(await campaign.jog_and_capture(pose, plan, "check", k))
        checks = tuple(campaign.checks)
        verified = await run.solve(f"confirm with {len(checks)}", confirmed, record, recovery, checks)
        if verified.accepted:
            return verified
        if not lacks_only_power(verified) or len(checks) >= spec.max_check_captures:
            remedy = "Check the wire, then start the recovery again."
            raise campaign.refusal(verified, verified.reason, remedy, "procedure.not_confirmed")
        count = 2


async def _confirm_written(campaign: _Campaign, recovery: TurnRecovery, plan: MotionPlan) -> None:
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


def _refuse_other_gears(record: MasteringRecord, state: MotorState) -> None:
    if record.drive != state.drive:
        raise RefusalError(
            "the controller's gear data are not those of the record",
            code="procedure.wrong_record",
            remedy="Compare the gear ratios with the data sheet; restore the controller's backup.",
        )


def _correction(recovery: TurnRecovery) -> Instruction:
    return Instruction(
        "accept_mastering",
        f"{recovery.reason}. The check poses confirm it. {_PROVISO if recovery.mode == 'turns' else ''}"
        "Write the mastering data to the controller?",
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
    asked = (Phase("near the reference pose"),) if spec.last_counts is None else ()
    waking = (
        *(("look at the alarms", 3), ("new battery", 1), ("acknowledge the lost position", 1)),
        *(("power cycle", 1), ("wait for the robot", 1), ("slow motion", 1), ("reset the alarms", 0)),
        *((f"pass the index of J{axis},", 1) for axis in range(1, 7)),
        ("clear the alarms", 1),
    )
    measuring = (
        *(("go to capture", spec.first_captures), ("capture", spec.first_captures)),
        *(("judge after", 1), ("plan after", 0), ("plan the checks from", 1)),
        *(("go to check", spec.check_captures), ("check", spec.check_captures), ("confirm with", 1)),
    )
    return (
        *(Phase("read the stored record"), *asked),
        *(Phase(name, times, adaptive=True) for name, times in waking),
        *(Phase("read the motors"), Phase("plan the first poses"), Phase("accept the plan")),
        *(Phase(name, times, adaptive=True) for name, times in measuring),
        *(Phase("plan the final checks"), Phase("accept the correction"), Phase("write the mastering")),
        Phase("go to final check", spec.final_captures, adaptive=True),
        Phase("final check", spec.final_captures, adaptive=True),
        *(Phase("confirm the written mastering"), Phase("put the old mastering back", 0, adaptive=True)),
    )


def _keeps(spec: MasteringRecoverySpec, result: RecoveryResult) -> Keepsake | None:
    del spec
    if result.record is None:
        return None
    return Keepsake("mastering_record", result.record.robot_serial, result.record)


ENTRY = Entry(
    name="mastering_recovery",
    title="Mastering recovery",
    version=1,
    procedure=mastering_recovery,
    spec_type=MasteringRecoverySpec,
    needs=("jogs_single_axes", "writes_mastering", "gauge", "gauge_setup", "model"),
    outline=_outline,
    keeps=_keeps,
    epoch_may_change=True,
)
