"""Pages by keyboard alone: Tab goes as one reads, where it is can be seen, and nothing that stays there covers it."""

from collections.abc import AsyncIterator
from itertools import pairwise
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import Page

from tests.service.browser_pages import go_to_page
from tests.service.test_pages import VIEWPORTS, PageViewer, view_cell
from tests.service.test_settings_pages import unfold_sections

pytestmark = pytest.mark.asyncio(loop_scope="module")
PLACES = (
    "#/",
    "#/history",
    "#/programs",
    "#/measurements",
    "#/devices",
    "#/procedure/three_point_frame",
    "#/procedure/drift_check",
)
MOST_STOPS = 200
FORGET = "() => { document.activeElement.blur(); scrollTo(0, 0); window.__met = new Set(); }"
# A field whose own look is hidden is drawn by the label around it. A column is what begins at the same left edge.
FOCUSED_ELEMENT = """() => { const focused = document.activeElement;
    if (focused === document.body || window.__met.has(focused)) return null;
    window.__met.add(focused);
    const drawn = getComputedStyle(focused).opacity === '0' ? focused.closest('label') : focused;
    const box = drawn.getBoundingClientRect();
    const [x, y] = [box.left + box.width / 2, box.top + box.height / 2], over = document.elementFromPoint(x, y);
    const column = drawn.closest('.columns > *');
    return { what: focused.outerHTML.slice(0, 90), top: box.top + scrollY, bottom: box.bottom + scrollY, left: box.left,
        column: column ? [...column.parentElement.children].indexOf(column) : null,
        drawn: getComputedStyle(drawn).outlineStyle !== 'none',
        covered: over === null || !(drawn.contains(over) || over.contains(drawn)) }; }"""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def page_viewer(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[PageViewer]:
    async with view_cell(tmp_path_factory.mktemp("cell")) as viewer:
        yield viewer


async def tab_stops(page: Page) -> list[dict[str, Any]]:
    """Press Tab until it has been everywhere; return where it went."""
    await page.evaluate(FORGET)
    found: list[dict[str, Any]] = []
    while len(found) < MOST_STOPS:
        await page.keyboard.press("Tab")
        held_elements = await page.evaluate(FOCUSED_ELEMENT)
        if held_elements is None:
            break
        found.append(held_elements)
    return found


@pytest.mark.parametrize("size", VIEWPORTS)
async def test_tab_goes_as_one_reads_and_is_seen(page_viewer: PageViewer, size: tuple[int, int]) -> None:
    async with page_viewer.open_page(size=size, locale="es") as page:
        for place in PLACES:
            await go_to_page(page, place)
            if "procedure" in place:
                await page.get_by_test_id("settings").wait_for()
                await unfold_sections(page)
            found = await tab_stops(page)
            assert 5 < len(found) < MOST_STOPS, place
            assert [each["what"] for each in found if not each["drawn"]] == [], place
            assert [each["what"] for each in found if each["covered"]] == [], place
            back = [
                (one["what"], other["what"])
                for one, other in pairwise(found)
                if one["column"] == other["column"] and _is_before(other, one)
            ]
            assert back == [], place


def _is_before(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether one stands above another, or left of it in the same row."""
    same_row = one["top"] < other["bottom"] and other["top"] < one["bottom"]
    return bool(one["left"] < other["left"] if same_row else one["top"] < other["top"])
