"""What a cell tells a Prometheus server: how it stands, what its runs ended with, what is due. No names, no keys.

The desk's newest words come in from the service; the journal is read on when somebody asks, only what was added.
"""

import os
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

from cellcal.calibration.errors import CellError
from cellcal.drivers.supervision import SUPERVISOR
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.export.exposition import Family, rendered
from cellcal.service.times import read_time

DESK_SILENT_S = 5.0
_BATCH = 500


@dataclass
class _Counted:
    """Runs of the journal by procedure and outcome: a run that is resumed changes its own."""

    head: int = 0
    runs: dict[str, tuple[str, str]] = field(default_factory=dict)
    certificates: dict[tuple[str, str], tuple[str, str]] = field(default_factory=dict)
    drifts: dict[str, dict[str, Any]] = field(default_factory=dict)


class Meter:
    """Knows the figures of one cell. ``heard`` is called by the service's loop, ``text`` by any thread."""

    def __init__(self, config: CellConfig, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._config, self._clock = config, clock
        self._session: dict[str, Any] | None = None
        self._live: dict[str, Any] | None = None
        self._heard_at_s = float("-inf")
        self._counted = _Counted()
        self._ledger: Any = None
        self._reading = threading.Lock()
        self._reminder: Any = None

    def heard(self, kind: str, content: dict[str, Any]) -> None:
        """Take what the desk said."""
        if kind == "session":
            self._session = content
        elif kind == "live":
            self._live = content
        elif kind == "gone":
            self._session = self._live = None
        self._heard_at_s = self._clock()

    def text(self) -> str:
        """Return all figures in Prometheus' text format."""
        with self._reading:
            readable = self._read_on()
            return rendered(
                [*self._standing(), *self._history(readable), *self._due(), *self._webhook(), *_process()]
            )

    def _standing(self) -> Iterator[Family]:
        from cellcal.service.site.alarms import wrong_in  # noqa: PLC0415  not while the service starts

        session, live = self._session, self._live
        told = session is not None and self._clock() - self._heard_at_s <= DESK_SILENT_S
        if not told:
            session = live = None
        labels = {"cell": self._config.cell.name, "version": installed_version("cellcal")}
        yield Family("cellcal_info", "gauge", "What this is; always 1.").add(1, labels)
        yield Family("cellcal_desk_up", "gauge", "Whether the cell's desk is heard.").add(told)
        connected = bool(session and session["connection"]["connected"])
        yield Family("cellcal_cell_up", "gauge", "Whether the cell's devices are connected.").add(connected)
        run = (session or {}).get("run") or {}
        active = run.get("state") not in (None, "ended")
        yield Family("cellcal_run_active", "gauge", "Whether a run is under way.").add(active)
        asks = bool((session or {}).get("prompt"))
        yield Family("cellcal_waits_for_person", "gauge", "Whether a question is open.").add(asks)
        alarms = Family("cellcal_alarms", "gauge", "Alarms that are up, by code.")
        for alarm in wrong_in(session, live):
            key = (("code", alarm.code),)
            alarms.samples[key] = alarms.samples.get(key, 0.0) + 1.0
        yield alarms if alarms.samples else alarms.add(0, {"code": "any"})
        yield from _devices((live or {}).get("devices", []))
        yield from _tasks((session or {}).get("troubles", []))

    def _read_on(self) -> bool:
        from cellcal.service.record.journal_files import journal_path  # noqa: PLC0415  heavy: not while the service starts
        from cellcal.service.site.journal_tail import JournalTail  # noqa: PLC0415  as above
        from cellcal.service.site.ledger import Ledger  # noqa: PLC0415  as above

        self._ledger = self._ledger or Ledger()
        with closing(JournalTail(journal_path(self._config))) as tail:  # SQLite's are of one thread
            while events := tail.after(self._counted.head, _BATCH):
                for event in events:
                    self._take(event)
            return not tail.trouble

    def _take(self, event: Any) -> None:
        self._ledger.take(event)
        counted = self._counted
        counted.head = event.seq
        run = self._ledger.run(event.run_id)
        if run is None:
            return
        counted.runs[event.run_id] = (run.procedure, run.state)
        certificate = self._ledger.certificate
        if certificate is not None and certificate["run_id"] == event.run_id:
            place = (certificate["robot_serial"], certificate["procedure"])
            counted.certificates[place] = (certificate["word"], certificate["ended_utc"])
        if self._ledger.drift and self._ledger.drift[-1]["run_id"] == event.run_id:
            counted.drifts[self._ledger.drift[-1]["robot_serial"]] = self._ledger.drift[-1]

    def _history(self, readable: bool) -> Iterator[Family]:
        counted = self._counted
        yield Family("cellcal_journal_readable", "gauge", "Whether the journal can be read.").add(readable)
        yield Family("cellcal_journal_events_total", "counter", "Events in the journal.").add(counted.head)
        runs = Family("cellcal_runs", "gauge", "Runs in the journal, by how they stand or ended.")
        for procedure, state in counted.runs.values():
            key = (("outcome", state), ("procedure", procedure))
            runs.samples[key] = runs.samples.get(key, 0.0) + 1.0
        yield runs
        yield from self._certificates()
        rms = Family("cellcal_drift_change_rms_meters", "gauge", "RMS change at the last drift check.")
        most = Family("cellcal_drift_change_max_meters", "gauge", "Largest change at the last drift check.")
        checked = Family("cellcal_drift_check_timestamp_seconds", "gauge", "When the last drift check ended.")
        for serial, drift in counted.drifts.items():
            rms.add(_figure(drift["change_rms_m"]), {"robot_serial": serial})
            most.add(_figure(drift["change_max_m"]), {"robot_serial": serial})
            checked.add(_seconds(drift["ended_utc"]), {"robot_serial": serial})
        yield from (rms, most, checked)

    def _certificates(self) -> Iterator[Family]:
        made = Family("cellcal_certificate_timestamp_seconds", "gauge", "End of the last certified run.")
        age = Family(
            "cellcal_certificate_age_seconds", "gauge", "How long ago that was, by this computer's clock."
        )
        now_s = time.time()
        for (serial, procedure), (word, ended_utc) in self._counted.certificates.items():
            labels = {"robot_serial": serial, "procedure": procedure, "word": word}
            ended_s = _seconds(ended_utc)
            made.add(ended_s, labels)
            age.add(None if ended_s is None else now_s - ended_s, labels)
        yield from (made, age)

    def _due(self) -> Iterator[Family]:
        due = Family(
            "cellcal_due_timestamp_seconds",
            "gauge",
            "Until when a calibration holds, or when a drift check is due: the end of that day.",
        )
        for gauge in self._config.gauges:
            if gauge.setup.certificate is not None:
                due.add(_end_of(gauge.setup.certificate.due), {"what": f"calibration of {gauge.device.name}"})
        if self._reminder is None:
            from cellcal.service.record.drift_schedule import Reminder  # noqa: PLC0415  not while the service starts

            self._reminder = Reminder(self._config)
        for told in self._reminder.due(self._clock()):
            due.add(_end_of(date.fromisoformat(told["due"])), {"what": told["what"]})
        yield due

    def _webhook(self) -> Iterator[Family]:
        from cellcal.service.export.webhook_outbox import WebhookOutbox  # noqa: PLC0415  not while the service starts

        if self._config.reports.webhook is None:
            return
        try:
            with WebhookOutbox(self._config.cell.data_dir) as outbox:
                standing = outbox.standing()
        except (CellError, sqlite3.Error):
            return  # the sender says why; all other figures stand
        waiting = Family("cellcal_webhook_waiting", "gauge", "Alarms that wait for their receiver.")
        yield waiting.add(standing.waiting)
        refused = Family("cellcal_webhook_refused", "gauge", "Alarms that the receiver did not understand.")
        yield refused.add(standing.refused)
        sent = Family("cellcal_webhook_delivered_total", "counter", "Alarms that the receiver took.")
        yield sent.add(standing.delivered)


def _tasks(of_the_cell: list[dict[str, Any]]) -> Iterator[Family]:
    failing = Family("cellcal_task_failing", "gauge", "Long-lived tasks that fail just now; 1 each.")
    for trouble in [*(trouble.as_json() for trouble in SUPERVISOR.troubles()), *of_the_cell]:
        failing.samples[(("task", trouble["task"]),)] = float(not trouble["running"])
    yield failing if failing.samples else failing.add(0, {"task": "any"})
    failed = Family("cellcal_task_failures_total", "counter", "Failures of tasks of the web process.")
    counts = SUPERVISOR.failures()
    yield failed.add(sum(counts.values()), {"task": "any"})


def _devices(devices: list[dict[str, Any]]) -> Iterator[Family]:
    ready = Family("cellcal_device_ready", "gauge", "Whether a device is ready.")
    state = Family("cellcal_device_state", "gauge", "The state of a device; always 1.")
    age = Family("cellcal_device_value_age_seconds", "gauge", "How old the newest value of a device is.")
    for device in devices:
        labels = {"device": device["name"], "role": device["role"]}
        ready.add(device["state"] == "ready", labels)
        state.add(1, labels | {"state": device["state"]})
        age.add(_figure(device["value_age_s"]), labels)
    yield from (ready, state, age)


def _process() -> Iterator[Family]:
    """Yield the usual figures of a process, as far as this system tells them."""
    times = os.times()
    spent = Family("process_cpu_seconds_total", "counter", "Processor time of the web process.")
    yield spent.add(times.user + times.system)
    folder = Path("/proc/self")
    try:
        fields = (folder / "stat").read_text().rpartition(")")[2].split()
        ticks, page = os.sysconf("SC_CLK_TCK"), os.sysconf("SC_PAGE_SIZE")
        booted = next(
            line for line in Path("/proc/stat").read_text().splitlines() if line.startswith("btime")
        )
        files = len(list((folder / "fd").iterdir()))
    except (OSError, StopIteration):
        return
    started = Family("process_start_time_seconds", "gauge", "When the web process began.")
    yield started.add(int(booted.split()[1]) + int(fields[19]) / ticks)
    yield Family("process_resident_memory_bytes", "gauge", "Its memory.").add(int(fields[21]) * page)
    yield Family("process_open_fds", "gauge", "Its open files.").add(files)


def _figure(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _seconds(wall_utc: str) -> float | None:
    try:
        return read_time(wall_utc).timestamp()
    except (ValueError, TypeError):
        return None


def _end_of(day: date) -> float:
    return datetime(day.year, day.month, day.day, tzinfo=UTC).timestamp() + 86400.0
