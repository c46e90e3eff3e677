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
from cellcal.drivers.interfaces import Counts, MasteringData, MasteringStore
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.journal import StoreError
from cellcal.service.record.journal_files import journal_path, open_journal
from cellcal.service.record.run_store import Store
from cellcal.service.record.unconfirmed_mastering import Unconfirmed
from cellcal.service.watching.loss_modes import Suspicion, old_backup, unconfirmed

_LOG = logging.getLogger(__name__)
LOOK_EVERY_S = 10.0


@dataclass(frozen=True, slots=True)
class Journalled:
    """What the journal says of one robot's mastering: its newest record, and what runs left unconfirmed."""

    record: MasteringRecord | None
    unconfirmed: tuple[Unconfirmed, ...] = ()


class HeldMastering:
    """Compares what one controller holds with what the journal says of its robot."""

    def __init__(self, newest: Callable[[], Journalled], *, look_every_s: float = LOOK_EVERY_S) -> None:
        self._newest, self._look_every_s = newest, look_every_s
        self._next_s = 0.0
        self._agreed: MasteringData | None = None
        self._told: tuple[str, Suspicion] | None = None

    def look_anew(self) -> None:
        """Look at the next opportunity: a run may have changed the mastering, or the record."""
        self._next_s, self._agreed = 0.0, None

    async def trouble(self, encoders: MasteringStore) -> tuple[str, Suspicion] | None:
        """Return in words what is wrong with the controller's mastering, and what is suspected; None: nothing.

        Between two looks the last answer stands.
        """
        now_s = time.monotonic()
        if now_s < self._next_s:
            return self._told
        self._next_s = now_s + self._look_every_s
        held = await encoders.mastering()
        if held == self._agreed:
            return self._told
        known = self._newest()
        self._told = _trouble(known, held)
        self._agreed = held if self._told is None and known.record is not None else None
        return self._told


def journalled_mastering(config: CellConfig, serial: str) -> Callable[[], Journalled]:
    """Return what reads of a robot's mastering from the cell's journal."""
    told, nothing = "", Journalled(None)

    def read() -> Journalled:
        nonlocal told
        if not journal_path(config).exists():
            return nothing
        try:
            with open_journal(config) as journal:
                store = Store(journal)
                return Journalled(store.mastering_record(serial), store.unconfirmed(serial))
        except StoreError as error:  # the eyes on the encoders matter more
            if str(error) != told:
                _LOG.warning("the controller's mastering is not compared with its record: %s", error)
            told = str(error)
            return nothing

    return read


def _trouble(known: Journalled, held: MasteringData) -> tuple[str, Suspicion] | None:
    pending = next((one for one in reversed(known.unconfirmed) if one.may_be_in_force(held)), None)
    if pending is not None:
        return f"run {pending.of_run} wrote it, and ended or broke off before it was confirmed", unconfirmed(
            pending.of_run
        )
    record = known.record
    if record is None or not held.mastered or held.counts_at_zero == record.counts_at_zero:
        return None
    return _told(record, held.counts_at_zero), old_backup()


def _told(record: MasteringRecord, held: Counts) -> str:
    if len(held) != len(record.counts_at_zero):
        return f"the controller masters {len(held)} axes, the newest record has {len(record.counts_at_zero)}"
    moved = np.subtract(held, record.counts_at_zero)
    joints_deg = np.rad2deg(record.drive.joints(np.array(held), np.array(record.counts_at_zero)))
    axes = [f"J{k + 1} by {abs(joints_deg[k]):.3f} deg" for k in np.flatnonzero(moved)]
    return (
        f"the controller's mastering is not that of the newest record ({record.sha256[:12]}), and no alarm tells of "
        f"it: {', '.join(axes)}"
    )
