"""A turn at the pendant and typed counts in a real browser: the key, what is left, and the word to stop."""

import json
import math
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import Page, WebSocketRoute, expect

from cellcal.calibration.message_table import with_messages
from cellcal.procedures.motion.jog_guidance import Advice, JogGuidance, JogLeg
from tests.service.browser_pages import CHOOSE, at_rest, hold_to_rules, wait_for_language, wait_for_value
from tests.service.past_cell_view import view_past_cell
from tests.service.test_pages import PageViewer

pytestmark = pytest.mark.asyncio(loop_scope="module")

MINUS_SIGN = chr(0x2212)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def page_viewer(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[PageViewer]:
    async with view_past_cell(tmp_path_factory.mktemp("cell")) as (viewer, past):
        RUN["id"] = past.calibration  # of which the page asks for photos
        yield viewer


RUN: dict[str, Any] = {
    "id": "", "procedure": "mastering_recovery", "title": "Mastering recovery", "who": "anna", "state": "running",
    "step": "go to capture 1", "index": 3, "expected": 9, "phases": [], "found": [], "events": [], "outcome": None,
    "hold_to_move": False, "does": "read", "instrument": "draw-wire", "left_s": None, "series": None,
}  # fmt: skip


async def ask_during_run(page: Page, prompt: dict[str, Any], guided: dict[str, Any] | None = None) -> None:
    """Let the page see a run that asks this, with guidance among its live values."""

    def forward_messages(line: WebSocketRoute) -> None:
        server = line.connect_to_server()

        def change_message(message: str | bytes) -> None:
            content = json.loads(message)
            if content["kind"] == "session":
                content["content"] |= {"prompt": prompt, "run": RUN}
            if content["kind"] == "live":
                content["content"]["guidance"] = guided
            line.send(json.dumps(with_messages(content)))

        server.on_message(change_message)

    await page.route_web_socket("**/api/screen", forward_messages)
    await page.reload()


# whether nothing stands above the first and the last line of a text
SEEN = """text => { const { left, top, bottom } = text.getBoundingClientRect();
    return [top + 12, bottom - 12].every(y => text.contains(document.elementFromPoint(left + 12, y))); }"""
NAMES = ("J1", "J2", "J3", "J4", "J5", "J6")


BRING_BACK = (
    "Axis 2: in manual mode, jog this axis alone until its calibration marks meet. Then update the revolution counter "
    "of this axis alone at the pendant."
)
NEAR_RECORD = (
    "In manual mode bring the robot near the pose of the record, as the pendant shows the joints: J1 13.5, J2 11.0, "
    "J3 -72.7, J4 -167.6, J5 -63.3, J6 -53.2 deg. Watch the arm: an axis may stand some motor turns from what is "
    "shown. Then hook the draw-wire to the flange and make the controller ready to move."
)


def guidance(left_deg: float, advice: Advice, **more: Any) -> JogGuidance:
    left_rad = math.radians(left_deg)
    return JogGuidance(JogLeg(2, math.radians(12.0), 0.0, NAMES), 0.0, 0.01, left_rad, advice, **more)


def question(key: str, text: str, data: dict[str, Any]) -> dict[str, Any]:
    return {
        "id": "r:7", "kind": "confirm", "key": key, "text": text, "unit": "", "step": "go to capture 1",
        "page": "ask", "data": data, "yes": "Done, go on", "no": "Not possible", "question": "", "is_folded": False,
        "drawing": "",
    }  # fmt: skip


TURN = question(
    "jog_by_hand",
    "With the pendant, turn J3 alone by +12.00 deg, at most 2.0 deg/s.",
    {"jog": guidance(12.0, Advice.TURN).as_json()},
)
COUNTS = [-1_234_567, 20, 300_000, 4, 5, 6]
TYPED = question(
    "type_mastering",
    "They are read back.",
    {"typed_counts": [{"name": f"J{k}", "now": 20, "type": count} for k, count in enumerate(COUNTS, 1)]},
)


@pytest.mark.parametrize(
    ("shown", "german"),
    [
        (guidance(-2.0, Advice.SLOW), "Drehen Sie J3 mit der Taste -, es fehlen 2,0°. Jetzt langsam."),
        (guidance(0.0, Advice.STOP), "Jetzt anhalten: J3 ist dort."),
        (
            guidance(9.0, Advice.WRONG_AXIS, other_axis=4, other_rad=0.1),
            "Halt: J5 hat sich um +5,7° gedreht. Nur J3 darf sich drehen.",
        ),
    ],
    ids=["slowly", "stop", "wrong axis"],
)
async def test_a_turn_shows_key_rest_and_advice_while_it_is_made(
    page_viewer: PageViewer, tmp_path: Path, shown: JogGuidance, german: str
) -> None:
    async with page_viewer.open_page() as page:
        guided = {"prompt_id": "r:7", "text": shown.sentence, "values": shown.as_json()}
        await ask_during_run(page, TURN, guided)
        await expect(page.get_by_test_id("jog-advice")).to_have_text(shown.sentence)
        left_angle = f"{abs(math.degrees(shown.left_rad)):.1f}°"
        await expect(page.get_by_test_id("jog-left")).to_have_text(left_angle)
        await expect(page.get_by_test_id("jog-key")).to_have_text("+" if shown.key == "+" else MINUS_SIGN)
        await page.screenshot(path=tmp_path / "jog.png")
        await hold_to_rules(page, "jog")
        choice = page.get_by_test_id("language")
        await page.evaluate(CHOOSE, [await choice.element_handle(), "de"])
        await wait_for_language(page, "de")
        await expect(page.get_by_test_id("jog-advice")).to_contain_text(german)


@pytest.mark.parametrize(
    ("text", "hold_to_move"),
    [(TYPED["text"], False), (BRING_BACK, True), (NEAR_RECORD, True), (NEAR_RECORD, False)],
)
async def test_a_question_is_seen_on_a_telephone_after_a_reload(
    page_viewer: PageViewer, text: str, hold_to_move: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(
        RUN, "hold_to_move", hold_to_move
    )  # its key takes as much of the screen as the answers
    async with page_viewer.open_page(size=(390, 844)) as page:
        await ask_during_run(
            page, {**TYPED, "text": text, "drawing": "pendant", "yes": "The axis is brought back"}
        )
        words = page.get_by_test_id("instruction")
        await expect(words).to_be_visible()
        await page.evaluate("scrollTo(0, document.documentElement.scrollHeight)")
        await page.reload()
        await expect(words).to_be_visible()
        await at_rest(page)
        await wait_for_value(lambda: words.evaluate(SEEN))  # not covered, and on the screen


async def test_guidance_of_another_question_is_not_shown(page_viewer: PageViewer) -> None:
    other = {"prompt_id": "r:6", "text": "Stop now: J1 is there.", "values": TURN["data"]["jog"]}
    async with page_viewer.open_page() as page:
        await ask_during_run(page, TURN, other)
        await expect(page.get_by_test_id("jog-left")).to_have_text("12.0°")
        await expect(page.get_by_test_id("jog-advice")).to_have_count(0)


async def test_six_counts_are_shown_to_be_typed(page_viewer: PageViewer, tmp_path: Path) -> None:
    async with page_viewer.open_page() as page:
        await ask_during_run(page, TYPED)
        rows = page.get_by_test_id("typed-counts").locator("tbody tr")
        await expect(rows).to_have_count(6)
        await expect(rows.nth(0).locator("td").first).to_have_text("-1234567")
        await page.screenshot(path=tmp_path / "typed.png")
        await hold_to_rules(page, "typed counts")
