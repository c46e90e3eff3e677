"""Events that a monitor took in and has not stored yet: a store that fails costs time, never an event.

They are kept in memory and tried again, with a pause that grows. While too many wait, none is taken from the bus,
whose own queue is bounded too: what it has to drop is asked of the cells later, as any hole is.
"""

import time
from collections import deque
from collections.abc import Callable, Sequence

from cellcal.calibration.message import make_message
from cellcal.drivers.supervision import SUPERVISOR
from cellcal.service.site.fleet import Fleet
from cellcal.service.site.keys import SiteError
from cellcal.service.site.site_store import ReceivedEvent, is_store_fault

TASK = "monitor: store"
MOST_WAITING = 5_000


class StoreFailsError(SiteError):
    """The monitor's file does not take what came."""

    def __init__(self, error: Exception, count: int) -> None:
        super().__init__(
            make_message(
                "the monitor's store takes nothing just now: {error}. {count} events wait in memory and "
                "are tried again.",
                error=error,
                count=count,
            ),
            remedy="See whether the disk is full or read-only, and whether another program has the file open.",
            code="store",
        )


class UnstoredEvents:
    """The events received, in their order, until they are stored. Used by the receiving thread."""

    def __init__(
        self,
        store: Callable[[Sequence[ReceivedEvent]], None],
        fleet: Fleet,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._store, self._fleet, self._clock = store, fleet, clock
        self._waiting: deque[ReceivedEvent] = deque()
        self._not_before_s = float("-inf")
        self._failing = False

    def __len__(self) -> int:
        """Return how many wait."""
        return len(self._waiting)

    @property
    def full(self) -> bool:
        """Whether no more may be taken just now."""
        return len(self._waiting) >= MOST_WAITING

    def take(self, received: Sequence[ReceivedEvent]) -> None:
        """Take in what came."""
        self._waiting.extend(received)

    def store(self, *, last: bool = False) -> None:
        """Store what waits, if it is time to try; the last time it is always."""
        if not self._waiting or (self._clock() < self._not_before_s and not last):
            return
        try:
            self._store(tuple(self._waiting))
        except Exception as error:  # noqa: BLE001  named: the store's fault waits, an event's is that cell's alone
            if is_store_fault(error):
                self.note_fault(error)
            else:
                self._store_one_by_one()
            return
        self._waiting.clear()
        self._note_recovery()

    def note_fault(self, error: Exception) -> None:
        """Name a fault of the store, and wait before it is tried again."""
        fault = StoreFailsError(error, len(self._waiting))
        if not self._failing:
            self._fleet.name_flaw(
                "",
                make_message(
                    "{told_message} {told_remedy}", told_message=fault.message, told_remedy=fault.remedy
                ),
            )
        self._failing = True
        self._not_before_s = self._clock() + SUPERVISOR.note_failure(TASK, fault)

    def _store_one_by_one(self) -> None:
        while self._waiting:
            each = self._waiting[0]
            try:
                with self._fleet.blame_cell(each.message.station):
                    self._store((each,))
            except Exception as error:  # noqa: BLE001  only the store's own faults are not caught above
                self.note_fault(error)
                return
            self._waiting.popleft()
        self._note_recovery()

    def _note_recovery(self) -> None:
        if self._failing:
            self._failing = False
            self._fleet.name_flaw("", "the monitor's store works again; what waited is stored.")
            SUPERVISOR.note_end(TASK)
