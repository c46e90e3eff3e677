"""When each robot's next drift check is due: some days after the last one that ended well, as the journal has it."""

import sqlite3
from collections.abc import Mapping
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message import make_message
from cellcal.procedures.run_history import EventKind
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.journal import EVENT_COLUMNS, JournalEvent
from cellcal.service.record.journal_files import journal_path
from cellcal.service.record.journal_reading import journal_to_read

PROCEDURE = "drift_check"
_RUNS = f"SELECT {EVENT_COLUMNS} FROM event WHERE run_id GLOB '{PROCEDURE}-*' AND kind IN (?, ?) ORDER BY seq"


def next_drift_checks(config: CellConfig, today: date | None = None) -> dict[str, date]:
    """Return the date of each robot's next drift check by the robot's name; empty where the cell file wants none.

    A robot that was never checked is to be checked today, and so is one whose last check is of a day to come: a clock
    stood wrong then or stands wrong now, and no reading tells since when.

    Raises
    ------
    sqlite3.Error
        The journal is there and cannot be read.
    """
    days = config.watch.drift_check_days
    if days is None:
        return {}
    checked = _last_checks(journal_path(config))
    now = today or datetime.now(UTC).date()
    return {
        robot.name: last + timedelta(days) if (last := checked.get(robot.serial)) and last <= now else now
        for robot in config.robots
    }


def _last_checks(journal: Path) -> Mapping[str, date]:
    """Return on which day each robot, by its serial number, was checked last; a check that found drift is one too."""
    database = journal_to_read(journal)
    if database is None:
        return {}
    try:
        rows = database.execute(_RUNS, (EventKind.STARTED, EventKind.ENDED)).fetchall()
    finally:
        database.close()
    serials: dict[str, str] = {}
    checked: dict[str, date] = {}
    for event in (JournalEvent(*row) for row in rows):
        if event.hash != event.expected_hash():
            break  # what stands behind damage is not trusted anywhere; others tell it
        body: dict[str, Any] = parse_json(event.body)
        if event.kind == EventKind.STARTED:
            serials[event.run_id] = body["cell"]["devices"][0]["identity"]["serial"]
        elif body["verdict"] == "passed" and event.run_id in serials:
            checked[serials[event.run_id]] = date.fromisoformat(event.wall_utc[:10])
    return checked


class DriftReminder:
    """The drift checks that are due, read again now and then: others ask many times a second."""

    EVERY_S = 10.0

    def __init__(self, config: CellConfig) -> None:
        self._config = config
        self._read_at_s = float("-inf")
        self._due: list[dict[str, str]] = []

    def list_due(self, now_s: float) -> list[dict[str, str]]:
        """Return what and when; as it was read last while the journal cannot be read, which others tell."""
        if now_s - self._read_at_s >= self.EVERY_S:
            self._read_at_s = now_s
            try:
                found = next_drift_checks(self._config)
            except sqlite3.Error:
                return self._due
            self._due = [
                {"what": make_message("drift check of {name}", name=name), "due": day.isoformat()}
                for name, day in found.items()
            ]
        return self._due
