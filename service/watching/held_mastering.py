"""Whether a controller still holds the mastering of the newest record: an old backup raises no alarm.

Looked at on each connection, after each run and now and then in between. A difference is told, never acted upon: the
robot may have been mastered on purpose, and then the record is what is old.
"""

import logging
import time
from collections.abc import Callable

import numpy as np

from calibration.mastering.counts import MasteringRecord
from drivers.interfaces import Counts, MasteringData, MasteringStore
from service.configuration.cell_file import CellConfig
from service.runs.cell import journal_path, open_journal
from service.runs.journal import StoreError
from service.runs.store import Store

_LOG = logging.getLogger(__name__)
LOOK_EVERY_S = 10.0


class HeldMastering:
    """Compares what one controller holds with the newest record of its robot."""

    def __init__(
        self, newest: Callable[[], MasteringRecord | None], *, look_every_s: float = LOOK_EVERY_S
    ) -> None:
        self._newest, self._look_every_s = newest, look_every_s
        self._next_s = 0.0
        self._agreed: MasteringData | None = None
        self._told: str | None = None

    def look_anew(self) -> None:
        """Look at the next opportunity: a run may have changed the mastering, or the record."""
        self._next_s, self._agreed = 0.0, None

    async def difference(self, encoders: MasteringStore) -> str | None:
        """Return in words how the controller's mastering differs from the newest record; None where it does not.

        Between two looks the last answer stands.
        """
        now_s = time.monotonic()
        if now_s < self._next_s:
            return self._told
        self._next_s = now_s + self._look_every_s
        held = await encoders.mastering()
        if held == self._agreed:
            return self._told
        record = self._newest()
        agrees = record is None or not held.mastered or held.counts_at_zero == record.counts_at_zero
        self._agreed = held if agrees and record is not None else None
        self._told = None if agrees or record is None else _told(record, held.counts_at_zero)
        return self._told


def newest_record(config: CellConfig, serial: str) -> Callable[[], MasteringRecord | None]:
    """Return what reads the newest mastering record of a robot from the cell's journal."""
    told = ""

    def read() -> MasteringRecord | None:
        nonlocal told
        if not journal_path(config).exists():
            return None
        try:
            with open_journal(config) as journal:
                return Store(journal).mastering_record(serial)
        except StoreError as error:  # the eyes on the encoders matter more
            if str(error) != told:
                _LOG.warning("the controller's mastering is not compared with its record: %s", error)
            told = str(error)
            return None

    return read


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
