"""Messages that are sent again, out of turn or without end: none hides a cell, clears an alarm or looks new."""

import threading
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cellcal.service.record.signing import station_key
from cellcal.service.site import listener as listening
from cellcal.service.site.fleet import CellView, Fleet
from cellcal.service.site.keys import StationKeys
from cellcal.service.site.link_files import EnrolledCell, StationsFile
from cellcal.service.site.listener import FleetListener
from cellcal.service.site.signed_messages import MessageSigner, SignedMessage
from cellcal.service.site.site_store import EventReach
from cellcal.service.site.state_shape import state_flaw

SITE, CELL = "hall-3", "cell-07"
KEYS = StationKeys(SITE, CELL)
ALARM = {"id": "x:y", "code": "x", "source": "y", "text": "E-stop.", "remedy": ""}
STATE: dict[str, Any] = {
    "cell": "Line 3", "alarms": [], "run": None, "asks": None, "attended": True, "drift": [], "certificate": None,
    "due": [], "outbox": {"first": 1, "last": 3},
}  # fmt: skip
AHEAD, TODAY = "20271130T101010000000-aaaaaa", "20261130T101010000000-bbbbbb"


class OneCell:
    """A monitor's view of one cell that is alive."""

    def __init__(self, folder: Path) -> None:
        self.key = station_key(folder)
        who = EnrolledCell(public_key=self.key.public_key, enrolled_utc="2026-01-01T00:00:00+00:00")
        self.fleet = Fleet(StationsFile(site=SITE, cells={CELL: who}))
        self.fleet.note_liveliness(KEYS.alive_key, alive=True)

    def publish_state(self, epoch: str, seq: int, off_s: float = 0.0, **changes: Any) -> None:
        wall = (datetime.now(UTC) + timedelta(seconds=off_s)).isoformat()
        raw = MessageSigner(self.key, CELL, epoch).sign_message(KEYS.state_key, seq, STATE | changes, wall)
        self.fleet.take_sample(KEYS.state_key, raw, time.monotonic())
        self.fleet.open_newest_states()

    def publish_alarm(self, seq: int, *, active: bool, epoch: str = TODAY) -> None:
        wall = datetime.now(UTC).isoformat()
        self.fleet.note_alarm(
            SignedMessage(CELL, epoch, seq, wall, KEYS.alarm_key, ALARM | {"active": active})
        )

    @property
    def view(self) -> CellView:
        return self.fleet.cell_views(time.monotonic())[0]

    @property
    def shown_epoch(self) -> str:
        state = self.fleet._stations[CELL].state
        return "" if state is None else state.epoch


@pytest.mark.parametrize(("count", "size"), [(300, 2), (90, 100_000)])
def test_other_keys_of_a_cell_take_no_room_from_its_state(tmp_path: Path, count: int, size: int) -> None:
    cell = OneCell(tmp_path)
    for k in range(count):
        cell.fleet.take_sample(KEYS.device_key(f"d{k}", "state"), b"x" * size, time.monotonic())
    cell.publish_state(TODAY, 5, asks={"key": "k", "step": "s"}, robots=["r" * 100] * 400)
    assert cell.view.link == "online"


def test_an_alarm_that_is_sent_again_neither_clears_nor_raises_one(tmp_path: Path) -> None:
    cell = OneCell(tmp_path)
    for seq, active in ((1, True), (2, False), (3, True)):
        cell.publish_alarm(seq, active=active)
    cell.publish_alarm(2, active=False)
    assert len(cell.view.alarms) == 1
    cell.publish_state(TODAY, 1 << 41, outbox={"first": 1, "last": 4})  # event 4 cleared it
    cell.publish_alarm(3, active=True)
    cell.publish_alarm(4, active=True, epoch="20251130T101010000000-cccccc")
    assert cell.view.alarms == ()
    cell.publish_alarm(5, active=True)
    assert len(cell.view.alarms) == 1


def test_an_outbox_that_began_while_the_clock_stood_ahead_hides_no_later_state(tmp_path: Path) -> None:
    cell = OneCell(tmp_path)
    cell.publish_state(AHEAD, 9, off_s=365 * 86400.0)
    cell.publish_state(TODAY, 2, attended=False)
    assert (cell.shown_epoch, cell.view.attended, cell.view.clock_off_s < 60.0) == (TODAY, False, True)
    assert not cell.fleet.flaws


def test_two_computers_that_speak_in_one_name_are_named_and_not_mixed(tmp_path: Path) -> None:
    cell = OneCell(tmp_path)
    cell.publish_state(AHEAD, 9)
    for seq in (2, 3):
        cell.publish_state(TODAY, seq, attended=False)
    cell.publish_state(AHEAD, 10)
    cell.publish_state(TODAY, 4, off_s=-86400.0)  # sent again after a day
    assert (cell.shown_epoch, cell.view.attended) == (AHEAD, True)
    assert "two computers speak in its name" in cell.fleet.flaws[-1]["what"]


@pytest.mark.parametrize("day", ["2026-W01-1", "20260101"])
def test_a_day_that_does_not_sort_with_others_is_not_shown(day: str) -> None:
    assert state_flaw(STATE | {"due": [{"what": "calibration", "due": "2026-01-01"}]}) == ""
    assert "YYYY-MM-DD" in state_flaw(STATE | {"due": [{"what": "calibration", "due": day}]})


def make_listener() -> Any:
    """Return a listener without a bus, whose cell always has another page."""
    listener = FleetListener.__new__(FleetListener)
    listener._leave, listener._store_lock = threading.Event(), threading.Lock()
    listener._ask_after_s, listener._missing = {}, {CELL: ("1", 0.0)}
    upto = iter(range(10**6))
    store: Any = SimpleNamespace(
        event_reach=lambda cell, epoch: EventReach(next(upto), 10**9), add_events=lambda events: []
    )
    listener._store = store
    listener.fleet = SimpleNamespace(note_reach=lambda *_: None)  # type: ignore[assignment]
    return listener


def test_a_cell_whose_history_never_ends_lets_others_be_asked() -> None:
    listener, pages = make_listener(), 0

    def fetch_page(cell: str, first: int) -> list[str]:
        nonlocal pages
        pages += 1
        assert pages <= listening._PAGES_AT_ONCE
        return ["an event"]

    listener._fetch_page = fetch_page
    listener._fetch_missing(CELL, "1")
    assert pages == listening._PAGES_AT_ONCE
    assert listener._ask_after_s[CELL] <= time.monotonic()  # its next turn is not put off


def test_an_answer_without_end_is_cut_off() -> None:
    listener, sent = make_listener(), 0

    def endless() -> Any:
        nonlocal sent
        while sent < 2000:  # enough to tell
            sent += 1
            yield SimpleNamespace(ok=SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: b"{}")))

    listener._session = SimpleNamespace(get=lambda *_, **__: endless())
    assert len(listener._get_replies("key", "")) == sent <= 501


def test_a_new_outbox_is_asked_for_what_is_missing_of_it() -> None:
    listener = make_listener()
    listener._store = SimpleNamespace(update_reach=lambda *_: EventReach(0, 5))
    listener._compare_state(SignedMessage(CELL, "2", 1, "", KEYS.state_key, STATE))
    assert listener._missing[CELL][0] == "2"
