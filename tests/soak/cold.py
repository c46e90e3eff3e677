"""A page opened cold over a slow wireless link: how soon a live value stands on it, and how many bytes that takes."""

import asyncio
import os
import statistics
import tempfile
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from playwright.async_api import Browser, BrowserContext, Page, async_playwright

from tests.service.browsers import CHROMIUM, NO_WEBGL, PATIENCE_MS, PATIENCE_S
from tests.service.desks import a_cell
from tests.service.shop import Shop, a_shop, sign_in
from tests.service.test_fonts import LATIN_ONLY
from tests.soak.figures import Figures
from tests.soak.slow_link import SlowLink, a_slow_link

RATE_BIT_S, DELAY_S = 4.0e6, 0.020
MOST_S, MOST_BYTES = 1.0, 450_000
_FLAGS = ["--no-sandbox", "--enable-unsafe-swiftshader"]
_LIVE = "[data-testid=gauge][data-stale=false]"
_UNKNOWN = "[data-testid=unknown-device]"
_DRAWN = "window.__robot !== undefined && window.__robot.frames > 0"
_CHINESE = "signed in, in Chinese on a device without a Chinese font, with the picture"
_FONTS = """performance.getEntriesByType('resource').filter((one) => one.name.endsWith('.woff2'))
    .map((one) => one.responseEnd)"""
_STAMP = """{ const look = new MutationObserver(() => {
    if (!document.querySelector('%s')) return;
    look.disconnect(); window.__seenMs = performance.now(); });
    look.observe(document, {subtree: true, childList: true, attributes: true}); }"""


@dataclass(frozen=True)
class Opened:
    """One cold opening: seconds from the navigation to what is waited for; bytes over the link until it is still."""

    seen_s: float
    carried: int
    drawn_s: float = 0.0  # until the last piece of a font that the device lacks was there
    pieces: int = 0


def cold(rounds: int) -> Figures:
    """Open the page so many times in each of six ways; a font that a device lacks counts as well."""
    found = asyncio.run(_cold(rounds))
    chinese = found[_CHINESE]
    parts = [
        f"{how} {statistics.median(each.seen_s for each in opened):.2f} s "
        f"({max(each.seen_s for each in opened):.2f} s at most), "
        f"{max(each.carried for each in opened) / 1e3:.0f} kB at most"
        for how, opened in found.items()
    ]
    every = [each for opened in found.values() for each in opened]
    reached = max(each.carried for each in every) <= MOST_BYTES and all(
        statistics.median(each.seen_s for each in opened) <= MOST_S for opened in found.values()
    )
    drawn_s = [each.drawn_s for each in chinese]
    line = (
        f"cold: {rounds} openings each over {RATE_BIT_S / 1e6:g} Mbit/s + {2e3 * DELAY_S:g} ms, from the "
        f"navigation to what is waited for: {'; '.join(parts)} (at most {MOST_S:g} s in the median, "
        f"{MOST_BYTES / 1e3:g} kB); all {max(each.pieces for each in chinese)} pieces of the Chinese "
        f"font are there after {statistics.median(drawn_s):.2f} s ({max(drawn_s):.2f} s at most); load of the "
        f"computer {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    )
    return Figures(line, reached)


async def _cold(rounds: int) -> dict[str, list[Opened]]:
    found: dict[str, list[Opened]] = {}
    with tempfile.TemporaryDirectory() as folder:
        async with _at_hand(Path(folder)) as (shop, link, browser):
            async with _known(shop, link, browser, drawing=True) as context:
                found["a live value, signed in, with the picture"] = [
                    await _open(context, link, _LIVE, drawn=True) for _ in range(rounds)
                ]
            async with _known(shop, link, browser, drawing=True, locale="de-DE") as context:
                found["the same in German"] = [
                    await _open(context, link, _LIVE, drawn=True) for _ in range(rounds)
                ]
            async with _known(shop, link, browser, drawing=False) as context:
                found["signed in, without the picture"] = [
                    await _open(context, link, _LIVE) for _ in range(rounds)
                ]
                found["enrolled, its session over"] = [
                    await _open(context, link, _LIVE, forgotten=True) for _ in range(rounds)
                ]
            async with (
                _without_chinese(Path(folder)) as another,
                _known(shop, link, another, drawing=True, locale="zh-CN") as context,
            ):
                found[_CHINESE] = [await _open(context, link, _LIVE, drawn=True) for _ in range(rounds)]
            context = await browser.new_context()
            found["an unknown one, told so"] = [await _open(context, link, _UNKNOWN) for _ in range(rounds)]
            await context.close()
    return found


@asynccontextmanager
async def _at_hand(folder: Path) -> AsyncIterator[tuple[Shop, SlowLink, Browser]]:
    async with AsyncExitStack() as stack:
        path, _ = await stack.enter_async_context(a_cell(folder, time_factor=1.0))
        shop = await stack.enter_async_context(a_shop(path))
        link = await stack.enter_async_context(a_slow_link(shop.port, rate_bit_s=RATE_BIT_S, delay_s=DELAY_S))
        await shop.until(lambda session: session["connection"]["connected"])
        yield shop, link, await stack.enter_async_context(_chromium())


@asynccontextmanager
async def _chromium(**environment: str) -> AsyncIterator[Browser]:
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(
            executable_path=CHROMIUM, args=_FLAGS, env={**os.environ, **environment}
        )
        yield browser
        await browser.close()


@asynccontextmanager
async def _without_chinese(folder: Path) -> AsyncIterator[Browser]:
    config = folder / "fonts.conf"
    config.write_text(LATIN_ONLY.format(cache=folder / "fonts"))
    async with _chromium(FONTCONFIG_FILE=str(config)) as browser:
        yield browser


@asynccontextmanager
async def _known(
    shop: Shop, link: SlowLink, browser: Browser, *, drawing: bool, locale: str = "en-US"
) -> AsyncIterator[BrowserContext]:
    """Enrol a tablet and sign Tom in, before anything is measured."""
    context = await browser.new_context(viewport={"width": 1280, "height": 800}, locale=locale)
    context.set_default_timeout(PATIENCE_MS)
    if not drawing:
        await context.add_init_script(NO_WEBGL)
    page = await context.new_page()
    await shop.enrol(page, f"tablet {drawing} {locale}", link.port)
    await sign_in(page, "Tom")
    await page.locator(_LIVE).wait_for()
    await page.close()
    yield context
    await context.close()


async def _open(
    context: BrowserContext, link: SlowLink, wanted: str, *, drawn: bool = False, forgotten: bool = False
) -> Opened:
    """Open the page with an empty cache and no connection; the tablet's key stays, its session unless it is over."""
    if forgotten:
        await context.clear_cookies()
    page = await context.new_page()
    line = await context.new_cdp_session(page)
    await line.send("Network.clearBrowserCache")
    await page.add_init_script(_STAMP % wanted)
    await link.let_go()
    before = link.carried
    await page.goto(f"http://127.0.0.1:{link.port}/", wait_until="commit")
    await _until(page, "window.__seenMs !== undefined")
    if drawn:
        await _until(page, _DRAWN)
    await page.wait_for_load_state("networkidle")
    fonts_ms = await page.evaluate(_FONTS)
    opened = Opened(
        await page.evaluate("window.__seenMs") / 1e3,
        link.carried - before,
        max(fonts_ms, default=0.0) / 1e3,
        len(fonts_ms),
    )
    await page.close()
    return opened


async def _until(page: Page, true: str) -> None:
    """Ask the page again and again: its content security policy forbids Playwright's own waiting."""
    async with asyncio.timeout(PATIENCE_S):
        while not await page.evaluate(true):
            await asyncio.sleep(0.05)
