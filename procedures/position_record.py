"""The position record: taken while a robot is healthy whose encoders no wire reads, such as an ABB, Yaskawa or KUKA.

What the controller shows about the position is kept with wire lengths over the whole reach. After a loss these
lengths prove whether what was done at the pendant has brought every axis back.
"""

from dataclasses import dataclass, field, replace
from typing import Annotated

from pydantic import Field

from cellcal.calibration.mastering.position_record import ArmPositionRecord, ShownValue
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import PositionCure
from cellcal.procedures.cell import Cell
from cellcal.procedures.forecast import Forecast, Knowledge
from cellcal.procedures.mastering_record import MasteringRecordSpec, mastering_record
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.recovery.mastering_forecasts import forecast_record
from cellcal.procedures.recovery.record_seal import seal_record
from cellcal.procedures.recovery.record_verdict import RecordResult, RecoveryProspect, verdict_on_record
from cellcal.procedures.recovery.shown_position import read_position_data, with_shown_motors
from cellcal.procedures.run import Run
from cellcal.procedures.setting_texts import RETAKES, ROOM, SAMPLES, SEED, describe_setting
from cellcal.procedures.verdict import ProcedureVerdict

_SHOWN = {
    PositionCure.REVOLUTION_COUNTERS: "ABB: joints and the state of each axis, and the calibration offset of each "
    "resolver where the controller gives its configuration.",
    PositionCure.ABSOLUTE_DATA: "Yaskawa: pulses, which are encoder counts less the home position's, and the "
    "absolute data of each axis where the controller gives ABSO.DAT.",
    PositionCure.MASTERING_GAUGE: "KUKA: joints, mastering angles and flags; encoder values cannot be read.",
}


@dataclass(frozen=True, slots=True)
class PositionRecordSpec:
    """How many poses to capture, how carefully, and what motion must keep to."""

    poses: Annotated[
        int,
        Field(ge=8, le=200),
        describe_setting(
            "Poses to record",
            "At how many poses the arm is measured; more make a later proof surer.",
            "effort",
            unit="1",
            basic=True,
        ),
    ] = 30
    samples: Annotated[int, Field(ge=1, le=1000), SAMPLES] = 5
    retakes: Annotated[int, Field(ge=0, le=20), RETAKES] = 2
    seed: Annotated[int, Field(ge=0), SEED] = 1
    room: Annotated[MotionBounds, ROOM] = field(default_factory=MotionBounds)


@dataclass(frozen=True, slots=True)
class PositionRecordResult:
    """The record, what a proof could reach with it, and how the controller's make shows its position."""

    record: ArmPositionRecord
    prospect: RecoveryProspect
    set_aside: tuple[str, ...]
    cure: PositionCure | None


@dataclass(frozen=True, slots=True)
class ShownPosition:
    """The position data that the controller shows at one moment."""

    values: tuple[ShownValue, ...]
    cure: PositionCure | None


async def position_record(run: Run, spec: PositionRecordSpec) -> PositionRecordResult:
    """Keep what the controller shows, then measure lengths over the whole reach against the joints that it shows."""
    shown = await run.step("read the position data", read_shown_position)
    measured = await mastering_record(run.with_devices(with_shown_motors), _mastering_spec(spec))
    record = seal_record(replace(measured.record, taken_by="position_record 1"))
    return PositionRecordResult(
        ArmPositionRecord(record, shown.values), measured.prospect, measured.set_aside, shown.cure
    )


async def read_shown_position(cell: Cell) -> ShownPosition:
    """Return what the controller shows about the position, and who can bring it back."""
    return ShownPosition(await read_position_data(cell), cell.robot.capabilities.position_cure)


def _mastering_spec(spec: PositionRecordSpec) -> MasteringRecordSpec:
    return MasteringRecordSpec(
        poses=spec.poses, samples=spec.samples, retakes=spec.retakes, seed=spec.seed, room=spec.room
    )


def _make_verdict(spec: PositionRecordSpec, result: PositionRecordResult) -> ProcedureVerdict:
    del spec
    whole = RecordResult(result.record.measured, result.prospect, set_aside=result.set_aside)
    verdict = verdict_on_record(whole)
    shown = [] if result.cure is None else [_SHOWN[result.cure]]
    sentence = make_message(
        "{count} values that the controller shows are kept.", count=len(result.record.shown)
    )
    return replace(verdict, remarks=(sentence, *shown, *verdict.remarks))


def _outline_phases(spec: PositionRecordSpec) -> tuple[Phase, ...]:
    return (
        *(Phase("read the position data"), Phase("read the motors"), Phase("plan the poses")),
        *(Phase("accept the plan"), Phase("go to pose", spec.poses), Phase("capture", spec.poses)),
        *(Phase("fit the wire", 1, adaptive=True), Phase("go again to pose", 0, adaptive=True)),
        *(Phase("capture again", 0, adaptive=True), Phase("predict a recovery")),
    )


def _results_to_store(spec: PositionRecordSpec, result: PositionRecordResult) -> StoredResult:
    del spec
    return StoredResult("position_record", result.record.measured.robot_serial, result.record)


def _forecast_run(spec: PositionRecordSpec, knowledge: Knowledge) -> Forecast:
    return forecast_record(knowledge, spec.room, (spec.poses, spec.samples), (None, spec.seed))


DEFINITION = ProcedureDefinition(
    name="position_record",
    title="Position record of an ABB, Yaskawa or KUKA",
    version=1,
    procedure=position_record,
    spec_type=PositionRecordSpec,
    needs=("position_cure", "drive_data", "model", "gauge", "gauge_setup"),
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=_make_verdict,
    forecast=_forecast_run,
)
