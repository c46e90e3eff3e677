"""The demo's bar in a real browser: in every language, for everybody's eyes and gloves; a press is seen by all."""

import asyncio
import json
import socket
from pathlib import Path

import uvicorn
from playwright.async_api import Browser, Page, async_playwright

from service.web.app import Settings, create_app
from tests.service.desks import a_cell
from tests.service.test_pages import CHROMIUM, FLAGS, LOCALES, NO_WEBGL, OVERFULL, ROOT, RUN_AXE, SMALL

PATIENCE_MS = 120_000.0
AXE = ROOT / "web/node_modules/axe-core/axe.min.js"


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
        assert texts["demo"] in await page.get_by_test_id("demo").inner_text()
        await page.add_script_tag(content=AXE.read_text(encoding="utf-8"))
        assert await page.evaluate(RUN_AXE) == [], locale
        assert await page.evaluate(SMALL) == [], locale
        assert await page.evaluate(OVERFULL) == [], locale
        await page.context.close()
    await first.get_by_test_id("demo-battery").click()
    await first.get_by_test_id("loss").wait_for(timeout=PATIENCE_MS)
    assert await first.get_by_test_id("demo-pressed").locator("li").count() == 1
    other = await _page(browser, url, "en")
    assert "Encoder battery dies" in await other.get_by_test_id("demo-last").inner_text()


async def _page(browser: Browser, url: str, locale: str) -> Page:
    context = await browser.new_context(viewport={"width": 1280, "height": 800}, bypass_csp=True)
    await context.add_init_script(f"localStorage.setItem('locale', {json.dumps(locale)})")
    await context.add_init_script(NO_WEBGL)
    page = await context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    await page.goto(url)
    await page.get_by_test_id("demo-battery").wait_for()
    return page
