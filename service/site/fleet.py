"""What a monitor knows of every cell of its site, and how sure it is of that.

Samples come in by the thousand a second; a signature costs about a fifth of a millisecond. So the newest sample of a
key replaces the one before unread, and is opened on request. Nothing is shown that was not opened. Whether
a cell is there is not signed: it is what the router says, and only a state that was opened makes a cell online.
"""

import logging
import sqlite3
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, NotRequired, TypedDict

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import limit_to_line, make_message
from cellcal.calibration.message_table import MESSAGES, remember_table
from cellcal.service.legacy_texts import remember_recorded_texts
from cellcal.service.site.keys import StationKeys, cell_of
from cellcal.service.site.link_files import StationsFile
from cellcal.service.site.signed_messages import (
    LONGEST_MESSAGE,
    MessageFlaw,
    SignedMessage,
    open_message,
    public_key,
    wall_utc,
)
from cellcal.service.site.site_store import EventReach, is_store_fault
from cellcal.service.site.state_shape import is_alarm, state_flaw
from cellcal.service.times import read_time

_LOG = logging.getLogger(__name__)
SILENT_S = 4.0  # a state comes every second; without a goodbye this tells a cable that was pulled
_MOST_KEYS, _MOST_WAITING_BYTES = 200, 8_000_000  # of a cell: samples that were not opened
_SMALL = 20_000  # bytes of a sample that need not be added up
MOST_ALARMS = 500  # of a cell, as in its state
_LONGEST_STATE, _LONGEST_FLAW = 500_000, 1000
_FLAWS_KEPT, _FLAWS_OF_CELL = 200, 50
_SIGNED_NOW_S = 60.0
OPENED_A_SECOND = 250  # states; more cells than that are looked at in turn


@dataclass(slots=True)
class _StationState:
    public: Ed25519PublicKey
    alive: bool = False
    samples: int = 0
    last_received_s: float | None = None  # anything, unopened
    state_s: float | None = None  # when the state that was opened arrived
    state: SignedMessage | None = None
    clock_off_s: float = 0.0
    alarms: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    alarms_until: tuple[str, int] = ("", 0)  # the newest event that they take into account
    waiting: dict[str, tuple[bytes, float]] = field(default_factory=dict)
    overflows: bool = False
    values: dict[str, SignedMessage] = field(default_factory=dict)
    reach: EventReach = field(default_factory=EventReach)

    def keep_waiting(self, key: str, raw: bytes, now_s: float, *, always: bool) -> bool:
        """Keep a sample in place of the one before; return whether there is room for it, which a state always has."""
        self.waiting.pop(key, None)
        if always and len(raw) <= LONGEST_MESSAGE:
            self.waiting[key] = (raw, now_s)
            return True
        others = list(self.waiting.values())  # pages take from it meanwhile
        large = len(raw) > _SMALL and len(raw) + sum(len(one) for one, _ in others) > _MOST_WAITING_BYTES
        if large or len(others) >= _MOST_KEYS:
            return False
        self.waiting[key] = (raw, now_s)
        return True


class ReachDocument(TypedDict):
    """Up to which journal event the site has everything, the newest that it knows of, and how many it lost."""

    have: int
    known: int
    lost: int


class CellRow(TypedDict):
    """One line of the table as JSON; what a cell sent stands in it as it came."""

    cell: str
    name: str
    link: str
    age_s: NotRequired[float | None]
    alarms: list[Mapping[str, Any]]
    run: Mapping[str, Any] | None
    asks: Mapping[str, Any] | None
    attended: bool
    drift: list[Mapping[str, Any]]
    certificate: Mapping[str, Any] | None
    due: list[Mapping[str, str]]
    clock_off_s: float
    events: ReachDocument


@dataclass(frozen=True, slots=True)
class CellView:
    """One line of the table."""

    cell: str
    name: str
    link: str  # online, silent, offline, never
    age_s: float | None  # of the last sample
    alarms: tuple[Mapping[str, Any], ...]
    run: Mapping[str, Any] | None
    asks: Mapping[str, Any] | None
    attended: bool
    drift: tuple[Mapping[str, Any], ...]
    certificate: Mapping[str, Any] | None
    due: tuple[Mapping[str, str], ...]
    events: EventReach
    clock_off_s: float

    def as_json(self) -> CellRow:
        """Return it for other programs."""
        return {
            "cell": self.cell,
            "name": self.name,
            "link": self.link,
            "age_s": self.age_s,
            "alarms": list(self.alarms),
            "run": self.run,
            "asks": self.asks,
            "attended": self.attended,
            "drift": list(self.drift),
            "certificate": self.certificate,
            "due": list(self.due),
            "clock_off_s": self.clock_off_s,
            "events": {"have": self.events.upto, "known": self.events.existing, "lost": self.events.lost},
        }


class Fleet:
    """Every enrolled cell. ``note_liveliness`` is called by zenoh's threads, the rest by the monitor's."""

    def __init__(self, enrolled: StationsFile) -> None:
        self.site = enrolled.site
        self._stations = {
            cell: _StationState(public_key(who.public_key)) for cell, who in enrolled.cells.items()
        }
        self._turn = 0
        self._lock = threading.Lock()
        self.flaws: deque[dict[str, str]] = deque(maxlen=_FLAWS_KEPT)
        self.flaw_count = 0

    # what comes in

    def take_sample(self, key: str, raw: bytes, now_s: float) -> None:
        """Take the newest of a key; an earlier one that was not read is dropped."""
        station = self._stations.get(cell_of(key))
        if station is None:
            return
        station.samples += 1
        station.last_received_s = now_s
        is_state = key == StationKeys(self.site, cell_of(key)).state_key  # no other key may take its room
        if not station.keep_waiting(key, raw, now_s, always=is_state) and not station.overflows:
            station.overflows = True  # said once: what floods a monitor must not flood its list of flaws
            self.name_flaw(
                cell_of(key), "it sends more than the monitor keeps of a cell: some of it is not shown"
            )

    def note_liveliness(self, key: str, *, alive: bool) -> None:
        """Note that a cell came or went; the same twice changes nothing."""
        station = self._stations.get(cell_of(key))
        if station is not None:
            station.alive = alive

    def open_message(self, key: str, raw: bytes) -> SignedMessage | None:
        """Open a message; one that is not believed is named, and dropped."""
        cell = cell_of(key)
        station = self._stations.get(cell)
        if station is None:
            self.name_flaw(cell, "is not enrolled")
            return None
        found = open_message(raw, key, cell, station.public)
        if isinstance(found, MessageFlaw):
            self.name_flaw(
                cell, make_message("{key}: {found_sentence}", key=key, found_sentence=found.sentence)
            )
            return None
        return found

    def name_flaw(self, cell: str, sentence: str) -> None:
        """Keep a sentence about what was not believed, or contradicts."""
        with self._lock:
            self.flaw_count += 1
            what = limit_to_line(sentence, _LONGEST_FLAW)
            own = [flaw for flaw in self.flaws if flaw["cell"] == cell]
            same = [flaw for flaw in own if flaw["what"] == what]
            for old in same or own[: max(0, len(own) - _FLAWS_OF_CELL + 1)]:  # no cell crowds out another's
                self.flaws.remove(old)
            self.flaws.append({"wall": wall_utc(), "cell": cell, "what": what})

    @contextmanager
    def blame_cell(self, cell: str) -> Iterator[None]:
        """Name what one cell's words broke, at that cell: the other cells' are looked at all the same."""
        try:
            yield
        except CellError as error:
            self.name_flaw(cell, f"{error.message} {error.remedy}".strip())
        except Exception as error:
            if is_store_fault(error):
                raise  # the store itself: no cell's fault
            if isinstance(error, sqlite3.Error):
                self.name_flaw(cell, make_message("what it said cannot be kept: {error}", error=error))
                return
            _LOG.exception("what %s said broke the monitor's work on it", cell)
            self.name_flaw(
                cell,
                make_message(
                    "what it said broke the program: {name}: {error}", name=type(error).__name__, error=error
                ),
            )

    def note_alarm(self, message: SignedMessage) -> None:
        """Take an alarm's event."""
        body = message.body
        if not is_alarm(body):
            self.name_flaw(message.station, "its alarm is not one of ours: another version?")
            return
        station = self._stations[message.station]
        if message.order_key <= station.alarms_until:
            return  # a repetition: it must neither clear what is up nor raise what is over
        station.alarms_until = message.order_key
        remember_table(body)
        alarms = {key: alarm for key, alarm in station.alarms.items() if key != body["id"]}
        if body.get("active") and len(alarms) >= MOST_ALARMS:
            self.name_flaw(message.station, "it has more alarms than the monitor keeps of a cell")
        elif body.get("active"):
            alarms[body["id"]] = body
        station.alarms = alarms  # whole: a page may be reading the one before

    def note_reach(self, cell: str, reach: EventReach) -> None:
        """Take note of how far a cell's events are here."""
        self._stations[cell].reach = reach

    # looking

    def open_newest_states(self, most: int = OPENED_A_SECOND) -> list[SignedMessage]:
        """Open the newest states that came since the last look, of so many cells; return them."""
        names = list(self._stations)
        found: list[SignedMessage] = []
        for _ in range(len(names)):
            cell = names[self._turn % len(names)]
            self._turn += 1
            state = None
            with self.blame_cell(cell):
                state = self._open_newest_state(cell)
            if state is not None:
                found.append(state)
            if len(found) >= most:
                break
        return found

    def newest_value(self, key: str) -> SignedMessage | None:
        """Return the newest believable message of a key: joints, a device's value or state."""
        station = self._stations.get(cell_of(key))
        if station is None:
            return None
        waiting = station.waiting.pop(key, None)
        message = None if waiting is None else self.open_message(key, waiting[0])
        stored = station.values.get(key)
        if message is not None and (stored is None or message.order_key > stored.order_key):
            station.values[key] = message
        return station.values.get(key)

    def cell_views(self, now_s: float) -> list[CellView]:
        """Return every cell as it stands."""
        silent_s = SILENT_S + len(self._stations) / OPENED_A_SECOND  # the turn until a state is opened
        return [
            _cell_view(cell, station, now_s, silent_s) for cell, station in sorted(self._stations.items())
        ]

    def sample_counts(self) -> dict[str, int]:
        """Return how many samples of each cell came in."""
        return {cell: station.samples for cell, station in self._stations.items()}

    def is_alive(self, cell: str) -> bool:
        """Whether the router says that a cell is there."""
        return self._stations[cell].alive

    def _open_newest_state(self, cell: str) -> SignedMessage | None:
        station = self._stations[cell]
        key = StationKeys(self.site, cell).state_key
        waiting = station.waiting.pop(key, None)
        if waiting is None:
            return None
        if len(waiting[0]) > _LONGEST_STATE:
            self.name_flaw(cell, "its state is longer than any of ours")
            return None
        message = self.open_message(key, waiting[0])
        if message is None:
            return None
        flaw = state_flaw(message.body)
        if flaw:
            self.name_flaw(cell, flaw)
            return None
        if not self._is_newer(message, station.state):
            return None
        _remember_texts(message.body)
        station.state, station.state_s = message, waiting[1]
        station.clock_off_s = _seconds_from_now(message.wall)
        station.alarms = {str(alarm["id"]): alarm for alarm in message.body["alarms"]}
        station.alarms_until = (message.epoch, message.body["outbox"].get("last", 0))
        return message

    def _is_newer(self, message: SignedMessage, newest: SignedMessage | None) -> bool:
        """Whether a state is newer than the newest one; one that counts from an earlier day is named."""
        if newest is None or message.order_key > newest.order_key:
            return True
        if message.epoch == newest.epoch:
            return False  # a repetition
        if _is_signed_now(message, newest):
            return True
        self.name_flaw(
            message.station,
            "it counts from an earlier day than before: two computers speak in its name, an old message "
            "was sent again, or its outbox is new and its clock was set. What it says is not shown.",
        )
        return False


def _is_signed_now(message: SignedMessage, newest: SignedMessage) -> bool:
    """Whether a message of an earlier epoch was signed just now, and the newest one was not.

    So it is where the clock stood ahead when the later epoch began. Old messages that are sent again are not.
    """
    return abs(_seconds_from_now(message.wall)) <= _SIGNED_NOW_S < abs(_seconds_from_now(newest.wall))


def _remember_texts(body: Mapping[str, Any]) -> None:
    """Take the templates of a state; a cell of an earlier version sends English texts alone."""
    if MESSAGES in body:
        remember_table(body)
    else:
        remember_recorded_texts(body)


def _cell_view(cell: str, station: _StationState, now_s: float, silent_s: float) -> CellView:
    body: Mapping[str, Any] = station.state.body if station.state is not None else {}
    return CellView(
        cell=cell,
        name=str(body.get("cell", cell)),
        link=_link_state(station, now_s, silent_s),
        age_s=None if station.last_received_s is None else round(now_s - station.last_received_s, 2),
        alarms=tuple(station.alarms.values()),
        run=body.get("run"),
        asks=body.get("asks"),
        attended=bool(body.get("attended")),
        drift=tuple(body.get("drift", ())),
        certificate=body.get("certificate"),
        due=tuple(body.get("due", ())),
        events=station.reach,
        clock_off_s=station.clock_off_s,
    )


def _link_state(station: _StationState, now_s: float, silent_s: float) -> str:
    if station.state_s is None:
        return "silent" if station.alive else "never"
    if not station.alive:
        return "offline"
    return "online" if now_s - station.state_s <= silent_s else "silent"


def _seconds_from_now(wall: str) -> float:
    try:
        return round((datetime.now(UTC) - read_time(wall)).total_seconds(), 1)
    except (ValueError, TypeError, OverflowError):
        return 0.0
