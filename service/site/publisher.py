"""Tells the site of one cell: follows its journal, read only, and what its desk says; a process of its own.

The desk's words come in on standard input, a JSON line each as the desk itself writes them: the service that
keeps the desk passes them on (``feed.py``). That way nobody has to sign in, no port is opened, and no page or run
waits: the pipe is written without waiting, and what does not fit is left out. Without a desk the journal alone is
told.

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

from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.record.journal import Event
from cellcal.service.record.journal_files import journal_path
from cellcal.service.record.signing import station_key
from cellcal.service.site.alarms import Alarm
from cellcal.service.site.answers import Answers
from cellcal.service.site.desk_tap import DeskTap
from cellcal.service.site.journal_tail import JournalTail, told
from cellcal.service.site.keys import SiteError, StationKeys
from cellcal.service.site.ledger import Ledger
from cellcal.service.site.link_files import CELL_FILE, read_link_folder, read_station
from cellcal.service.site.outbox import Outbox, Sent, ToSend
from cellcal.service.site.sealed import Sealer
from cellcal.service.site.standing import DueDates, state_of
from cellcal.service.site.station import Station
from cellcal.service.site.troubles import Troubles
from cellcal.service.unexpected import log_in_lines, run_guarded

_LOG = logging.getLogger(__name__)
PERIOD_S = 0.1
STATE_EVERY_S = 1.0
JOURNAL_EVERY_S = 0.2
DEVICE_STATE_EVERY_S = 10.0
CERTIFICATES = "certificates"  # as certificates/certificate.py keeps them; to import it takes seconds


@dataclass(frozen=True, slots=True)
class Parts:
    """What the publisher works with."""

    config: CellConfig
    keys: StationKeys
    sealer: Sealer
    outbox: Outbox
    tap: DeskTap
    due: DueDates


class Publisher:
    """One turn of the loop at a time; `publish` below runs it."""

    def __init__(self, parts: Parts, ledger: Ledger, clock: Callable[[], float] = time.monotonic) -> None:
        self._parts, self._ledger, self._clock = parts, ledger, clock
        self._tail = JournalTail(journal_path(parts.config))
        self._troubles = Troubles(parts.config, parts.tap, parts.due)
        self._state_at_s = self._journal_at_s = float("-inf")
        self._shown: Any = None
        self._live_seen: Any = None
        self._devices: dict[str, tuple[float, Any]] = {}

    def catch_up(self) -> None:
        """Read the whole journal, and put into the outbox what is not there: the site will ask for it."""
        outbox, known = self._parts.outbox, self._parts.outbox.journalled()
        while events := self._tail.after(self._ledger.head):
            for event in events:
                self._ledger.take(event)
            outbox.add([self._of_journal(event) for event in events if event.seq > known])

    def turn(self, station: Station) -> None:
        """Tell what is new."""
        now_s = self._clock()
        for sent in [*self._new_events(now_s), *self._new_alarms(now_s)]:
            station.tell_event(sent)
        self._tell_live(station, now_s)
        self._tell_state(station, now_s)

    def close(self) -> None:
        """Let go of the journal."""
        self._tail.close()

    def _new_events(self, now_s: float) -> list[Sent]:
        if now_s - self._journal_at_s < JOURNAL_EVERY_S:
            return []
        self._journal_at_s = now_s
        events = self._tail.after(self._ledger.head)
        for event in events:
            self._ledger.take(event)
        return self._parts.outbox.add([self._of_journal(event) for event in events]) if events else []

    def _of_journal(self, event: Event) -> ToSend:
        key = self._parts.keys.session_event(event.run_id)
        return ToSend(key, lambda seq: self._parts.sealer.seal(key, seq, told(event)), event.seq)

    def _new_alarms(self, now_s: float) -> list[Sent]:
        changes = self._troubles.look(now_s, self._tail.trouble)
        return self._parts.outbox.add([self._of_alarm(*change) for change in changes]) if changes else []

    def _of_alarm(self, alarm: Alarm, raised: bool) -> ToSend:
        key, body = self._parts.keys.alarm, alarm.as_json() | {"active": raised}
        return ToSend(key, lambda seq: self._parts.sealer.seal(key, seq, body))

    def _tell_live(self, station: Station, now_s: float) -> None:
        live = self._parts.tap.live()
        if live is None or live is self._live_seen:
            return
        self._live_seen = live
        for device in live["devices"]:
            self._tell_device(station, device, now_s)

    def _tell_device(self, station: Station, device: dict[str, Any], now_s: float) -> None:
        keys, value = self._parts.keys, device["value"]
        facts = {key: device[key] for key in ("name", "role", "age_s")}
        if value is not None and device["role"] == "robot":
            station.tell_value(keys.joints, facts | value)
        elif value is not None and device["live"]:  # a reading of a tracker is told by the run that took it
            station.tell_value(keys.device(device["name"], "value"), facts | value)
        state = {key: device[key] for key in ("name", "role", "state", "message", "remedy")}
        told_at_s, before = self._devices.get(device["name"], (float("-inf"), None))
        if state != before or now_s - told_at_s > DEVICE_STATE_EVERY_S:
            self._devices[device["name"]] = (now_s, state)
            station.tell_latest(keys.device(device["name"], "state"), state)

    def _tell_state(self, station: Station, now_s: float) -> None:
        parts = self._parts
        body = state_of(
            parts.config, parts.tap.session(), self._ledger, self._troubles.up, parts.due.at(now_s)
        )
        if body == self._shown and now_s - self._state_at_s < STATE_EVERY_S:
            return
        self._shown, self._state_at_s = body, now_s
        first, last = parts.outbox.bounds()
        station.tell_state(body | {"outbox": {"first": first, "last": last}})


def publish(config: CellConfig, stream: BinaryIO | None, leave: threading.Event) -> None:
    """Tell the site of a cell until ``leave`` is set, or the stream of the desk's words ends.

    Raises
    ------
    SiteError
        The cell file names no site, its folder is not whole, or another process tells the site already.
    """
    folder = site_folder(config)
    link, who = read_link_folder(folder, CELL_FILE), read_station(folder)
    keys = StationKeys(who.site, who.cell)
    with Outbox(config.cell.data_dir) as outbox:
        sealer = Sealer(station_key(config.cell.data_dir), who.cell, outbox.epoch)
        tap = DeskTap(stream)
        parts = Parts(config, keys, sealer, outbox, tap, DueDates(config, link.certificate))
        ledger = Ledger()
        publisher = Publisher(parts, ledger)
        answers = Answers(journal_path(config), outbox.path, config.cell.data_dir / CERTIFICATES, ledger)
        publisher.catch_up()
        try:
            with Station(_zenoh(link.zenoh_config), keys, sealer, outbox, answers) as station:
                while not (leave.is_set() or tap.ended.is_set()):
                    publisher.turn(station)
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


def _zenoh(make: Callable[[], zenoh.Config]) -> zenoh.Config:
    try:
        return make()
    except zenoh.ZError as error:
        raise SiteError(
            f"zenoh does not take the configuration: {error}.", remedy="Enrol the cell anew."
        ) from error


def main(path: str) -> None:
    """Tell the site until standard input ends."""
    log_in_lines("site: %(message)s")
    publish(read_cell_file(path), sys.stdin.buffer, threading.Event())


if __name__ == "__main__":
    sys.exit(run_guarded(lambda: main(sys.argv[1])))
