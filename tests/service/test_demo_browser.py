"""The demo's bar in a real browser: in every language, for everybody's eyes and gloves; a press is seen by all."""

import asyncio
import json
import socket
from pathlib import Path

import uvicorn
from playwright.async_api import Browser, Page, async_playwright, expect

from service.web.app import Settings, create_app
from tests.service.browsers import COUNT_ASKED, LOCALES, PATIENCE_MS, ROOT, hold_to_rules, speaks
from tests.service.desks import a_cell
from tests.service.test_pages import CHROMIUM, FLAGS, NO_WEBGL


async def test_the_demos_buttons_are_for_everybody_and_a_pressed_loss_is_noticed(tmp_path: Path) -> None:
    assert CHROMIUM, (
        "This test looks at the pages in Chromium, which is not installed: apt-get install chromium"
    )
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        async with a_cell(tmp_path) as (path, door), async_playwright() as playwright:
            app = create_app(Settings(path, demo=True, open_access=True, demo_door=door))
            server = uvicorn.Server(
                uvicorn.Config(app, log_level="warning", ws="websockets-sansio", timeout_graceful_shutdown=2)
            )
            serving = asyncio.create_task(server.serve([listening]))
            browser = await playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
            try:
                await _look(browser, f"http://127.0.0.1:{listening.getsockname()[1]}/")
            finally:
                await browser.close()
                server.should_exit = True
                await serving


async def _look(browser: Browser, url: str) -> None:
    first = await _page(browser, url, "en")
    for locale in LOCALES:
        page = await _page(browser, url, locale)
        texts = json.loads((ROOT / f"web/src/locales/{locale}.json").read_text(encoding="utf-8"))
        await speaks(page, locale)
        await expect(page.get_by_test_id("demo")).to_contain_text(texts["demo"])
        await hold_to_rules(page, locale)
        await page.context.close()
    await first.get_by_test_id("demo-battery").click()
    await first.get_by_test_id("loss").wait_for()
    await expect(first.get_by_test_id("demo-pressed").locator("li")).to_have_count(1)
    other = await _page(browser, url, "en")
    await expect(other.get_by_test_id("demo-last")).to_contain_text("Encoder battery dies")


async def _page(browser: Browser, url: str, locale: str) -> Page:
    context = await browser.new_context(viewport={"width": 1280, "height": 800})
    await context.add_init_script(f"localStorage.setItem('locale', {json.dumps(locale)})")
    await context.add_init_script(f"{NO_WEBGL}; {COUNT_ASKED}")
    page = await context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    await page.goto(url)
    await page.get_by_test_id("demo-battery").wait_for()
    return page
