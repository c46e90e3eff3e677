"""By keyboard alone, at twice the size, without motion, and in another language in the middle of a run."""

import asyncio
import json
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import numpy as np
import pytest
import pytest_asyncio
from playwright.async_api import Page, Route, expect

from tests.service.browser_pages import (
    LOCALES,
    ROOT,
    at_rest,
    go_to_page,
    hold_to_rules,
    wait_for_language,
    wait_for_value,
)
from tests.service.longer_texts import lengthen_page_texts
from tests.service.step_page_actions import (
    TIP_IN_FLANGE_M,
    FakePendant,
    at_the_pages,
    record_step,
    tip_at_home,
    wait_for_question,
    wait_for_reason,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")
FRAME = {"frame_number": 3, "tip_in_flange_m": TIP_IN_FLANGE_M.tolist()}
OF_FRAME_M = {"touch_origin": (0.0, 0.0, 0.0), "touch_on_x": (0.25, 0.0, 0.0), "touch_on_xy": (0.0, 0.2, 0.0)}
PLACES = (
    "#/",
    "#/procedure/three_point_frame",
    "#/history",
    "#/devices",
    "#/parameters",
    "#/programs",
    "#/measurements",
)
ISO = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d")
# What has the focus, by its test id or that of what it is in, and how thick the line around it is.
FOCUSED = """() => { const one = document.activeElement, seen = getComputedStyle(one);
    return [one.closest('[data-testid]')?.dataset.testid ?? one.tagName,
        seen.outlineStyle === 'none' ? 0 : parseFloat(seen.outlineWidth)]; }"""
WIDE = """[...document.querySelectorAll('body *')].filter(e => e.getBoundingClientRect().right > innerWidth)
    .map(e => e.outerHTML.slice(0, 120))"""
MOVING = "document.getAnimations().filter(one => one.playState === 'running').length"
# Characters that are drawn as one that no font has.
UNDRAWN = """(texts) => {
    const canvas = document.createElement('canvas'); canvas.width = canvas.height = 40;
    const pen = canvas.getContext('2d', {willReadFrequently: true});
    pen.font = '32px ' + getComputedStyle(document.body).fontFamily; pen.textBaseline = 'top';
    const drawn = (one) => { pen.clearRect(0, 0, 40, 40); pen.fillText(one, 2, 2);
        return pen.getImageData(0, 0, 40, 40).data.join(); };
    const none = new Set([drawn('\\u{10FFFD}'), drawn('\\u{E123}')]);
    return [...new Set(texts)].filter((one) => one.trim() && none.has(drawn(one))).join(''); }"""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def pendant(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[FakePendant]:
    async with at_the_pages(tmp_path_factory.mktemp("hands")) as found:
        yield found


@asynccontextmanager
async def a_frame_being_taught(pendant: FakePendant) -> AsyncIterator[Page]:
    """Look at a run that has recorded its first point and asks for the second."""
    pendant.release_control()
    viewer = pendant.viewer
    async with viewer.open_page() as page:
        await viewer.send_order(op="start", procedure="three_point_frame", settings=FRAME, hold_to_move=False)
        try:
            await wait_for_question(page, "pointer_is_mounted")
            await record_step(page)
            await wait_for_question(page, "touch_origin")
            await pendant.touch_point(tip_at_home(), np.eye(3))
            await record_step(page)
            await wait_for_question(page, "touch_on_x")
            yield page
        finally:
            await viewer.send_order(op="stop")
            await viewer.wait_until(lambda session: session["run"]["outcome"])
            await viewer.send_order(op="dismiss")


async def by_tab(page: Page, test_id: str) -> None:
    """Go from element to element until one has the focus, which is to be seen at each."""
    await expect(page.get_by_test_id(test_id)).to_be_visible()
    await at_rest(page)
    for _ in range(120):
        await page.keyboard.press("Tab")
        focused, outline_px = await page.evaluate(FOCUSED)
        assert focused == "BODY" or outline_px >= 2, f"the focus of {focused} is not visible"
        if focused == test_id:
            return
    raise AssertionError(f"no Tab leads to {test_id}")


async def test_a_procedure_is_run_by_keyboard_alone(pendant: FakePendant) -> None:
    """U19: from the list to the end, its settings and the press of two seconds too."""
    pendant.release_control()
    async with pendant.viewer.open_page() as page:
        await by_tab(page, "intention-work")
        await page.keyboard.press("Enter")
        await by_tab(page, "procedure-three_point_frame")
        await page.keyboard.press("Enter")
        await by_tab(page, "value-frame_number")
        await page.keyboard.type("3")
        for axis, tip_m in zip("xyz", TIP_IN_FLANGE_M, strict=True):
            await by_tab(page, f"tip_in_flange_m-0-{axis}")
            await page.keyboard.type(f"{1000.0 * tip_m:g}")
        await by_tab(page, "start")
        await page.keyboard.press("Enter")
        await wait_for_question(page, "pointer_is_mounted")
        await by_tab(page, "yes")
        await page.keyboard.press("Enter")
        for key, away_m in OF_FRAME_M.items():
            await wait_for_question(page, key)
            await pendant.touch_point(tip_at_home() + np.array(away_m), np.eye(3))
            await wait_for_reason(page, "")
            await by_tab(page, "yes")
            await page.keyboard.press(" ")
        await wait_for_question(page, "accept_frame")
        await by_tab(page, "yes")
        await page.keyboard.down(" ")
        ended = await pendant.viewer.wait_until(lambda session: session["run"]["outcome"])
        await page.keyboard.up(" ")
        assert ended["run"]["outcome"]["verdict"] == "passed"
        await by_tab(page, "dismiss")
        await page.keyboard.press("Enter")
        await pendant.viewer.wait_until(lambda session: session["run"] is None)


async def test_at_twice_the_size_nothing_is_wider_than_the_screen(pendant: FakePendant) -> None:
    """U19: a browser that shows a tablet of 1280 by 800 at 200 % lays out half of both."""
    async with a_frame_being_taught(pendant) as page:
        await page.set_viewport_size({"width": 640, "height": 400})
        for locale in LOCALES:
            await page.get_by_test_id("language").select_option(locale)
            await wait_for_language(page, locale)
            for place in PLACES:
                await go_to_page(page, place)
                wide = await page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
                assert wide[0] <= wide[1], (place, locale, await page.evaluate(WIDE))


async def test_reduced_motion_is_respected(pendant: FakePendant) -> None:
    """U19: a page that works on something pulses, unless the reader asked for less motion."""
    pendant.release_control()
    async with pendant.viewer.open_page() as page:
        await page.evaluate(
            "document.querySelector('main').insertAdjacentHTML('beforeend', '<p class=pulse>…</p>')"
        )
        await wait_for_value(lambda: page.evaluate(MOVING))
        await page.emulate_media(reduced_motion="reduce")
        await wait_for_value(lambda: page.evaluate(MOVING), (0).__eq__)


async def test_another_language_keeps_the_step_and_what_was_recorded(pendant: FakePendant) -> None:
    """U20: the same question, the same points, and nothing is told to the service."""
    async with a_frame_being_taught(pendant) as page:
        before = await pendant.viewer.read_session()
        title = page.get_by_test_id("prompt").locator("h2").inner_text
        english = await title()
        titles = [english]
        await page.evaluate("window.kept = true")
        for locale in (*LOCALES[1:], LOCALES[0]):
            await page.get_by_test_id("language").select_option(locale)
            await wait_for_language(page, locale)
            await wait_for_question(page, "touch_on_x")
            await expect(page.locator("[aria-current=step]")).to_have_count(1)
            await expect(page.get_by_test_id("points").locator("[data-state=recorded]")).to_have_count(1)
            # words come after the language
            titles.append(await wait_for_value(title, lambda value: value != titles[-1]))
        assert len(set(titles)) == len(LOCALES), titles
        assert titles[-1] == english
        assert await page.evaluate("window.kept === true"), "the page was loaded anew"
        now = await pendant.viewer.read_session()
        assert (now["rev"], now["prompt"]["id"]) == (before["rev"], before["prompt"]["id"])


async def test_the_language_picked_last_is_spoken_whichever_comes_first(pendant: FakePendant) -> None:
    """U20: a slow link brings the texts of an earlier pick after those of a later one."""
    come = asyncio.Event()

    async def delay_answer(route: Route) -> None:
        await come.wait()
        await route.continue_()

    async with a_frame_being_taught(pendant) as page:
        await page.route("**/assets/es-*", delay_answer)
        await page.get_by_test_id("language").select_option("es")
        await page.get_by_test_id("language").select_option("de")
        await wait_for_language(page, "de")
        async with page.expect_response("**/assets/es-*"):
            come.set()
        await at_rest(page)
        await wait_for_language(page, "de")
        await expect(page.get_by_test_id("language")).to_have_value("de")


async def test_what_was_typed_outlives_another_language(pendant: FakePendant) -> None:
    """U20: settings that are being typed stay, and are told again as the language writes them."""
    pendant.release_control()
    async with pendant.viewer.open_page("#/procedure/three_point_frame") as page:
        box = page.get_by_test_id("tip_in_flange_m-0-x")
        await box.fill("20.5")
        await box.press("Tab")
        for locale in (*LOCALES[1:], LOCALES[0]):
            await page.get_by_test_id("language").select_option(locale)
            await wait_for_language(page, locale)
            await expect(box).to_have_value("20,5" if locale in ("de", "es") else "20.5")


async def test_every_character_of_the_pages_is_drawn(pendant: FakePendant) -> None:
    """U20: none of the characters of any language comes out as the box of one that no font has."""
    for locale in LOCALES:
        files = sorted((ROOT / "web/src/locales").rglob(f"{locale}.json"))
        texts = [
            json.dumps(json.loads(path.read_text(encoding="utf-8")), ensure_ascii=False) for path in files
        ]
        async with pendant.viewer.open_page(locale=locale) as page:
            await wait_for_language(page, locale)
            await at_rest(page)
            assert await page.evaluate(UNDRAWN, "\U0010fffd中") == "\U0010fffd", (
                "Chinese has no font here: apt-get install fonts-wqy-microhei"
            )
            assert await page.evaluate(UNDRAWN, "".join(texts)) == "", locale


async def test_a_run_in_texts_that_are_forty_percent_longer_fits(pendant: FakePendant) -> None:
    """U20: a step with its meter, the row of main buttons, and a dialog, lying and upright."""
    tool = int((await pendant.fake_client.read_truth())["robots"]["fanuc"]["active"]["tool_number"])
    async with a_frame_being_taught(pendant) as page:
        stop = await lengthen_page_texts(page, "ask_to_stop")
        await wait_for_question(page, "touch_on_x")
        await expect(page.get_by_test_id("stop")).to_contain_text(stop)
        for width, height in ((1280, 800), (1024, 768), (800, 1280)):
            await page.set_viewport_size({"width": width, "height": height})
            await hold_to_rules(page, f"a step, {width} wide")
        await pendant.fake_client.inject_fault("select", tool=tool + 1)
        try:
            await page.get_by_test_id("context-guard").wait_for()
            await hold_to_rules(page, "a dialog")
        finally:
            await pendant.fake_client.inject_fault("select", tool=tool)


async def test_dates_are_iso_in_data_and_local_on_the_page(pendant: FakePendant) -> None:
    async with a_frame_being_taught(pendant):
        pass
    runs_answer = (await pendant.viewer.client.get("/api/runs")).json()
    assert runs_answer
    assert all(ISO.match(line["started_utc"]) for line in runs_answer)
    for locale, local in (
        ("de", r"\b\d{1,2}\. [A-Z][a-zä]+\.? \d{4}\b"),
        ("zh", r"\d{4}年\d{1,2}月\d{1,2}日"),
    ):
        async with pendant.viewer.open_page("#/history", locale=locale) as page:
            row = page.get_by_test_id("run").first
            await expect(row).to_contain_text(re.compile(local))
            await expect(row).not_to_contain_text(ISO)
