"""A monitor whose store fails keeps what came, and what one cell says takes out no other."""

import sqlite3
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from cellcal.calibration.errors import CellError
from cellcal.drivers.supervision import SUPERVISOR
from cellcal.service.record.signing import station_key
from cellcal.service.site.fleet import MOST_ALARMS
from cellcal.service.site.keys import SiteError, StationKeys
from cellcal.service.site.listener import FleetListener
from cellcal.service.site.outbox import SiteOutbox
from cellcal.service.site.signed_messages import MessageSigner, SignedMessage
from cellcal.service.site.site_store import ReceivedEvent, SiteStore
from cellcal.service.site.unstored import MOST_WAITING, TASK, UnstoredEvents
from tests.service.loopback_site import PATIENCE_S, SITE, LoopbackSite, open_bus, wait_until
from tests.service.test_fleet import PlayedFleet

BODY = {"id": "x:y", "active": True, "source": "y", "text": "true", "code": "x", "remedy": ""}


def describe_flaws(listener: FleetListener) -> str:
    return " ".join(flaw["what"] for flaw in listener.fleet.flaws)


def test_events_that_came_while_the_store_failed_are_stored_later_and_cells_stay_visible(
    tmp_path: Path,
) -> None:
    site, file = LoopbackSite(tmp_path, "cell-07", "cell-08"), tmp_path / "s.sqlite"
    with (
        site.start_router(),
        FleetListener(site.monitor_folder, file, patience_s=PATIENCE_S) as listener,
        open_bus(site.zenoh_of("cell-07")) as cell,
        closing(sqlite3.connect(file, isolation_level=None)) as other,
    ):
        keys, config = site.station_keys("cell-07"), site.cells["cell-07"]
        with SiteOutbox(config.cell.data_dir) as outbox:
            sealer = MessageSigner(station_key(config.cell.data_dir), "cell-07", outbox.epoch)
        first = sealer.sign_message(keys.alarm_key, 1, BODY)
        wait_until(lambda: (cell.put(keys.alarm_key, first), listener.event_numbers("cell-07"))[1])
        other.execute("ALTER TABLE event RENAME TO away")
        for seq in range(2, 30):
            cell.put(keys.alarm_key, sealer.sign_message(keys.alarm_key, seq, BODY | {"text": str(seq)}))
        wait_until(lambda: "the monitor's store takes nothing just now" in describe_flaws(listener))
        assert TASK in [trouble.task for trouble in SUPERVISOR.list_troubles()]
        wait_until(
            lambda: listener.fleet.cell_views(time.monotonic())[0].alarms[0]["text"] == "29"
        )  # shown all the same
        other.execute("ALTER TABLE away RENAME TO event")
        wait_until(lambda: listener.event_numbers("cell-07") == list(range(1, 30)))
        wait_until(lambda: "works again" in describe_flaws(listener))
        assert TASK not in [trouble.task for trouble in SUPERVISOR.list_troubles()]


def received(cell: str, seq: int, body: Any = None) -> ReceivedEvent:
    return ReceivedEvent(
        SignedMessage(cell, "1", seq, "2026-01-01T00:00:00+00:00", "k", body), f"{cell} {seq}".encode()
    )


def test_an_event_that_cannot_be_stored_is_its_cells_alone(tmp_path: Path) -> None:
    hall = PlayedFleet(tmp_path, 2)
    good, bad = hall.names
    with SiteStore(Path(":memory:")) as store:

        def add(events: Sequence[ReceivedEvent]) -> None:
            store.add_events(events)

        unstored = UnstoredEvents(add, hall.fleet)
        unstored.take([received(good, 1), received(bad, 2**63), received(good, 2), received(bad, 1, {1, 2})])
        unstored.store()
        assert len(unstored) == 0
        assert store.event_numbers(good) == [1, 2]
        assert {flaw["cell"] for flaw in hall.fleet.flaws} == {bad}


def test_what_waits_is_bounded_and_tried_again_after_a_pause_only(tmp_path: Path) -> None:
    hall, now, tried = PlayedFleet(tmp_path, 1), [100.0], []

    def refuse(_: Sequence[ReceivedEvent]) -> None:
        tried.append(1)
        raise sqlite3.OperationalError("database or disk is full")

    unstored = UnstoredEvents(refuse, hall.fleet, clock=lambda: now[0])
    unstored.take([received(hall.names[0], seq) for seq in range(MOST_WAITING)])
    assert unstored.full
    for _ in range(100):
        unstored.store()
    assert len(tried) == 1
    now[0] += 60.0
    unstored.store()
    assert (len(tried), len(unstored)) == (2, MOST_WAITING)
    assert [flaw["what"] for flaw in hall.fleet.flaws if "disk is full" in flaw["what"]] != []
    assert len(hall.fleet.flaws) == 1, "the same words each time would push everything else away"
    unstored.store(last=True)
    assert len(tried) == 3
    SUPERVISOR.note_end(TASK)


@pytest.mark.parametrize(
    "error",
    [
        SiteError("the question was not answered", remedy="See whether it is online."),
        CellError("a number that is none", remedy="x", code="y"),
        RecursionError(), OverflowError(), UnicodeEncodeError("utf-8", "\ud800", 0, 1, "no"), KeyError("x"),
        sqlite3.DataError("too big"), sqlite3.IntegrityError("null"), sqlite3.ProgrammingError("no such type"),
        sqlite3.InterfaceError("bad parameter"),
    ],
    ids=lambda error: type(error).__name__,
)  # fmt: skip
def test_what_one_cell_breaks_is_named_at_it_and_ends_no_loop(tmp_path: Path, error: Exception) -> None:
    hall = PlayedFleet(tmp_path, 2)
    for cell in hall.names:
        with hall.fleet.blame_cell(cell):
            if cell == hall.names[0]:
                raise error
    assert [flaw["cell"] for flaw in hall.fleet.flaws] == [hall.names[0]]


def test_a_cell_that_refuses_to_tell_what_is_missing_does_not_keep_the_monitor_from_asking_others(
    tmp_path: Path,
) -> None:
    site = LoopbackSite(tmp_path, "cell-07", "cell-08")
    before = SUPERVISOR.failure_counts().get("monitor: asking", 0)
    with (
        site.start_router(),
        FleetListener(site.monitor_folder, tmp_path / "s.sqlite", patience_s=PATIENCE_S) as listener,
        open_bus(site.zenoh_of("cell-07")) as cell,
    ):
        keys = site.station_keys("cell-07")
        refusing = cell.declare_queryable(
            keys.answer_key("outbox"), lambda query: query.reply_err(b'{"message": "my outbox is broken"}')
        )
        wait_until(
            lambda: (
                _mark_as_missing(listener, "cell-07") and "my outbox is broken" in describe_flaws(listener)
            )
        )
        refusing.undeclare()
        assert {flaw["cell"] for flaw in listener.fleet.flaws if "outbox is broken" in flaw["what"]} == {
            "cell-07"
        }
        assert SUPERVISOR.failure_counts().get("monitor: asking", 0) == before
        with site.publish_cell("cell-08"):
            site.append_to_journal("cell-08", "drift_check-0123456789ab", 3)
            wait_until(lambda: listener.event_numbers("cell-08"))


def _mark_as_missing(listener: FleetListener, cell: str) -> bool:
    """Let the monitor take a cell for one of which something is missing."""
    listener.fleet.note_liveliness(f"cellcal/v1/{listener.fleet.site}/{cell}/alive", alive=True)
    listener._missing[cell] = ("1", 0.0)
    listener._store.update_reach(cell, "1", 1, 5)
    return True


def test_a_cell_that_floods_the_monitor_takes_no_room_of_others(tmp_path: Path) -> None:
    hall = PlayedFleet(tmp_path, 2)
    good, bad = hall.names
    keys, now_s = StationKeys(SITE, bad), time.monotonic()
    for k in range(1000):
        hall.fleet.take_sample(keys.device_key(f"d{k}", "value"), b"x" * 100_000, now_s)
    for k in range(MOST_ALARMS + 50):
        alarm = {"id": f"a{k}", "code": "c", "source": "s", "text": "t", "active": True}
        hall.fleet.note_alarm(
            SignedMessage(bad, "1", k + 1, "2026-01-01T00:00:00+00:00", keys.alarm_key, alarm)
        )
    hall.publish_state(bad, cell="Line 3\n" + "A" * 200_000)
    hall.publish_state(bad, more="A" * 1_000_000)
    hall.publish_state(good)
    views = {view.cell: view for view in hall.fleet.cell_views(time.monotonic())}
    assert views[good].link == "online"
    assert len(views[bad].alarms) == MOST_ALARMS
    assert len(views[bad].name) < 100
    said = [str(flaw["what"]) for flaw in hall.fleet.flaws]
    assert {flaw["cell"] for flaw in hall.fleet.flaws} == {bad}
    assert sum("sends more than the monitor keeps" in what for what in said) == 1
    assert sum("more alarms" in what for what in said) == 1  # what is repeated stands once
    assert hall.fleet.flaw_count >= 51
    assert all(what.isprintable() and len(what) < 1100 for what in said)


def test_flaws_of_a_cell_that_floods_leave_those_of_others_visible(tmp_path: Path) -> None:
    hall = PlayedFleet(tmp_path, 2)
    quiet, loud = hall.names
    hall.fleet.name_flaw(quiet, "its chain is broken")
    for number in range(500):
        hall.fleet.name_flaw(loud, f"flaw {number}")
        hall.fleet.name_flaw(loud, "the same again")
    assert {flaw["cell"] for flaw in hall.fleet.flaws} == {quiet, loud}
    assert len(hall.fleet.flaws) == 51
    assert hall.fleet.flaw_count == 1001
