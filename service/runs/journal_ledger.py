"""The steps of a run in the journal of its cell."""

from collections.abc import Mapping
from typing import Any

from cellcal.calibration.message import make_message
from cellcal.calibration.message_table import with_messages
from cellcal.procedures.run_history import EventKind
from cellcal.service.record.journal import Journal, StoreError
from cellcal.service.record.run_store import RunStore

_OUTCOMES = (EventKind.FINDING, EventKind.CONDITION, EventKind.FAILED)


class JournalLedger:
    """A run's end of the journal. A finding names the instruments that were read for it."""

    def __init__(self, journal: Journal, run_id: str, actor: str) -> None:
        self._journal, self._run_id, self._actor = journal, run_id, actor
        self._read: set[str] = set()

    def note_reading(self, role: str, reading: Any) -> None:
        """Note an instrument that gave a reading."""
        if reading is not None:
            self._read.add(role)

    def record(self, kind: EventKind, body: Mapping[str, Any], *, key: str = "") -> None:
        """Store one fact durably."""
        if kind is EventKind.FINDING and self._read:
            body = {**body, "instruments": sorted(self._read)}
        if kind in _OUTCOMES:
            self._read.clear()
        self._journal.append(self._run_id, kind, with_messages(dict(body)), key=key, actor=self._actor)


def forget_from(journal: Journal, run_id: str, step: str, *, actor: str = "service") -> None:
    """Redo: findings from ``step`` on no longer count when the run is resumed. Nothing is deleted.

    Raises
    ------
    StoreError
        The run has no finding of that name.
    """
    names = [finding.step for finding in RunStore(journal).find_run(run_id).past.findings]
    if step not in names:
        raise StoreError(
            make_message("run {run_id} has no finding {step!r}", run_id=run_id, step=step),
            code="store.no_such_step",
            remedy=make_message("It has: {names}.", names=", ".join(names) or "none"),
        )
    journal.append(run_id, EventKind.FORGOTTEN, {"keep": names.index(step), "step": step}, actor=actor)
