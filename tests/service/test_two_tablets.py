"""Two tablets over the fake cell: one orders, both see; links that fall silent; the button that has to be held.

One browser, one cell and one service serve every test of this file, one after the other. No time is asserted: what
the issue asks in seconds is measured by the campaign ``pages_link``.
"""

import re
from collections.abc import AsyncIterator
from typing import Any

import httpx
import pytest
import pytest_asyncio
from playwright.async_api import expect

from tests.service.browser_pages import go_to_page, hold_to_rules_in_languages, wait_for_value
from tests.service.tablets_at_cell import (
    TabletsAtCell,
    expect_enabled,
    expect_held,
    expect_shown,
    open_tablets_at_cell,
    press_points,
    touch_session,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")
FIRST = "[data-testid=prompt][data-key=pin_is_fixed]"
NEXT = "[data-testid=prompt]:not([data-key=pin_is_fixed])"
HEIGHT = 800
HIDE = """() => {
    Object.defineProperty(document, 'hidden', {value: true, configurable: true});
    document.dispatchEvent(new Event('visibilitychange')); delete document.hidden; }"""
# Quick taps, all within 0.35 s: less than a page ignores after a new question.
TAPS = """async ([x, y]) => { for (const ends = Date.now() + 350; Date.now() < ends;) {
    document.elementFromPoint(x, y)?.closest('button')?.click();
    await new Promise(done => setTimeout(done, 40)); } }"""
PLACES = ("#/", "#/history", "#/devices", "#/sign-in", "#/procedure/mastering_record")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def open_tablets(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[TabletsAtCell]:
    async with open_tablets_at_cell(tmp_path_factory.mktemp("cell")) as tablets:
        yield tablets
        assert tablets.complaints == []


@pytest_asyncio.fixture(loop_scope="module")
async def tablets(open_tablets: TabletsAtCell) -> AsyncIterator[TabletsAtCell]:
    await open_tablets.wait_until(lambda session: session["connection"]["connected"])
    open_tablets.app.state.context.control.asked_s = 3600.0
    open_tablets.release_control()
    open_tablets.silent_link.mend_link()  # a test that failed may have left the link broken
    for page in (open_tablets.tom, open_tablets.tina):
        await page.evaluate("location.hash = '#/'")
        await expect_shown(page, "offline", there=False)
        await page.reload()  # whatever was refused before is forgotten
        await expect_shown(page, "device-robot")
    yield open_tablets


async def test_one_orders_the_other_sees_and_takes_over(tablets: TabletsAtCell) -> None:
    tom, tina = tablets.tom, tablets.tina
    await tablets.no_run()
    await tom.evaluate("location.hash = '#/procedure/six_point_tcp'")
    await tom.get_by_test_id("value-tool_number").fill("1")
    await tom.get_by_test_id("start").click()
    for page in (tom, tina):
        await page.locator(FIRST).wait_for()
    await expect(tina.get_by_test_id("controlled-by")).to_contain_text("Tom")
    await expect_enabled(tina, "yes", be_pressed=False)
    await expect_enabled(tina, "stop")
    await tina.get_by_test_id("take-over").click()
    await expect(tom.get_by_test_id("asked-for")).to_contain_text("Tina")
    for page in (tom, tina):
        await hold_to_rules_in_languages(page, "a request to take over")
    await tom.get_by_test_id("refuse").click()
    await tina.get_by_test_id("take-over").click()  # refused, she may ask again
    await tina.get_by_test_id("withdraw").click()
    await expect_shown(tom, "asked-for", there=False)
    await tina.get_by_test_id("take-over").click()
    await tom.get_by_test_id("give").click()
    await expect_enabled(tina, "yes")
    await expect_enabled(tom, "yes", be_pressed=False)
    tablets.app.state.context.control.asked_s = 0.0
    await tom.get_by_test_id("take-over").click()  # Tina looks elsewhere and answers nothing
    await expect_enabled(tom, "yes")
    await expect_enabled(tina, "yes", be_pressed=False)


async def test_a_tablet_takes_over_from_one_that_is_gone_while_a_question_waits(
    tablets: TabletsAtCell,
) -> None:
    await tablets.first_question()
    tina, gone = tablets.tina, await tablets.tom.context.new_page()
    await tablets.tom.goto(f"http://127.0.0.1:{tablets.port}/icon.svg")  # no page of the app
    await gone.goto(f"http://127.0.0.1:{tablets.port}/")
    await gone.get_by_test_id("yes").click()  # Tom has control
    await expect(tina.get_by_test_id("controlled-by")).to_contain_text("Tom")
    await gone.close()  # the battery of the only tablet with his session is empty
    control = tablets.app.state.context.control
    await wait_for_value(lambda: _has_no_page(control))
    await tina.get_by_test_id("take-over").click()
    await expect_enabled(tina, "yes")  # long before the hour that an answer is waited for in these tests
    assert control.current_holder.name == "Tina"
    await tablets.tom.goto(f"http://127.0.0.1:{tablets.silent_link.port}/")
    await expect(tablets.tom.get_by_test_id("controlled-by")).to_contain_text("Tina")


async def _has_no_page(control: Any) -> bool:
    return not control.has_open_page(control.current_holder.id)


async def test_a_double_tap_answers_one_question(tablets: TabletsAtCell) -> None:
    first = await tablets.first_question()
    page = tablets.tina
    await expect_enabled(page, "yes")
    box = await page.get_by_test_id("yes").bounding_box()
    assert box is not None
    await page.evaluate(TAPS, [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])
    await page.locator(NEXT).wait_for()
    await expect_enabled(page, "no")  # nothing that was pressed is on its way any more
    assert tablets.answered_once_since(first)
    await expect_shown(page, "refusal", there=False)


async def test_a_page_that_is_behind_is_refused_and_then_shows_what_is(tablets: TabletsAtCell) -> None:
    first = await tablets.first_question()
    page, behind = tablets.tina, await tablets.tina.context.new_page()
    await behind.route_web_socket("**/api/screen", _only_the_first_session)
    await behind.goto(f"http://127.0.0.1:{tablets.port}/")
    for each in (behind, page):
        await expect_enabled(each, "yes")
    await page.get_by_test_id("yes").click()
    await page.locator(NEXT).wait_for()
    await behind.get_by_test_id("yes").click()  # the page still shows the question before
    await expect_shown(behind, "refusal")
    await behind.locator(NEXT).wait_for()
    await expect_enabled(page, "no")
    assert tablets.answered_once_since(first)
    await behind.close()


def _only_the_first_session(socket: Any) -> None:
    server, messages = socket.connect_to_server(), []

    def pass_on(message: str) -> None:
        if '"kind":"session"' not in message:
            socket.send(message)
        elif not messages:
            messages.append(message)
            socket.send(message)

    server.on_message(pass_on)


async def test_a_stale_order_carries_the_present_session(tablets: TabletsAtCell) -> None:
    await tablets.first_question()
    cookies = {each["name"]: each["value"] for each in await tablets.tina.context.cookies()}
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{tablets.port}", cookies=cookies) as client:
        envelope = {"id": "late", "rev": 1, "order": {"op": "go_on"}}
        answer = await client.post("/api/commands", json=envelope)
    assert answer.status_code == 409
    session = tablets.last_session()
    assert session is not None
    assert session["prompt"]
    assert answer.json()["session"]["prompt"] == session["prompt"]


@pytest.mark.parametrize("late", [False, True], ids=["lost", "late"])
async def test_a_press_into_a_dead_link_counts_once_when_it_is_back(
    tablets: TabletsAtCell, late: bool
) -> None:
    first = await tablets.first_question()
    page, silent_link = tablets.tom, tablets.silent_link

    async def swallowed_bytes() -> int:
        return silent_link.swallowed

    await expect_enabled(page, "yes")
    silent_link.break_link(late=late)
    await page.get_by_test_id("yes").click()
    await expect_shown(page, "offline")
    await expect_shown(page, "queued")
    for button in ("yes", "no", "stop", "hold"):
        await expect_enabled(page, button, be_pressed=False)
    await wait_for_value(swallowed_bytes)
    session = tablets.last_session()
    assert session is not None
    assert session["prompt"]["id"] == first["id"]
    silent_link.mend_link()
    await expect_shown(page, "offline", there=False)
    await page.locator(NEXT).wait_for()
    await expect_shown(page, "queued", there=False)
    await expect_enabled(page, "no")
    await expect_shown(page, "refusal", there=False)
    assert tablets.answered_once_since(first)


async def test_what_was_typed_outlives_a_dead_link(tablets: TabletsAtCell) -> None:
    await tablets.no_run()
    page = tablets.tom
    await page.evaluate("location.hash = '#/procedure/six_point_tcp'")
    field = page.get_by_test_id("value-tool_number")
    await field.fill("7")
    await expect_enabled(page, "start")
    tablets.silent_link.break_link(late=False)
    await expect_shown(page, "offline")
    await expect_enabled(page, "start", be_pressed=False)
    tablets.silent_link.mend_link()
    await expect_shown(page, "offline", there=False)
    await expect_enabled(page, "start")
    await expect(field).to_have_value("7")
    await expect(page).to_have_url(re.compile("six_point_tcp"))
    tablets.silent_link.break_link(late=False)
    await expect_shown(page, "offline")
    await page.evaluate("location.hash = '#/'")
    tablets.silent_link.mend_link()
    await expect_shown(page, "intention-tool")  # what could not be asked is asked when the link is back


class TestHoldToMove:
    """Together, also in random order: they share one run and its plan."""

    async def test_the_robot_moves_only_while_the_button_is_held(self, tablets: TabletsAtCell) -> None:
        await tablets.waits_for_hold()
        tom, tina = tablets.tom, tablets.tina
        await expect_enabled(tom, "hold")
        await expect_enabled(tina, "hold")  # there was no order yet
        fingers, at = await touch_session(tom)
        for ending in ("lifted", "cancelled", "second finger", "hidden", "blurred"):
            await press_points(fingers, at)
            await expect_held(tom)
            await tablets.wait_until(lambda session: not session["waits_for_hold"])
            if ending == "lifted":
                await tina.get_by_test_id("moving").wait_for()
                await expect_enabled(tina, "hold", be_pressed=False)
                await press_points(fingers, at | {"x": at["x"] + 3.0, "y": at["y"] - 3.0}, kind="touchMove")
                await expect_held(tom)  # a glove that trembles does not let go
                await press_points(fingers, kind="touchEnd")
            elif ending == "cancelled":
                await press_points(fingers, kind="touchCancel")
            elif ending == "second finger":
                await press_points(fingers, at, {"x": 5.0, "y": 5.0, "id": 2.0})
            elif ending == "hidden":
                await tom.evaluate(HIDE)
            else:
                await tom.evaluate("dispatchEvent(new Event('blur'))")
            await expect_held(tom, yes=False)
            await tablets.wait_for_standstill()
            if ending not in ("lifted", "cancelled"):
                await press_points(fingers, kind="touchEnd")
        await tina.get_by_test_id("moving").wait_for(state="detached")

    async def test_a_key_that_repeats_presses_once(self, tablets: TabletsAtCell) -> None:
        await tablets.waits_for_hold()
        page = tablets.tina
        await expect_enabled(page, "hold")
        await page.get_by_test_id("hold").focus()
        await page.keyboard.down(" ")
        await expect_held(page)
        await tablets.wait_until(lambda session: not session["waits_for_hold"])
        await page.evaluate("dispatchEvent(new Event('blur'))")
        await expect_held(page, yes=False)
        for _ in range(3):
            await page.keyboard.down(" ")  # still down: the keyboard repeats it
        await tablets.wait_for_standstill()
        await expect_held(page, yes=False)
        await page.keyboard.up(" ")

    @pytest.mark.parametrize("late", [False, True], ids=["lost", "late"])
    async def test_a_dead_link_lets_go_and_late_words_do_not_press(
        self, tablets: TabletsAtCell, late: bool
    ) -> None:
        await tablets.waits_for_hold()
        page = tablets.tom
        await expect_enabled(page, "hold")
        fingers, at = await touch_session(page)
        await press_points(fingers, at)
        await expect_held(page)
        await tablets.wait_until(lambda session: not session["waits_for_hold"])
        tablets.silent_link.break_link(late=late)
        await tablets.wait_for_standstill()  # the service lets go by itself; the finger still presses
        await expect_shown(page, "offline")
        await expect_held(page, yes=False)
        tablets.silent_link.mend_link()
        await expect_shown(page, "offline", there=False)
        await tablets.wait_for_standstill()
        await press_points(fingers, kind="touchEnd")

    async def test_control_that_passes_on_lets_the_button_go(self, tablets: TabletsAtCell) -> None:
        await tablets.waits_for_hold()
        tablets.app.state.context.control.asked_s = 0.0
        await expect_enabled(tablets.tom, "hold")
        fingers, at = await touch_session(tablets.tom)
        await press_points(fingers, at)
        await tablets.wait_until(lambda session: not session["waits_for_hold"])
        await tablets.tina.get_by_test_id("take-over").click()
        await expect_held(tablets.tom, yes=False)
        await expect_enabled(tablets.tom, "hold", be_pressed=False)
        await tablets.wait_for_standstill()
        await press_points(fingers, kind="touchEnd")

    async def test_a_stopped_robot_is_shown_on_every_page_and_nothing_moves(
        self, tablets: TabletsAtCell
    ) -> None:
        await tablets.waits_for_hold()
        page = tablets.tina
        await expect_enabled(page, "hold")
        await tablets.fake_client.inject_fault("emergency_stop", device="fanuc")
        try:
            await expect_shown(page, "stopped")
            await expect(page.get_by_test_id("stopped")).to_have_attribute("role", "alert")
            await expect(page.get_by_test_id("stopped").get_by_role("button")).to_have_count(0)
            await expect_enabled(page, "hold", be_pressed=False)
            for button in ("hold", "stop"):
                await wait_for_value(
                    page.get_by_test_id(button).bounding_box,
                    lambda box: box is not None and box["y"] + box["height"] <= HEIGHT,
                )
            for place in PLACES:
                await go_to_page(page, place)
                await expect_shown(page, "stopped")
        finally:
            for mended in ("release_emergency_stop", "press_reset"):
                await tablets.fake_client.inject_fault(mended, device="fanuc")
        await expect_shown(page, "stopped", there=False)
