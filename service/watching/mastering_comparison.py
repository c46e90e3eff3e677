"""Whether a controller still holds the mastering of the newest record, or one that a run wrote and never confirmed.

Neither raises an alarm. Looked at on each connection, after each run and now and then in between. What is found is
told, never acted upon: the robot may have been mastered on purpose, and then the record is what is old.
"""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Condition, Counts, MasteringData, ReadsMastering
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.journal import StoreError
from cellcal.service.record.journal_files import journal_path, open_journal
from cellcal.service.record.run_store import RunStore
from cellcal.service.record.unconfirmed_mastering import UnconfirmedMastering
from cellcal.service.watching.loss_modes import Suspicion, old_backup, suspect_unconfirmed

_LOG = logging.getLogger(__name__)
LOOK_EVERY_S = 10.0


@dataclass(frozen=True, slots=True)
class JournalledMastering:
    """The mastering of one robot in the journal: its newest record, and what runs left unconfirmed."""

    record: MasteringRecord | None
    unconfirmed: tuple[UnconfirmedMastering, ...] = ()


class MasteringComparison:
    """Compares what one controller holds with what the journal says of its robot."""

    def __init__(
        self, newest: Callable[[], JournalledMastering], *, look_every_s: float = LOOK_EVERY_S
    ) -> None:
        self._newest, self._look_every_s = newest, look_every_s
        self._next_s = 0.0
        self._agreed: MasteringData | None = None
        self._last_trouble: tuple[str, Suspicion] | None = None

    def force_check(self) -> None:
        """Look at the next opportunity: a run may have changed the mastering, or the record."""
        self._next_s, self._agreed = 0.0, None

    def note_loss(self, robot: str, condition: Condition) -> None:
        """Do nothing: the counts and the mastering that a controller holds are compared after a loss, too."""

    async def find_trouble(self, encoders: ReadsMastering) -> tuple[str, Suspicion] | None:
        """Return in words what is wrong with the controller's mastering, and what is suspected; None: nothing.

        Between two looks the last answer stands.
        """
        now_s = time.monotonic()
        if now_s < self._next_s:
            return self._last_trouble
        self._next_s = now_s + self._look_every_s
        current = await encoders.read_mastering()
        if current == self._agreed:
            return self._last_trouble
        journalled = self._newest()
        self._last_trouble = _compare_mastering(journalled, current)
        self._agreed = current if self._last_trouble is None and journalled.record is not None else None
        return self._last_trouble


def journalled_mastering(config: CellConfig, serial: str) -> Callable[[], JournalledMastering]:
    """Return what reads of a robot's mastering from the cell's journal."""
    last_error, nothing = "", JournalledMastering(None)

    def read_journal() -> JournalledMastering:
        nonlocal last_error
        if not journal_path(config).exists():
            return nothing
        try:
            with open_journal(config) as journal:
                store = RunStore(journal)
                return JournalledMastering(store.mastering_record(serial), store.list_unconfirmed(serial))
        except StoreError as error:  # the eyes on the encoders matter more
            if str(error) != last_error:
                _LOG.warning("the controller's mastering is not compared with its record: %s", error)
            last_error = str(error)
            return nothing

    return read_journal


def _compare_mastering(
    journalled: JournalledMastering, current: MasteringData
) -> tuple[str, Suspicion] | None:
    pending = next((one for one in reversed(journalled.unconfirmed) if one.may_be_in_force(current)), None)
    if pending is not None:
        return (
            make_message(
                "run {of_run} wrote it, and ended or broke off before it was confirmed", of_run=pending.of_run
            ),
            suspect_unconfirmed(pending.of_run),
        )
    record = journalled.record
    if record is None or not current.mastered or current.counts_at_zero == record.counts_at_zero:
        return None
    return _describe_mismatch(record, current.counts_at_zero), old_backup()


def _describe_mismatch(record: MasteringRecord, counts: Counts) -> str:
    if len(counts) != len(record.counts_at_zero):
        return make_message(
            "the controller masters {count_count} axes, the newest record has {counts_at_zero_count}",
            count_count=len(counts),
            counts_at_zero_count=len(record.counts_at_zero),
        )
    moved = np.subtract(counts, record.counts_at_zero)
    joints_deg = np.rad2deg(record.drive.to_joints(np.array(counts), np.array(record.counts_at_zero)))
    axes = [f"J{k + 1} by {abs(joints_deg[k]):.3f} deg" for k in np.flatnonzero(moved)]
    return make_message(
        "the controller's mastering is not that of the newest record ({sha256}), and no alarm "
        "tells of it: {axes}",
        sha256=record.sha256[:12],
        axes=", ".join(axes),
    )
