"""The outbox: every event that the site should have, numbered and signed, for as long as it takes to be asked for.

A short loss of the link is mended from the publisher's memory. After hours the site asks for what it misses by
number: rows stay here whatever the link does. Numbers begin at 1 and have no holes.
"""

import fcntl
import itertools
import os
import secrets
import sqlite3
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from cellcal.service.files import create_private_file, make_private_folder
from cellcal.service.record.database_setup import DURABLE, prepare_database
from cellcal.service.record.journal_reading import read_only
from cellcal.service.site.keys import SiteError

OUTBOX_NAME = "site_outbox.sqlite"
KEPT_ROWS = 200_000
_LIVE_BITS = 40  # room for live messages between two starts
_SCHEMA = (
    "CREATE TABLE IF NOT EXISTS outbox(seq INTEGER PRIMARY KEY, key TEXT NOT NULL, journal_seq INTEGER UNIQUE,"
    " message BLOB NOT NULL) STRICT",
    "CREATE TABLE IF NOT EXISTS counter(epoch TEXT NOT NULL, starts INTEGER NOT NULL) STRICT",
)


@dataclass(frozen=True, slots=True)
class UnsentEvent:
    """An event without its number yet. ``journal_seq`` keeps one of the journal from being sent under two."""

    key: str
    seal: Callable[[int], bytes]  # from its number to the signed message
    journal_seq: int | None = None


@dataclass(frozen=True, slots=True)
class SentEvent:
    """A numbered, signed event."""

    seq: int
    key: str
    message: bytes


class SiteOutbox:
    """One cell's outbox. Only one process may hold it: two would give the same numbers to different events."""

    def __init__(self, data_dir: Path, *, kept_rows: int = KEPT_ROWS) -> None:
        make_private_folder(data_dir)
        self.path = data_dir / OUTBOX_NAME
        self._kept_rows = kept_rows
        self._lock = _lock_file(self.path)
        try:
            create_private_file(self.path)
            self._database = sqlite3.connect(self.path, isolation_level=None)
            prepare_database(self._database, (*DURABLE, *_SCHEMA))
            self.epoch, self._starts = self._begin_epoch()
        except sqlite3.Error as error:
            os.close(self._lock)
            raise SiteError(
                f"the outbox {self.path} cannot be used: {error}.",
                remedy="Free the disk, or move the file away: a new one is begun from the journal.",
                code="store",
            ) from error
        self._live = itertools.count((self._starts << _LIVE_BITS) + 1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        self._database.close()
        os.close(self._lock)

    def add_events(self, events: Sequence[UnsentEvent]) -> list[SentEvent]:
        """Keep events, numbered and signed, all or none; one of the journal that is here already is left out.

        Raises
        ------
        SiteError
            The disk is full or failing.
        """
        try:
            return self._insert_events(events)
        except sqlite3.Error as error:
            raise SiteError(
                f"the outbox {self.path} cannot be written: {error}.", remedy="Free the disk.", code="store"
            ) from error

    def _insert_events(self, events: Sequence[UnsentEvent]) -> list[SentEvent]:
        sent: list[SentEvent] = []
        self._database.execute("BEGIN IMMEDIATE")
        try:
            last = self.number_bounds()[1]
            for event in events:
                if event.journal_seq is not None and self._has_journal_seq(event.journal_seq):
                    continue
                last += 1
                sent.append(SentEvent(last, event.key, event.seal(last)))
                row = (last, event.key, event.journal_seq, sent[-1].message)
                self._database.execute("INSERT INTO outbox VALUES(?, ?, ?, ?)", row)
            self._database.execute("DELETE FROM outbox WHERE seq <= ?", (last - self._kept_rows,))
            self._database.execute("COMMIT")
        except BaseException:
            self._database.execute("ROLLBACK")
            raise
        return sent

    def number_bounds(self) -> tuple[int, int]:
        """Return the first and last number that are kept; (1, 0) while it is empty."""
        first, last = self._database.execute("SELECT min(seq), max(seq) FROM outbox").fetchone()
        return (1, 0) if last is None else (first, last)

    def last_journal_seq(self) -> int:
        """Return the last event of the journal that is here."""
        found = self._database.execute("SELECT max(journal_seq) FROM outbox").fetchone()[0]
        return int(found or 0)

    def next_live(self) -> int:
        """Return a number for a message that is not kept: higher than any before, also of an earlier start."""
        return next(self._live)  # from any thread

    def _has_journal_seq(self, journal_seq: int) -> bool:
        sql = "SELECT 1 FROM outbox WHERE journal_seq = ?"
        return self._database.execute(sql, (journal_seq,)).fetchone() is not None

    def _begin_epoch(self) -> tuple[str, int]:
        row = self._database.execute("SELECT epoch, starts FROM counter").fetchone()
        if row is None:
            epoch = f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}-{secrets.token_hex(3)}"
            self._database.execute("INSERT INTO counter VALUES(?, 1)", (epoch,))
            return epoch, 1
        self._database.execute("UPDATE counter SET starts = starts + 1")
        return str(row[0]), int(row[1]) + 1


def rows_between(path: Path, first: int, most: int) -> list[SentEvent]:
    """Return kept events from a number on; read only, from any thread."""
    database = read_only(path)
    try:
        sql = "SELECT seq, key, message FROM outbox WHERE seq >= ? ORDER BY seq LIMIT ?"
        return [SentEvent(*row) for row in database.execute(sql, (first, most)).fetchall()]
    finally:
        database.close()


def _lock_file(path: Path) -> int:
    descriptor = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise SiteError(
            "another process already tells the site of this cell.",
            remedy="`cellcal serve` does it by itself; end it, or the other `cellcal site publish`.",
            code="busy",
        ) from error
    return descriptor
