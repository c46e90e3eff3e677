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

from tests.service.browser_pages import CHROMIUM, NO_WEBGL, PATIENCE_MS, PATIENCE_S
from tests.service.cell_process_session import a_cell
from tests.service.service_with_tablets import ServiceWithTablets, open_service_with_tablets, sign_in
from tests.service.test_fonts import LATIN_ONLY
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.slow_link import SlowLink, slow_link_to

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
class ColdOpening:
    """One cold opening: seconds from the navigation to what is waited for; bytes over the link until it is still."""

    shown_s: float
    byte_count: int
    drawn_s: float = 0.0  # until the last piece of a font that the device lacks was there
    pieces: int = 0


def cold(rounds: int) -> CampaignFigures:
    """Open the page so many times in each of six ways; a font that a device lacks counts as well."""
    found = asyncio.run(_open_rounds(rounds))
    chinese = found[_CHINESE]
    parts = [
        f"{how} {statistics.median(each.shown_s for each in opened):.2f} s "
        f"({max(each.shown_s for each in opened):.2f} s at most), "
        f"{max(each.byte_count for each in opened) / 1e3:.0f} kB at most"
        for how, opened in found.items()
    ]
    every = [each for opened in found.values() for each in opened]
    reached = max(each.byte_count for each in every) <= MOST_BYTES and all(
        statistics.median(each.shown_s for each in opened) <= MOST_S for opened in found.values()
    )
    drawn_s = [each.drawn_s for each in chinese]
    line = (
        f"cold: {rounds} openings each over {RATE_BIT_S / 1e6:g} Mbit/s + {2e3 * DELAY_S:g} ms, from the "
        f"navigation to what is waited for: {'; '.join(parts)} (at most {MOST_S:g} s in the median, "
        f"{MOST_BYTES / 1e3:g} kB); all {max(each.pieces for each in chinese)} pieces of the Chinese "
        f"font are there after {statistics.median(drawn_s):.2f} s ({max(drawn_s):.2f} s at most); load of the "
        f"computer {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    )
    return CampaignFigures(line, reached)


async def _open_rounds(rounds: int) -> dict[str, list[ColdOpening]]:
    found: dict[str, list[ColdOpening]] = {}
    with tempfile.TemporaryDirectory() as folder:
        async with _open_signed_in(Path(folder)) as (tablet_service, link, browser):
            async with _signed_in_context(tablet_service, link, browser, drawing=True) as context:
                found["a live value, signed in, with the picture"] = [
                    await _open_page(context, link, _LIVE, drawn=True) for _ in range(rounds)
                ]
            async with _signed_in_context(
                tablet_service, link, browser, drawing=True, locale="de-DE"
            ) as context:
                found["the same in German"] = [
                    await _open_page(context, link, _LIVE, drawn=True) for _ in range(rounds)
                ]
            async with _signed_in_context(tablet_service, link, browser, drawing=False) as context:
                found["signed in, without the picture"] = [
                    await _open_page(context, link, _LIVE) for _ in range(rounds)
                ]
                found["enrolled, its session over"] = [
                    await _open_page(context, link, _LIVE, forgotten=True) for _ in range(rounds)
                ]
            async with (
                _without_chinese(Path(folder)) as another,
                _signed_in_context(tablet_service, link, another, drawing=True, locale="zh-CN") as context,
            ):
                found[_CHINESE] = [await _open_page(context, link, _LIVE, drawn=True) for _ in range(rounds)]
            context = await browser.new_context()
            found["an unknown one, told so"] = [
                await _open_page(context, link, _UNKNOWN) for _ in range(rounds)
            ]
            await context.close()
    return found


@asynccontextmanager
async def _open_signed_in(folder: Path) -> AsyncIterator[tuple[ServiceWithTablets, SlowLink, Browser]]:
    async with AsyncExitStack() as stack:
        path, _ = await stack.enter_async_context(a_cell(folder, time_factor=1.0))
        tablet_service = await stack.enter_async_context(open_service_with_tablets(path))
        link = await stack.enter_async_context(
            slow_link_to(tablet_service.port, rate_bit_s=RATE_BIT_S, delay_s=DELAY_S)
        )
        await tablet_service.wait_until(lambda session: session["connection"]["connected"])
        yield tablet_service, link, await stack.enter_async_context(_open_chromium())


@asynccontextmanager
async def _open_chromium(**environment: str) -> AsyncIterator[Browser]:
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
    async with _open_chromium(FONTCONFIG_FILE=str(config)) as browser:
        yield browser


@asynccontextmanager
async def _signed_in_context(
    tablet_service: ServiceWithTablets,
    link: SlowLink,
    browser: Browser,
    *,
    drawing: bool,
    locale: str = "en-US",
) -> AsyncIterator[BrowserContext]:
    """Enrol a tablet and sign Tom in, before anything is measured."""
    context = await browser.new_context(viewport={"width": 1280, "height": 800}, locale=locale)
    context.set_default_timeout(PATIENCE_MS)
    if not drawing:
        await context.add_init_script(NO_WEBGL)
    page = await context.new_page()
    await tablet_service.enrol_tablet(page, f"tablet {drawing} {locale}", link.port)
    await sign_in(page, "Tom")
    await page.locator(_LIVE).wait_for()
    await page.close()
    yield context
    await context.close()


async def _open_page(
    context: BrowserContext, link: SlowLink, awaited: str, *, drawn: bool = False, forgotten: bool = False
) -> ColdOpening:
    """Open the page with an empty cache and no connection; the tablet's key stays, its session unless it is over."""
    if forgotten:
        await context.clear_cookies()
    page = await context.new_page()
    line = await context.new_cdp_session(page)
    await line.send("Network.clearBrowserCache")
    await page.add_init_script(_STAMP % awaited)
    await link.let_go()
    before = link.carried_bytes
    await page.goto(f"http://127.0.0.1:{link.port}/", wait_until="commit")
    await _poll_page(page, "window.__seenMs !== undefined")
    if drawn:
        await _poll_page(page, _DRAWN)
    await page.wait_for_load_state("networkidle")
    fonts_ms = await page.evaluate(_FONTS)
    opened = ColdOpening(
        await page.evaluate("window.__seenMs") / 1e3,
        link.carried_bytes - before,
        max(fonts_ms, default=0.0) / 1e3,
        len(fonts_ms),
    )
    await page.close()
    return opened


async def _poll_page(page: Page, true: str) -> None:
    """Ask the page again and again: its content security policy forbids Playwright's own waiting."""
    async with asyncio.timeout(PATIENCE_S):
        while not await page.evaluate(true):
            await asyncio.sleep(0.05)
