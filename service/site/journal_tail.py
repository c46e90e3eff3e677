"""Follows a cell's journal, read only: the writing process is not disturbed."""

import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypedDict

from cellcal.calibration.message import make_message
from cellcal.service.record.journal import EVENT_COLUMNS, JournalEvent
from cellcal.service.record.journal_reading import journal_to_read

LONGEST_BODY = 1_000_000


class JournalTail:
    """The events appended since the last read. A journal that is not there yet has no events."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._database: sqlite3.Connection | None = None
        self.trouble = ""

    def events_after(self, seq: int, most: int = 500) -> list[JournalEvent]:
        """Return the next events behind one that are as they were written; ``trouble`` says why others are not."""
        try:
            database = self._open_database()
            if database is None:
                return []
            sql = f"SELECT {EVENT_COLUMNS} FROM event WHERE seq > ? ORDER BY seq LIMIT ?"
            rows = database.execute(sql, (seq, most)).fetchall()
        except sqlite3.Error as error:
            self.trouble = make_message("the journal cannot be read: {error}", error=error)
            self.close()
            return []
        events = [JournalEvent(*row) for row in rows]
        damage = next((event.seq for event in events if event.hash != event.expected_hash()), None)
        self.trouble = "" if damage is None else _damage_text(damage)
        return [event for event in events if damage is None or event.seq < damage]

    def close(self) -> None:
        """Let go of the file; the next look opens it again."""
        if self._database is not None:
            self._database.close()
            self._database = None

    def _open_database(self) -> sqlite3.Connection | None:
        if self._database is None:
            self._database = journal_to_read(self._path)
        return self._database


def _damage_text(seq: int) -> str:
    return make_message(
        "the journal is damaged after event {after_seq}: {damage_reason}",
        after_seq=seq - 1,
        damage_reason=make_message("event {number} is not what was written", number=seq),
    )


class EventBody(TypedDict):
    """A journal event as the bus carries it: all that its hash covers; hashes as hexadecimal digits.

    ``body`` is None where the text is too long for a message.
    """

    journal_seq: int
    run_id: str
    idx: int
    kind: str
    idem: str | None
    body: str | None
    body_bytes: int
    wall_utc: str
    mono_ns: int
    boot_id: str
    actor: str
    prev: str
    hash: str


def event_to_json(event: JournalEvent) -> EventBody:
    """Return an event for the site: all that its hash covers, so that the chain can be checked there too.

    A body that is too long for a message is left out and named; the run's certificate carries what counts of it.
    """
    whole = len(event.body) <= LONGEST_BODY
    return {
        "journal_seq": event.seq,
        "run_id": event.run_id,
        "idx": event.idx,
        "kind": event.kind,
        "idem": event.idem,
        "body": event.body if whole else None,
        "body_bytes": len(event.body.encode()),
        "wall_utc": event.wall_utc,
        "mono_ns": event.mono_ns,
        "boot_id": event.boot_id,
        "actor": event.actor,
        "prev": event.prev.hex(),
        "hash": event.hash.hex(),
    }


def chain_flaw(body: Mapping[str, Any]) -> str:
    """Return what is wrong with an event as the site got it; nothing where its hash covers it."""
    text = body.get("body")
    if text is None:
        return ""
    event = JournalEvent(
        seq=body["journal_seq"],
        run_id=body["run_id"],
        idx=body["idx"],
        kind=body["kind"],
        idem=body["idem"],
        body=text,
        wall_utc=body["wall_utc"],
        mono_ns=body["mono_ns"],
        boot_id=body["boot_id"],
        actor=body["actor"],
        prev=bytes.fromhex(body["prev"]),
        hash=bytes.fromhex(body["hash"]),
    )
    return (
        ""
        if event.hash == event.expected_hash()
        else make_message("event {seq} is not what its hash says", seq=event.seq)
    )
