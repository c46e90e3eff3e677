"""What becomes of a mastering that a run wrote and did not get to confirm: the old data go back, or all are told.

It is done whatever ended the run, a refusal, a lost link, a stop or a cancel, and is waited for like the robot's own
stop. A process that was killed does nothing: its journal tells the next look (`record.unconfirmed_mastering`).
"""

import asyncio
import contextlib
import logging

from pydantic_core import to_jsonable_python

from cellcal.calibration.errors import CellError
from cellcal.procedures.cell import Cell
from cellcal.procedures.motors import motor_store
from cellcal.procedures.past import Effect, Kind, Past
from cellcal.procedures.run import RETRYABLE, ProcedureError, to_the_end
from cellcal.procedures.steps.write import ReadBackError, restore_mastering
from cellcal.service.record.journal import Journal, StoreError
from cellcal.service.record.mastering_backups import WRITES
from cellcal.service.record.run_store import Store
from cellcal.service.record.unconfirmed_mastering import Unconfirmed, unconfirmed_masterings

_LOG = logging.getLogger(__name__)
STEP = "put back what was not confirmed"
TRIES, PAUSE_S, DEADLINE_S = 3, 1.0, 60.0

_DONE = "The mastering that this run wrote was not confirmed: the old data were put back."
_NOT_DONE = (
    "The mastering that this run wrote is NOT confirmed, and it may be in force: do not move the robot in AUTO. "
    "Resume this run, which confirms it or puts the old data back, or undo it (mastering_undo)."
)


class NotPutBackError(ProcedureError):
    """The old mastering data do not belong into this controller any more, or not by our hand."""

    code = "procedure.not_put_back"


async def put_back_unconfirmed(cell: Cell, journal: Journal, run_id: str, actor: str) -> str:
    """Put the old mastering back where a run leaves one unconfirmed; return what to tell, empty where it does not."""
    try:
        serial, past = _told(journal, run_id)
        pending = [
            one for one in unconfirmed_masterings(journal.events(run_id), serial) if one.of_run == run_id
        ]
    except StoreError as error:
        _LOG.warning("whether run %s leaves a mastering unconfirmed cannot be read: %s", run_id, error)
        return ""
    if not pending:
        return ""
    return await to_the_end(_PutBack(cell, journal, run_id, actor).do(pending[0], past))


class _PutBack:
    """One clean-up."""

    def __init__(self, cell: Cell, journal: Journal, run_id: str, actor: str) -> None:
        self._cell, self._journal, self._run_id, self._actor = cell, journal, run_id, actor

    async def do(self, pending: Unconfirmed, past: Past) -> str:
        attempt = past.attempts.get(STEP, 0) + 1
        step = {"step": STEP, "attempt": attempt, "effect": Effect.WRITE.value}
        inputs = to_jsonable_python(pending.before)
        self._note(Kind.INTENT, step | {"inputs": inputs})
        try:
            async with asyncio.timeout(DEADLINE_S):
                await self._again_and_again(pending)
        except (CellError, TimeoutError) as error:
            why = str(error) or "the robot did not answer in time"
            told = {"error": type(error).__name__, "code": getattr(error, "code", ""), "message": why}
            self._note(Kind.FAILED, step | {"stopped": False} | told)
            _LOG.warning("run %s: the old mastering is not back: %s", self._run_id, why)
            return _NOT_DONE
        names = [finding.step for finding in past.findings]
        keep = names.index(WRITES) if WRITES in names else len(names)
        self._note(Kind.UNDONE, {"step": WRITES, "keep": keep, "value": inputs})
        return _DONE

    async def _again_and_again(self, pending: Unconfirmed) -> None:
        for _ in range(1, TRIES):
            with contextlib.suppress(*RETRYABLE):
                return await self._once(pending)
            await asyncio.sleep(PAUSE_S)
        return await self._once(pending)

    async def _once(self, pending: Unconfirmed) -> None:
        cell, before = self._cell, pending.before
        if cell.permit is not None:
            cell.permit.hold()
        store = motor_store(cell)
        held = await store.mastering()
        if before is None or (held != before and not pending.may_be_in_force(held)):
            raise NotPutBackError("the controller holds a mastering that this run neither found nor wrote")
        if await store.encoder_epoch() != pending.epoch:
            raise NotPutBackError(
                "the encoders lost their position since: the old data belong to other counts"
            )
        found = await restore_mastering(cell, before)
        if found != before:
            raise ReadBackError(f"the mastering reads {found} after {before} was put back")

    def _note(self, kind: Kind, body: dict[str, object]) -> None:
        try:
            self._journal.append(self._run_id, kind, body, actor=self._actor)
        except StoreError as error:  # the robot matters more: what it holds is read again on each later look
            _LOG.warning(
                "run %s: that the old mastering goes back was not journalled: %s", self._run_id, error
            )


def _told(journal: Journal, run_id: str) -> tuple[str, Past]:
    view = Store(journal).run(run_id)
    return str(view.cell["devices"][0]["identity"]["serial"]), view.past
