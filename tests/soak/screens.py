"""Fifty screens at ten messages a second: what they cost the web process, and that no capture waits for them.

The limit holds for what the screens hear all the time: the live values, while nothing runs. While records are taken
the process does more: it obeys orders, and shows every screen the session at each change. That is told beside it.
"""

import asyncio
import contextlib
import json
import os
import re
import statistics
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

import httpx
from websockets.asyncio.client import ClientConnection, connect

from cellcal.procedures.run_history import EventKind
from cellcal.service.record.journal import Journal
from tests.service.cell_process_session import a_cell
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.service_process import ScriptedBrowser, ServiceProcess, free_port, serve_cell

MOST_SHARE = 0.05  # of a core
SPAN_S = 20.0
ROUNDS = 3  # records with and without the screens, in turn
_FASTER = 1000.0  # than a robot, so that sessions change far more often than on a real cell
_TICKS_S = 1.0 / os.sysconf("SC_CLK_TCK")
_POSE, _CAPTURE = re.compile(r"go to pose (\d+)"), re.compile(r"capture (\d+)")


@dataclass(frozen=True)
class ScreensCost:
    """What so many screens cost."""

    alone: float  # share of a core that the web process takes with one screen, while nothing runs
    share: float  # with all of them: live values only
    rate_hz: float  # live messages a second that a screen got
    record_alone: float  # the same while records are taken, without the screens
    record_share: float  # and with them
    sessions_hz: float  # how often a session, too, went to each screen then
    without_s: list[float]  # how long captures took
    with_s: list[float]


@dataclass
class TakenRecords:
    """Some records: how long their captures took, and what the web process used meanwhile [s]."""

    captures_s: list[float] = field(default_factory=list)
    used_s: float = 0.0
    passed_s: float = 0.0
    sessions: int = 0  # that each screen was shown

    @property
    def core_share(self) -> float:
        """Share of a core."""
        return self.used_s / self.passed_s


def screens(count: int) -> CampaignFigures:
    """Open so many screens beside a run."""
    with tempfile.TemporaryDirectory() as folder:
        cost = asyncio.run(measure_cost(Path(folder), count, rounds=ROUNDS, span_s=SPAN_S))
    without, beside = (_describe_spread(each) for each in (cost.without_s, cost.with_s))
    late_s = statistics.median(cost.with_s) - statistics.median(cost.without_s)
    noise_s = statistics.median(abs(each - statistics.median(cost.without_s)) for each in cost.without_s)
    line = (
        f"screens: the web process takes {cost.share:.1%} of a core for live values to {count} screens at "
        f"{cost.rate_hz:.1f} Hz while nothing runs (at most 5 %), {cost.alone:.1%} for one; while records are taken, "
        f"{_FASTER:g} times as fast as by a robot, {cost.record_share:.1%}: live values, the orders of sessions that take "
        f"them ({cost.record_alone:.1%} with one screen), and {cost.sessions_hz:.1f} whole sessions a second to each "
        f"(no limit); {len(cost.without_s)} captures without them took {without}, {len(cost.with_s)} beside "
        f"them {beside}: later by {1e3 * late_s:+.1f} ms, spread {1e3 * noise_s:.1f} ms"
    )
    return CampaignFigures(
        line, cost.share <= MOST_SHARE and cost.rate_hz > 9.0 and late_s <= max(0.005, 3.0 * noise_s)
    )


async def measure_cost(folder: Path, count: int, *, rounds: int, span_s: float) -> ScreensCost:
    """Take records, every other one with the screens open; then look at the web process while nothing runs."""
    without, beside = TakenRecords(), TakenRecords()
    async with (
        a_cell(folder, time_factor=_FASTER) as (path, _),
        serve_cell(path, free_port()) as (service, client),
    ):
        browser = ScriptedBrowser(client)
        for _ in range(rounds):
            await _time_captures(browser, folder, service, without)
            async with _open_screens(client, count):
                await _time_captures(browser, folder, service, beside)
        async with _open_screens(client, 1):
            alone, _ = await _measure_share(service, span_s, [])
        async with _open_screens(client, count) as message_counts:
            share, rate_hz = await _measure_share(service, span_s, message_counts)
    return ScreensCost(
        alone, share, rate_hz, without.core_share, beside.core_share, beside.sessions / beside.passed_s,
        without.captures_s, beside.captures_s,
    )  # fmt: skip


async def _time_captures(
    browser: ScriptedBrowser, folder: Path, service: ServiceProcess, taken: TakenRecords
) -> None:
    """Take a record; add how long each of its captures took, from the robot's arrival on, and what all cost."""
    clock = asyncio.get_running_loop()
    browser.count, started = 0, False
    used_s, began_s = _used_s(service.web_pid), clock.time()

    def has_ended() -> bool:
        nonlocal started
        run = (browser.session or {}).get("run")
        started = started or (run is not None and run["state"] == "running")
        return started and run is not None and run["state"] == "ended"

    await browser.look_until(has_ended)
    taken.used_s += _used_s(service.web_pid) - used_s
    taken.passed_s += clock.time() - began_s
    taken.sessions += browser.count
    assert browser.session is not None
    run = browser.session["run"]
    assert run["outcome"]["verdict"] == "passed", run["outcome"]
    await browser.press_button({"op": "dismiss"})
    taken.captures_s += _capture_times_s(folder / "data" / "journal.db", run["id"])


def _capture_times_s(path: Path, run_id: str) -> list[float]:
    arrived_ns, took_s = dict[str, int](), list[float]()
    with Journal.open_file(path) as journal:
        for event in journal.list_events(run_id):
            step = json.loads(event.body)["step"] if event.kind == EventKind.FINDING else ""
            if pose := _POSE.fullmatch(step):
                arrived_ns[pose[1]] = event.mono_ns
            elif (capture := _CAPTURE.fullmatch(step)) and capture[1] in arrived_ns:
                took_s.append((event.mono_ns - arrived_ns[capture[1]]) * 1e-9)
    return took_s


@asynccontextmanager
async def _open_screens(client: httpx.AsyncClient, count: int) -> AsyncIterator[list[int]]:
    """Open screens that read all they get; the list counts the live messages of each."""
    cookie_header = "; ".join(f"{name}={token}" for name, token in client.cookies.items())
    url = str(client.base_url).replace("http", "ws").rstrip("/") + "/api/screen"
    message_counts = [0] * count

    async def read_screen(place: int, screen: ClientConnection) -> None:
        async for text in screen:
            message_counts[place] += text.startswith('{"kind":"live"') if isinstance(text, str) else 0

    async with contextlib.AsyncExitStack() as open_ones:
        found = [
            await open_ones.enter_async_context(
                connect(
                    url, additional_headers={"cookie": cookie_header}
                )  # offers compression, as browsers do
            )
            for _ in range(count)
        ]
        reading = [asyncio.create_task(read_screen(place, screen)) for place, screen in enumerate(found)]
        try:
            yield message_counts
        finally:
            for task in reading:
                task.cancel()
            await asyncio.gather(*reading, return_exceptions=True)


async def _measure_share(
    service: ServiceProcess, span_s: float, message_counts: list[int]
) -> tuple[float, float]:
    """Return which share of a core the web process takes, and how often a screen hears something [Hz]."""
    loop = asyncio.get_running_loop()
    await asyncio.sleep(1.0)  # what opening cost
    before, used_s, began_s = list(message_counts), _used_s(service.web_pid), loop.time()
    await asyncio.sleep(span_s)
    passed_s = loop.time() - began_s
    got = [now - then for now, then in zip(message_counts, before, strict=True)]
    return (_used_s(service.web_pid) - used_s) / passed_s, min(got, default=0) / passed_s


def _used_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) * _TICKS_S


def _describe_spread(times_s: list[float]) -> str:
    tenth = statistics.quantiles(times_s, n=10)
    return f"{1e3 * statistics.median(times_s):.0f} ms (tenths {1e3 * tenth[0]:.0f} to {1e3 * tenth[-1]:.0f})"
