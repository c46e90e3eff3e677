"""A turn at the pendant and typed counts in a real browser: the key, what is left, and the word to stop."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import expect

from tests.service.browser_pages import CHOOSE, hold_to_rules, wait_for_language
from tests.service.past_cell_view import view_past_cell
from tests.service.test_view3d import Seen, feed_question

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.xdist_group("jog_pages")]

MINUS_SIGN = chr(0x2212)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def picture_view(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Seen]:
    async with view_past_cell(tmp_path_factory.mktemp("cell")) as found:
        yield found


def jog(left_deg: float, advice: str, **more: Any) -> dict[str, Any]:
    key = "+" if left_deg >= 0.0 else "-"
    turn = {"axis": 2, "key": key, "left_rad": left_deg / 57.29578, "turn_rad": 0.2, "advice": advice}
    return {**turn, "other_axis": None, "other_rad": 0.0, **more}


def question(key: str, text: str, data: dict[str, Any]) -> dict[str, Any]:
    return {
        "id": "r:7", "kind": "confirm", "key": key, "text": text, "unit": "", "step": "go to capture 1",
        "page": "ask", "data": data,
    }  # fmt: skip


TURN = question(
    "jog_by_hand",
    "With the pendant, turn J3 alone by +12.00 deg, at most 2.0 deg/s. Say yes when it stands.",
    {"jog": jog(12.0, "turn")},
)
COUNTS = [-1_234_567, 20, 300_000, 4, 5, 6]
TYPED = question(
    "type_mastering",
    "They are read back.",
    {"typed_counts": [{"name": f"J{k}", "now": 20, "type": count} for k, count in enumerate(COUNTS, 1)]},
)


@pytest.mark.parametrize(
    ("shown", "text", "german"),
    [
        (
            jog(-2.0, "slow"),
            "Turn J3 with the - key, 2.0 deg are left. Now slowly.",
            "Drehen Sie J3 mit der Taste -, es fehlen 2,0°. Jetzt langsam.",
        ),
        (
            jog(0.0, "stop"),
            "Stop now: J3 is there. Say yes when it stands.",
            "Jetzt anhalten: J3 ist dort.",
        ),
        (
            jog(9.0, "wrong_axis", other_axis=4, other_rad=0.1),
            "Stop: J5 turned by +5.7 deg. Only J3 may turn.",
            "Halt: J5 hat sich um +5,7° gedreht. Nur J3 darf sich drehen.",
        ),
    ],
)
async def test_a_turn_shows_key_rest_and_advice_while_it_is_made(
    picture_view: Seen, tmp_path: Path, shown: dict[str, Any], text: str, german: str
) -> None:
    def guide(live: dict[str, Any]) -> None:
        live["guidance"] = {"prompt_id": "r:7", "text": text, "values": shown}

    async with picture_view[0].open_page() as page:
        await feed_question(page, TURN, guide)
        await page.reload()
        await expect(page.get_by_test_id("jog-advice")).to_have_text(text)
        left = f"{abs(shown['left_rad']) * 57.29578:.1f}°"
        await expect(page.get_by_test_id("jog-left")).to_have_text(left)
        await expect(page.get_by_test_id("jog-key")).to_have_text("+" if shown["key"] == "+" else MINUS_SIGN)
        await page.screenshot(path=tmp_path / "jog.png")
        await hold_to_rules(page, "jog")
        choice = page.get_by_test_id("language")
        await page.evaluate(CHOOSE, [await choice.element_handle(), "de"])
        await wait_for_language(page, "de")
        await expect(page.get_by_test_id("jog-advice")).to_contain_text(german)


async def test_guidance_of_another_question_is_not_shown(picture_view: Seen) -> None:
    def guide(live: dict[str, Any]) -> None:
        live["guidance"] = {"prompt_id": "r:6", "text": "Stop now: J1 is there.", "values": jog(0.0, "stop")}

    async with picture_view[0].open_page() as page:
        await feed_question(page, TURN, guide)
        await page.reload()
        await expect(page.get_by_test_id("jog-left")).to_have_text("12.0°")
        await expect(page.get_by_test_id("jog-advice")).to_have_count(0)


async def test_six_counts_are_shown_to_be_typed(picture_view: Seen, tmp_path: Path) -> None:
    async with picture_view[0].open_page() as page:
        await feed_question(page, TYPED)
        await page.reload()
        rows = page.get_by_test_id("typed-counts").locator("tr")
        await expect(rows).to_have_count(6)
        await expect(rows.nth(0).locator("td").first).to_have_text("-1234567")
        await page.screenshot(path=tmp_path / "typed.png")
        await hold_to_rules(page, "typed counts")
