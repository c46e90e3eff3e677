"""Alarms that wait for their receiver, on disk: none is lost while it is away, and each has one id for ever.

What is up is kept beside what waits, in the same transaction: a sender that was started again neither says an alarm
twice nor forgets to say that it is over.
"""

import json
import sqlite3
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from cellcal.calibration.documents.json_text import parse_json
from cellcal.service.export.webhook_target import WebhookError
from cellcal.service.files import create_private_file, make_private_folder
from cellcal.service.record.database_setup import DURABLE, prepare_database
from cellcal.service.site.alarms import CellAlarm

OUTBOX_NAME = "webhook_outbox.sqlite"
KEPT_ROWS = 10_000
_SCHEMA = (
    "CREATE TABLE IF NOT EXISTS event(seq INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE,"
    " body BLOB NOT NULL, refusals INTEGER NOT NULL DEFAULT 0, refused TEXT) STRICT",
    "CREATE TABLE IF NOT EXISTS up(id TEXT PRIMARY KEY, alarm TEXT NOT NULL) STRICT",
    "CREATE TABLE IF NOT EXISTS tally(name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT",
)


@dataclass(frozen=True, slots=True)
class WaitingEvent:
    """An event that is to be delivered."""

    seq: int
    id: str
    body: bytes
    refusals: int


@dataclass(frozen=True, slots=True)
class DeliveryState:
    """The state of deliveries."""

    waiting: int
    delivered: int
    refused: int
    dropped: int
    last_error: str
    last_delivered_utc: str


class WebhookOutbox:
    """One connection; each thread opens its own."""

    def __init__(self, data_dir: Path, *, kept_rows: int = KEPT_ROWS) -> None:
        make_private_folder(data_dir)
        self.path, self._kept_rows = data_dir / OUTBOX_NAME, kept_rows
        try:
            create_private_file(self.path)
            self._database = sqlite3.connect(self.path, isolation_level=None)
            prepare_database(self._database, (*DURABLE, *_SCHEMA))
        except sqlite3.Error as error:
            raise WebhookError(
                f"the outbox {self.path} cannot be used: {error}.",
                remedy="Free the disk; or move the file away, with what waits in it.",
                code="store",
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._database.close()

    def active_alarms(self) -> list[CellAlarm]:
        """Return the alarms that were up at the last change."""
        rows = self._database.execute("SELECT alarm FROM up ORDER BY rowid").fetchall()
        return [CellAlarm(**parse_json(row[0])) for row in rows]

    def add_changes(self, cell: str, changes: Sequence[tuple[CellAlarm, bool]]) -> None:
        """Keep alarms that were raised or cleared, all or none."""
        with self._transaction():
            for alarm, raised in changes:
                self._insert_event(cell, alarm, raised=raised)

    def next_event(self) -> WaitingEvent | None:
        """Return the oldest event that is to be delivered."""
        sql = "SELECT seq, id, body, refusals FROM event WHERE refused IS NULL ORDER BY seq LIMIT 1"
        row = self._database.execute(sql).fetchone()
        return None if row is None else WaitingEvent(*row)

    def mark_delivered(self, event: WaitingEvent) -> None:
        """Forget an event that was taken."""
        with self._transaction():
            self._database.execute("DELETE FROM event WHERE seq = ?", (event.seq,))
            self._increment_count("delivered")
            self._store_note("last_delivered_utc", _utc_now())
            self._store_note("last_error", "")

    def note_failure(self, why: str) -> None:
        """Note why the newest attempt came to nothing."""
        with self._transaction():
            self._store_note("last_error", why)

    def mark_refused(self, event: WaitingEvent, why: str, *, at_last: bool) -> None:
        """Note that the receiver refused an event; at last it is set aside, so that later ones get through."""
        sql = "UPDATE event SET refusals = refusals + 1, refused = ? WHERE seq = ?"
        with self._transaction():
            self._database.execute(sql, (why if at_last else None, event.seq))
            self._store_note("last_error", why)

    def delivery_state(self) -> DeliveryState:
        """Return how many wait, and what became of the others."""
        tally = dict(self._database.execute("SELECT name, value FROM tally").fetchall())
        waiting, refused = self._database.execute(
            "SELECT count(*) FILTER (WHERE refused IS NULL), count(*) FILTER (WHERE refused IS NOT NULL) FROM event"
        ).fetchone()
        counted = {name: int(tally.get(name, "0")) for name in ("delivered", "dropped")}
        return DeliveryState(
            waiting, counted["delivered"], refused, counted["dropped"],
            tally.get("last_error", ""), tally.get("last_delivered_utc", ""),
        )  # fmt: skip

    def _insert_event(self, cell: str, alarm: CellAlarm, *, raised: bool) -> None:
        body = event_body("alarm.raised" if raised else "alarm.cleared", {"cell": cell, **alarm.as_json()})
        self._database.execute("INSERT INTO event(id, body) VALUES(?, ?)", (f"evt_{uuid.uuid4().hex}", body))
        if raised:
            fields = {name: getattr(alarm, name) for name in alarm.__slots__}
            self._database.execute(
                "INSERT OR REPLACE INTO up VALUES(?, ?)", (alarm.alarm_id, json.dumps(fields))
            )
        else:
            self._database.execute("DELETE FROM up WHERE id = ?", (alarm.alarm_id,))
        sql = "DELETE FROM event WHERE seq <= (SELECT max(seq) FROM event) - ?"
        for _ in range(self._database.execute(sql, (self._kept_rows,)).rowcount):
            self._increment_count("dropped")

    def _increment_count(self, name: str) -> None:
        sql = "INSERT INTO tally VALUES(?, '1') ON CONFLICT(name) DO UPDATE SET value = CAST(value AS INTEGER) + 1"
        self._database.execute(sql, (name,))

    def _store_note(self, name: str, value: str) -> None:
        self._database.execute("INSERT OR REPLACE INTO tally VALUES(?, ?)", (name, value))

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._database.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._database.execute("COMMIT")
        except BaseException:
            self._database.execute("ROLLBACK")
            raise


def event_body(kind: str, data: Mapping[str, object]) -> bytes:
    """Return the body of an event: {type, timestamp, data}."""
    return json.dumps({"type": kind, "timestamp": _utc_now(), "data": data}, allow_nan=False).encode()


def _utc_now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
