"""Masterings that runs wrote and that nothing has confirmed: folded from the journal, nothing is stored twice.

From the intent to write on, a mastering is unconfirmed. A run that passes after its write confirms it; the old data
in the controller again undo it. Whatever happens in between, a lost link or a killed process, leaves it unconfirmed,
and every later look says so.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import MasteringData
from cellcal.procedures.cell import Cell
from cellcal.procedures.procedure_definition import ProcedureDefinition
from cellcal.procedures.run import ProcedureError
from cellcal.procedures.run_history import EventKind, StepEffect
from cellcal.service.record.journal import JournalEvent
from cellcal.service.record.mastering_backups import WRITES, mastering_before, serial_of

_TELLING = frozenset(
    {
        EventKind.STARTED,
        EventKind.INTENT,
        EventKind.FINDING,
        EventKind.FORGOTTEN,
        EventKind.UNDONE,
        EventKind.ENDED,
    }
)
_MAY_START = ("mastering_undo", "mastering_recovery")  # the one moves nothing, the other by its record


@dataclass(frozen=True, slots=True)
class UnconfirmedMastering:
    """The mastering that a run wrote, and the one in the controller before it."""

    of_run: str
    written: MasteringData
    before: MasteringData | None  # None where the run has not read it
    epoch: int | None  # of the encoders at that write

    def may_be_in_force(self, current: MasteringData) -> bool:
        """Return whether a controller holds this write, whole or in part, and not what was there before it."""
        new, old = self.written.counts_at_zero, (self.before or self.written).counts_at_zero
        if current == self.before or not len(current.counts_at_zero) == len(old) == len(new):
            return False
        ours = all(h in pair for h, *pair in zip(current.counts_at_zero, new, old, strict=True))
        return ours and (current.counts_at_zero != old or current == self.written)


class UnconfirmedMasteringError(ProcedureError):
    """The mastering in force was written by a run that did not get to confirm it: nothing moves by it."""

    code = "procedure.unconfirmed_mastering"


@dataclass(slots=True)
class _WritingRun:
    """The journal's events so far of one run that writes."""

    events: list[tuple[JournalEvent, dict[str, Any]]] = field(default_factory=list)
    pending: UnconfirmedMastering | None = None


def unconfirmed_masterings(
    events: Iterable[JournalEvent], robot_serial: str
) -> tuple[UnconfirmedMastering, ...]:
    """Return what of a robot's masterings was written and neither confirmed nor undone since, oldest first."""
    relevant = [event for event in events if event.kind in _TELLING]
    writing = {event.run_id for event in relevant if event.kind == EventKind.INTENT and WRITES in event.body}
    runs: dict[str, _WritingRun] = {}
    for event in relevant:
        if event.run_id in writing:
            _apply_event(runs, event, parse_json(event.body), robot_serial)
    return tuple(writing_run.pending for writing_run in runs.values() if writing_run.pending is not None)


async def unconfirmed_in_force(
    cell: Cell, events: Iterable[JournalEvent], robot_serial: str
) -> UnconfirmedMastering | None:
    """Return the newest unconfirmed mastering that a controller holds; None where it holds no such one."""
    pending = unconfirmed_masterings(events, robot_serial)
    if not pending or cell.mastering is None:
        return None
    current = await cell.mastering.read_mastering()
    return next((one for one in reversed(pending) if one.may_be_in_force(current)), None)


def refuse_unconfirmed(
    found: UnconfirmedMastering | None, entry: ProcedureDefinition, run_id: str = ""
) -> None:
    """Refuse to start or resume by an unconfirmed mastering, other than to confirm or undo it.

    Raises
    ------
    UnconfirmedMasteringError
        It is in force, and this is neither the run that wrote it, nor an undo or a recovery.
    """
    if found is None or found.of_run == run_id or entry.name in _MAY_START:
        return
    raise UnconfirmedMasteringError(
        make_message(
            "the robot's mastering was written by run {of_run} and never confirmed: nothing moves by it",
            of_run=found.of_run,
        ),
        remedy="Resume that run, undo it (mastering_undo), or start a mastering recovery. Until then do not move the "
        "robot in AUTO.",
    )


def _apply_event(
    runs: dict[str, _WritingRun], event: JournalEvent, body: dict[str, Any], robot_serial: str
) -> None:
    if event.kind == EventKind.STARTED:
        if serial_of(body) == robot_serial:
            runs[event.run_id] = _WritingRun()
        return
    writing_run = runs.get(event.run_id)
    if writing_run is None:
        return
    writing_run.events.append((event, body))
    if event.kind == EventKind.INTENT and body["step"] == WRITES:
        writing_run.pending = _pending_mastering(writing_run, event, body)
    elif writing_run.pending is not None and _is_undone_by(event, body, writing_run.pending):
        writing_run.pending = None
    elif writing_run.pending is not None and event.kind == EventKind.ENDED and body["verdict"] == "passed":
        for other in runs.values():  # what the controller holds is then confirmed, regardless of the writer
            other.pending = None


def _pending_mastering(
    writing_run: _WritingRun, event: JournalEvent, body: dict[str, Any]
) -> UnconfirmedMastering:
    if writing_run.pending is not None:
        return (
            writing_run.pending
        )  # tried again: what was there before the first attempt is what was there before
    goal = body["inputs"][0][0]
    data = goal if isinstance(goal, dict) else {"counts_at_zero": goal, "mastered": True}
    before = mastering_before(writing_run.events)
    old, epoch = (None, None) if before is None else (mastering_data(before[0]), before[1])
    return UnconfirmedMastering(event.run_id, mastering_data(data), old, epoch)


def _is_undone_by(event: JournalEvent, body: dict[str, Any], pending: UnconfirmedMastering) -> bool:
    """Return whether the old data are in the controller again, by a step of the run or by its clean-up."""
    if event.kind == EventKind.UNDONE:
        return True
    value = body.get("value")
    written = (
        event.kind == EventKind.FINDING and body["effect"] == StepEffect.WRITE and body["step"] != WRITES
    )
    return (
        written
        and isinstance(value, dict)
        and "counts_at_zero" in value
        and mastering_data(value) == pending.before
    )


def mastering_data(stored: dict[str, Any]) -> MasteringData:
    """Return mastering data from their stored form."""
    return MasteringData(tuple(stored["counts_at_zero"]), stored["mastered"])
