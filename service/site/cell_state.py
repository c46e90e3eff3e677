"""The state of a cell as the site sees it: one message, whole, so that the newest one is enough."""

from datetime import date
from pathlib import Path

from cellcal.calibration.message import make_message
from cellcal.calibration.message_table import MESSAGES, with_messages
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.drift_schedule import DriftReminder
from cellcal.service.session_documents import RunDocument, SessionDocument
from cellcal.service.site.alarms import CellAlarm
from cellcal.service.site.authority import valid_until
from cellcal.service.site.ledger import SiteLedger


class DueDates:
    """The due dates of a cell: calibrations, its certificate where it is on a bus, and drift checks.

    Drift checks move on whenever one was run; the rest stands as it was at the start.
    """

    def __init__(self, config: CellConfig, link_certificate: Path | None = None) -> None:
        self._fixed = [
            {
                "what": make_message("calibration of {device_name}", device_name=entry.device.name),
                "due": entry.setup.certificate.due.isoformat(),
            }
            for entry in config.instrument_entries
            if entry.setup.certificate is not None
        ]
        if link_certificate is not None:
            ends = valid_until(link_certificate).date()
            self._fixed.append({"what": "certificate on the bus", "due": ends.isoformat()})
        self._reminder = DriftReminder(config)

    def due_items(self, now_s: float) -> list[dict[str, str]]:
        """Return what and when, the first one first."""
        return sorted([*self._fixed, *self._reminder.list_due(now_s)], key=lambda item: item["due"])


def overdue_items(due: list[dict[str, str]], today: date) -> list[dict[str, str]]:
    """Return what is past its date."""
    return [item for item in due if date.fromisoformat(item["due"]) < today]


def state_of(
    config: CellConfig,
    session: SessionDocument | None,
    ledger: SiteLedger,
    alarms: list[CellAlarm],
    due: list[dict[str, str]],
) -> dict[str, object]:
    """Return the body of the state message, without what the outbox holds."""
    run, prompt = (None, None) if session is None else (session["run"], session["prompt"])
    state: dict[str, object] = {
        "cell": config.cell.name,
        "robots": [
            {"name": robot.name, "model": robot.model, "serial": robot.serial} for robot in config.robots
        ],
        "attended": session is not None,  # whether the service of this cell runs
        "connection": None if session is None else session["connection"],
        "robot": None if session is None else session["robot"],
        "level": None if session is None else session["level"],
        "run": None if run is None else _run_summary(run),
        "asks": None if prompt is None else {"key": prompt["key"], "step": prompt["step"]},
        "alarms": [alarm.as_json() for alarm in alarms],
        "certificate": ledger.certificate,
        "drift": list(ledger.drift),
        "due": due,
        "journal": {"head": ledger.head, "hash": ledger.head_hash},
        MESSAGES: {},  # this cell sends templates and arguments
    }
    found: dict[str, object] = with_messages(state)
    return found


def _run_summary(run: RunDocument) -> dict[str, object]:
    outcome = run["outcome"]
    return {
        "id": run["id"],
        "procedure": run["procedure"],
        "title": run["title"],
        "state": run["state"],
        "step": run["step"],
        "index": run["index"],
        "expected": run["expected"],
        "verdict": None if outcome is None else outcome["verdict"],
    }
