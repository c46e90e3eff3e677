"""One run as an MCAP file, for Foxglove, Lichtblick and other readers of robot logs: an extra, ``cellcal[mcap]``.

Three channels of JSON: ``/run`` (what it is), ``/events`` (the journal, event by event) and ``/readings`` (what was
measured, also what was not used). Times are those of the journal: this computer's clock, in milliseconds.
"""

import importlib
import io
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CellError
from cellcal.service.certificates.points import list_readings
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.files import SHARED_FILE, replace_file
from cellcal.service.record.journal import JournalEvent
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_store import RunStore, RunView
from cellcal.service.times import read_time

_TEXT, _NUMBER, _ANYTHING = {"type": "string"}, {"type": "number"}, dict[str, str]()
_SCHEMAS: Mapping[str, Mapping[str, Any]] = {
    "run": {"run_id": _TEXT, "procedure": _TEXT, "state": _TEXT, "spec": _ANYTHING, "cell": _ANYTHING},
    "events": {"seq": _NUMBER, "idx": _NUMBER, "kind": _TEXT, "actor": _TEXT, "body": _ANYTHING},
    "readings": {"step": _TEXT, "used": {"type": "boolean"}, "reason": _TEXT, "value": _ANYTHING},
}


def write_mcap(config: CellConfig, run_id: str, out: Path) -> int:
    """Write a run (``last`` is the newest) and return how many messages it gave.

    Raises
    ------
    CellError
        There is no such run, or the extra is not installed.
    """
    writer_module = _import_mcap()
    with open_journal(config) as journal:
        view, events = RunStore(journal).with_events(run_id)
    content = io.BytesIO()
    count = _write_run(writer_module, content, view, events)
    replace_file(out, content.getvalue(), mode=SHARED_FILE)
    return count


def _write_run(module: Any, out: io.BytesIO, view: RunView, events: list[JournalEvent]) -> int:
    count = 0
    writer = module.Writer(out)
    writer.start(profile="", library="cellcal")
    channels = {name: _add_channel(writer, name) for name in _SCHEMAS}
    for name, time_ns, message in sorted(_run_messages(view, events), key=lambda entry: entry[1]):
        data = json.dumps(message, allow_nan=False, ensure_ascii=False).encode()
        writer.add_message(channels[name], log_time=time_ns, publish_time=time_ns, data=data, sequence=count)
        count += 1
    writer.add_metadata("cellcal", {"run_id": view.run_id, "journal_head": events[-1].hash.hex()})
    writer.finish()
    return count


def _add_channel(writer: Any, name: str) -> int:
    schema = {"type": "object", "properties": _SCHEMAS[name]}
    schema_id = writer.register_schema(f"cellcal.{name}", "jsonschema", json.dumps(schema).encode())
    channel: int = writer.register_channel(f"/{name}", "json", schema_id)
    return channel


def _run_messages(view: RunView, events: list[JournalEvent]) -> Iterator[tuple[str, int, dict[str, object]]]:
    head = {key: getattr(view, key) for key in ("run_id", "procedure", "state")}
    yield "run", _to_nanoseconds(view.started_utc), {**head, "spec": view.spec, "cell": view.cell}
    for event in events:
        fields = {"seq": event.seq, "idx": event.idx, "kind": event.kind, "actor": event.actor}
        yield "events", _to_nanoseconds(event.wall_utc), {**fields, "body": parse_json(event.body)}
    for taken in list_readings(events, view.judgement):
        message = {key: taken.get(key) for key in ("step", "used", "reason", "value")}
        yield "readings", _to_nanoseconds(taken["at_utc"]), message


def _to_nanoseconds(wall_utc: str) -> int:
    return round(read_time(wall_utc).timestamp() * 1000) * 1_000_000


def _import_mcap() -> Any:
    try:
        return importlib.import_module("mcap.writer")  # an extra: most who calibrate never need it
    except ImportError as error:
        raise CellError(
            "writing MCAP needs the library mcap, which is not installed.",
            remedy='Install the extra: pip install "cellcal[mcap]" (mcap 1.6.0). CSV and XLSX need none.',
            code="missing_extra",
        ) from error
