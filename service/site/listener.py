"""A monitor's end of the bus: receives all cells, stores their events, asks for what is missing. It puts nothing.

One thread takes events off the bus, another opens and stores them, a third asks cells for what they still hold.
"""

import sqlite3
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Self, TypeGuard

import zenoh
from zenoh.ext import HistoryConfig, RecoveryConfig, declare_advanced_subscriber
from zenoh.handlers import RingChannel

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message import make_message
from cellcal.drivers.supervision import log_failures, start_thread
from cellcal.service.record.signing import CheckedDocument, check_document
from cellcal.service.site.event_inbox import EventInbox
from cellcal.service.site.fleet import OPENED_A_SECOND, Fleet
from cellcal.service.site.journal_tail import chain_flaw
from cellcal.service.site.keys import SiteError, StationKeys, cell_of, checked_identifier
from cellcal.service.site.link_files import MONITOR_FILE, close_session, read_link_folder, read_stations
from cellcal.service.site.signed_messages import SignedMessage
from cellcal.service.site.site_store import ReceivedEvent, SiteStore
from cellcal.service.site.unstored import UnstoredEvents

_BATCH_S = 0.1
_RECEIVE_S = 0.02
_MOST_WAITING = (
    4000  # samples that the bus keeps for us; the oldest gives way, and an event is asked for later
)
_SETTLE_S = 1.5  # a short hole is mended from the cell's memory without being asked for
_AGAIN_S = 3.0
_ASK_S = 10.0
_PAGE = 500
_PAGES_AT_ONCE = 10
_LONGEST_REPLY = 64_000_000  # bytes; a certificate has at most 16 million
_RETRY_S = 1.0


class FleetListener:
    """Listens for as long as it is open.

    Raises
    ------
    SiteError
        The folder is not whole, the store cannot be used, or no router answers within ``patience_s``.
    """

    def __init__(self, folder: Path, store: Path, *, patience_s: float = 5.0) -> None:
        link, stations = read_link_folder(folder, MONITOR_FILE), read_stations(folder)
        self.fleet = Fleet(stations)
        self._cells = sorted(stations.cells)
        self._keys_of = {cell: StationKeys(stations.site, cell) for cell in self._cells}
        self._public = {cell: who.public_key for cell, who in stations.cells.items()}
        self._all = StationKeys(stations.site, "*")
        self._inbox = EventInbox(self._cells)
        self._leave = threading.Event()
        self._missing: dict[str, tuple[str, float]] = {}  # since when, and of which outbox
        self._ask_after_s: dict[str, float] = {}
        self._store = SiteStore(store)
        self._store_lock = threading.Lock()
        self._unstored = UnstoredEvents(self._store_all, self.fleet)
        opened: list[zenoh.Session] = []
        try:
            where = link.config["connect"]["endpoints"]
            opened.append(_open_session(link.zenoh_config(), patience_s, where))
            opened.append(_open_session(link.zenoh_config(), patience_s, where))
            self._session, self._stream = opened
        except BaseException:
            for session in opened:
                close_session(session)
            self._store.close()
            raise
        self._subscribe_keys()
        self._threads = [
            start_thread(
                "monitor: receiving", partial(self._name_failure, self._receive_events), self._leave
            ),
            start_thread("monitor: hearing", partial(self._name_failure, self._process_samples), self._leave),
            start_thread("monitor: asking", partial(self._name_failure, self._process_requests), self._leave),
        ]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the bus, store what has come, and let go of the file."""
        self._leave.set()
        receiving, hearing, asking = self._threads
        receiving.join(_ASK_S)
        hearing.join(_ASK_S)
        close_session(self._stream)
        close_session(self._session)
        asking.join(_ASK_S)
        with self._store_lock:
            self._store.close()

    @property
    def is_linked(self) -> bool:
        """Whether the router is connected."""
        return bool(self._session.info.routers_zid())

    def event_numbers(self, cell: str) -> list[int]:
        """Return the numbers of a cell's events that are stored."""
        with self._store_lock:
            return self._store.event_numbers(cell)

    def stored_events(self, cell: str, most: int = 100) -> list[dict[str, Any]]:
        """Return a cell's newest events that are stored, newest first."""
        with self._store_lock:
            return [parse_json(raw) for raw in self._store.newest_events(cell, most)]

    def ask_cell(self, cell: str, verb: str, **arguments: str | int) -> list[SignedMessage]:
        """Ask a cell one of its reading verbs; answers whose signature is not the cell's are named and left out."""
        key = self._station_keys(cell).answer_key(verb)
        replies = self._get_replies(key, ";".join(f"{name}={value}" for name, value in arguments.items()))
        opened = [self.fleet.open_message(key, raw) for raw in replies]
        return [message for message in opened if message is not None]

    def fetch_certificate(self, cell: str, run_id: str) -> tuple[bytes, CheckedDocument]:
        """Fetch a certificate from its cell, with what a check of it against the cell's key ends with."""
        keys = self._station_keys(cell)
        checked_run = "".join(letter for letter in run_id if letter.isalnum() or letter in "_-")
        replies = self._get_replies(keys.certificate_key(checked_run), "")
        if not replies:
            raise SiteError(
                make_message("{cell} does not answer.", cell=cell),
                remedy="See whether it is online.",
                code="device",
            )
        return replies[0], check_document(replies[0], expected_key=self._public[cell])

    def _station_keys(self, cell: str) -> StationKeys:
        if cell not in self._keys_of:
            checked_identifier(cell, "cell")
            raise SiteError(
                make_message("there is no cell {cell!r} on this site.", cell=cell),
                remedy="See `cellcal monitor`.",
            )
        return self._keys_of[cell]

    def _get_replies(self, key: str, parameters: str) -> list[bytes]:
        selector = f"{key}?{parameters}" if parameters else key
        replies = self._session.get(
            selector, consolidation=zenoh.ConsolidationMode.NONE, timeout=_ASK_S
        )  # the default gives the newest of a key only
        found: list[bytes] = []
        byte_count = 0
        for reply in replies:
            if reply.ok is not None:
                found.append(reply.ok.payload.to_bytes())
                byte_count += len(found[-1])
                if len(found) > _PAGE or byte_count > _LONGEST_REPLY:
                    break  # no answer of ours is longer: what else comes would only fill the memory
            elif reply.err is not None:
                words = _error_text(reply.err.payload.to_bytes())
                raise SiteError(
                    make_message("{key}: {words}", key=key, words=words),
                    remedy="See whether the cell is online.",
                    code="device",
                )
        return found

    # hearing: Rust keeps what comes in until our one thread takes it; a Python callback for each sample would wait
    # for the interpreter's lock each time, and what a link cannot hand over it drops. What comes ten times a second
    # has a session of its own: in one that follows liveliness, each sample costs ten times as much with 300 cells

    def _subscribe_keys(self) -> None:
        history = HistoryConfig(detect_late_publishers=True, max_samples=1000)
        newest = HistoryConfig(detect_late_publishers=True, max_samples=1)
        recovery = RecoveryConfig(periodic_queries=None, heartbeat=True)
        all_cells = self._all
        self._events = [
            declare_advanced_subscriber(
                self._session, key, RingChannel(_MOST_WAITING), history=history, recovery=recovery
            )
            for key in (all_cells.any_session_event, all_cells.alarm_key)
        ]
        self._latest = [
            declare_advanced_subscriber(
                self._session,
                f"{all_cells.base_key}/device/*/state",
                RingChannel(_MOST_WAITING),
                history=newest,
            )
        ]
        self._values = [
            self._stream.declare_subscriber(key, RingChannel(_MOST_WAITING))
            for key in (all_cells.state_key, all_cells.joints_key, f"{all_cells.base_key}/device/*/value")
        ]
        self._alive = self._session.liveliness().declare_subscriber(
            all_cells.alive_key, self._on_liveliness, history=True
        )

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        with log_failures("monitor: who is there"):
            self.fleet.note_liveliness(str(sample.key_expr), alive=sample.kind == zenoh.SampleKind.PUT)

    # our own threads

    def _name_failure(self, work: Callable[[], None]) -> None:
        try:
            work()
        except Exception as error:  # shown on the page; the supervisor names it and begins anew
            if not self._leave.is_set():
                self.fleet.name_flaw(
                    "", make_message("the monitor cannot go on with its work just now: {error}", error=error)
                )
            raise

    def _process_samples(self) -> None:
        """Take what came in, store events, and open a share of the newest states, again and again."""
        while True:
            leaving = self._leave.wait(_BATCH_S)
            self._take_samples()
            if not self._unstored.full:
                self._unstored.take(self._believed(self._inbox.take(_PAGE)))
            self._unstored.store(last=leaving)
            self._compare_all(self.fleet.open_newest_states(max(1, int(OPENED_A_SECOND * _BATCH_S))))
            if leaving:
                return

    def _take_samples(self) -> None:
        now_s = time.monotonic()
        subscribers: list[Any] = [*self._latest, *self._values]
        for subscriber in subscribers:
            for _ in range(_MOST_WAITING):
                sample = subscriber.try_recv()
                if sample is None:
                    break
                key = str(sample.key_expr)
                with self.fleet.blame_cell(cell_of(key)):
                    self.fleet.take_sample(key, sample.payload.to_bytes(), now_s)

    def _receive_events(self) -> None:
        """Take events off the bus as fast as they come, whatever it costs to open and to store them."""
        while True:
            leaving = self._leave.wait(_RECEIVE_S)
            for cell in self._inbox.receive(self._events):  # said once, as for its values
                self.fleet.name_flaw(
                    cell, "it sends events faster than they can be opened: what is dropped is asked for later"
                )
            if leaving:
                return

    def _believed(self, batch: list[tuple[str, bytes]]) -> list[ReceivedEvent]:
        received = []
        for key, raw in batch:
            with self.fleet.blame_cell(cell_of(key)):
                message = self.fleet.open_message(key, raw)
                if message is None or not self._has_intact_chain(message):
                    continue
                received.append(ReceivedEvent(message, raw))
                if key == self._keys_of[message.station].alarm_key:
                    self.fleet.note_alarm(message)
        return received

    def _store_all(self, received: Sequence[ReceivedEvent]) -> None:
        with self._store_lock:
            for cell in sorted({each.message.station for each in received}):
                own = [each for each in received if each.message.station == cell]
                for sentence in self._store.add_events(own):
                    self.fleet.name_flaw(cell, sentence)
            for cell, epoch in {(each.message.station, each.message.epoch) for each in received}:
                self.fleet.note_reach(cell, self._store.event_reach(cell, epoch))

    def _has_intact_chain(self, message: SignedMessage) -> bool:
        body = message.body
        try:
            flaw = chain_flaw(body) if isinstance(body, dict) and "journal_seq" in body else ""
        except (KeyError, ValueError, TypeError, AttributeError):
            flaw = "an event has not the parts of one"
        if flaw:
            self.fleet.name_flaw(message.station, flaw)
        return not flaw

    def _compare_all(self, states: list[SignedMessage]) -> None:
        for state in states:
            try:
                with self.fleet.blame_cell(state.station):
                    self._compare_state(state)
            except (
                sqlite3.Error
            ) as error:  # the store: no cell is taken out by it, and each is compared again
                self._unstored.note_fault(error)
                return

    def _compare_state(self, state: SignedMessage) -> None:
        """Compare what a cell says it has with what is here."""
        has = state.body.get("outbox") or {}
        first, last = has.get("first"), has.get("last")
        if not (_is_number(first) and _is_number(last)):
            return  # another version of ours
        with self._store_lock:
            reach = self._store.update_reach(state.station, state.epoch, first, last)
        self.fleet.note_reach(state.station, reach)
        if not reach.missing_count:
            self._missing.pop(state.station, None)
        elif self._missing.get(state.station, ("",))[0] != state.epoch:  # also where a new outbox counts anew
            self._missing[state.station] = (state.epoch, time.monotonic())

    def _process_requests(self) -> None:
        while not self._leave.wait(_BATCH_S):
            for cell, (epoch, since_s) in list(self._missing.items()):
                now_s = time.monotonic()
                due = max(since_s + _SETTLE_S, self._ask_after_s.get(cell, 0.0))
                if now_s >= due and self.fleet.is_alive(cell) and not self._leave.is_set():
                    with self.fleet.blame_cell(cell):
                        self._fetch_missing(cell, epoch)

    def _fetch_missing(self, cell: str, epoch: str) -> None:
        """Fetch what is missing of a cell, page by page; other cells are asked before so many more."""
        self._ask_after_s[cell] = time.monotonic() + _AGAIN_S
        for _ in range(_PAGES_AT_ONCE):
            if self._leave.is_set():
                return
            with self._store_lock:
                reach = self._store.event_reach(cell, epoch)
            if not reach.missing_count:
                self._missing.pop(cell, None)
                return
            found = self._fetch_page(cell, reach.upto + 1)
            if not found:
                return
            with self._store_lock:
                flaws = self._store.add_events(found)
                after = self._store.event_reach(cell, epoch)
            for sentence in flaws:
                self.fleet.name_flaw(cell, sentence)
            self.fleet.note_reach(cell, after)
            if after.upto <= reach.upto:
                return
        self._ask_after_s[cell] = time.monotonic()  # it answers well: the rest comes in its next turn

    def _fetch_page(self, cell: str, first: int) -> list[ReceivedEvent]:
        found = []
        for raw in self._get_replies(self._keys_of[cell].answer_key("outbox"), f"from={first};most={_PAGE}"):
            key = _key_of(raw)
            message = (
                self.fleet.open_message(key, raw)
                if key.startswith(self._keys_of[cell].base_key + "/")
                else None
            )
            if message is not None and self._has_intact_chain(message):
                found.append(ReceivedEvent(message, raw))
        return found


def _open_session(config: zenoh.Config, patience_s: float, endpoints: list[str]) -> zenoh.Session:
    """Open the session; a client cannot be opened while no router answers."""
    until_s = time.monotonic() + patience_s
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            if time.monotonic() > until_s:
                raise SiteError(
                    make_message(
                        "the site's router at {endpoints} does not answer: {error}.",
                        endpoints=", ".join(endpoints),
                        error=error,
                    ),
                    remedy="Start `cellcal site router`, and see that this computer reaches it. A certificate that "
                    "is not of this site is refused without a word.",
                    code="device.unreachable",
                ) from error
            time.sleep(min(_RETRY_S, patience_s / 5))


def _is_number(value: object) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**63


def _key_of(raw: bytes) -> str:
    try:
        message = parse_json(raw)
    except DocumentError:
        return ""
    return str(message.get("key", "")) if isinstance(message, dict) else ""


def _error_text(raw: bytes) -> str:
    try:
        return str(parse_json(raw)["message"])
    except (DocumentError, KeyError, TypeError):
        return "the question was not answered in time"
