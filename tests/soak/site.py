"""Campaigns over the view from afar: a thousand cells into one monitor, and a router that is away.

Run as a module with a folder, seconds and cells it plays those cells so long: a session, a certificate and a
liveliness token each.
"""

import itertools
import json
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import zenoh

from cellcal.service.record.signing import CellKey, station_key
from cellcal.service.site.enrolment import CellApplicant, NewSite, enroll_cells
from cellcal.service.site.keys import StationKeys
from cellcal.service.site.link_files import CELL_FILE, close_session, read_link_folder
from cellcal.service.site.listener import FleetListener
from cellcal.service.site.signed_messages import MessageSigner
from cellcal.service.site.station import advanced_publisher
from tests.service.loopback_site import SITE, LoopbackSite, free_port, router_of, wait_until
from tests.soak.campaign_figures import CampaignFigures

RATE_HZ = 10
_SPAN_S = 20.0
_PLAYERS = 2
_PATIENCE_S = 300.0
_AWAY_S = 6.5
_EVENTS_HZ = 50
_PRESIGNED = 10  # joints are opened on request, so repeating some changes nothing for the monitor


def site(cells: int) -> CampaignFigures:
    """So many cells at 10 Hz into one monitor, each with its own session, and events across a router's death."""
    lost_events, event_count = _measure_outage()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "site"
        names = [f"cell-{k:04d}" for k in range(cells)]
        keys = {cell: station_key(Path(name) / "keys" / cell) for cell in names}
        port = free_port()
        enroll_cells(
            folder,
            [CellApplicant(cell, key.public_key) for cell, key in keys.items()],
            NewSite(SITE, f"127.0.0.1:{port}"),
        )
        with (
            router_of(folder),
            FleetListener(folder / "monitor", Path(name) / "s.sqlite", patience_s=60) as listener,
        ):
            put, online, share = _follow_cells(Path(name), names, listener)
            flaws = listener.fleet.flaw_count
            sample_count = sum(listener.fleet.sample_counts().values())
    line = (
        f"site: {cells} cells at {RATE_HZ} Hz, {put} samples in {_SPAN_S:g} s, {put - sample_count} lost, "
        f"{online} online, {flaws} not believed, monitor {share:.0%} of a core (at most 50 %); "
        f"router away {_AWAY_S} s: {lost_events} of {event_count} events lost"
    )
    return CampaignFigures(
        line, put == sample_count and online == cells and flaws == 0 and share <= 0.5 and lost_events == 0
    )


def _follow_cells(root: Path, names: list[str], listener: FleetListener) -> tuple[int, int, float]:
    players = [player_of(root, names[k::_PLAYERS]) for k in range(_PLAYERS)]
    try:
        for player in players:
            assert player.stdout is not None
            assert player.stdout.readline() == "ready\n"
        wait_until(lambda: all(map(listener.fleet.is_alive, names)), _PATIENCE_S)
        began_s, used_s = time.monotonic(), time.process_time()
        for player in players:
            assert player.stdin is not None
            player.stdin.write("go\n")
            player.stdin.flush()
        counts = [int(player.stdout.readline()) for player in players if player.stdout is not None]
        share = (time.process_time() - used_s) / (time.monotonic() - began_s)
        online = sum(view.link == "online" for view in listener.fleet.cell_views(time.monotonic()))
        time.sleep(2.0)  # what is on its way
        return sum(counts), online, share
    finally:
        for player in players:
            player.communicate()


def _measure_outage() -> tuple[int, int]:
    """Kill the router for 6.5 s while a journal grows; return how many of its events never came, of how many."""
    with tempfile.TemporaryDirectory() as name:
        one = LoopbackSite(Path(name), "cell-07")
        count = 0

        def grow_journal(span_s: float) -> None:
            nonlocal count
            ends_s = time.monotonic() + span_s
            while time.monotonic() < ends_s:
                one.append_to_journal("cell-07", "soak-run", 10, first=count)
                count += 10
                time.sleep(10 / _EVENTS_HZ)

        store = Path(name) / "s.sqlite"
        with (
            one.publish_cell("cell-07"),
            one.start_router() as router,
            FleetListener(one.monitor_folder, store, patience_s=60.0) as listener,
        ):
            grow_journal(2.0)
            router.kill()
            router.wait()
            grow_journal(_AWAY_S)
            with one.start_router():
                grow_journal(2.0)
                ends_s = time.monotonic() + 60.0
                while len(listener.event_numbers("cell-07")) < count and time.monotonic() < ends_s:
                    time.sleep(0.1)
                return len(set(range(1, count + 1)) - set(listener.event_numbers("cell-07"))), count


def player_of(root: Path, names: list[str], span_s: float = _SPAN_S) -> "subprocess.Popen[str]":
    """Start a process that plays cells; it says ready, waits for go, and stays when it has told all."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.soak.site", str(root), str(span_s)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    process.stdin.write(json.dumps(names) + "\n")
    process.stdin.flush()
    return process


class _SimulatedCell:
    """One simulated cell."""

    def __init__(self, root: Path, cell: str) -> None:
        self.keys = StationKeys(SITE, cell)
        self.key: CellKey = station_key(root / "keys" / cell)
        self.sealer = MessageSigner(self.key, cell, "e")
        link = read_link_folder(root / "site" / "cells" / cell, CELL_FILE)
        self.session = zenoh.open(link.zenoh_config([("connect/timeout_ms", 60_000)]))
        self.token = self.session.liveliness().declare_token(self.keys.alive_key)
        self.numbers = itertools.count(1)
        joints = {
            "name": "robot",
            "role": "robot",
            "age_s": 0.01,
            "joints_rad": [0.123456789] * 6,
            "moving": False,
        }
        self.state = advanced_publisher(self.session, self.keys.state_key, 1)
        self.joints_publisher = self.session.declare_publisher(self.keys.joints_key)
        self.joints = [
            self.sealer.sign_message(self.keys.joints_key, next(self.numbers), joints)
            for _ in range(_PRESIGNED)
        ]

    def publish_tick(self, tick: int) -> int:
        """Publish joints, and once a second the state; return how many messages."""
        self.joints_publisher.put(self.joints[tick % _PRESIGNED])
        if tick % RATE_HZ:
            return 1
        self.state.put(self.sealer.sign_message(self.keys.state_key, next(self.numbers), _cell_state()))
        return 2


def _cell_state() -> dict[str, Any]:
    empty: dict[str, Any] = {
        "alarms": [],
        "drift": [],
        "due": [],
        "run": None,
        "asks": None,
        "certificate": None,
    }
    return empty | {"cell": "simulated", "attended": True, "outbox": {"first": 1, "last": 0}}


def _play_cells() -> None:
    zenoh.init_log_from_env_or("error")
    root, names = Path(sys.argv[1]), json.loads(sys.stdin.readline())
    with ThreadPoolExecutor(16) as opening:  # a peer takes half a second to open
        players = list(opening.map(lambda name: _SimulatedCell(root, name), names))
    for player in players:  # what is said before a cell knows of its listener is lost
        wait_until(
            lambda awaited_player=player: awaited_player.joints_publisher.matching_status.matching,
            _PATIENCE_S,
        )
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    sys.stdin.readline()
    count, began_s = 0, time.monotonic()
    ticks = int(float(sys.argv[2]) * RATE_HZ)
    for tick in range(ticks):
        for k, player in enumerate(players):
            count += player.publish_tick(tick + k)  # states are spread over the second
        time.sleep(max(0.0, began_s + (tick + 1) / RATE_HZ - time.monotonic()))
    sys.stdout.write(f"{count}\n")
    sys.stdout.flush()
    sys.stdin.read()  # stay until all have been counted
    for player in players:
        close_session(player.session)


if __name__ == "__main__":
    _play_cells()
