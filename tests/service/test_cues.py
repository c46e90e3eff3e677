"""U22: a tone and a shake at a tablet that asked for them, and what the page shows at every tablet."""

from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import Page, expect

from tests.service.browser_pages import (
    go_to_page,
    hold_to_rules,
    locales_for,
    wait_for_language,
    wait_for_value,
)
from tests.service.step_page_actions import FakePendant, at_the_pages, wait_for_question

pytestmark = pytest.mark.asyncio(loop_scope="module")
# its last value is no function: that would be called
SPY = """{ window.__tones = []; window.__shakes = [];
    const make = AudioContext.prototype.createOscillator;
    AudioContext.prototype.createOscillator = function () {
        const tone = make.call(this), start = tone.start.bind(tone);
        tone.start = (...at) => { window.__tones.push(tone.frequency.value); start(...at); };
        return tone; };
    navigator.vibrate = (what) => { window.__shakes.push(what); return true; }; 0; }"""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def pendant(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[FakePendant]:
    async with at_the_pages(tmp_path_factory.mktemp("cues")) as found:
        yield found


async def played_tones(page: Page) -> list[int]:
    return [round(each) for each in await page.evaluate("window.__tones")]


async def sounded_tones(page: Page) -> set[int]:
    return set(await played_tones(page))


async def a_record_and_a_refusal(pendant: FakePendant, page: Page) -> None:
    """Let one answer be recorded and the next be declined, and see both on the page."""
    frame: dict[str, Any] = {"frame_number": 3, "tip_in_flange_m": [0.0, 0.0, 0.1]}
    await pendant.viewer.send_order(
        op="start", procedure="three_point_frame", settings=frame, hold_to_move=False
    )
    await wait_for_question(page, "pointer_is_mounted")
    await page.get_by_test_id("yes").click()
    await wait_for_question(page, "touch_origin")
    await expect(page.get_by_text("read the user frame").first).to_be_visible()
    await page.get_by_test_id("no").click()
    await pendant.viewer.wait_until(lambda session: session["run"]["outcome"])
    await expect(page.locator("[data-testid=outcome], [data-testid=verdict], .banner").first).to_be_visible()


async def test_nothing_sounds_before_it_is_switched_on_and_the_page_says_all(pendant: FakePendant) -> None:
    pendant.release_control()
    async with pendant.viewer.open_page() as page:
        await page.evaluate(SPY)
        await go_to_page(page, "#/tablet")
        await expect(page.get_by_test_id("cue").get_by_role("checkbox")).not_to_be_checked()
        await go_to_page(page, "#/")
        await a_record_and_a_refusal(pendant, page)
        assert await played_tones(page) == []
        await pendant.viewer.send_order(op="dismiss")


async def test_switched_on_it_sounds_and_shakes_at_a_record_and_at_a_failure(pendant: FakePendant) -> None:
    pendant.release_control()
    async with pendant.viewer.open_page() as page:
        await page.evaluate(SPY)
        await go_to_page(page, "#/tablet")
        await page.get_by_test_id("cue").get_by_role("checkbox").check()
        await go_to_page(page, "#/")
        await wait_for_value(lambda: played_tones(page), [880].__eq__)  # what it will sound like
        await a_record_and_a_refusal(pendant, page)
        await wait_for_value(lambda: sounded_tones(page), {880, 220}.__eq__)
        assert await page.evaluate("window.__shakes.length === window.__tones.length")
        await go_to_page(page, "#/tablet")
        await page.reload()
        cue_checkbox = page.get_by_test_id("cue").get_by_role("checkbox")
        await expect(cue_checkbox).to_be_checked()
        await pendant.viewer.send_order(op="dismiss")


async def test_the_setting_is_for_everybody(pendant: FakePendant) -> None:
    for locale in locales_for("cues"):
        async with pendant.viewer.open_page(locale=locale) as page:
            await wait_for_language(page, locale)
            await go_to_page(page, "#/tablet")
            size = await page.get_by_test_id("cue").bounding_box()
            assert size is not None
            assert size["height"] >= 44
            await hold_to_rules(page, locale)
