"""A stopped robot on every page and every tablet's size; refusals in the reader's language. The cell process is a double."""

from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import FloatRect, Locator, Page, expect

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.web.cell_client import CellProcessGoneError, StopUnconfirmedError
from tests.service.browser_pages import layout_faults
from tests.service.service_client import ServiceClock
from tests.service.service_with_tablets import PATIENCE_MS, ServiceWithTablets, open_service_with_tablets
from tests.service.test_people_pages import OneQuestionProcess

pytestmark = pytest.mark.asyncio(loop_scope="module")
SIZES = ((1280, 800), (1024, 768), (800, 1280))
PLACES = ("#/history", "#/devices", "#/sign-in", "#/parameters/1", "#/procedure/mastering_record", "#/")
MOTION = ("hold",)
ALWAYS = ("stopped", "hold", "stop")
STOPPED = {"message": "the robot stopped: operator.", "remedy": "Look at the robot."}


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def tablet_service(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[ServiceWithTablets]:
    path = write_cell_file(tmp_path_factory.mktemp("cell"), "127.0.0.1", seed=1, time_factor=1.0)
    async with open_service_with_tablets(
        path, process_double=OneQuestionProcess, clock=ServiceClock()
    ) as opened:
        yield opened
        assert opened.complaints == []


def publish_state(tablet_service: ServiceWithTablets, state: str, **trouble: Any) -> None:
    """Let the cell process say how the robot is."""
    if state == "stopped":
        trouble["stop"] = dict(trouble)
    robot = {"role": "robot", "name": "fanuc", "state": state, "message": "", "remedy": "", "age_s": 0.0}
    live_message = {"devices": [robot | {"value": None, "settle": None} | trouble]}
    tablet_service.app.state.context.link.live_values = live_message
    tablet_service.app.state.context.screens.broadcast("live", live_message)


async def _bounding_box(place: Locator) -> FloatRect:
    box = await place.bounding_box()
    assert box is not None
    return box


async def stands_inside(page: Page, test_id: str, size: tuple[int, int]) -> None:
    """Wait until an element is wholly on the screen, without scrolling."""
    place = page.get_by_test_id(test_id)
    await expect(place).to_be_in_viewport(ratio=1.0, timeout=PATIENCE_MS)
    box = await _bounding_box(place)
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= size[0], test_id


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
async def test_a_stopped_robot_is_shown_everywhere_until_it_is_released(
    tablet_service: ServiceWithTablets, size: tuple[int, int]
) -> None:
    publish_state(tablet_service, "ready")
    tablet_service.app.state.context.link.ask_question("wire_is_hooked")
    tablet_service.release_control()
    async with tablet_service.signed_in_tablet("Tom", size=size) as page:
        await page.evaluate("location.hash = '#/'")
        await expect(page.get_by_test_id("hold")).to_be_enabled(timeout=PATIENCE_MS)
        publish_state(tablet_service, "stopped", **STOPPED)
        banner = page.get_by_test_id("stopped")
        await expect(banner).to_have_attribute("role", "alert", timeout=PATIENCE_MS)
        for place in PLACES:
            await page.evaluate("place => { location.hash = place; }", place)
            await expect(page.locator("main h1").first).to_be_visible(timeout=PATIENCE_MS)
            await expect(banner).to_be_visible(timeout=PATIENCE_MS)
        for button in MOTION:
            await expect(page.get_by_test_id(button)).to_be_disabled(timeout=PATIENCE_MS)
        for control in ALWAYS:
            await stands_inside(page, control, size)
        for below in (40, 80, 160, 320, 100_000):
            await page.evaluate("below => scrollTo(0, below)", below)
            await expect(banner).to_be_in_viewport(ratio=1.0, timeout=PATIENCE_MS)
            assert not await layout_faults(page), below
        await page.evaluate("scrollTo(0, 0)")
        tops = [(await _bounding_box(page.get_by_test_id(control)))["y"] for control in ("hold", "stop")]
        assert tops[0] == tops[1], "a second row hides what is asked"
        assert (await _bounding_box(page.locator("header")))["height"] <= 140, "no place is left for the step"
        await expect(banner).to_contain_text("What to do")
        await expect(banner.get_by_role("button")).to_have_count(0)
        await page.keyboard.press("Escape")
        await banner.click()
        await expect(banner).to_be_visible()
        await expect(page.get_by_test_id("stop")).to_be_enabled(timeout=PATIENCE_MS)
        publish_state(tablet_service, "position_lost", message="not mastered", stop=STOPPED)
        await expect(banner).to_contain_text("obot stopped: operator", timeout=PATIENCE_MS)
        await expect(page.get_by_test_id("hold")).to_be_disabled(timeout=PATIENCE_MS)
        publish_state(tablet_service, "ready")
        await expect(banner).to_have_count(0, timeout=PATIENCE_MS)
        await expect(page.get_by_test_id("hold")).to_be_enabled(timeout=PATIENCE_MS)


async def test_a_telephone_shows_the_question_above_its_buttons_and_why_none_works(
    tablet_service: ServiceWithTablets,
) -> None:
    publish_state(tablet_service, "ready")
    tablet_service.app.state.context.link.ask_question("wire_is_hooked")
    tablet_service.release_control()
    async with tablet_service.signed_in_tablet("Tom", locale="de", size=(390, 844)) as page:
        await page.evaluate("location.hash = '#/'")
        await expect(page.get_by_test_id("hold")).to_be_enabled(timeout=PATIENCE_MS)
        question, answer = page.get_by_test_id("instruction"), page.get_by_test_id("yes")
        await expect(question).to_be_in_viewport(ratio=1.0, timeout=PATIENCE_MS)
        question_box, agreed = await _bounding_box(question), await _bounding_box(answer)
        assert question_box["y"] + question_box["height"] <= agreed["y"]
        assert await layout_faults(page) == []
        await page.evaluate("scrollTo(0, document.body.scrollHeight)")
        await page.context.set_offline(True)
        await expect(page.get_by_test_id("offline")).to_be_in_viewport(ratio=1.0, timeout=PATIENCE_MS)
        await page.get_by_test_id("joints").evaluate("details => { details.open = true; }")
        await expect(page.get_by_test_id("joints").locator("dl")).to_have_count(0, timeout=PATIENCE_MS)
        await page.context.set_offline(False)
        await expect(page.get_by_test_id("offline")).to_have_count(0, timeout=PATIENCE_MS)
    tablet_service.complaints.clear()  # the browser tells of a cut line, too


REASON = make_message(
    "{label}: counts went from {counts} to {counts_after}, lengths spread by {readings_mm:.2f} mm",
    label="capture 7",
    counts=12,
    counts_after=15,
    readings_mm=0.25,
)
REMEDY = "Let the arm come to rest, see that the wire hangs free, then resume. The vendor says XK-17."
SENTENCES: dict[str, tuple[str, str]] = {
    "en": ("lengths spread by 0.25 mm", "see that the wire hangs free"),
    "de": ("Längen streuten um 0,25 mm", "ob das Seil frei hängt"),
    "es": ("las longitudes se dispersaron 0,25 mm", "que el cable cuelga libre"),
    "zh": ("长度散布 0.25 mm", "检查拉绳悬挂无阻"),
}


_REFUSED = make_message("the robot refused: {entry_text}.", entry_text="SRVO-023 Stop error")


@pytest.mark.parametrize("locale", SENTENCES)
async def test_a_refusal_is_written_in_the_reader_s_language(
    tablet_service: ServiceWithTablets, locale: str
) -> None:
    publish_state(
        tablet_service,
        "stopped",
        message=RefusedError("fanuc", _REFUSED).message,
        remedy="Look at the robot.",
    )
    async with tablet_service.signed_in_tablet("Tom", locale=locale) as page:
        await page.evaluate("location.hash = '#/'")
        tablet_service.app.state.context.link.end_run("refused", REASON, REMEDY)
        reason, remedy = SENTENCES[locale]
        outcome = page.get_by_test_id("outcome")
        await expect(outcome).to_contain_text(reason, timeout=PATIENCE_MS)
        await expect(outcome).to_contain_text(remedy, timeout=PATIENCE_MS)
        english = outcome.locator("[lang=en]")
        await expect(english).to_have_text([] if locale == "en" else ["The vendor says XK-17."])
        banner = page.get_by_test_id("stopped")
        await expect(banner).to_contain_text("SRVO-023 Stop error", timeout=PATIENCE_MS)
        if locale != "en":
            await expect(banner).not_to_contain_text("the robot refused", timeout=PATIENCE_MS)
    tablet_service.app.state.context.screens.broadcast(
        "session", tablet_service.app.state.context.link.session
    )


NOT_CONFIRMED = {
    "en": "the robot may still move. Press the emergency stop",
    "de": "kann sich noch bewegen. Drücken Sie den Not-Halt",
    "es": "puede seguir moviéndose. Pulse la parada de emergencia",
    "zh": "机器人可能仍在运动。请按下急停按钮",
}


@pytest.mark.parametrize("locale", NOT_CONFIRMED)
@pytest.mark.parametrize("unanswered", [StopUnconfirmedError, CellProcessGoneError])
async def test_an_unconfirmed_stop_is_not_shown_as_done(
    tablet_service: ServiceWithTablets,
    monkeypatch: pytest.MonkeyPatch,
    locale: str,
    unanswered: type[CellProcessGoneError],
) -> None:
    async def silent(_: dict[str, Any]) -> dict[str, Any]:
        raise unanswered

    publish_state(tablet_service, "ready")
    tablet_service.app.state.context.link.ask_question("wire_is_hooked")
    tablet_service.release_control()
    monkeypatch.setattr(tablet_service.app.state.context.link, "send_order", silent)
    async with tablet_service.signed_in_tablet("Tom", locale=locale) as page:
        await page.evaluate("location.hash = '#/'")
        await page.get_by_test_id("stop").click()
        await expect(page.get_by_test_id("refusal")).to_contain_text(
            NOT_CONFIRMED[locale], timeout=PATIENCE_MS
        )
