"""What the journal says: runs, their findings and results, mastering records. Nothing is stored twice."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter

from calibration.mastering import MasteringRecord
from procedures.canonical import sha256_of
from procedures.past import Kind, Past, fold
from service.journal import Event, Journal, StoreError

RECORD = "mastering_record"
_RECORDS: TypeAdapter[MasteringRecord] = TypeAdapter(MasteringRecord)


@dataclass(frozen=True, slots=True)
class RunView:
    """One run, folded from its events."""

    run_id: str
    procedure: str
    version: int
    spec: Any
    cell: Mapping[str, Any]
    started_utc: str
    state: str  # a verdict, or "interrupted" while no end is journalled
    reason: str
    result: Any
    past: Past


class Store:
    """Reads a journal; writes only what somebody brings in from outside."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal

    def runs(self) -> list[RunView]:
        """Return every run, oldest first."""
        grouped: dict[str, list[Event]] = {}
        for event in self._journal.events():
            grouped.setdefault(event.run_id, []).append(event)
        return [_view(events) for events in grouped.values() if events[0].kind == Kind.STARTED]

    def run(self, run_id: str) -> RunView:
        """Return one run.

        Raises
        ------
        StoreError
            There is no such run.
        """
        events = self._journal.events(run_id)
        if not events or events[0].kind != Kind.STARTED:
            raise StoreError(
                f"there is no run {run_id!r}", code="store.no_such_run", remedy="See `cellcal runs`."
            )
        return _view(events)

    def kept(self, what: str, robot_serial: str) -> list[Mapping[str, Any]]:
        """Return every kept result of one kind for one robot, oldest first."""
        facts = [json.loads(event.body) for event in self._journal.events() if event.kind == Kind.STORED]
        return [fact for fact in facts if (fact["what"], fact["robot_serial"]) == (what, robot_serial)]

    def mastering_record(self, robot_serial: str) -> MasteringRecord | None:
        """Return the latest mastering record of a robot; None when none was ever taken."""
        facts = self.kept(RECORD, robot_serial)
        return _RECORDS.validate_python(facts[-1]["value"]) if facts else None

    def put_mastering_record(self, record: MasteringRecord, *, actor: str) -> None:
        """Take in a record that was exported elsewhere."""
        value = _RECORDS.dump_python(record, mode="json")
        body = stored_body(RECORD, record.robot_serial, record.robot_serial, value)
        self._journal.append(f"import-{body['sha256'][:12]}", Kind.STORED, body, key="record", actor=actor)

    @staticmethod
    def export_json(record: MasteringRecord) -> str:
        """Return a mastering record as a text file: sorted, indented, exact numbers."""
        return json.dumps(
            _RECORDS.dump_python(record, mode="json"), sort_keys=True, indent=2, allow_nan=False
        )

    @staticmethod
    def import_json(text: str) -> MasteringRecord:
        """Read what ``export_json`` wrote."""
        return _RECORDS.validate_json(text)


def stored_body(what: str, subject: str, robot_serial: str, value: Any) -> dict[str, Any]:
    """Return the body of a STORED event."""
    return {
        "what": what,
        "subject": subject,
        "robot_serial": robot_serial,
        "value": value,
        "sha256": sha256_of(value),
    }


def _view(events: list[Event]) -> RunView:
    bodies = [(event.kind, json.loads(event.body)) for event in events]
    header = bodies[0][1]
    ended: Mapping[str, Any] = {}
    for kind, body in bodies:
        if kind == Kind.ENDED:
            ended = body
        elif kind in (Kind.RESUMED, Kind.FORGOTTEN):
            ended = {}
    return RunView(
        run_id=events[0].run_id,
        procedure=header["procedure"],
        version=header["version"],
        spec=header["spec"],
        cell=header["cell"],
        started_utc=events[0].wall_utc,
        state=ended.get("verdict", "interrupted"),
        reason=ended.get("reason", ""),
        result=ended.get("result"),
        past=fold(bodies),
    )
