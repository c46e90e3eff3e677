"""Results that runs kept for a robot, read from the journal."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cellcal.calibration.documents.json_text import parse_json
from cellcal.service.configuration.cell_file import CellConfig


@dataclass(frozen=True, slots=True)
class JournalledResult:
    """A result that outlived its run."""

    run_id: str
    what: str
    subject: str
    at_utc: str
    value: Mapping[str, Any]


def newest_stored_result(config: CellConfig, serial: str, what: str) -> JournalledResult | None:
    """Return the newest result of one kind that was kept for a robot."""
    found = [result for result in list_stored_results(config, serial) if result.what == what]
    return found[-1] if found else None


def list_stored_results(config: CellConfig, serial: str) -> list[JournalledResult]:
    """Return every result that was kept for a robot, oldest first."""
    from cellcal.procedures.run_history import EventKind  # noqa: PLC0415  # heavy: not at the start of the service
    from cellcal.service.record.journal_files import open_journal  # noqa: PLC0415  # heavy, as above

    with open_journal(config) as journal:
        events = [event for event in journal.list_events() if event.kind == EventKind.STORED]
    bodies = [(event, parse_json(event.body)) for event in events]
    return [
        JournalledResult(event.run_id, body["what"], str(body["subject"]), event.wall_utc, body["value"])
        for event, body in bodies
        if body["robot_serial"] == serial
    ]
