"""What becomes of a mastering that a run wrote and did not get to confirm: the old data go back, or all are told.

It is done whatever ended the run, a refusal, a lost link, a stop or a cancel, and is waited for like the robot's own
stop. A process that was killed does nothing: its journal tells the next look (`record.unconfirmed_mastering`).
"""

import asyncio
import contextlib
import logging

from pydantic_core import to_jsonable_python

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.procedures.cell import Cell
from cellcal.procedures.motors import motor_store
from cellcal.procedures.robot_stop import finish_cleanup
from cellcal.procedures.run import RETRYABLE, ProcedureError
from cellcal.procedures.run_history import EventKind, RunHistory, StepEffect
from cellcal.procedures.steps.write import ReadBackError, restore_mastering
from cellcal.service.record.journal import Journal, StoreError
from cellcal.service.record.mastering_backups import WRITES
from cellcal.service.record.run_store import RunStore
from cellcal.service.record.unconfirmed_mastering import UnconfirmedMastering, unconfirmed_masterings

_LOG = logging.getLogger(__name__)
STEP = "put back what was not confirmed"
TRIES, PAUSE_S, DEADLINE_S = 3, 1.0, 60.0

_DONE = "The mastering that this run wrote was not confirmed: the old data were put back."
_NOT_DONE = (
    "The mastering that this run wrote is NOT confirmed, and it may be in force: do not move the robot in AUTO. "
    "Resume this run, which confirms it or puts the old data back, or undo it (mastering_undo)."
)


class RollbackRefusedError(ProcedureError):
    """The old mastering data do not belong into this controller any more, or not by our hand."""

    code = "procedure.not_put_back"


async def roll_back_unconfirmed(cell: Cell, journal: Journal, run_id: str, actor: str) -> str:
    """Put the old mastering back where a run leaves one unconfirmed; return what to tell, empty where it does not."""
    try:
        serial, past = _serial_and_past(journal, run_id)
        pending = [
            one for one in unconfirmed_masterings(journal.list_events(run_id), serial) if one.of_run == run_id
        ]
    except StoreError as error:
        _LOG.warning("whether run %s leaves a mastering unconfirmed cannot be read: %s", run_id, error)
        return ""
    if not pending:
        return ""
    return await finish_cleanup(_MasteringRollback(cell, journal, run_id, actor).roll_back(pending[0], past))


class _MasteringRollback:
    """One clean-up."""

    def __init__(self, cell: Cell, journal: Journal, run_id: str, actor: str) -> None:
        self._cell, self._journal, self._run_id, self._actor = cell, journal, run_id, actor

    async def roll_back(self, pending: UnconfirmedMastering, past: RunHistory) -> str:
        attempt = past.attempts.get(STEP, 0) + 1
        step = {"step": STEP, "attempt": attempt, "effect": StepEffect.WRITE.value}
        inputs = to_jsonable_python(pending.before)
        self._append_note(EventKind.INTENT, step | {"inputs": inputs})
        try:
            async with asyncio.timeout(DEADLINE_S):
                await self._restore_with_retries(pending)
        except (CellError, TimeoutError) as error:
            why = str(error) or "the robot did not answer in time"
            code = error.code if isinstance(error, CellError) else ""
            error_fields = {"error": type(error).__name__, "code": code, "message": why}
            self._append_note(EventKind.FAILED, step | {"stopped": False} | error_fields)
            _LOG.warning("run %s: the old mastering is not back: %s", self._run_id, why)
            return _NOT_DONE
        names = [finding.step for finding in past.findings]
        keep = names.index(WRITES) if WRITES in names else len(names)
        self._append_note(EventKind.UNDONE, {"step": WRITES, "keep": keep, "value": inputs})
        return _DONE

    async def _restore_with_retries(self, pending: UnconfirmedMastering) -> None:
        for _ in range(1, TRIES):
            with contextlib.suppress(*RETRYABLE):
                return await self._restore_once(pending)
            await asyncio.sleep(PAUSE_S)
        return await self._restore_once(pending)

    async def _restore_once(self, pending: UnconfirmedMastering) -> None:
        cell, before = self._cell, pending.before
        if cell.permit is not None:
            cell.permit.check_held()
        store = motor_store(cell)
        current = await store.read_mastering()
        if before is None or (current != before and not pending.may_be_in_force(current)):
            raise RollbackRefusedError(
                "the controller holds a mastering that this run neither found nor wrote"
            )
        if await store.encoder_epoch() != pending.epoch:
            raise RollbackRefusedError(
                "the encoders lost their position since: the old data belong to other counts"
            )
        found = await restore_mastering(cell, before)
        if found != before:
            raise ReadBackError(
                make_message(
                    "the mastering reads {restored} after {data} was put back", restored=found, data=before
                )
            )

    def _append_note(self, kind: EventKind, body: dict[str, object]) -> None:
        try:
            self._journal.append(self._run_id, kind, body, actor=self._actor)
        except StoreError as error:  # the robot matters more: what it holds is read again on each later look
            _LOG.warning(
                "run %s: that the old mastering goes back was not journalled: %s", self._run_id, error
            )


def _serial_and_past(journal: Journal, run_id: str) -> tuple[str, RunHistory]:
    view = RunStore(journal).find_run(run_id)
    return str(view.cell["devices"][0]["identity"]["serial"]), view.past
