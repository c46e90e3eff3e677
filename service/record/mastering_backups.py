"""What controllers held before a run wrote their mastering: folded from the journal, nothing is stored twice."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from cellcal.calibration.documents.json_text import parse_json
from cellcal.drivers.interfaces import MasteringData
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.cell import MasteringBackup
from cellcal.procedures.run_history import EventKind
from cellcal.service.record.journal import JournalEvent

WRITES = "write the mastering"  # the step of every procedure that does
_KEYS = {"counts_at_zero", "mastered"}


def mastering_backups(events: Iterable[JournalEvent], robot_serial: str) -> tuple[MasteringBackup, ...]:
    """Return one backup for each run of a robot that wrote, or may have written, a mastering, in that order.

    A run that put the old mastering back by itself has nothing to undo.
    """
    runs: dict[str, list[JournalEvent]] = {}
    for event in events:
        runs.setdefault(event.run_id, []).append(event)
    found = [backup for own in runs.values() for backup in _of_run(own, robot_serial)]
    return tuple(sorted(found, key=lambda backup: backup.at_utc))


def _of_run(events: list[JournalEvent], robot_serial: str) -> Iterator[MasteringBackup]:
    bodies = [(event, parse_json(event.body)) for event in events]
    if bodies[0][0].kind != EventKind.STARTED or serial_of(bodies[0][1]) != robot_serial:
        return
    place = next(
        (k for k, (e, body) in enumerate(bodies) if e.kind == EventKind.INTENT and body["step"] == WRITES),
        None,
    )
    before = None if place is None else mastering_before(bodies[:place])
    if place is None or before is None:
        return
    data, epoch = before
    written = [
        body["value"]
        for event, body in bodies[place:]
        if event.kind in (EventKind.FINDING, EventKind.UNDONE) and _is_mastering(body)
    ]
    if written and written[-1] == data:
        return
    event = bodies[place][0]
    mastering_data = MasteringData(tuple(data["counts_at_zero"]), data["mastered"])
    yield MasteringBackup(event.run_id, event.wall_utc, robot_serial, mastering_data, epoch, sha256_of(data))


def mastering_before(
    bodies: Sequence[tuple[JournalEvent, dict[str, Any]]],
) -> tuple[dict[str, Any], int] | None:
    """Return the mastering that was read last before the write, and the encoders' epoch."""
    for event, body in reversed(bodies):
        value = body.get("value")
        if event.kind != EventKind.FINDING or not isinstance(value, dict) or value.get("epoch") is None:
            continue
        if isinstance(value.get("mastering"), dict):
            return dict(value["mastering"]), value["epoch"]
        if value.get("counts_at_zero"):  # a robot that was measured by its own joints is mastered
            return {"counts_at_zero": value["counts_at_zero"], "mastered": True}, value["epoch"]
    return None


def _is_mastering(body: Mapping[str, Any]) -> bool:
    return isinstance(body["value"], dict) and body["value"].keys() == _KEYS


def serial_of(header: Mapping[str, Any]) -> str:
    """Return the serial number of the robot that a run's first event names."""
    devices = header["cell"]["devices"]
    return str(devices[0]["identity"]["serial"]) if devices else ""
