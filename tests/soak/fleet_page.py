"""The fleet's page over the real bus: how soon a thousand cells stand on it, and how soon one that left is grey.

What the monitor costs is of this process, in which it runs here: the listener's threads, the page's service, and the
little that steering a browser takes. Stalls are of the loop that serves pages; a busy computer makes them longer.
"""

import asyncio
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from playwright.async_api import BrowserContext, Page

from cellcal.service.gc_freeze import freeze_startup_objects
from cellcal.service.record.signing import station_key
from cellcal.service.site.enrolment import CellApplicant, NewSite, enroll_cells
from cellcal.service.site.listener import FleetListener
from cellcal.service.web.fleet import FleetContext, create_fleet_app
from tests.service.browser_pages import PATIENCE_MS, open_chromium, serve_app
from tests.service.loopback_site import SITE, free_port, router_of, wait_until
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.site import RATE_HZ, player_of

_CELLS = 1000
_COST_S = 20.0
_TICK_S = 0.005
_MOST_SHARE, _MOST_STALL_S = 0.5, 0.1
_SPAN_S = 600.0
_PATIENCE_S = 300.0
_MOST_OPENED_S, _MOST_GREY_S = 1.0, 2.0
_TICKS = """import sys, time
span_s, tick_s, late_s = float(sys.argv[1]), float(sys.argv[2]), 0.0
ends_s = time.monotonic() + span_s
while (slept_s := time.monotonic()) < ends_s:
    time.sleep(tick_s)
    late_s = max(late_s, time.monotonic() - slept_s - tick_s)
print(late_s)"""
_STAMP = """{ const look = new MutationObserver(() => {
    if (document.querySelectorAll('tbody tr').length < %d) return;
    look.disconnect(); window.__seenMs = performance.now(); });
    look.observe(document, {subtree: true, childList: true}); }"""


@dataclass(frozen=True)
class _FollowingCost:
    """What following the cells and telling one page took."""

    share: float  # of a core
    samples_hz: float
    stalls_s: list[float]  # by how much the loop's ticks came late, shortest first
    idle_s: float  # the same of a process that does nothing but tick: what the computer itself stands for
    look_s: float  # processor time of taking the picture of all cells once

    @property
    def stall_s(self) -> float:
        """The longest stall that is the monitor's own."""
        return max(0.0, self.stalls_s[-1] - self.idle_s)

    def describe(self) -> str:
        late = self.stalls_s[int(0.999 * len(self.stalls_s))]
        return (
            f"{self.samples_hz:.0f} samples a second take {self.share:.0%} of a core (at most {_MOST_SHARE:.0%}); "
            f"the loop stood for {1e3 * self.stalls_s[-1]:.0f} ms at most, a process that does nothing for "
            f"{1e3 * self.idle_s:.0f} ms (at most {1e3 * _MOST_STALL_S:g} ms more), and longer than "
            f"{1e3 * late:.0f} ms at one tick of a thousand; all rows take {1e3 * self.look_s:.0f} ms of processor"
        )


def fleet(rounds: int) -> CampaignFigures:
    """Open the page so often; kill so many cells' processes, and freeze as many, as a pulled cable would."""
    opened, closed, frozen, cost = asyncio.run(_measure_fleet(rounds))
    line = (
        f"fleet: {cost.describe()}; {_CELLS} cells at {RATE_HZ} Hz drawn {_describe_times(opened)} "
        f"after the navigation "
        f"(at most {_MOST_OPENED_S:g} s); a cell "
        f"whose process was killed is grey {_describe_times(closed)} later (at most "
        f"{_MOST_GREY_S:g} s), one that was frozen, "
        f"as by a pulled cable, {_describe_times(frozen)} later; load of the computer {os.getloadavg()[0]:.1f} on "
        f"{os.cpu_count()} cores"
    )
    reached = statistics.median(opened) <= _MOST_OPENED_S and max(closed) <= _MOST_GREY_S
    return CampaignFigures(line, reached and cost.share <= _MOST_SHARE and cost.stall_s <= _MOST_STALL_S)


def _describe_times(seconds: list[float]) -> str:
    return f"{statistics.median(seconds):.2f} s ({max(seconds):.2f} at most of {len(seconds)})"


async def _measure_fleet(rounds: int) -> tuple[list[float], list[float], list[float], _FollowingCost]:
    names = [f"cell-{k:04d}" for k in range(_CELLS)]
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        root = Path(name)
        keys = {cell: station_key(root / "keys" / cell) for cell in names}
        applicants = [CellApplicant(cell, key.public_key) for cell, key in keys.items()]
        enroll_cells(root / "site", applicants, NewSite(SITE, f"127.0.0.1:{free_port()}"))
        stack.enter_context(router_of(root / "site"))
        listener = stack.enter_context(FleetListener(root / "site/monitor", root / "s.sqlite", patience_s=60))
        leaving, staying = names[: 2 * rounds], names[2 * rounds :]
        shares = (*([one] for one in leaving), staying[::2], staying[1::2])
        players = [player_of(root, some, _SPAN_S) for some in shares]
        stack.callback(_stop_players, players)
        await asyncio.to_thread(_start_players, players)
        await asyncio.to_thread(wait_until, lambda: all(map(listener.fleet.is_alive, names)), _PATIENCE_S)
        async with _context_of(listener, root) as (context, app_context):
            opened = [await _open_time_s(context) for _ in range(rounds)]
            page = await _open_page(context)
            cost = await _measure_cost(listener, app_context)
            closed = [
                await _grey_time_s(page, cell, player, signal.SIGKILL)
                for cell, player in zip(leaving[:rounds], players, strict=False)
            ]
            frozen = [
                await _grey_time_s(page, cell, player, signal.SIGSTOP)
                for cell, player in zip(leaving[rounds:], players[rounds:], strict=False)
            ]
        return opened, closed, frozen, cost


async def _measure_cost(listener: FleetListener, app_context: FleetContext) -> _FollowingCost:
    """Watch this process, and the loop that serves the page, while all cells speak."""
    loop, late_s = asyncio.get_running_loop(), list[float]()
    ticking = await asyncio.create_subprocess_exec(
        sys.executable, "-c", _TICKS, str(_COST_S), str(_TICK_S), stdout=asyncio.subprocess.PIPE
    )
    before, used_s, began_s = sum(listener.fleet.sample_counts().values()), time.process_time(), loop.time()
    while loop.time() < began_s + _COST_S:
        slept_s = loop.time()
        await asyncio.sleep(_TICK_S)
        late_s.append(loop.time() - slept_s - _TICK_S)
    passed_s, used_s = loop.time() - began_s, time.process_time() - used_s
    samples = sum(listener.fleet.sample_counts().values()) - before
    idle_s, _ = await ticking.communicate()
    looked_s = time.thread_time()
    app_context.update_rows()
    looked_s = time.thread_time() - looked_s
    return _FollowingCost(used_s / passed_s, samples / passed_s, sorted(late_s), float(idle_s), looked_s)


@asynccontextmanager
async def _context_of(
    listener: FleetListener, folder: Path
) -> AsyncIterator[tuple[BrowserContext, FleetContext]]:
    """Open a browser that is signed in at the monitor's service."""
    app = create_fleet_app(listener, folder)
    freeze_startup_objects()  # as `cellcal monitor --port` does
    async with serve_app(app) as url, open_chromium() as browser:
        context = await browser.new_context(viewport={"width": 1280, "height": 800}, base_url=url)
        context.set_default_timeout(PATIENCE_MS)
        await context.add_init_script(_STAMP % _CELLS)
        page = await context.new_page()
        await page.goto(f"/api/sign-in/console?token={app.state.context.authenticator.console_token()}")
        await page.wait_for_function("() => window.__seenMs !== undefined")
        await page.close()
        yield context, app.state.context


async def _open_page(context: BrowserContext) -> Page:
    page = await context.new_page()
    await page.goto("/")
    await page.wait_for_function("() => window.__seenMs !== undefined")
    return page


async def _open_time_s(context: BrowserContext) -> float:
    """Return after how many seconds from the navigation all cells stood on the page."""
    page = await _open_page(context)
    seen_ms = float(await page.evaluate("window.__seenMs"))
    await page.close()
    return seen_ms / 1e3


async def _grey_time_s(page: Page, cell: str, player: "subprocess.Popen[str]", how: signal.Signals) -> float:
    """Return how many seconds after a signal to a cell's process its row is no longer that of one online."""
    row = page.locator(f'[data-testid="cell-{cell}"]')
    await page.locator(f'[data-testid="cell-{cell}"][data-link="online"]').wait_for()
    began_s = time.monotonic()
    player.send_signal(how)
    await page.locator(f'[data-testid="cell-{cell}"]:not([data-link="online"])').wait_for()
    took_s = time.monotonic() - began_s
    await row.scroll_into_view_if_needed()
    return took_s


def _start_players(players: list["subprocess.Popen[str]"]) -> None:
    for player in players:
        assert player.stdout is not None
        assert player.stdin is not None
        assert player.stdout.readline() == "ready\n"
    for player in players:
        assert player.stdin is not None
        player.stdin.write("go\n")
        player.stdin.flush()


def _stop_players(players: list["subprocess.Popen[str]"]) -> None:
    for player in players:
        player.kill()
        player.wait()
