"""An app served in this process and Chromium to look at it; when a page is at rest, and what every page is held to.

A page shows what a fetch or the socket brought, some time after whatever caused it. So a test waits for what it
asserts: by Playwright's `expect`, to which importing this module gives patience, or by `comes`.
"""

import asyncio
import os
import shutil
import socket
import zlib
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, TypeVar

import uvicorn
from fastapi import FastAPI
from playwright.async_api import Browser, Locator, Page, async_playwright, expect

from cellcal.service.web.middleware import RequestBudget, RequestFilter
from cellcal.service.web.pages import DIST
from cellcal.service.web.server import WebServer
from tests.machine_speed import stretched_s

ROOT = Path(__file__).parents[2]
PATIENCE_S = stretched_s(90.0)
PATIENCE_MS = 1000.0 * PATIENCE_S
EVERY_S = 0.05
LOCALES = ("en", "de", "es", "zh")
# As deploy/prepare_machine.sh looks for it.
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
WINDOWLESS_CHROMIUM = shutil.which("chromium-headless-shell")
FLAGS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-fake-device-for-media-stream"]
SERVED: dict[str, Any] = {
    "log_level": "warning",
    "ws": "websockets-sansio",
    "timeout_graceful_shutdown": 2,
}
NO_WEBGL = """{ const drawn = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
        return kind.startsWith('webgl') ? null : drawn.call(this, kind, ...more); } }"""
# Chooses a language, also where a dialog covers the choice.
CHOOSE = """([choice, locale]) => {
    choice.value = locale; choice.dispatchEvent(new Event('change', {bubbles: true})); }"""
Value = TypeVar("Value")

expect.set_options(timeout=PATIENCE_MS)

AXE = ROOT / "web/node_modules/axe-core/axe.min.js"
# Only the enhanced contrast is looked at: what keeps 7:1 keeps 4.5:1, too.
RUN_AXE = """async (coloursToo) => (await axe.run(document, {resultTypes: ['violations'], preload: false,
    runOnly: ['wcag2a', 'wcag2aa', 'wcag21aa', 'wcag22aa'],
    rules: {'color-contrast': {enabled: false}, 'color-contrast-enhanced': {enabled: coloursToo}}}))
    .violations.map(v => v.id + ': ' + v.nodes.map(n => n.html.slice(0, 120)).join(' | '))"""
RUN_AXE_ON_COLOURS = """async () => (await axe.run(document, {resultTypes: ['violations'], preload: false,
    runOnly: {type: 'rule', values: ['color-contrast-enhanced']}}))
    .violations.map(v => v.id + ': ' + v.nodes.map(n => n.html.slice(0, 120)).join(' | '))"""
THEMES = ("usual", "dark", "bright")
SHOW_THEME = "(theme) => { document.documentElement.dataset.theme = theme; }"
BUTTONS = "button, a.button, select, input:not([type=file]), summary"
CRAMPED = """(buttons) => {
    const shown = document.querySelector('dialog[open]') ?? document;
    const boxes = [...shown.querySelectorAll(buttons)].filter(e => e.checkVisibility())
        .map(e => [e.outerHTML.slice(0, 90), e.getBoundingClientRect(), e]);
    const seen = boxes.map(([html, box, e]) => {  // what is scrolled away cannot be hit
        let {left, top, right, bottom} = box, above = null;  // and what stands above the page covers it
        for (let p = e.parentElement; p; p = p.parentElement) {
            const how = getComputedStyle(p), q = p.getBoundingClientRect();
            if (how.position === 'sticky' || how.position === 'fixed') above = p;
            if (how.overflow === 'visible') continue;
            [left, top] = [Math.max(left, q.left), Math.max(top, q.top)];
            [right, bottom] = [Math.min(right, q.right), Math.min(bottom, q.bottom)];
        }
        return [html, {left, top, right, bottom}, above]; }).filter(([, b]) => b.left < b.right && b.top < b.bottom);
    const wrong = boxes.filter(([, b]) => b.height < 44 || b.width < 44).map(([html]) => 'small: ' + html);
    for (const [html, b, e] of boxes) if (e.scrollWidth > e.clientWidth + 1 && e.tagName !== 'INPUT'
        && e.tagName !== 'SELECT') wrong.push('overfull: ' + html);
    for (let i = 0; i < seen.length; i++) for (let j = i + 1; j < seen.length; j++) {
        const [p, q] = [seen[i][1], seen[j][1]];
        const dx = Math.max(p.left - q.right, q.left - p.right), dy = Math.max(p.top - q.bottom, q.top - p.bottom);
        if (seen[i][2] === seen[j][2] && Math.max(dx, dy) < 8 - 0.01)
            wrong.push('close: ' + seen[i][0] + ' and ' + seen[j][0]);
    }
    // The keys that stay at the bottom never stand over the words that they answer.
    const [told, keys] = ['[data-testid=instruction]', '[data-testid=prompt] .buttons'].map(s => document.querySelector(s));
    if (told && keys && told.getBoundingClientRect().bottom > keys.getBoundingClientRect().top + 1)
        wrong.push('keys over the words that they answer');
    const lows = [['.main, [data-testid=hold], [data-testid=stop]', 75.5], ['[data-testid^=key-]', 64]]; // 20 mm
    for (const [keys, least] of lows) for (const e of document.querySelectorAll(keys))
        if (e.checkVisibility() && e.getBoundingClientRect().height < least)
            wrong.push('low: ' + e.outerHTML.slice(0, 90));
    if (document.documentElement.scrollWidth > innerWidth + 1) wrong.push('wider than the screen');
    return wrong;
}"""
# The page counts what it has asked for and not heard of; an answer counts as heard when its readers have run.
COUNT_ASKED = """{ const ask = window.fetch; window.__asked = 0;
    window.fetch = async (...what) => { window.__asked += 1;
        try { const told = await ask(...what); await told.clone().arrayBuffer(); return told; }
        finally { setTimeout(() => { window.__asked -= 1; }); } }; }"""
AT_REST = """() => !window.__asked
    && !document.querySelector('main .pulse:not([aria-hidden]), dialog .pulse:not([aria-hidden])')"""
DRAWN = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"
GO = """(place) => new Promise((done) => {
    if (location.hash === place) return done(true);
    addEventListener('hashchange', () => setTimeout(() => done(true)), {once: true});
    location.hash = place; })"""


@asynccontextmanager
async def serve_app(app: FastAPI, **how: Any) -> AsyncIterator[str]:
    """Serve an app on a free port of loopback while the block lasts; yields its address, as http://127.0.0.1:port.

    All browsers of a test have the same address: they may ask as often as they like.
    """
    allow_many_requests(app)
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        server = WebServer(uvicorn.Config(app, **SERVED | how))
        serving = asyncio.create_task(server.serve([listening]))
        try:
            while not (server.started or serving.done()):
                await asyncio.sleep(EVERY_S)
            yield f"http://127.0.0.1:{listening.getsockname()[1]}"
        finally:
            server.should_exit = True
            await serving


def allow_many_requests(app: FastAPI, **budgets: RequestBudget) -> None:
    """Let one address ask as often as it likes, but for the kinds that are named; what was set before stays."""
    many = RequestBudget(burst=100_000.0, rate_hz=10_000.0)
    for each in app.user_middleware:
        if each.cls is RequestFilter and "budgets" not in each.kwargs:
            each.kwargs["budgets"] = {"sign-in": many, "orders": many, "else": many} | budgets


@asynccontextmanager
async def open_chromium(*, whole: bool = False, **environment: str) -> AsyncIterator[Browser]:
    """Open a browser for the built pages, with more in its environment.

    Where the machine has the one without windows it is taken: it opens a page in a quarter of the processor time. The
    ``whole`` browser has a camera, and is what people have.
    """
    assert CHROMIUM, "The pages are looked at in Chromium, which is not installed: apt-get install chromium"
    assert (DIST / "index.html").is_file(), "The pages are not built: run `make pages`."
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(
            executable_path=CHROMIUM if whole else WINDOWLESS_CHROMIUM or CHROMIUM,
            args=FLAGS,
            env={**os.environ, **environment},
        )
        try:
            yield browser
        finally:
            await browser.close()


async def wait_for_value(read: Callable[[], Awaitable[Value]], right: Callable[[Value], Any] = bool) -> Value:
    """Read until what is read is right, and return it; who waits in vain is told what was read last."""
    ends_s = asyncio.get_running_loop().time() + PATIENCE_S
    while not right(value := await read()):
        assert asyncio.get_running_loop().time() < ends_s, f"it never came true; read last: {value!r}"
        await asyncio.sleep(EVERY_S)
    return value


async def at_rest(page: Page) -> None:
    """Wait until nothing that the page asked for is under way, and what came is drawn."""
    await page.wait_for_function(AT_REST, timeout=PATIENCE_MS)
    await page.evaluate(DRAWN)


async def go_to_page(page: Page, place: str) -> None:
    """Open another page of the app, and wait until it is there, and not the one before."""
    await page.evaluate(GO, place)
    await expect(page.locator("main h1").first).to_be_visible()
    await at_rest(page)


async def unfold(part: Locator | Page) -> None:
    """Open the first part that is folded, as a person does: who sees it still folded taps again."""
    summary = part.locator("summary").first
    ends_s = asyncio.get_running_loop().time() + PATIENCE_S
    while not await summary.evaluate("summary => summary.parentElement.open"):
        assert asyncio.get_running_loop().time() < ends_s, "it stays folded"
        await summary.click()  # a picture that is drawn in this moment can move the line away under the tap


async def wait_for_language(page: Page, locale: str) -> None:
    """Wait until the page is in a language."""
    await expect(page.locator("html")).to_have_attribute("lang", {"zh": "zh-Hans"}.get(locale, locale))


async def axe_violations(page: Page, *, with_colours: bool = True) -> list[str]:
    """Return what axe finds wrong with the page at rest."""
    await at_rest(page)
    if not await page.evaluate("'axe' in window"):
        await page.evaluate(AXE.read_text(encoding="utf-8"))
    found: list[str] = await page.evaluate(RUN_AXE, with_colours)
    return found


async def theme_faults(page: Page, where: str) -> list[str]:
    """Return what axe finds wrong with the colours of the page at rest in another theme, which the place chooses.

    In both others for `make soak ARGS=languages`; tests/service/test_colours.py compares all pairs of colours.
    """
    found: list[str] = []
    before = await page.evaluate("document.documentElement.dataset.theme")
    for theme in some_of([theme for theme in THEMES if theme != before], where):
        await page.evaluate(SHOW_THEME, theme)
        await page.evaluate(DRAWN)
        found += [f"{theme}: {fault}" for fault in await page.evaluate(RUN_AXE_ON_COLOURS)]
    await page.evaluate(SHOW_THEME, before)
    await page.evaluate(DRAWN)
    return found


async def layout_faults(page: Page) -> list[str]:
    """Return what a glove would miss, what is longer than its place, and whether the page is too wide."""
    found: list[str] = await page.evaluate(CRAMPED, BUTTONS)
    return found


async def hold_to_rules(page: Page, where: str) -> None:
    """Hold a page at rest to its accessibility, to targets for gloves and their gaps, and to texts that fit.

    Its colours are looked at in English, in two themes: a colour depends on no language.
    """
    is_english = await page.evaluate("document.documentElement.lang") == "en"
    wrong = [*await axe_violations(page, with_colours=is_english), *await layout_faults(page)]
    if is_english:
        wrong += await theme_faults(page, where)
    assert not wrong, (where, wrong)


def some_of(all_of_them: Sequence[Value], where: str, *, every: int = 0) -> Sequence[Value]:
    """Return the one that a name chooses, or with ``every`` each so many-th; all for `make soak ARGS=languages`."""
    if os.environ.get("CELLCAL_PAGES_IN_FULL"):
        return all_of_them
    first = zlib.crc32(where.encode()) % (every or len(all_of_them))
    return all_of_them[first :: every or len(all_of_them)]


def locales_for(where: str) -> tuple[str, ...]:
    """Return the languages in which a place is looked at: another one, which its name chooses, and then English.

    All four where `make soak ARGS=languages` asks for them; every text in each is compared without a browser.
    """
    return (*some_of(LOCALES[1:], where), LOCALES[0])


async def hold_to_rules_in_languages(page: Page, where: str) -> None:
    """Hold a page to the rules in the languages that `locales_for` chooses, and bring it back to English."""
    choice = page.get_by_test_id("language")
    for locale in locales_for(where):
        await page.evaluate(CHOOSE, [await choice.element_handle(), locale])
        await wait_for_language(page, locale)
        await hold_to_rules(page, f"{where} in {locale}")
