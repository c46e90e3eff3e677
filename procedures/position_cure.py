"""A lost position of an ABB, Yaskawa or KUKA, brought back by a person at the pendant and proved by measurement.

The controller tells which axes are lost; a person brings each to its mark and makes it good at the pendant, as the
make wants it. Lengths of the draw-wire, compared with the position record, then tell for every axis by how many
motor turns it is off, or by which angle where its zero was made anew. Nothing is written by wire.
"""

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from pydantic import Field

from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.mastering.turn_recovery import TurnRecovery
from cellcal.calibration.message import make_message
from cellcal.procedures.forecast import ANSWER_S, PERSON_S, Forecast, Knowledge
from cellcal.procedures.mastering_record import HOOK_WIRE
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.motion.turn_uncertainty import HALF_TURN, Turns
from cellcal.procedures.motors import MotorState
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_confirmation
from cellcal.procedures.recovery.cure_result import PositionCureResult, changed_constants, prove_axes
from cellcal.procedures.recovery.cure_verdict import verdict_on_cure
from cellcal.procedures.recovery.mastering_forecasts import forecast_walk
from cellcal.procedures.recovery.pendant_cures import (
    USUAL_ZERO,
    AxisCure,
    Zero,
    bring_back_axis,
    make_ready,
    see_none_lost,
)
from cellcal.procedures.recovery.position_log import LogPlace, note_log_place, refuse_lost_since
from cellcal.procedures.recovery.recovery_campaign import (
    RecoveryCampaign,
    confirm_elsewhere,
    measure_until_decided,
)
from cellcal.procedures.recovery.recovery_spec import MasteringRecoverySpec, fewest_captures
from cellcal.procedures.recovery.shown_position import (
    AxisState,
    read_axis_state,
    read_position_data,
    stored_position_record,
    with_shown_motors,
)
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.setting_texts import FIRST_CAPTURES, MAX_CAPTURES, ROOM, SAMPLES, describe_setting
from cellcal.procedures.steps.mastering import check_same_epoch, read_motors
from cellcal.procedures.steps.motion import CountsToJoints

FEWEST_CHECKS = 4  # poses that are not fitted
WANTED_SHARE = 0.8  # of the limit of a new zero: its U (k = 2), where the series ends


@dataclass(frozen=True, slots=True)
class PositionCureSpec:
    """The axes to bring back, how their zero was set, and how well it must be proved."""

    zero: Annotated[
        Literal["usual", "kept", "new"],
        describe_setting(
            "Zero of these axes",
            "Kept: only motor turns were lost. New: the zero is set anew with a gauge or at a mark, as after a new "
            "motor.",
            "what",
            basic=True,
            choices={
                "usual": "as usual for the make",
                "kept": "kept: only turns were lost",
                "new": "new: set by a gauge or a mark",
            },
        ),
    ] = "usual"
    axes_again: Annotated[
        tuple[Annotated[int, Field(ge=1)], ...],
        describe_setting(
            "Axes to bring back again",
            "Axes that the controller takes as good and that are wrong all the same, as the pendant names "
            "them; empty: none.",
            "what",
            unit="1",
            basic=True,
            axes=True,
        ),
    ] = ()
    limit_rad: Annotated[
        float,
        Field(gt=0, le=0.05),
        describe_setting(
            "Largest error of a new zero",
            "An axis whose zero was set anew may be off by no more than this; whole turns are exact or wrong.",
            "limits",
            unit="rad",
            basic=True,
        ),
    ] = 0.0087266
    first_captures: Annotated[int, Field(ge=6, le=200), FIRST_CAPTURES] = 12
    max_captures: Annotated[int, Field(ge=6, le=200), MAX_CAPTURES] = 30
    samples: Annotated[int, Field(ge=1, le=1000), SAMPLES] = 5
    room: Annotated[MotionBounds, ROOM] = field(default_factory=MotionBounds)


async def position_cure(run: Run, spec: PositionCureSpec) -> PositionCureResult:
    """Lead through the work at the pendant axis by axis, then prove by lengths that every axis is right."""
    record = await run.step("read the position record", stored_position_record)
    state = await run.step("look at the axes", read_axis_state)
    cures = _planned_cures(spec, state, len(record.measured.counts_at_zero))
    for k, cure in enumerate(cures, 1):
        await run.step(f"bring back axis {k}", bring_back_axis, cure)
    await run.step("see that no axis is lost", see_none_lost, tuple(cure.axis for cure in cures))
    await run.step("near the record's pose", make_ready, record.measured.reference_joints_rad)
    await run.ensure("the wire is hooked", ask_confirmation, HOOK_WIRE)
    shown = await run.step("read the position data", read_position_data)
    campaign, recovery = await _measure(run, spec, record.measured, cures)
    effort = campaign.make_effort()
    return PositionCureResult(
        cure=state.cure,
        axes=prove_axes(record.measured, recovery, state.cure, cures),
        reason=recovery.reason,
        gate=recovery.gate,
        captures=effort.captures,
        check_captures=effort.check_captures,
        robot_seconds=effort.robot_seconds,
        set_aside=effort.set_aside,
        changed_constants=changed_constants(
            record, shown, tuple(cure.axis for cure in cures if cure.zero == "new")
        ),
        shown=shown,
    )


async def _measure(
    run: Run, spec: PositionCureSpec, record: MasteringRecord, cures: tuple[AxisCure, ...]
) -> tuple[RecoveryCampaign, TurnRecovery]:
    """Measure until the gate decides by how much every axis is off, and look at poses that were not fitted."""
    bench = run.with_devices(with_shown_motors)
    state: MotorState = await bench.step("read the motors", read_motors)
    await bench.ensure("the encoders kept their position", check_same_epoch, state.epoch)
    is_later_entry = bench.is_replaying
    place: LogPlace = await bench.step("note the place in the log", note_log_place)
    await bench.ensure("no position was lost since", refuse_lost_since, place, is_later_entry)
    rules = MasteringRecoverySpec(
        exchanged_axes=tuple(cure.axis + 1 for cure in cures if cure.zero == "new"),
        first_captures=spec.first_captures,
        max_captures=spec.max_captures,
        wanted_u_rad=WANTED_SHARE * spec.limit_rad,
        samples=spec.samples,
        room=spec.room,
    )
    rules = fewest_captures(rules) if bench.is_jogged_by_hand else rules
    none = (0,) * len(record.counts_at_zero)
    mapping = CountsToJoints(record.drive, record.counts_at_zero, none)
    here = mapping.joints_at(state.counts)
    campaign = RecoveryCampaign(bench, rules, record, state, mapping, here, _first_doubt(spec, record, cures))
    found = await measure_until_decided(campaign, none)
    return campaign, await confirm_elsewhere(campaign, found)


def _planned_cures(spec: PositionCureSpec, state: AxisState, axes: int) -> tuple[AxisCure, ...]:
    """Return what is to be brought back: what the controller names, and what a person names."""
    if not all(1 <= axis <= axes for axis in spec.axes_again):
        raise RefusalError(
            make_message(
                "axes_again names an axis that is not there: {axes_again}", axes_again=spec.axes_again
            ),
            remedy=make_message("Axes count from 1 to {axes}.", axes=axes),
        )
    if state.is_lost and not state.lost_axes and not spec.axes_again:
        raise RefusalError(
            make_message(
                "the controller shows a lost position and names no axis: {words}", words=state.words
            ),
            remedy="Name the axes in axes_again, then start a new run.",
        )
    zero: Zero = USUAL_ZERO[state.cure] if spec.zero == "usual" else spec.zero
    named = sorted({*state.lost_axes, *(axis - 1 for axis in spec.axes_again)})
    return tuple(
        AxisCure(axis, state.cure, "new" if axis in state.without_zero else zero, axis in state.lost_axes)
        for axis in named
    )


def _first_doubt(spec: PositionCureSpec, record: MasteringRecord, cures: tuple[AxisCure, ...]) -> Turns:
    """Return by how many turns each motor may stand elsewhere: brought back ones by as many as may be lost."""
    back, most = {cure.axis for cure in cures}, float(spec.room.lost_turns)
    unsure = (
        min(most, HALF_TURN) if back else most
    )  # nothing brought back: any axis may be what is looked for
    return tuple(most if axis in back else unsure for axis in range(len(record.counts_at_zero)))


def _outline_phases(spec: PositionCureSpec) -> tuple[Phase, ...]:
    return (
        *(Phase("read the position record"), Phase("look at the axes")),
        Phase("bring back axis", len(spec.axes_again) or 1, adaptive=True),
        *(
            Phase("see that no axis is lost"),
            Phase("near the record's pose"),
            Phase("read the position data"),
        ),
        *(
            Phase("read the motors"),
            Phase("note the place in the log"),
            Phase("plan the first poses"),
            Phase("accept the plan"),
        ),
        Phase("go to capture", spec.first_captures, adaptive=True),
        Phase("capture", spec.first_captures, adaptive=True),
        Phase("judge the captures", 1, adaptive=True),
        Phase("plan one more pose", 0, adaptive=True),
        *(Phase("plan the checks", 1, adaptive=True), Phase("go to check", 4, adaptive=True)),
        *(Phase("check", 4, adaptive=True), Phase("confirm by checks", 1, adaptive=True)),
    )


def _results_to_store(spec: PositionCureSpec, result: PositionCureResult) -> StoredResult | None:
    del spec, result
    return None


def _forecast_run(spec: PositionCureSpec, knowledge: Knowledge) -> Forecast:
    record = knowledge.position_record
    if record is None:
        return Forecast(0.0, lacks=("a position record of this robot",))
    walk_knowledge = replace(knowledge, record=record.measured, last_counts=None)
    forecast = forecast_walk(walk_knowledge, spec.room, (spec.first_captures, FEWEST_CHECKS), spec.samples)
    work_s = PERSON_S * (2 + len(spec.axes_again)) + ANSWER_S
    return replace(forecast, duration_s=forecast.duration_s + work_s)


DEFINITION = ProcedureDefinition(
    name="position_cure",
    title="Bring a lost position back at the pendant",
    version=2,
    procedure=position_cure,
    spec_type=PositionCureSpec,
    needs=("position_cure", "drive_data", "model", "gauge", "gauge_setup"),
    wants=("position_record",),
    outline=_outline_phases,
    results_to_store=_results_to_store,
    epoch_may_change=True,
    needs_position=False,
    verdict=lambda spec, result: verdict_on_cure(spec.limit_rad, result),
    forecast=_forecast_run,
)
