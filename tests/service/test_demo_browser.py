"""The demo's bar in a real browser: in every language, readable and large enough for gloves; all screens show a press."""

import json
from pathlib import Path

from playwright.async_api import Browser, Page, expect

from cellcal.service.demo.faults import DEMO_FAULTS
from cellcal.service.demo.web_routes import CLEARED, DemoExtension
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.browser_pages import (
    COUNT_ASKED,
    LOCALES,
    NO_WEBGL,
    PATIENCE_MS,
    ROOT,
    go_to_page,
    hold_to_rules,
    layout_faults,
    locales_for,
    open_chromium,
    serve_app,
    wait_for_language,
)
from tests.service.cell_process_session import a_cell

PERSONS_ACTIONS = (
    "new_battery",
    "power_cycle",
    "mount_wire",
    "hook_wire",
    "wire_home",
    "jog",
)  # as service/demo/technician_actions.py gives them


async def test_the_demos_buttons_are_for_everybody_and_a_pressed_loss_is_noticed(tmp_path: Path) -> None:
    async with a_cell(tmp_path) as (path, fake_client):
        app = create_app(
            ServiceSettings(path, demo=True, open_access=True, extension=DemoExtension(fake_client))
        )
        async with serve_app(app) as url, open_chromium() as browser:
            await _check_bar(browser, f"{url}/")


def test_all_that_can_happen_has_its_words_in_every_language() -> None:
    action_keys = {f"hand_{name}" for name in PERSONS_ACTIONS}
    expected_keys = {
        f"demo_do_{name}" for name in {each.name for each in DEMO_FAULTS} | action_keys | {CLEARED}
    }
    expected_keys |= {f"demo_kind_{each.kind}" for each in DEMO_FAULTS}
    for locale in LOCALES:
        texts = json.loads((ROOT / f"web/src/locales/{locale}.json").read_text(encoding="utf-8"))
        assert expected_keys - texts.keys() == set(), locale


async def _check_refusal(page: Page) -> None:
    """What the demo refuses is said in the page's language: here the service is asked for what it does not have."""
    await page.route(
        "**/api/demo/faults", lambda route: route.continue_(post_data=json.dumps({"name": "flood"}))
    )
    await page.get_by_test_id("demo-battery").click()
    refused = page.get_by_test_id("demo-refused")
    await expect(refused).to_contain_text("Die Demo kennt keinen Fehler 'flood'. Wählen Sie battery, ")


async def _check_bar(browser: Browser, url: str) -> None:
    first = await _open_page(browser, url, "en")
    for locale in sorted({*locales_for("the bar"), "de"}):
        page = await _open_page(browser, url, locale)
        texts = json.loads((ROOT / f"web/src/locales/{locale}.json").read_text(encoding="utf-8"))
        await wait_for_language(page, locale)
        await expect(page.get_by_test_id("demo")).to_contain_text(texts["demo"])
        await hold_to_rules(page, locale)
        if locale == "de":
            await _check_refusal(page)
        await page.context.close()
    await first.get_by_test_id("demo-battery").click()
    await first.get_by_test_id("loss").wait_for()
    await _check_first_of_all(first)
    await first.get_by_test_id("demo-open").click()
    await expect(first.get_by_test_id("demo-pressed").locator("li")).to_have_count(1)
    other = await _open_page(browser, url, "en")
    await expect(other.get_by_test_id("demo-last")).to_contain_text("Encoder battery dies")


async def _check_first_of_all(page: Page) -> None:
    """With a loss the home page is about it: one button, all else folded away; the tour goes on and can be left."""
    await expect(page.get_by_test_id("loss-first")).to_be_in_viewport()
    await expect(page.get_by_test_id("first-button")).to_have_attribute(
        "href", "#/procedure/mastering_recovery"
    )
    await expect(page.get_by_test_id("intention-tool")).to_be_hidden()
    await expect(page.get_by_test_id("glance-position")).to_have_attribute("data-tone", "bad")
    await go_to_page(page, "#/procedure/drift_check")
    await expect(page.get_by_test_id("position-first")).to_be_visible()
    await expect(page.get_by_test_id("start")).to_be_disabled()
    await go_to_page(page, "#/procedure/mastering_recovery")
    await expect(page.get_by_test_id("cannot-start")).to_be_visible()  # no record was taken in this cell
    await expect(page.get_by_test_id("position-first")).to_have_count(0)
    await page.evaluate("location.hash = '#/'")
    await expect(page.get_by_test_id("loss-first")).to_be_visible()
    await expect(page.get_by_test_id("tour")).to_have_attribute("data-step", "2")
    await hold_to_rules(page, "home with a loss")
    await page.get_by_test_id("tour-leave").click()
    await expect(page.get_by_test_id("tour")).to_have_count(0)
    await page.set_viewport_size({"width": 390, "height": 844})
    assert await layout_faults(page) == []
    await page.reload()
    await page.get_by_test_id("demo-open").wait_for()
    await expect(page.get_by_test_id("tour")).to_have_count(0)


async def _open_page(browser: Browser, url: str, locale: str) -> Page:
    context = await browser.new_context(viewport={"width": 1280, "height": 800})
    await context.add_init_script(f"localStorage.setItem('locale', {json.dumps(locale)})")
    await context.add_init_script(f"{NO_WEBGL}; {COUNT_ASKED}")
    page = await context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    await page.goto(url)
    await page.get_by_test_id("demo-open").wait_for()
    return page
