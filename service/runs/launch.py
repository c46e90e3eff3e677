"""A run on a cell from its file: journal, devices, spec, and what the service must remember afterwards."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from cellcal.drivers.errors import DeviceError
from cellcal.drivers.interfaces import Operator, Readiness
from cellcal.procedures.cell import Cell
from cellcal.procedures.progress import ignore_progress
from cellcal.procedures.robot_condition import read_reached_condition
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.healthy_counts import LastHealthyCounts, remember_healthy
from cellcal.service.record.journal_end import refuse_missing_end
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunOutcome, RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.open_cell import open_cell, with_robot_history
from cellcal.service.runs.redo import discard_from
from cellcal.service.runs.run_procedure import OnEvent, RunConditions, resume_procedure, run_procedure
from cellcal.service.runs.settings import build_spec
from cellcal.service.runs.stale_run import agree_if_old

_LOG = logging.getLogger(__name__)
_LEAVES_HEALTHY = ("mastering_record", "mastering_recovery")


@dataclass(frozen=True, slots=True)
class RunTarget:
    """One robot of one cell, and who answers and listens."""

    config: CellConfig
    operator: Operator
    robot: str | None = None
    on_event: OnEvent = ignore_progress
    actor: str = "service"  # who began it
    accept_missing_end: bool = False  # a person's word: go on although the journal's end is missing


async def start_run(where: RunTarget, procedure: str, settings: Mapping[str, object]) -> RunOutcome:
    """Run a procedure from its beginning."""
    # what is misspelt reaches no device
    spec = build_spec(where.config, where.config.robot_named(where.robot).name, procedure, settings)
    async with open_cell(where.config, where.operator, where.robot) as cell:
        how = RunConditions(where.on_event, actor=where.actor, accept_missing_end=where.accept_missing_end)
        return await start_run_on(where.config, cell, procedure, spec, how)


async def resume_run(where: RunTarget, run_id: str, redo_from: str | None = None) -> RunOutcome:
    """Resume a run; ``last`` is the newest. ``redo_from`` is a step whose finding and all after it are done again.

    Raises
    ------
    DeclinedError
        The person did not agree to what would be discarded, or to go on with a run that stood still for long.
    """
    async with open_cell(where.config, where.operator, where.robot) as cell:
        how = RunConditions(where.on_event, actor=where.actor, accept_missing_end=where.accept_missing_end)
        return await resume_run_on(where.config, cell, run_id, how, redo_from=redo_from)


async def start_run_on(
    config: CellConfig, cell: Cell, procedure: str, spec: Any, how: RunConditions
) -> RunOutcome:
    """Run a procedure with its spec (`build_spec`) on a cell that is connected already."""
    with open_journal(config) as journal:
        missing_end = refuse_missing_end(config, journal, accepted=how.accept_missing_end)
        how = replace(how, missing_end=missing_end)
        cell_with_history = await with_robot_history(cell, journal)
        outcome = await run_procedure(cell_with_history, procedure, spec, journal, how=how)
        await _save_healthy_counts(config, cell, outcome)
        return outcome


async def resume_run_on(
    config: CellConfig, cell: Cell, run_id: str, how: RunConditions, *, redo_from: str | None = None
) -> RunOutcome:
    """Resume a run on a cell that is connected already; as `resume_run`."""
    with open_journal(config) as journal:
        missing_end = refuse_missing_end(config, journal, accepted=how.accept_missing_end)
        how = replace(how, missing_end=missing_end)
        cell_with_history = await with_robot_history(cell, journal)
        run_id = RunStore(journal).resolve_run_id(run_id)
        if redo_from is not None:
            await discard_from(cell.operator, journal, run_id, redo_from)
        await agree_if_old(cell.operator, journal, run_id)
        ended_before = RunStore(journal).find_run(run_id).state == RunVerdict.PASSED
        outcome = await resume_procedure(cell_with_history, run_id, journal, how=how)
        if not ended_before:  # what the motors count today tells nothing of the day when it passed
            await _save_healthy_counts(config, cell, outcome)
        return outcome


async def _save_healthy_counts(config: CellConfig, cell: Cell, outcome: RunOutcome) -> None:
    """Keep the counts that a run has left healthy. The run is over: what goes wrong here takes nothing from it."""
    passed = outcome.verdict is RunVerdict.PASSED and outcome.procedure in _LEAVES_HEALTHY
    if not passed or cell.mastering is None:
        return
    try:
        if (await read_reached_condition(cell.robot)).readiness is Readiness.POSITION_LOST:
            return
        await remember_healthy(cell.robot.name, cell.mastering, LastHealthyCounts(config.cell.data_dir))
    except (DeviceError, OSError) as error:
        _LOG.warning(
            "the counts of %s were not kept as healthy: %s The watch keeps them at its next look.",
            cell.robot.name,
            error,
        )
