"""Connections of the web server: how many there may be, which are closed first, and what happens without descriptors.

A stop must reach the service whatever else is connected. So connections are accepted one at a time; too many of one
address, or in all, close the oldest that waits for nothing but its next request; and where the system has no
descriptor left, spare ones are given up for the newest connection.
"""

import contextlib
import errno
import logging
import os
import resource
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

_log = logging.getLogger(__name__)
WAITING_OF_ADDRESS = 96  # a browser keeps six; a gateway may stand for a whole workshop
ALL_OF_ADDRESS = 320
HEADERS_S = 10.0  # for a whole request, from the beginning of the connection or of the wait for the next one
ANSWER_S = 600.0  # for an answer that its receiver does not take
LEAVE_S = 5.0  # for the last bytes of one that is being closed, which a receiver may never take
SPARES = 12  # a connection, and what a stop opens besides: the register of people
RESCUE_S = 2.0  # for so long the spare descriptors stay given up
LOG_EVERY_S = 1.0
_LIMITS_S = {"new": HEADERS_S, "waiting": HEADERS_S, "busy": ANSWER_S, "leaving": LEAVE_S}
_REASONS = {
    "new": "it sent no whole request in time",
    "waiting": "it sent no whole request in time",
    "busy": "it did not take its answer in time",
    "leaving": "it did not take its last bytes in time",
}
_OUT_OF = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})


class AbortableTransport(Protocol):
    """The part of a transport that is needed here."""

    def abort(self) -> None: ...
    def is_closing(self) -> bool: ...
    def get_extra_info(self, name: str, default: Any = None) -> Any: ...


@dataclass(eq=False, slots=True)
class ServerConnection:
    """One connection. ``state``: new (no request yet), waiting (for the next one), busy, screen (WebSocket), leaving.

    One that is leaving was closed by this side, and has a descriptor until its last bytes are taken.
    """

    address: str
    transport: AbortableTransport
    since_s: float
    state: str = "new"


@dataclass
class ServerConnections:
    """All connections of a server."""

    most: int
    clock: Callable[[], float] = time.monotonic
    closed: int = 0  # by us, since the service began
    _open: dict[int, ServerConnection] = field(default_factory=dict)
    _spares: list[int] = field(default_factory=list)
    _rescue_until_s: float = float("-inf")
    _logged_at_s: float = float("-inf")
    _unlogged: int = 0

    def __len__(self) -> int:
        """Return how many are open."""
        return len(self._open)

    def add_connection(self, address: str, transport: AbortableTransport) -> ServerConnection:
        """Take note of a new connection; older ones are closed where there are too many."""
        self._forget_closed()
        made = ServerConnection(address, transport, self.clock())
        self._open[id(made)] = made
        self._make_room(made)
        return made

    def set_state(self, connection: ServerConnection, state: str) -> None:
        """Take note of what a connection does now."""
        connection.state, connection.since_s = state, self.clock()

    def remove_connection(self, connection: ServerConnection) -> None:
        """Forget a connection."""
        self._open.pop(id(connection), None)

    def close_stale(self) -> None:
        """Close what has waited too long; take the spare descriptors back."""
        self._forget_closed()
        now_s = self.clock()
        for connection in list(self._open.values()):
            limit_s = _LIMITS_S.get(connection.state)
            if limit_s is not None and now_s - connection.since_s > limit_s:
                self._close_connection(connection, _REASONS[connection.state])
        if now_s > self._rescue_until_s:
            self.open_spares()

    def open_spares(self) -> None:
        """Open the spare descriptors, as many as there are to be had."""
        with contextlib.suppress(OSError):
            while len(self._spares) < SPARES:
                self._spares.append(os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC))

    def release_spares(self) -> None:
        """Give the spare descriptors up."""
        while self._spares:
            os.close(self._spares.pop())

    def on_accept_error(self, error: OSError) -> bool:
        """Take note that a connection could not be accepted; return whether to try again at once."""
        self._log_rarely(f"a connection could not be accepted: {error.strerror}")
        if error.errno not in _OUT_OF:
            return False
        self._rescue_until_s = self.clock() + RESCUE_S
        had = bool(self._spares)
        self.release_spares()
        closed = [
            self._close_connection(each, "descriptors ran out")
            for each in self._closable_connections()[:SPARES]
        ]
        return had or bool(closed)

    def _make_room(self, made: ServerConnection) -> None:
        of_address = [each for each in self._open.values() if each.address == made.address]
        waiting = [each for each in of_address if each.state in ("new", "waiting")]
        if len(waiting) > WAITING_OF_ADDRESS or len(of_address) > ALL_OF_ADDRESS:
            self._close_first(of_address, made, "too many of its address")
        if len(self._open) > self.most:
            counts = Counter(each.address for each in self._open.values())
            most = max(counts.values())
            self._close_first(
                [each for each in self._open.values() if counts[each.address] == most],
                made,
                "too many in all",
            )

    def _close_first(self, of: list[ServerConnection], made: ServerConnection, why: str) -> None:
        order = sorted(of, key=_close_rank)
        self._close_connection(next((each for each in order if each is not made), made), why)

    def _closable_connections(self) -> list[ServerConnection]:
        return sorted(
            (each for each in self._open.values() if each.state in ("leaving", "new", "waiting")),
            key=_close_rank,
        )

    def _close_connection(self, connection: ServerConnection, why: str) -> ServerConnection:
        self.remove_connection(connection)
        connection.transport.abort()
        self.closed += 1
        self._log_rarely(f"a connection of {connection.address} was closed: {why}")
        return connection

    def _forget_closed(self) -> None:
        for key, each in list(self._open.items()):
            if not each.transport.is_closing():
                continue
            if not _has_descriptor(each.transport):
                del self._open[key]
            elif each.state != "leaving":
                self.set_state(each, "leaving")

    def _log_rarely(self, words: str) -> None:
        """Log at most once a second: a flood must not fill the disk as well."""
        now_s = self.clock()
        if now_s - self._logged_at_s < LOG_EVERY_S:
            self._unlogged += 1
            return
        more = f" ({self._unlogged} more like it)" if self._unlogged else ""
        _log.warning("%s%s", words, more)
        self._logged_at_s, self._unlogged = now_s, 0


def most_connections() -> int:
    """Return how many connections the descriptors of this process allow, with room for everything else."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return max(16, min(2000, soft * 6 // 10))


def _close_rank(connection: ServerConnection) -> tuple[int, float]:
    order = ("leaving", "new", "waiting", "screen", "busy")
    return order.index(connection.state), connection.since_s


def _has_descriptor(transport: AbortableTransport) -> bool:
    line = transport.get_extra_info("socket")
    return line is not None and line.fileno() >= 0
