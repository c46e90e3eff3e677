"""What a monitor has received: events as they were signed, each once, and which are missing.

A file that is lost costs nothing but time: cells keep their outboxes, and are asked again.
"""

import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from cellcal.calibration.message import make_message
from cellcal.service.files import create_private_file, make_private_folder
from cellcal.service.record.database_setup import prepare_database
from cellcal.service.site.keys import SiteError
from cellcal.service.site.signed_messages import SignedMessage

_SCHEMA = (
    "CREATE TABLE IF NOT EXISTS event(station TEXT NOT NULL, epoch TEXT NOT NULL, seq INTEGER NOT NULL,"
    " key TEXT NOT NULL, wall TEXT NOT NULL, message BLOB NOT NULL,"
    " journal_seq INTEGER, prev TEXT, hash TEXT, PRIMARY KEY(station, epoch, seq)) STRICT",
    "CREATE INDEX IF NOT EXISTS by_journal ON event(station, journal_seq)",
    "CREATE TABLE IF NOT EXISTS reach(station TEXT NOT NULL, epoch TEXT NOT NULL, upto INTEGER NOT NULL,"
    " known INTEGER NOT NULL, lost INTEGER NOT NULL, PRIMARY KEY(station, epoch)) STRICT",
)
_PRAGMAS = (
    "PRAGMA busy_timeout=5000",
    "PRAGMA journal_mode=WAL",
    "PRAGMA synchronous=NORMAL",
    "PRAGMA trusted_schema=OFF",
)
_INSERT = "INSERT INTO event VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?)"


def is_store_fault(error: Exception) -> bool:
    """Whether the file, the disk or another program is at fault, and not what a cell said."""
    if isinstance(error, sqlite3.OperationalError | sqlite3.InternalError):
        return True
    return type(error) is sqlite3.DatabaseError  # "file is not a database", "disk image is malformed"


@dataclass(frozen=True, slots=True)
class ReceivedEvent:
    """An event whose signature was checked, with the bytes that were signed."""

    message: SignedMessage
    raw: bytes


@dataclass(frozen=True, slots=True)
class EventReach:
    """The reach of a station's events here: all up to ``upto``; ``existing`` exist; ``lost`` are gone for good."""

    upto: int = 0
    existing: int = 0
    lost: int = 0

    @property
    def missing_count(self) -> int:
        """The largest number behind the first gap."""
        return max(self.existing - self.upto, 0)


_IN_MEMORY = ":memory:"  # SQLite's name of a database without a file


class SiteStore:
    """One monitor's file. Used by one thread at a time."""

    def __init__(self, path: Path) -> None:
        try:
            make_private_folder(path.parent)
            if path.name != _IN_MEMORY:
                create_private_file(path)
            self._database = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
            prepare_database(self._database, (*_PRAGMAS, *_SCHEMA))
        except (OSError, sqlite3.Error) as error:
            raise SiteError(
                make_message("the monitor's store {path} cannot be used: {error}.", path=path, error=error),
                remedy="Name another with --store, or move it away: cells are asked again.",
                code="store",
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        self._database.close()

    def add_events(self, received: Sequence[ReceivedEvent]) -> list[str]:
        """Keep events, each once; return sentences about what contradicts what is here."""
        flaws: list[str] = []
        self._database.execute("BEGIN IMMEDIATE")
        try:
            for each in received:
                flaws += self._insert_event(each)
            for station, epoch in {(each.message.station, each.message.epoch) for each in received}:
                self._advance_reach(station, epoch)
            self._database.execute("COMMIT")
        except BaseException:
            self._database.execute("ROLLBACK")
            raise
        return flaws

    def event_reach(self, station: str, epoch: str) -> EventReach:
        """Return how far a station's events of one outbox are here."""
        sql = "SELECT upto, known, lost FROM reach WHERE station = ? AND epoch = ?"
        row = self._database.execute(sql, (station, epoch)).fetchone()
        return EventReach() if row is None else EventReach(*row)

    def update_reach(self, station: str, epoch: str, first: int, last: int) -> EventReach:
        """Take note of what a station has; what it no longer has is lost to us, and counted."""
        reach = self.event_reach(station, epoch)
        if reach.existing >= last and first <= reach.upto + 1:
            return reach
        gone = max(0, first - 1 - reach.upto)
        stored = self._count_events(station, epoch, reach.upto + 1, first - 1) if gone else 0
        upto = max(reach.upto, first - 1)
        self._store_reach(
            station, epoch, EventReach(upto, max(reach.existing, last), reach.lost + gone - stored)
        )
        self._advance_reach(station, epoch)
        return self.event_reach(station, epoch)

    def newest_events(self, station: str, most: int = 100) -> list[bytes]:
        """Return a station's newest events as they were signed, newest first."""
        sql = "SELECT message FROM event WHERE station = ? ORDER BY epoch DESC, seq DESC LIMIT ?"
        return [row[0] for row in self._database.execute(sql, (station, most)).fetchall()]

    def event_numbers(self, station: str) -> list[int]:
        """Return the numbers of a station's events, in order."""
        sql = "SELECT seq FROM event WHERE station = ? ORDER BY epoch, seq"
        return [row[0] for row in self._database.execute(sql, (station,)).fetchall()]

    def _insert_event(self, each: ReceivedEvent) -> list[str]:
        message = each.message
        place = (message.station, message.epoch, message.seq)
        sql = "SELECT message FROM event WHERE station = ? AND epoch = ? AND seq = ?"
        stored = self._database.execute(sql, place).fetchone()
        if stored is not None:
            if stored[0] == each.raw:
                return []
            return [
                make_message(
                    "tells another event under the number {seq} of an earlier one: its outbox was restored "
                    "from a copy. Move site_outbox.sqlite away at the cell.",
                    seq=message.seq,
                )
            ]
        link = _journal_link(message.body)
        flaws = self._chain_flaws(message.station, *link)
        self._database.execute(_INSERT, (*place, message.key, message.wall, each.raw, *link))
        return flaws

    def _chain_flaws(self, station: str, seq: int | None, prev: str | None, own: str | None) -> list[str]:
        """Compare with its neighbours in the cell's journal: who rewrites a journal contradicts what is here."""
        if seq is None:
            return []
        sql = "SELECT journal_seq, prev, hash FROM event WHERE station = ? AND journal_seq BETWEEN ? AND ?"
        for other, before, hashed in self._database.execute(sql, (station, seq - 1, seq + 1)).fetchall():
            agrees = {seq - 1: hashed == prev, seq: hashed == own, seq + 1: before == own}[other]
            if not agrees:
                return [
                    make_message(
                        "event {seq} of its journal does not follow from what it told before: it was rewritten.",
                        seq=seq,
                    )
                ]
        return []

    def _advance_reach(self, station: str, epoch: str) -> None:
        reach = self.event_reach(station, epoch)
        upto = reach.upto
        sql = "SELECT seq FROM event WHERE station = ? AND epoch = ? AND seq > ? ORDER BY seq"
        for (seq,) in self._database.execute(sql, (station, epoch, upto)):
            if seq != upto + 1:
                break
            upto = seq
        highest = self._database.execute(
            "SELECT max(seq) FROM event WHERE station = ? AND epoch = ?", (station, epoch)
        ).fetchone()[0]
        self._store_reach(station, epoch, EventReach(upto, max(reach.existing, highest or 0), reach.lost))

    def _store_reach(self, station: str, epoch: str, reach: EventReach) -> None:
        row = (station, epoch, reach.upto, reach.existing, reach.lost)
        self._database.execute("INSERT OR REPLACE INTO reach VALUES(?, ?, ?, ?, ?)", row)

    def _count_events(self, station: str, epoch: str, first: int, last: int) -> int:
        sql = "SELECT count(*) FROM event WHERE station = ? AND epoch = ? AND seq BETWEEN ? AND ?"
        return int(self._database.execute(sql, (station, epoch, first, last)).fetchone()[0])


def _journal_link(body: Any) -> tuple[int | None, str | None, str | None]:
    if not isinstance(body, dict) or not isinstance(body.get("journal_seq"), int):
        return None, None, None
    return body["journal_seq"], str(body.get("prev")), str(body.get("hash"))
