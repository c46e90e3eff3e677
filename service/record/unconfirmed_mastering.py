"""Masterings that runs wrote and that nothing has confirmed: folded from the journal, nothing is stored twice.

From the intent to write on, a mastering is unconfirmed. A run that passes after its write confirms it; the old data
in the controller again undo it. Whatever happens in between, a lost link or a killed process, leaves it unconfirmed,
and every later look says so.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from cellcal.calibration.documents.json_text import parse_json
from cellcal.drivers.interfaces import MasteringData
from cellcal.procedures.cell import Cell
from cellcal.procedures.entry import Entry
from cellcal.procedures.past import Effect, Kind
from cellcal.procedures.run import ProcedureError
from cellcal.service.record.journal import Event
from cellcal.service.record.mastering_backups import WRITES, held_before, serial_of

_TELLING = frozenset({Kind.STARTED, Kind.INTENT, Kind.FINDING, Kind.FORGOTTEN, Kind.UNDONE, Kind.ENDED})
_MAY_START = ("mastering_undo", "mastering_recovery")  # the one moves nothing, the other by its record


@dataclass(frozen=True, slots=True)
class Unconfirmed:
    """What a run wrote, and what the controller held before it."""

    of_run: str
    written: MasteringData
    before: MasteringData | None  # None where the run has not read it
    epoch: int | None  # of the encoders at that write

    def may_be_in_force(self, held: MasteringData) -> bool:
        """Tell whether a controller holds this write, whole or in part, and not what was there before it."""
        new, old = self.written.counts_at_zero, (self.before or self.written).counts_at_zero
        if held == self.before or not len(held.counts_at_zero) == len(old) == len(new):
            return False
        ours = all(h in pair for h, *pair in zip(held.counts_at_zero, new, old, strict=True))
        return ours and (held.counts_at_zero != old or held == self.written)


class UnconfirmedMasteringError(ProcedureError):
    """The mastering in force was written by a run that did not get to confirm it: nothing moves by it."""

    code = "procedure.unconfirmed_mastering"


@dataclass(slots=True)
class _Told:
    """What the journal has told so far of one run that writes."""

    events: list[tuple[Event, dict[str, Any]]] = field(default_factory=list)
    pending: Unconfirmed | None = None


def unconfirmed_masterings(events: Iterable[Event], robot_serial: str) -> tuple[Unconfirmed, ...]:
    """Return what of a robot's masterings was written and neither confirmed nor undone since, oldest first."""
    known = [event for event in events if event.kind in _TELLING]
    writing = {event.run_id for event in known if event.kind == Kind.INTENT and WRITES in event.body}
    runs: dict[str, _Told] = {}
    for event in known:
        if event.run_id in writing:
            _take(runs, event, parse_json(event.body), robot_serial)
    return tuple(told.pending for told in runs.values() if told.pending is not None)


async def unconfirmed_in_force(cell: Cell, events: Iterable[Event], robot_serial: str) -> Unconfirmed | None:
    """Return the newest unconfirmed mastering that a controller holds; None where it holds no such one."""
    pending = unconfirmed_masterings(events, robot_serial)
    if not pending or cell.mastering is None:
        return None
    held = await cell.mastering.mastering()
    return next((one for one in reversed(pending) if one.may_be_in_force(held)), None)


def refuse_unconfirmed(found: Unconfirmed | None, entry: Entry, run_id: str = "") -> None:
    """Refuse to start or resume by a mastering that nobody has confirmed, other than to confirm or undo it.

    Raises
    ------
    UnconfirmedMasteringError
        It is in force, and this is neither the run that wrote it, nor an undo or a recovery.
    """
    if found is None or found.of_run == run_id or entry.name in _MAY_START:
        return
    raise UnconfirmedMasteringError(
        f"the robot's mastering was written by run {found.of_run} and never confirmed: nothing moves by it",
        remedy="Resume that run, undo it (mastering_undo), or start a mastering recovery. Until then do not move the "
        "robot in AUTO.",
    )


def _take(runs: dict[str, _Told], event: Event, body: dict[str, Any], robot_serial: str) -> None:
    if event.kind == Kind.STARTED:
        if serial_of(body) == robot_serial:
            runs[event.run_id] = _Told()
        return
    told = runs.get(event.run_id)
    if told is None:
        return
    told.events.append((event, body))
    if event.kind == Kind.INTENT and body["step"] == WRITES:
        told.pending = _pending(told, event, body)
    elif told.pending is not None and _undoes(event, body, told.pending):
        told.pending = None
    elif told.pending is not None and event.kind == Kind.ENDED and body["verdict"] == "passed":
        for other in runs.values():  # what the controller holds is then confirmed, whoever wrote before
            other.pending = None


def _pending(told: _Told, event: Event, body: dict[str, Any]) -> Unconfirmed:
    if told.pending is not None:
        return told.pending  # tried again: what was there before the first attempt is what was there before
    goal = body["inputs"][0][0]
    data = goal if isinstance(goal, dict) else {"counts_at_zero": goal, "mastered": True}
    before = held_before(told.events)
    old, epoch = (None, None) if before is None else (mastering_data(before[0]), before[1])
    return Unconfirmed(event.run_id, mastering_data(data), old, epoch)


def _undoes(event: Event, body: dict[str, Any], pending: Unconfirmed) -> bool:
    """Tell whether the old data are in the controller again, by a step of the run or by its clean-up."""
    if event.kind == Kind.UNDONE:
        return True
    value = body.get("value")
    written = event.kind == Kind.FINDING and body["effect"] == Effect.WRITE and body["step"] != WRITES
    return (
        written
        and isinstance(value, dict)
        and "counts_at_zero" in value
        and mastering_data(value) == pending.before
    )


def mastering_data(stored: dict[str, Any]) -> MasteringData:
    """Return mastering data from their stored form."""
    return MasteringData(tuple(stored["counts_at_zero"]), stored["mastered"])
