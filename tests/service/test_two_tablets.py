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

from tests.service.browsers import comes, go, hold_to_rules_in_every_language
from tests.service.floor import Floor, a_floor, can, held, press, seen, touch

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.xdist_group("two_tablets")]
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
async def opened(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Floor]:
    async with a_floor(tmp_path_factory.mktemp("cell")) as floor:
        yield floor
        assert floor.complaints == []


@pytest_asyncio.fixture(loop_scope="module")
async def floor(opened: Floor) -> AsyncIterator[Floor]:
    await opened.until(lambda session: session["connection"]["connected"])
    opened.app.state.house.control.asked_s = 3600.0
    opened.nobody_has_control()
    opened.hole.heal()  # a test that failed may have left the link broken
    for page in (opened.tom, opened.tina):
        await page.evaluate("location.hash = '#/'")
        await seen(page, "offline", there=False)
        await page.reload()  # whatever was refused before is forgotten
        await seen(page, "device-robot")
    yield opened


async def test_one_orders_the_other_sees_and_takes_over(floor: Floor) -> None:
    tom, tina = floor.tom, floor.tina
    await floor.no_run()
    await tom.evaluate("location.hash = '#/procedure/six_point_tcp'")
    await tom.get_by_test_id("value-tool_number").fill("1")
    await tom.get_by_test_id("start").click()
    for page in (tom, tina):
        await page.locator(FIRST).wait_for()
    await expect(tina.get_by_test_id("controlled-by")).to_contain_text("Tom")
    await can(tina, "yes", be_pressed=False)
    await can(tina, "stop")
    await tina.get_by_test_id("take-over").click()
    await expect(tom.get_by_test_id("asked-for")).to_contain_text("Tina")
    for page in (tom, tina):
        await hold_to_rules_in_every_language(page, "a request to take over")
    await tom.get_by_test_id("refuse").click()
    await tina.get_by_test_id("take-over").click()  # refused, she may ask again
    await tina.get_by_test_id("withdraw").click()
    await seen(tom, "asked-for", there=False)
    await tina.get_by_test_id("take-over").click()
    await tom.get_by_test_id("give").click()
    await can(tina, "yes")
    await can(tom, "yes", be_pressed=False)
    floor.app.state.house.control.asked_s = 0.0
    await tom.get_by_test_id("take-over").click()  # Tina looks elsewhere and answers nothing
    await can(tom, "yes")
    await can(tina, "yes", be_pressed=False)


async def test_a_double_tap_answers_one_question(floor: Floor) -> None:
    first = await floor.asked()
    page = floor.tina
    await can(page, "yes")
    box = await page.get_by_test_id("yes").bounding_box()
    assert box is not None
    await page.evaluate(TAPS, [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])
    await page.locator(NEXT).wait_for()
    await can(page, "no")  # nothing that was pressed is on its way any more
    assert floor.answered_once_since(first)
    await seen(page, "refusal", there=False)


async def test_a_page_that_is_behind_is_refused_and_then_shows_what_is(floor: Floor) -> None:
    first = await floor.asked()
    page, behind = floor.tina, await floor.tina.context.new_page()
    await behind.route_web_socket("**/api/screen", _only_the_first_session)
    await behind.goto(f"http://127.0.0.1:{floor.port}/")
    for each in (behind, page):
        await can(each, "yes")
    await page.get_by_test_id("yes").click()
    await page.locator(NEXT).wait_for()
    await behind.get_by_test_id("yes").click()  # the page still shows the question before
    await seen(behind, "refusal")
    await behind.locator(NEXT).wait_for()
    await can(page, "no")
    assert floor.answered_once_since(first)
    await behind.close()


def _only_the_first_session(socket: Any) -> None:
    server, told = socket.connect_to_server(), []

    def pass_on(message: str) -> None:
        if '"kind":"session"' not in message:
            socket.send(message)
        elif not told:
            told.append(message)
            socket.send(message)

    server.on_message(pass_on)


async def test_a_stale_order_carries_the_present_session(floor: Floor) -> None:
    await floor.asked()
    cookies = {each["name"]: each["value"] for each in await floor.tina.context.cookies()}
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{floor.port}", cookies=cookies) as client:
        asked = {"id": "late", "rev": 1, "order": {"op": "go_on"}}
        answer = await client.post("/api/commands", json=asked)
    assert answer.status_code == 409
    session = floor.session()
    assert session is not None
    assert session["prompt"]
    assert answer.json()["session"]["prompt"] == session["prompt"]


@pytest.mark.parametrize("late", [False, True], ids=["lost", "late"])
async def test_a_press_into_a_dead_link_counts_once_when_it_is_back(floor: Floor, late: bool) -> None:
    first = await floor.asked()
    page, hole = floor.tom, floor.hole

    async def swallowed() -> int:
        return hole.swallowed

    await can(page, "yes")
    hole.swallow(late=late)
    await page.get_by_test_id("yes").click()
    await seen(page, "offline")
    await seen(page, "queued")
    for button in ("yes", "no", "stop", "hold"):
        await can(page, button, be_pressed=False)
    await comes(swallowed)
    session = floor.session()
    assert session is not None
    assert session["prompt"]["id"] == first["id"]
    hole.heal()
    await seen(page, "offline", there=False)
    await page.locator(NEXT).wait_for()
    await seen(page, "queued", there=False)
    await can(page, "no")
    await seen(page, "refusal", there=False)
    assert floor.answered_once_since(first)


async def test_what_was_typed_outlives_a_dead_link(floor: Floor) -> None:
    await floor.no_run()
    page = floor.tom
    await page.evaluate("location.hash = '#/procedure/six_point_tcp'")
    field = page.get_by_test_id("value-tool_number")
    await field.fill("7")
    await can(page, "start")
    floor.hole.swallow(late=False)
    await seen(page, "offline")
    await can(page, "start", be_pressed=False)
    floor.hole.heal()
    await seen(page, "offline", there=False)
    await can(page, "start")
    await expect(field).to_have_value("7")
    await expect(page).to_have_url(re.compile("six_point_tcp"))
    floor.hole.swallow(late=False)
    await seen(page, "offline")
    await page.evaluate("location.hash = '#/'")
    floor.hole.heal()
    await seen(page, "procedure-six_point_tcp")  # what could not be asked is asked when the link is back


class TestHold:
    """Together, also in random order: they share one run and its plan."""

    async def test_the_robot_moves_only_while_the_button_is_held(self, floor: Floor) -> None:
        await floor.waits_for_hold()
        tom, tina = floor.tom, floor.tina
        await can(tom, "hold")
        await can(tina, "hold")  # nobody has ordered anything yet
        fingers, at = await touch(tom)
        for ending in ("lifted", "cancelled", "second finger", "hidden", "blurred"):
            await press(fingers, at)
            await held(tom)
            await floor.until(lambda session: not session["waits_for_hold"])
            if ending == "lifted":
                await tina.get_by_test_id("moving").wait_for()
                await can(tina, "hold", be_pressed=False)
                await press(fingers, at | {"x": at["x"] + 3.0, "y": at["y"] - 3.0}, kind="touchMove")
                await held(tom)  # a glove that trembles does not let go
                await press(fingers, kind="touchEnd")
            elif ending == "cancelled":
                await press(fingers, kind="touchCancel")
            elif ending == "second finger":
                await press(fingers, at, {"x": 5.0, "y": 5.0, "id": 2.0})
            elif ending == "hidden":
                await tom.evaluate(HIDE)
            else:
                await tom.evaluate("dispatchEvent(new Event('blur'))")
            await held(tom, yes=False)
            await floor.stands()
            if ending not in ("lifted", "cancelled"):
                await press(fingers, kind="touchEnd")
        await tina.get_by_test_id("moving").wait_for(state="detached")

    async def test_a_key_that_repeats_presses_once(self, floor: Floor) -> None:
        await floor.waits_for_hold()
        page = floor.tina
        await can(page, "hold")
        await page.get_by_test_id("hold").focus()
        await page.keyboard.down(" ")
        await held(page)
        await floor.until(lambda session: not session["waits_for_hold"])
        await page.evaluate("dispatchEvent(new Event('blur'))")
        await held(page, yes=False)
        for _ in range(3):
            await page.keyboard.down(" ")  # still down: the keyboard repeats it
        await floor.stands()
        await held(page, yes=False)
        await page.keyboard.up(" ")

    @pytest.mark.parametrize("late", [False, True], ids=["lost", "late"])
    async def test_a_dead_link_lets_go_and_late_words_do_not_press(self, floor: Floor, late: bool) -> None:
        await floor.waits_for_hold()
        page = floor.tom
        await can(page, "hold")
        fingers, at = await touch(page)
        await press(fingers, at)
        await held(page)
        await floor.until(lambda session: not session["waits_for_hold"])
        floor.hole.swallow(late=late)
        await floor.stands()  # the service lets go by itself; the finger still presses
        await seen(page, "offline")
        await held(page, yes=False)
        floor.hole.heal()
        await seen(page, "offline", there=False)
        await floor.stands()
        await press(fingers, kind="touchEnd")

    async def test_control_that_passes_on_lets_the_button_go(self, floor: Floor) -> None:
        await floor.waits_for_hold()
        floor.app.state.house.control.asked_s = 0.0
        await can(floor.tom, "hold")
        fingers, at = await touch(floor.tom)
        await press(fingers, at)
        await floor.until(lambda session: not session["waits_for_hold"])
        await floor.tina.get_by_test_id("take-over").click()
        await held(floor.tom, yes=False)
        await can(floor.tom, "hold", be_pressed=False)
        await floor.stands()
        await press(fingers, kind="touchEnd")

    async def test_a_stopped_robot_is_told_on_every_page_and_nothing_moves(self, floor: Floor) -> None:
        await floor.waits_for_hold()
        page = floor.tina
        await can(page, "hold")
        await floor.door.inject_fault("emergency_stop", device="fanuc")
        try:
            await seen(page, "stopped")
            await expect(page.get_by_test_id("stopped")).to_have_attribute("role", "alert")
            await expect(page.get_by_test_id("stopped").get_by_role("button")).to_have_count(0)
            await can(page, "hold", be_pressed=False)
            for button in ("hold", "stop"):
                await comes(
                    page.get_by_test_id(button).bounding_box,
                    lambda box: box is not None and box["y"] + box["height"] <= HEIGHT,
                )
            for place in PLACES:
                await go(page, place)
                await seen(page, "stopped")
        finally:
            for mended in ("release_emergency_stop", "press_reset"):
                await floor.door.inject_fault(mended, device="fanuc")
        await seen(page, "stopped", there=False)
