"""What a cell tells a Prometheus server: how it stands, what its runs ended with, what is due. No names, no keys.

The newest messages of the cell process come from the service; of the journal only what was added is read, on request.
"""

import logging
import os
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.supervision import SUPERVISOR, TroubleDocument
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.export.exposition import MetricFamily, render_text
from cellcal.service.session_documents import DeviceDocument, EventContent, LiveDocument, SessionDocument
from cellcal.service.times import read_time

if TYPE_CHECKING:
    from cellcal.service.site.ledger import DriftEntry

_LOG = logging.getLogger(__name__)
CONTROLLER_SILENT_S = 5.0
_BATCH = 500


@dataclass
class _RunCounts:
    """Runs of the journal by procedure and outcome: a run that is resumed changes its own."""

    head: int = 0
    runs: dict[str, tuple[str, str]] = field(default_factory=dict)
    certificates: dict[tuple[str, str], tuple[str, str]] = field(default_factory=dict)
    drifts: dict[str, "DriftEntry"] = field(default_factory=dict)


class CellMetrics:
    """The figures of one cell. ``on_event`` is called by the service's loop, ``render_metrics`` by any thread."""

    def __init__(self, config: CellConfig, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._config, self._clock = config, clock
        self._session: SessionDocument | None = None
        self._live: LiveDocument | None = None
        self._last_received_at_s = float("-inf")
        self._counted = _RunCounts()
        self._ledger: Any = None
        self._reading = threading.Lock()
        self._reminder: Any = None
        self._version = installed_version(
            "cellcal"
        )  # of a file: a state is told also without a free descriptor

    def on_event(self, kind: str, content: EventContent) -> None:
        """Take a message of the cell process."""
        if kind == "session":
            self._session = cast(SessionDocument, content)
        elif kind == "live":
            self._live = cast(LiveDocument, content)
        elif kind == "gone":
            self._session = self._live = None
        self._last_received_at_s = self._clock()

    def render_metrics(self) -> str:
        """Return all figures in Prometheus' text format."""
        with self._reading:
            return render_text(
                _all_readable(
                    {
                        "state": self._state_metrics,
                        "history": self._history_metrics,
                        "due": self._due_metrics,
                        "webhook": self._webhook_metrics,
                        "process": _process_metrics,
                    }
                )
            )

    def _state_metrics(self) -> Iterator[MetricFamily]:
        from cellcal.service.site.alarms import list_alarms  # noqa: PLC0415  not while the service starts

        session, live = self._session, self._live
        is_current = session is not None and self._clock() - self._last_received_at_s <= CONTROLLER_SILENT_S
        if not is_current:
            session = live = None
        labels = {"cell": self._config.cell.name, "version": self._version}
        yield MetricFamily("cellcal_info", "gauge", "What this is; always 1.").add_sample(1, labels)
        yield MetricFamily(
            "cellcal_desk_up", "gauge", "Whether messages of the cell process arrive."
        ).add_sample(is_current)
        connected = bool(session and session["connection"]["connected"])
        yield MetricFamily(
            "cellcal_cell_up", "gauge", "Whether the cell's devices are connected."
        ).add_sample(connected)
        run = None if session is None else session["run"]
        active = run is not None and run["state"] != "ended"
        yield MetricFamily("cellcal_run_active", "gauge", "Whether a run is under way.").add_sample(active)
        asks = session is not None and session["prompt"] is not None
        yield MetricFamily("cellcal_waits_for_person", "gauge", "Whether a question is open.").add_sample(
            asks
        )
        alarms = MetricFamily("cellcal_alarms", "gauge", "Alarms that are up, by code.")
        for alarm in list_alarms(session, live):
            key = (("code", alarm.code),)
            alarms.samples[key] = alarms.samples.get(key, 0.0) + 1.0
        yield alarms if alarms.samples else alarms.add_sample(0, {"code": "any"})
        yield from _device_metrics([] if live is None else live["devices"])
        yield from _task_metrics([] if session is None else session["troubles"])

    def _read_on(self) -> bool:
        from cellcal.service.record.journal_files import journal_path  # noqa: PLC0415  heavy: not while the service starts
        from cellcal.service.site.journal_tail import JournalTail  # noqa: PLC0415  as above
        from cellcal.service.site.ledger import SiteLedger  # noqa: PLC0415  as above

        self._ledger = self._ledger or SiteLedger()
        with closing(JournalTail(journal_path(self._config))) as tail:  # SQLite's are of one thread
            while events := tail.events_after(self._counted.head, _BATCH):
                for event in events:
                    self._count_event(event)
            return not tail.trouble

    def _count_event(self, event: Any) -> None:
        self._ledger.take_event(event)
        counted = self._counted
        counted.head = event.seq
        run = self._ledger.find_run(event.run_id)
        if run is None:
            return
        counted.runs[event.run_id] = (run.procedure, run.state)
        certificate = self._ledger.certificate
        if certificate is not None and certificate["run_id"] == event.run_id:
            place = (certificate["robot_serial"], certificate["procedure"])
            counted.certificates[place] = (certificate["word"], certificate["ended_utc"])
        if self._ledger.drift and self._ledger.drift[-1]["run_id"] == event.run_id:
            counted.drifts[self._ledger.drift[-1]["robot_serial"]] = self._ledger.drift[-1]

    def _history_metrics(self) -> Iterator[MetricFamily]:
        from cellcal.service.record.journal_files import lease_folder  # noqa: PLC0415  heavy: not while the service starts
        from cellcal.service.record.robot_lock import runs_under_way, state_seen  # noqa: PLC0415  as above

        readable = self._read_on()
        counted = self._counted
        yield MetricFamily(
            "cellcal_journal_readable", "gauge", "Whether the journal can be read."
        ).add_sample(readable)
        yield MetricFamily("cellcal_journal_events_total", "counter", "Events in the journal.").add_sample(
            counted.head
        )
        runs = MetricFamily("cellcal_runs", "gauge", "Runs in the journal, by how they stand or ended.")
        under_way = runs_under_way(lease_folder(self._config))
        for run_id, (procedure, state) in counted.runs.items():
            key = (("outcome", state_seen(state, run_id, under_way)), ("procedure", procedure))
            runs.samples[key] = runs.samples.get(key, 0.0) + 1.0
        yield runs
        yield from self._certificate_metrics()
        rms = MetricFamily("cellcal_drift_change_rms_meters", "gauge", "RMS change at the last drift check.")
        most = MetricFamily(
            "cellcal_drift_change_max_meters", "gauge", "Largest change at the last drift check."
        )
        checked = MetricFamily(
            "cellcal_drift_check_timestamp_seconds", "gauge", "When the last drift check ended."
        )
        for serial, drift in counted.drifts.items():
            rms.add_sample(_finite_figure(drift["change_rms_m"]), {"robot_serial": serial})
            most.add_sample(_finite_figure(drift["change_max_m"]), {"robot_serial": serial})
            checked.add_sample(_epoch_seconds(drift["ended_utc"]), {"robot_serial": serial})
        yield from (rms, most, checked)

    def _certificate_metrics(self) -> Iterator[MetricFamily]:
        made = MetricFamily(
            "cellcal_certificate_timestamp_seconds", "gauge", "End of the last certified run."
        )
        age = MetricFamily(
            "cellcal_certificate_age_seconds", "gauge", "How long ago that was, by this computer's clock."
        )
        now_s = time.time()
        for (serial, procedure), (word, ended_utc) in self._counted.certificates.items():
            labels = {"robot_serial": serial, "procedure": procedure, "word": word}
            ended_s = _epoch_seconds(ended_utc)
            made.add_sample(ended_s, labels)
            age.add_sample(None if ended_s is None else now_s - ended_s, labels)
        yield from (made, age)

    def _due_metrics(self) -> Iterator[MetricFamily]:
        due = MetricFamily(
            "cellcal_due_timestamp_seconds",
            "gauge",
            "Until when a calibration holds, or when a drift check is due: the end of that day.",
        )
        for gauge in self._config.gauges:
            if gauge.setup.certificate is not None:
                due.add_sample(
                    _end_of(gauge.setup.certificate.due),
                    {"what": make_message("calibration of {device_name}", device_name=gauge.device.name)},
                )
        if self._reminder is None:
            from cellcal.service.record.drift_schedule import DriftReminder  # noqa: PLC0415  not while the service starts

            self._reminder = DriftReminder(self._config)
        for item in self._reminder.list_due(self._clock()):
            due.add_sample(_end_of(date.fromisoformat(item["due"])), {"what": item["what"]})
        yield due

    def _webhook_metrics(self) -> Iterator[MetricFamily]:
        from cellcal.service.export.webhook_outbox import WebhookOutbox  # noqa: PLC0415  not while the service starts

        if self._config.reports.webhook is None:
            return
        try:
            with WebhookOutbox(self._config.cell.data_dir) as outbox:
                standing = outbox.delivery_state()
        except (CellError, sqlite3.Error):
            return  # the sender says why; all other figures stand
        waiting = MetricFamily("cellcal_webhook_waiting", "gauge", "Alarms that wait for their receiver.")
        yield waiting.add_sample(standing.waiting)
        refused = MetricFamily(
            "cellcal_webhook_refused", "gauge", "Alarms that the receiver did not understand."
        )
        yield refused.add_sample(standing.refused)
        sent = MetricFamily("cellcal_webhook_delivered_total", "counter", "Alarms that the receiver took.")
        yield sent.add_sample(standing.delivered)


def _all_readable(groups: Mapping[str, Callable[[], Iterator[MetricFamily]]]) -> list[MetricFamily]:
    """Return the figures of all groups; one that cannot be read now is left out and named, and hides no other.

    Without a free descriptor even an import fails, with ImportError.
    """
    unreadable = MetricFamily(
        "cellcal_figures_unreadable", "gauge", "Figures that cannot be read now; 1 each."
    )
    families = []
    for name, group in groups.items():
        try:
            families += list(group())
        except (OSError, ImportError, CellError, sqlite3.Error) as error:
            unreadable.add_sample(1, {"group": name})
            _LOG.warning("figures of %s cannot be read: %s", name, error)
    return [*families, unreadable]


def _task_metrics(of_the_cell: list[TroubleDocument]) -> Iterator[MetricFamily]:
    failing = MetricFamily("cellcal_task_failing", "gauge", "Long-lived tasks that fail just now; 1 each.")
    for trouble in [*(trouble.to_json() for trouble in SUPERVISOR.list_troubles()), *of_the_cell]:
        failing.samples[(("task", trouble["task"]),)] = float(not trouble["running"])
    yield failing if failing.samples else failing.add_sample(0, {"task": "any"})
    failed = MetricFamily("cellcal_task_failures_total", "counter", "Failures of tasks of the web process.")
    counts = SUPERVISOR.failure_counts()
    yield failed.add_sample(sum(counts.values()), {"task": "any"})


def _device_metrics(devices: list[DeviceDocument]) -> Iterator[MetricFamily]:
    ready = MetricFamily("cellcal_device_ready", "gauge", "Whether a device is ready.")
    state = MetricFamily("cellcal_device_state", "gauge", "The state of a device; always 1.")
    age = MetricFamily(
        "cellcal_device_value_age_seconds", "gauge", "How old the newest value of a device is."
    )
    for device in devices:
        labels = {"device": device["name"], "role": device["role"]}
        ready.add_sample(device["state"] == "ready", labels)
        state.add_sample(1, labels | {"state": device["state"]})
        age.add_sample(_finite_figure(device["value_age_s"]), labels)
    yield from (ready, state, age)


def _process_metrics() -> Iterator[MetricFamily]:
    """Yield the usual figures of a process, as far as this system tells them."""
    times = os.times()
    spent = MetricFamily("process_cpu_seconds_total", "counter", "Processor time of the web process.")
    yield spent.add_sample(times.user + times.system)
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
    started = MetricFamily("process_start_time_seconds", "gauge", "When the web process began.")
    yield started.add_sample(int(booted.split()[1]) + int(fields[19]) / ticks)
    yield MetricFamily("process_resident_memory_bytes", "gauge", "Its memory.").add_sample(
        int(fields[21]) * page
    )
    yield MetricFamily("process_open_fds", "gauge", "Its open files.").add_sample(files)


def _finite_figure(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _epoch_seconds(wall_utc: str) -> float | None:
    try:
        return read_time(wall_utc).timestamp()
    except (ValueError, TypeError):
        return None


def _end_of(day: date) -> float:
    return datetime(day.year, day.month, day.day, tzinfo=UTC).timestamp() + 86400.0
