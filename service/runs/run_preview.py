"""What a run would do and reach, from the cell file and the journal alone: no device is touched."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any

from pydantic_core import to_jsonable_python

from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Counts
from cellcal.procedures.catalogue import DEFINITIONS, definition_named
from cellcal.procedures.cell import Cell
from cellcal.procedures.forecast import Forecast, Knowledge
from cellcal.procedures.instruments import instruments_of
from cellcal.procedures.procedure_definition import (
    Phase,
    ProcedureDefinition,
    all_missing,
    is_for_other_controllers,
    missing_remedies,
    with_planned_counts,
)
from cellcal.procedures.procedure_guide import GUIDE, Intention
from cellcal.procedures.run import RefusalError
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.quantities import format_quantity
from cellcal.service.record.drift_schedule import PROCEDURE, next_drift_checks
from cellcal.service.record.healthy_counts import LastHealthyCounts
from cellcal.service.record.journal_files import journal_path, open_journal
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.open_cell import offline_cell
from cellcal.service.runs.settings import build_spec, chosen_by_cell


class ClassOutOfReachError(CellError):
    """A class of limits was chosen that the planned measurement cannot prove."""

    code = "procedure.class_out_of_reach"


@dataclass(frozen=True, slots=True)
class DryRun:
    """A procedure on a cell, before anything happens. ``problem`` says why there is no forecast."""

    procedure: str
    title: str
    version: int
    robot: str
    serial: str
    settings: Any
    lacks: tuple[str, ...]
    phases: tuple[Phase, ...]
    expected_steps: int
    forecast: Forecast | None
    problem: str = ""


@dataclass(frozen=True, slots=True)
class ProcedureAvailability:
    """One procedure of the catalogue, and what this cell lacks for it."""

    name: str
    title: str
    version: int
    lacks: tuple[str, ...] | None  # None where no cell was asked about
    due: date | None = None  # when it should be run next
    remedies: tuple[str, ...] = ()  # how to get each thing that it lacks
    uses: str = ""  # what a person has at hand for it
    intention: Intention = "check"
    when: str = ""  # to use it
    minutes: tuple[int, int] = (0, 0)  # that it usually takes
    for_other_controllers: bool = False  # this robot's controller has another procedure for it
    needs_position: bool = True  # it refuses a robot that has lost its position
    commands_motion: bool = True  # else a person moves the arm, or it stands still


def dry_run(
    config: CellConfig, procedure: str, settings: Mapping[str, object], robot: str | None = None
) -> DryRun:
    """Foretell a run.

    Raises
    ------
    CellError
        There is no such procedure, robot or setting.
    """
    entry, cell = definition_named(procedure), offline_cell_with_history(config, robot)
    spec = build_spec(config, cell.robot.name, procedure, settings)
    lacks = all_missing(entry, cell)
    forecast, problem = (None, "") if lacks else _make_forecast(entry, spec, cell, config)
    phases = with_planned_counts(entry.outline(spec), forecast.planned if forecast else {})
    return DryRun(
        procedure=entry.name,
        title=entry.title,
        version=entry.version,
        robot=cell.robot.name,
        serial=config.robot_named(robot).serial,
        settings=to_jsonable_python(spec),
        lacks=(*lacks, *(forecast.lacks if forecast else ())),
        phases=phases,
        expected_steps=sum(len(phase.step_names) for phase in phases),
        forecast=forecast,
        problem=problem,
    )


def list_procedures(config: CellConfig | None, robot: str | None = None) -> list[ProcedureAvailability]:
    """Return the whole catalogue, with what a cell lacks for each procedure."""
    if config is None:
        return [_availability(entry, None, None) for entry in DEFINITIONS]
    cell = offline_cell_with_history(config, robot)
    due = {PROCEDURE: next_drift_checks(config).get(config.robot_named(robot).name)}
    return [_availability(entry, cell, due.get(entry.name)) for entry in DEFINITIONS]


def _availability(entry: ProcedureDefinition, cell: Cell | None, due: date | None) -> ProcedureAvailability:
    guide = GUIDE[entry.name]
    return ProcedureAvailability(
        entry.name,
        entry.title,
        entry.version,
        lacks=None if cell is None else all_missing(entry, cell),
        due=due,
        remedies=() if cell is None else missing_remedies(entry, cell),
        uses=guide.uses,
        intention=guide.intention,
        when=guide.when,
        minutes=guide.minutes,
        for_other_controllers=cell is not None and is_for_other_controllers(entry, cell),
        needs_position=entry.needs_position,
        commands_motion=entry.commands_motion,
    )


def offline_cell_with_history(config: CellConfig, robot: str | None = None) -> Cell:
    """Return the cell on paper, with what its journal holds of this robot."""
    cell, serial = offline_cell(config, robot), config.robot_named(robot).serial
    if not journal_path(config).exists():
        return cell
    with open_journal(config) as journal:
        return RunStore(journal).with_history(cell, serial)


def refuse_class_out_of_reach(
    config: CellConfig, procedure: str, settings: Mapping[str, object], robot: str | None = None
) -> None:
    """Refuse a chosen class of limits that the predicted uncertainty cannot prove.

    A class may be chosen only where the predicted U is at most a third of its limit.

    Raises
    ------
    ClassOutOfReachError
        The message names the prediction and the classes within reach.
    """
    in_force = {**chosen_by_cell(config, config.robot_named(robot).name, procedure), **settings}
    chosen = in_force.get("accuracy_class")
    if chosen is None or in_force.get("limits") is not None:
        return
    found = dry_run(config, procedure, settings, robot)
    for prediction in found.forecast.predictions if found.forecast else ():
        reach = prediction.classes_in_reach()
        if prediction.limits and chosen not in reach:
            expanded = format_quantity(prediction.expanded, prediction.unit)
            raise ClassOutOfReachError(
                make_message(
                    "class {chosen} cannot be proved: {prediction_name} would be known to {expanded}, more "
                    "than a third of its limit. In reach: {reach}.",
                    chosen=chosen,
                    prediction_name=prediction.name,
                    expanded=expanded,
                    reach=", ".join(reach) or "none",
                ),
                remedy="Measure more or better (see --dry-run), choose another class, or set limits of your own.",
            )


def knowledge_of(cell: Cell, last_counts: Counts | None) -> Knowledge:
    """Return what a cell, reached or on paper, tells without being asked."""
    return Knowledge(
        model=cell.model,
        gauge_setup=cell.gauge_setup,
        gauge=None if cell.gauge is None else cell.gauge.capabilities,
        record=cell.record,
        position_record=cell.position_record,
        last_counts=last_counts,
        limits=cell.limits,
        tracker_setup=cell.tracker_setup,
        tracker=None if cell.tracker is None else cell.tracker.capabilities,
        instruments=instruments_of(cell),
        alignments=cell.alignments,
        drift_references=cell.drift_references,
    )


def _make_forecast(
    entry: ProcedureDefinition, spec: Any, cell: Cell, config: CellConfig
) -> tuple[Forecast | None, str]:
    if entry.forecast is None:
        return None, "this procedure foretells nothing but its steps"
    healthy = LastHealthyCounts(config.cell.data_dir).load_counts(cell.robot.name)
    knowledge = knowledge_of(cell, None if healthy is None else healthy.counts)
    try:
        return entry.forecast(spec, knowledge), ""
    except (CalibrationError, RefusalError) as error:
        return None, str(error)
