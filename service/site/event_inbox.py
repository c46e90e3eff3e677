"""Events that came over the bus and were not opened yet: so many bytes for each cell, taken in turn.

A signature costs about a fifth of a millisecond, so a cell that floods sends faster than anything is opened. Its
events wait within its own share, and what does not fit is dropped: the state of a cell says what it has sent, and
what is missing here is asked of it later, as any hole is. Other cells' events neither wait behind the flood nor lose
their room to it.
"""

import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Protocol

from cellcal.service.site.keys import cell_of

MOST_EVENTS, MOST_BYTES = 2000, 4_000_000  # of a cell
MOST_BYTES_OF_ALL = 64_000_000
_MOST_AT_ONCE = 20_000  # samples of a subscriber, so that a flood cannot keep a look from ending


class _Payload(Protocol):
    def to_bytes(self) -> bytes: ...


class EventSample(Protocol):
    """A sample of the bus."""

    @property
    def key_expr(self) -> object: ...
    @property
    def payload(self) -> _Payload: ...


class EventSource(Protocol):
    """A subscriber."""

    def try_recv(self) -> EventSample | None: ...


@dataclass(slots=True)
class _CellShare:
    waiting: deque[tuple[str, bytes]] = field(default_factory=deque)
    byte_count: int = 0


class EventInbox:
    """Filled by the thread that receives, emptied by the one that opens; only of cells that are enrolled."""

    def __init__(self, cells: Iterable[str]) -> None:
        self._shares = {cell: _CellShare() for cell in cells}
        self._turns = deque(self._shares)
        self._byte_count = 0
        self._lock = threading.Lock()
        self._overflowing: set[str] = set()

    def receive(self, sources: Iterable[EventSource]) -> tuple[str, ...]:
        """Take in what came; return the cells of which something was dropped for the first time."""
        before = set(self._overflowing)
        for source in sources:
            for _ in range(_MOST_AT_ONCE):
                sample = source.try_recv()
                if sample is None:
                    break
                self.add(str(sample.key_expr), sample.payload.to_bytes())
        return tuple(sorted(self._overflowing - before))

    def add(self, key: str, raw: bytes) -> None:
        """Keep an event where there is room for it in its cell's share."""
        cell = cell_of(key)
        share = self._shares.get(cell)
        if share is None:
            return
        with self._lock:
            own = share.byte_count + len(raw)
            is_first = not share.waiting  # one large event of a cell always has room
            full = len(share.waiting) >= MOST_EVENTS or own > MOST_BYTES
            if not is_first and (full or self._byte_count + len(raw) > MOST_BYTES_OF_ALL):
                self._overflowing.add(cell)
                return
            share.waiting.append((key, raw))
            share.byte_count = own
            self._byte_count += len(raw)

    def take(self, most: int) -> list[tuple[str, bytes]]:
        """Return up to so many events, those of each cell in their order, the cells in turns."""
        found: list[tuple[str, bytes]] = []
        with self._lock:
            empty_turns = 0
            while len(found) < most and empty_turns < len(self._turns):
                share = self._shares[self._turns[0]]
                self._turns.rotate(-1)
                if not share.waiting:
                    empty_turns += 1
                    continue
                empty_turns = 0
                key, raw = share.waiting.popleft()
                share.byte_count -= len(raw)
                self._byte_count -= len(raw)
                found.append((key, raw))
        return found
