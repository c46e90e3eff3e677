"""Publishes one cell to the site: follows its journal, read only, and its cell process; a process of its own.

Messages of the cell process come in on standard input, a JSON line each as it writes them: the service that runs the
cell process passes them on (`service/site/forwarding_process.py`). So no sign-in is needed, no port is opened, and no
page or run waits: the pipe is written without waiting, and what does not fit is left out. Without a cell process only
the journal is published.

Whatever fails here, the cell goes on: nothing reads what this process writes, but the site.
"""

import logging
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import zenoh

from cellcal.calibration.message_table import with_messages
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.record.journal import JournalEvent
from cellcal.service.record.journal_files import journal_path, lease_folder
from cellcal.service.record.signing import station_key
from cellcal.service.session_documents import DeviceDocument
from cellcal.service.site.alarms import CellAlarm
from cellcal.service.site.answers import CellAnswers
from cellcal.service.site.cell_alarms import CellAlarmWatch
from cellcal.service.site.cell_state import DueDates, state_of
from cellcal.service.site.controller_tap import ControllerTap
from cellcal.service.site.journal_tail import JournalTail, event_to_json
from cellcal.service.site.keys import SiteError, StationKeys
from cellcal.service.site.ledger import SiteLedger
from cellcal.service.site.link_files import CELL_FILE, read_link_folder, read_station
from cellcal.service.site.outbox import SentEvent, SiteOutbox, UnsentEvent
from cellcal.service.site.signed_messages import MessageSigner
from cellcal.service.site.station import Station
from cellcal.service.unexpected_errors import log_in_lines, run_guarded

_LOG = logging.getLogger(__name__)
PERIOD_S = 0.1
STATE_EVERY_S = 1.0
JOURNAL_EVERY_S = 0.2
DEVICE_STATE_EVERY_S = 10.0
CERTIFICATES = "certificates"  # as certificates/certificate.py keeps them; to import it takes seconds


@dataclass(frozen=True, slots=True)
class PublisherParts:
    """The parts of the publisher."""

    config: CellConfig
    keys: StationKeys
    sealer: MessageSigner
    outbox: SiteOutbox
    tap: ControllerTap
    due: DueDates


class SitePublisher:
    """One turn of the loop at a time; `publish` below runs it."""

    def __init__(
        self, parts: PublisherParts, ledger: SiteLedger, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._parts, self._ledger, self._clock = parts, ledger, clock
        self._tail = JournalTail(journal_path(parts.config))
        self._troubles = CellAlarmWatch(parts.config, parts.tap, parts.due)
        self._state_at_s = self._journal_at_s = float("-inf")
        self._shown: Any = None
        self._live_seen: Any = None
        self._devices: dict[str, tuple[float, Any]] = {}

    def catch_up(self) -> None:
        """Read the whole journal, and put into the outbox what is not there: the site will ask for it."""
        outbox, last_seq = self._parts.outbox, self._parts.outbox.last_journal_seq()
        while events := self._tail.events_after(self._ledger.head):
            for event in events:
                self._ledger.take_event(event)
            outbox.add_events([self._of_journal(event) for event in events if event.seq > last_seq])

    def publish_changes(self, station: Station) -> None:
        """Tell what is new."""
        now_s = self._clock()
        for sent in [*self._new_events(now_s), *self._new_alarms(now_s)]:
            station.publish_event(sent)
        self._publish_live(station, now_s)
        self._publish_state(station, now_s)

    def close(self) -> None:
        """Let go of the journal."""
        self._tail.close()

    def _new_events(self, now_s: float) -> list[SentEvent]:
        if now_s - self._journal_at_s < JOURNAL_EVERY_S:
            return []
        self._journal_at_s = now_s
        events = self._tail.events_after(self._ledger.head)
        for event in events:
            self._ledger.take_event(event)
        return self._parts.outbox.add_events([self._of_journal(event) for event in events]) if events else []

    def _of_journal(self, event: JournalEvent) -> UnsentEvent:
        key = self._parts.keys.session_event(event.run_id)
        return UnsentEvent(
            key, lambda seq: self._parts.sealer.sign_message(key, seq, event_to_json(event)), event.seq
        )

    def _new_alarms(self, now_s: float) -> list[SentEvent]:
        changes = self._troubles.update_alarms(now_s, self._tail.trouble)
        return (
            self._parts.outbox.add_events([self._of_alarm(*change) for change in changes]) if changes else []
        )

    def _of_alarm(self, alarm: CellAlarm, raised: bool) -> UnsentEvent:
        key, body = self._parts.keys.alarm_key, with_messages(alarm.as_json() | {"active": raised})
        return UnsentEvent(key, lambda seq: self._parts.sealer.sign_message(key, seq, body))

    def _publish_live(self, station: Station, now_s: float) -> None:
        live = self._parts.tap.latest_live()
        if live is None or live is self._live_seen:
            return
        self._live_seen = live
        for device in live["devices"]:
            self._publish_device(station, device, now_s)

    def _publish_device(self, station: Station, device: DeviceDocument, now_s: float) -> None:
        keys, value = self._parts.keys, device["value"]
        facts = {key: device[key] for key in ("name", "role", "age_s")}
        if value is not None and device["role"] == "robot":
            station.publish_value(keys.joints_key, facts | value)
        elif value is not None and device["live"]:  # a reading of a tracker is told by the run that took it
            station.publish_value(keys.device_key(device["name"], "value"), facts | value)
        state = {key: device[key] for key in ("name", "role", "state", "message", "remedy")}
        told_at_s, before = self._devices.get(device["name"], (float("-inf"), None))
        if state != before or now_s - told_at_s > DEVICE_STATE_EVERY_S:
            self._devices[device["name"]] = (now_s, state)
            station.publish_latest(keys.device_key(device["name"], "state"), state)

    def _publish_state(self, station: Station, now_s: float) -> None:
        parts = self._parts
        body = state_of(
            parts.config,
            parts.tap.latest_session(),
            self._ledger,
            self._troubles.active_alarms,
            parts.due.due_items(now_s),
        )
        if body == self._shown and now_s - self._state_at_s < STATE_EVERY_S:
            return
        self._shown, self._state_at_s = body, now_s
        first, last = parts.outbox.number_bounds()
        station.publish_state(body | {"outbox": {"first": first, "last": last}})


def run_publisher(config: CellConfig, stream: BinaryIO | None, leave: threading.Event) -> None:
    """Publish a cell to the site until ``leave`` is set, or the stream of the cell process's messages ends.

    Raises
    ------
    SiteError
        The cell file names no site, its folder is not whole, or another process tells the site already.
    """
    folder = site_folder(config)
    link, who = read_link_folder(folder, CELL_FILE), read_station(folder)
    keys = StationKeys(who.site, who.cell)
    with SiteOutbox(config.cell.data_dir) as outbox:
        sealer = MessageSigner(station_key(config.cell.data_dir), who.cell, outbox.epoch)
        tap = ControllerTap(stream)
        parts = PublisherParts(config, keys, sealer, outbox, tap, DueDates(config, link.own_certificate))
        ledger = SiteLedger()
        publisher = SitePublisher(parts, ledger)
        certificates, leases = config.cell.data_dir / CERTIFICATES, lease_folder(config)
        answers = CellAnswers(journal_path(config), outbox.path, certificates, ledger, leases=leases)
        publisher.catch_up()
        try:
            with Station(_check_config(link.zenoh_config), keys, sealer, outbox, answers) as station:
                while not (leave.is_set() or tap.ended.is_set()):
                    publisher.publish_changes(station)
                    leave.wait(PERIOD_S)
        finally:
            publisher.close()


def site_folder(config: CellConfig) -> Path:
    """Return the folder that the cell was given for the bus.

    Raises
    ------
    SiteError
        The cell file has no ``[site]`` table.
    """
    if config.site is None:
        raise SiteError(
            f"{config.path} tells no site: it has no [site] table.",
            remedy='Add [site] with folder = "…", the folder that `cellcal site enroll` made for this cell.',
            code="usage",
        )
    return config.site.folder


def _check_config(make: Callable[[], zenoh.Config]) -> zenoh.Config:
    try:
        return make()
    except zenoh.ZError as error:
        raise SiteError(
            f"zenoh does not take the configuration: {error}.", remedy="Enrol the cell anew."
        ) from error


def main(path: str) -> None:
    """Tell the site until standard input ends."""
    log_in_lines("site: %(message)s")
    run_publisher(read_cell_file(path), sys.stdin.buffer, threading.Event())


if __name__ == "__main__":
    sys.exit(run_guarded(lambda: main(sys.argv[1])))
