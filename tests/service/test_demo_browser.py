"""The demo's bar in a real browser: in every language, for everybody's eyes and gloves; a press is seen by all."""

import json
from pathlib import Path

from playwright.async_api import Browser, Page, expect

from cellcal.service.demo.faults import DEMO_FAULTS
from cellcal.service.demo.web_routes import CLEARED, DemoExtension
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.browsers import (
    COUNT_ASKED,
    LOCALES,
    NO_WEBGL,
    PATIENCE_MS,
    ROOT,
    chromium,
    hold_to_rules,
    served,
    speaks,
)
from tests.service.desks import a_cell

HANDS = (
    "new_battery",
    "power_cycle",
    "mount_wire",
    "hook_wire",
    "wire_home",
    "jog",
)  # as service/demo/technician_actions.py lends them


async def test_the_demos_buttons_are_for_everybody_and_a_pressed_loss_is_noticed(tmp_path: Path) -> None:
    async with a_cell(tmp_path) as (path, door):
        app = create_app(ServiceSettings(path, demo=True, open_access=True, extension=DemoExtension(door)))
        async with served(app) as url, chromium() as browser:
            await _look(browser, f"{url}/")


def test_all_that_can_happen_has_its_words_in_every_language() -> None:
    hands = {f"hand_{name}" for name in HANDS}
    wanted = {f"demo_do_{name}" for name in {each.name for each in DEMO_FAULTS} | hands | {CLEARED}}
    wanted |= {f"demo_kind_{each.kind}" for each in DEMO_FAULTS}
    for locale in LOCALES:
        texts = json.loads((ROOT / f"web/src/locales/{locale}.json").read_text(encoding="utf-8"))
        assert wanted - texts.keys() == set(), locale


async def _refused(page: Page) -> None:
    """What the demo refuses is said in the page's language: here the service is asked for what it does not have."""
    await page.route(
        "**/api/demo/mishaps", lambda route: route.continue_(post_data=json.dumps({"name": "flood"}))
    )
    await page.get_by_test_id("demo-battery").click()
    refused = page.get_by_test_id("demo-refused")
    await expect(refused).to_contain_text("die Demo kennt kein Missgeschick 'flood'. Wählen Sie battery, ")


async def _look(browser: Browser, url: str) -> None:
    first = await _page(browser, url, "en")
    for locale in LOCALES:
        page = await _page(browser, url, locale)
        texts = json.loads((ROOT / f"web/src/locales/{locale}.json").read_text(encoding="utf-8"))
        await speaks(page, locale)
        await expect(page.get_by_test_id("demo")).to_contain_text(texts["demo"])
        await hold_to_rules(page, locale)
        if locale == "de":
            await _refused(page)
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
