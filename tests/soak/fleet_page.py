"""The fleet's page over the real bus: how soon two hundred cells stand on it, and how soon one that left is grey."""

import asyncio
import os
import signal
import statistics
import subprocess
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager
from pathlib import Path

from playwright.async_api import BrowserContext, Page

from service.certificates.signing import station_key
from service.site.enrolment import Applicant, NewSite, enroll
from service.site.listener import Listener
from service.web.fleet import create_fleet_app
from tests.service.browsers import PATIENCE_MS, chromium, served
from tests.service.sites import SITE, free_port, router_of, until
from tests.soak.figures import Figures
from tests.soak.site import player_of

_CELLS = 200
_SPAN_S = 600.0
_PATIENCE_S = 300.0
_MOST_OPENED_S, _MOST_GREY_S = 1.0, 2.0
_STAMP = """{ const look = new MutationObserver(() => {
    if (document.querySelectorAll('tbody tr').length < %d) return;
    look.disconnect(); window.__seenMs = performance.now(); });
    look.observe(document, {subtree: true, childList: true}); }"""


def fleet(rounds: int) -> Figures:
    """Open the page so often; kill so many cells' processes, and freeze as many, as a pulled cable would."""
    opened, closed, frozen = asyncio.run(_fleet(rounds))
    line = (
        f"fleet: {_CELLS} cells drawn {_told(opened)} after the navigation (at most {_MOST_OPENED_S:g} s); a cell "
        f"whose process was killed is grey {_told(closed)} later (at most {_MOST_GREY_S:g} s), one that was frozen, "
        f"as by a pulled cable, {_told(frozen)} later; load of the computer {os.getloadavg()[0]:.1f} on "
        f"{os.cpu_count()} cores"
    )
    return Figures(line, statistics.median(opened) <= _MOST_OPENED_S and max(closed) <= _MOST_GREY_S)


def _told(seconds: list[float]) -> str:
    return f"{statistics.median(seconds):.2f} s ({max(seconds):.2f} at most of {len(seconds)})"


async def _fleet(rounds: int) -> tuple[list[float], list[float], list[float]]:
    names = [f"cell-{k:04d}" for k in range(_CELLS)]
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        root = Path(name)
        keys = {cell: station_key(root / "keys" / cell) for cell in names}
        applicants = [Applicant(cell, key.public) for cell, key in keys.items()]
        enroll(root / "site", applicants, NewSite(SITE, f"127.0.0.1:{free_port()}"))
        stack.enter_context(router_of(root / "site"))
        listener = stack.enter_context(Listener(root / "site/monitor", root / "s.sqlite", patience_s=60))
        leaving = names[: 2 * rounds]
        players = [
            player_of(root, some, _SPAN_S) for some in (names[2 * rounds :], *([one] for one in leaving))
        ]
        stack.callback(_end, players)
        await asyncio.to_thread(_begin, players)
        await asyncio.to_thread(until, lambda: all(map(listener.fleet.is_alive, names)), _PATIENCE_S)
        async with _context_of(listener, root) as context:
            opened = [await _opened(context) for _ in range(rounds)]
            page = await _page(context)
            closed = [
                await _grey(page, cell, player, signal.SIGKILL)
                for cell, player in zip(leaving[:rounds], players[1:], strict=False)
            ]
            frozen = [
                await _grey(page, cell, player, signal.SIGSTOP)
                for cell, player in zip(leaving[rounds:], players[1 + rounds :], strict=True)
            ]
        return opened, closed, frozen


@asynccontextmanager
async def _context_of(listener: Listener, folder: Path) -> AsyncIterator[BrowserContext]:
    """Open a browser that is signed in at the monitor's service."""
    app = create_fleet_app(listener, folder)
    async with served(app) as url, chromium() as browser:
        context = await browser.new_context(viewport={"width": 1280, "height": 800}, base_url=url)
        context.set_default_timeout(PATIENCE_MS)
        await context.add_init_script(_STAMP % _CELLS)
        page = await context.new_page()
        await page.goto(f"/api/sign-in/console?token={app.state.house.entrance.console_token()}")
        await page.wait_for_function("window.__seenMs !== undefined")
        await page.close()
        yield context


async def _page(context: BrowserContext) -> Page:
    page = await context.new_page()
    await page.goto("/")
    await page.wait_for_function("window.__seenMs !== undefined")
    return page


async def _opened(context: BrowserContext) -> float:
    """Return after how many seconds from the navigation all cells stood on the page."""
    page = await _page(context)
    seen_ms = float(await page.evaluate("window.__seenMs"))
    await page.close()
    return seen_ms / 1e3


async def _grey(page: Page, cell: str, player: "subprocess.Popen[str]", how: signal.Signals) -> float:
    """Return how many seconds after a signal to a cell's process its row is no longer that of one online."""
    row = page.locator(f'[data-testid="cell-{cell}"]')
    await page.locator(f'[data-testid="cell-{cell}"][data-link="online"]').wait_for()
    began_s = time.monotonic()
    player.send_signal(how)
    await page.locator(f'[data-testid="cell-{cell}"]:not([data-link="online"])').wait_for()
    took_s = time.monotonic() - began_s
    await row.scroll_into_view_if_needed()
    return took_s


def _begin(players: list["subprocess.Popen[str]"]) -> None:
    for player in players:
        assert player.stdout is not None
        assert player.stdin is not None
        assert player.stdout.readline() == "ready\n"
    for player in players:
        assert player.stdin is not None
        player.stdin.write("go\n")
        player.stdin.flush()


def _end(players: list["subprocess.Popen[str]"]) -> None:
    for player in players:
        player.kill()
        player.wait()
