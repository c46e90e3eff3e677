"""The journal: append-only events in SQLite, durable when ``append`` returns, each chained to the one before.

State is a fold over events and nothing else is authoritative. The file is opened with WAL and
``synchronous=FULL``: an acknowledged event survives kill -9 and a power cut (tests/e2e/test_power_cut.py and
tests/e2e/test_kill_nine.py).
"""

import hashlib
import os
import sqlite3
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self
from uuid import NAMESPACE_URL, uuid5

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.calibration.message_table import MESSAGES
from cellcal.procedures.canonical_json import canonical_json
from cellcal.service.files import create_private_file, make_private_folder
from cellcal.service.record.database_setup import (
    SqlDatabase,
    find_foreign_rules,
    prepare_database,
    primary_code,
)

_GENESIS = bytes(32)
_BUSY_MS = 5000
# No CHECK(json_valid(body)): SQLite 3.40 refuses it while the schema is not trusted; canonical_json() and the
# hash say more.
_SCHEMA = """
CREATE TABLE IF NOT EXISTS event(
  seq INTEGER PRIMARY KEY, run_id TEXT NOT NULL, idx INTEGER NOT NULL, kind TEXT NOT NULL,
  idem TEXT UNIQUE,
  body TEXT NOT NULL,
  wall_utc TEXT NOT NULL, mono_ns INTEGER NOT NULL, boot_id TEXT NOT NULL,
  actor TEXT NOT NULL, prev BLOB NOT NULL, hash BLOB NOT NULL,
  UNIQUE(run_id, idx)) STRICT
"""
_PRAGMAS = (
    f"PRAGMA busy_timeout={_BUSY_MS}",
    "PRAGMA journal_mode=WAL",
    "PRAGMA synchronous=FULL",
    "PRAGMA foreign_keys=ON",
    "PRAGMA trusted_schema=OFF",
)
EVENT_COLUMNS = "seq, run_id, idx, kind, idem, body, wall_utc, mono_ns, boot_id, actor, prev, hash"


class StoreError(CellError):
    """The journal cannot store or read a fact; ``safe_points`` findings of the run are stored."""

    code = "store"

    def __init__(
        self, message: str, *, remedy: str = "", code: str | None = None, safe_points: int | None = None
    ) -> None:
        super().__init__(message, remedy=remedy, code=code)
        self.safe_points = safe_points


@dataclass(frozen=True, slots=True)
class NewEvent:
    """A fact to be stored. The same ``key`` in the same run is stored once."""

    kind: str
    body: Mapping[str, Any]
    key: str = ""


@dataclass(frozen=True, slots=True)
class JournalEvent:
    """One stored fact. ``body`` is the canonical JSON text; ``fact()`` of the store parses it."""

    seq: int
    run_id: str
    idx: int
    kind: str
    idem: str | None
    body: str
    wall_utc: str
    mono_ns: int
    boot_id: str
    actor: str
    prev: bytes
    hash: bytes

    def expected_hash(self) -> bytes:
        """Return sha256(prev, canonical row): what ``hash`` must be."""
        row = [self.seq, self.run_id, self.idx, self.kind, self.idem, self.body]
        row += [self.wall_utc, self.mono_ns, self.boot_id, self.actor]
        return hashlib.sha256(self.prev + canonical_json(row).encode()).digest()


@dataclass(frozen=True, slots=True)
class JournalDamage:
    """The place from which the journal is not trustworthy."""

    after_seq: int
    reason: str


def open_database(path: Path) -> SqlDatabase:
    """Connect in autocommit mode: transactions are written out in the journal itself."""
    return sqlite3.connect(path, isolation_level=None, timeout=_BUSY_MS / 1000)


class Journal:
    """Append-only events of one cell.

    A damaged journal opens read-only: ``damage`` says where the good prefix ends and only that is returned.
    After a failed write nothing more is accepted: a second fsync may report success over lost pages.
    """

    def __init__(self, path: Path, *, connect: Callable[[Path], SqlDatabase] = open_database) -> None:
        self.path = path
        self.damage: JournalDamage | None = None
        self._broken: StoreError | None = None
        self._boot_id = _boot_id()
        self._database = connect(path)
        self._file = _file_identity(path)
        try:
            prepare_database(self._database, (*_PRAGMAS, _SCHEMA))
            self.damage = self._find_damage()
        except sqlite3.DatabaseError as error:
            if primary_code(error) not in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
                raise StoreError(
                    make_message("the journal {path} cannot be opened: {error}", path=path, error=error),
                    code="store.io",
                ) from error
            self.damage = JournalDamage(0, make_message("not a readable database: {error}", error=error))

    @classmethod
    def open_file(cls, path: Path) -> Self:
        """Open or create the journal file and make its directory entry durable."""
        make_private_folder(path.parent)
        create_private_file(path)
        journal = cls(path)
        _sync_directory(path.parent)
        return journal

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; may be called twice."""
        self._database.close()

    def append(
        self, run_id: str, kind: str, body: Mapping[str, Any], *, key: str = "", actor: str = "service"
    ) -> JournalEvent:
        """Store one fact durably and return it; a ``key`` already used in the run returns the stored one."""
        return self.append_all(run_id, [NewEvent(kind, body, key)], actor=actor)[0]

    def append_all(
        self, run_id: str, events: Iterable[NewEvent], *, actor: str = "service"
    ) -> list[JournalEvent]:
        """Store several facts in one transaction: all or none.

        Raises
        ------
        StoreError
            A body holds NaN, a key was used for another fact, the disk is full or failing, or the journal
            is damaged.
        """
        prepared = [(event, _checked_body(event)) for event in events]
        self._refuse_if_broken()
        try:
            self._database.execute("BEGIN IMMEDIATE").fetchall()
            try:
                stored = [self._insert_event(run_id, event, body, actor) for event, body in prepared]
                self._database.execute("COMMIT").fetchall()
            except BaseException:
                self._roll_back()
                raise
        except sqlite3.Error as error:
            self._refuse_if_taken_away()
            raise self._store_error(run_id, error) from error
        self._refuse_if_taken_away()
        return stored

    def list_events(self, run_id: str | None = None) -> list[JournalEvent]:
        """Return the trustworthy events in order, of one run or of all."""
        limit = self.damage.after_seq if self.damage is not None else None
        where = ["1"] + ["run_id = ?"] * (run_id is not None) + ["seq <= ?"] * (limit is not None)
        values = [value for value in (run_id, limit) if value is not None]
        sql = f"SELECT {EVENT_COLUMNS} FROM event WHERE {' AND '.join(where)} ORDER BY seq"
        if limit == 0:
            return []
        return [JournalEvent(*row) for row in self._database.execute(sql, values).fetchall()]

    def head_hash(self) -> bytes:
        """Return the hash of the last event: printed on certificates, it also betrays a truncated journal."""
        return self._chain_tail()[1]

    def verify_chain(self) -> JournalDamage | None:
        """Check the whole chain; None when every event is as it was written."""
        last, prev = 0, _GENESIS
        try:
            for row in self._database.execute(f"SELECT {EVENT_COLUMNS} FROM event ORDER BY seq").fetchall():
                event = JournalEvent(*row)
                if event.seq != last + 1:
                    return JournalDamage(last, make_message("event {number} is missing", number=last + 1))
                if event.prev != prev or event.hash != event.expected_hash():
                    return JournalDamage(
                        last, make_message("event {number} is not what was written", number=event.seq)
                    )
                last, prev = event.seq, event.hash
        except sqlite3.DatabaseError as error:
            return JournalDamage(
                last, make_message("cannot be read after event {number}: {error}", number=last, error=error)
            )
        return None

    def _find_damage(self) -> JournalDamage | None:
        foreign = find_foreign_rules(self._database)
        if foreign:
            return JournalDamage(0, make_message("{foreign}, which no journal has", foreign=foreign))
        found = self._database.execute("PRAGMA quick_check").fetchall()
        chain = self.verify_chain()
        if chain is None and [tuple(row) for row in found] != [("ok",)]:
            return JournalDamage(
                self._chain_tail()[0], make_message("the file is damaged: {reason}", reason=found[0][0])
            )
        return chain

    def _insert_event(self, run_id: str, event: NewEvent, body: str, actor: str) -> JournalEvent:
        idem = str(uuid5(NAMESPACE_URL, f"{run_id}/{event.key}")) if event.key else None
        existing = self._find_stored(idem) if idem else None
        if existing is not None:
            if existing.kind != event.kind or not _is_same_fact(existing.body, body):
                raise StoreError(
                    make_message(
                        "the key {event_key!r} of this run already holds another fact", event_key=event.key
                    ),
                    code="store.conflict",
                    remedy="Two programs may be writing the same run: end one of them.",
                )
            return existing
        seq, prev = self._chain_tail()
        rows = self._database.execute("SELECT max(idx) FROM event WHERE run_id = ?", (run_id,)).fetchall()
        idx = 0 if rows[0][0] is None else rows[0][0] + 1
        clocks = (datetime.now(UTC).isoformat(timespec="milliseconds"), time.monotonic_ns(), self._boot_id)
        draft = JournalEvent(seq + 1, run_id, idx, event.kind, idem, body, *clocks, actor, prev, b"")
        row = replace(draft, hash=draft.expected_hash())
        marks = ", ".join("?" * 12)
        self._database.execute(
            f"INSERT INTO event({EVENT_COLUMNS}) VALUES({marks})", _row_values(row)
        ).fetchall()
        return row

    def _find_stored(self, idem: str) -> JournalEvent | None:
        rows = self._database.execute(f"SELECT {EVENT_COLUMNS} FROM event WHERE idem = ?", (idem,)).fetchall()
        return JournalEvent(*rows[0]) if rows else None

    def _chain_tail(self) -> tuple[int, bytes]:
        rows = self._database.execute("SELECT seq, hash FROM event ORDER BY seq DESC LIMIT 1").fetchall()
        return (rows[0][0], rows[0][1]) if rows else (0, _GENESIS)

    def _roll_back(self) -> None:
        try:
            self._database.execute("ROLLBACK").fetchall()
        except sqlite3.Error:
            return  # a full disk has already rolled back

    def _refuse_if_broken(self) -> None:
        if self._broken is not None:
            raise self._broken
        self.refuse_damaged()

    def _refuse_if_taken_away(self) -> None:
        """Refuse where the file was deleted, moved or replaced: SQLite goes on to write what is in no file."""
        if _file_identity(self.path) != self._file:
            self._broken = StoreError(
                "the journal was deleted, moved or replaced while it was open: what is found now is lost.",
                code="store.io",
                remedy="Put the data folder back, or restore a backup; then start anew.",
            )
            raise self._broken

    def refuse_damaged(self) -> None:
        """Refuse what a damaged journal cannot tell: the newest of anything may stand behind the damage.

        Raises
        ------
        StoreError
            It is damaged; the message says after which event.
        """
        if self.damage is not None:
            raise StoreError(
                make_message(
                    "the journal is damaged after event {after_seq}: {damage_reason}",
                    after_seq=self.damage.after_seq,
                    damage_reason=self.damage.reason,
                ),
                code="store.damaged",
                remedy="It is open for reading only. Export what is good, then restore a backup.",
            )

    def _store_error(self, run_id: str, error: sqlite3.Error) -> StoreError:
        if isinstance(error, sqlite3.IntegrityError) or primary_code(error) == sqlite3.SQLITE_BUSY:
            return StoreError(
                make_message("the journal is in use by another program: {error}", error=error),
                code="store.busy",
            )
        safe = self._safe_points(run_id)
        points = (
            "everything stored before is safe"
            if safe is None
            else make_message("your {count} points are safe", count=safe)
        )
        if primary_code(error) == sqlite3.SQLITE_FULL:
            text = make_message("disk full: nothing more can be saved, {points}.", points=points)
            code = "store.full"
        else:
            text = make_message("the disk refuses to store ({error}): {points}.", error=error, points=points)
            code = "store.io"
        self._broken = StoreError(
            text, code=code, remedy="Free or repair the disk, then resume.", safe_points=safe
        )
        return self._broken

    def _safe_points(self, run_id: str) -> int | None:
        sql = "SELECT count(*) FROM event WHERE run_id = ? AND kind = 'finding'"
        try:
            return int(self._database.execute(sql, (run_id,)).fetchall()[0][0])
        except sqlite3.Error:
            return None


def _file_identity(path: Path) -> tuple[int, int] | None:
    """Return which file a path names at present; None where there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _row_values(event: JournalEvent) -> tuple[Any, ...]:
    return (
        *(event.seq, event.run_id, event.idx, event.kind, event.idem, event.body),
        *(event.wall_utc, event.mono_ns, event.boot_id, event.actor, event.prev, event.hash),
    )


def _is_same_fact(stored: str, body: str) -> bool:
    """Whether two bodies say the same; templates and arguments beside the English texts do not count."""
    if stored == body:
        return True
    first, second = ({**parse_json(each), MESSAGES: None} for each in (stored, body))
    return first == second


def _checked_body(event: NewEvent) -> str:
    try:
        return canonical_json(event.body)
    except (ValueError, TypeError) as error:
        raise StoreError(
            make_message(
                "a {event_kind!r} event cannot be stored: {error}", event_kind=event.kind, error=error
            ),
            code="store.not_a_fact",
        ) from error


def _boot_id() -> str:
    path = Path("/proc/sys/kernel/random/boot_id")
    return read_plain_text(path).strip() if path.exists() else ""


def _sync_directory(directory: Path) -> None:
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
