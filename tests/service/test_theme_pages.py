"""The colours of the pages in a browser: as the system has it, or as the tablet chose, also in drawings and the picture."""

import io
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import pytest
import pytest_asyncio
from PIL import Image
from playwright.async_api import Locator, Page, expect

from tests.service.browser_pages import (
    PATIENCE_MS,
    THEMES,
    at_rest,
    go_to_page,
    hold_to_rules_in_languages,
    wait_for_value,
)
from tests.service.cell_with_history import PastRuns
from tests.service.past_cell_view import view_past_cell
from tests.service.test_colours import contrast, luminance, themes
from tests.service.test_pages import PageViewer

pytestmark = pytest.mark.asyncio(loop_scope="module")
SHOWN = "document.documentElement.dataset.theme"
# The colour that the first drawing of the page is drawn with.
DRAWN_WITH = (
    "getComputedStyle(document.querySelector('[data-testid=drawing] use')).getPropertyValue('--brand')"
)

ViewedRuns = tuple[PageViewer, PastRuns]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def past(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[ViewedRuns]:
    async with view_past_cell(tmp_path_factory.mktemp("cell")) as found:
        yield found


@asynccontextmanager
async def tablet_with(viewer: PageViewer, **system: Any) -> AsyncIterator[Page]:
    """Open a page on a tablet whose system wants such colours."""
    context = await viewer.browser.new_context(viewport={"width": 1280, "height": 800}, **system)
    context.set_default_timeout(PATIENCE_MS)
    page = await context.new_page()
    try:
        await page.goto(viewer.url)
        await page.get_by_test_id("device-robot").wait_for()
        yield page
    finally:
        await context.close()


def rgb(colour: str) -> str:
    return f"rgb({', '.join(str(int(colour[i : i + 2], 16)) for i in (1, 3, 5))})"


@pytest.mark.parametrize(
    ("system", "theme"),
    [
        ({"color_scheme": "light", "contrast": "no-preference"}, "usual"),
        ({"color_scheme": "dark", "contrast": "no-preference"}, "dark"),
        ({"color_scheme": "light", "contrast": "more"}, "bright"),
        pytest.param({"color_scheme": "dark", "contrast": "more"}, "dark", marks=pytest.mark.soak),
    ],
)
async def test_a_tablet_that_chose_nothing_follows_its_system(
    past: ViewedRuns, system: dict[str, str], theme: str
) -> None:
    async with tablet_with(past[0], **system) as page:
        assert await page.evaluate(SHOWN) == theme
        # The folded cards of procedures, which come before it once they are there, have no ground.
        card = page.locator("aside.card")
        await expect(card).to_have_css("background-color", rgb(themes()[theme]["--card"]))


async def test_a_change_of_the_system_is_followed_and_a_choice_of_the_tablet_is_kept(
    past: ViewedRuns,
) -> None:
    async with tablet_with(past[0], color_scheme="light") as page:
        await page.emulate_media(color_scheme="dark")
        await expect(page.locator("html")).to_have_attribute("data-theme", "dark")
        await go_to_page(page, "#/tablet")
        await expect(page.get_by_test_id("theme-system")).to_have_attribute("aria-pressed", "true")
        await hold_to_rules_in_languages(page, "the choice")
        await page.get_by_test_id("theme-bright").click()
        await expect(page.locator("html")).to_have_attribute("data-theme", "bright")
        await page.reload()
        await expect(page.locator("html")).to_have_attribute("data-theme", "bright")
        await expect(page.get_by_test_id("theme-bright")).to_have_attribute("aria-pressed", "true")
        await page.get_by_test_id("theme-system").click()
        await expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    async with tablet_with(past[0], color_scheme="light") as page:  # another tablet
        assert await page.evaluate(SHOWN) == "usual"


async def test_drawings_and_the_picture_of_the_cell_have_the_colours_of_the_theme(past: ViewedRuns) -> None:
    async with tablet_with(past[0], color_scheme="light") as page:
        for theme in (*THEMES[1:], THEMES[0]):
            await go_to_page(page, "#/tablet")
            await page.get_by_test_id(f"theme-{theme}").click()
            await go_to_page(page, "#/")
            await wait_for_value(lambda: page.evaluate("window.__robot?.frames"))
            colours = themes()[theme]
            drawing = page.get_by_test_id("drawing").first
            await wait_for_value(partial(drawing.evaluate, "seen => seen.firstElementChild.getBBox().width"))
            assert (await page.evaluate(DRAWN_WITH)).strip() == colours["--brand"]
            inked = await _darkest_and_lightest(drawing)
            assert min(contrast(colours["--card"], colour) for colour in inked) < 1.1  # its ground
            assert max(contrast(colours["--card"], colour) for colour in inked) > 7.0  # its lines
            view = page.get_by_test_id("view3d").locator("canvas")
            sky = await _darkest_and_lightest(view, share=0.08)
            assert max(contrast(colours["--view-above"], colour) for colour in sky) < 1.25


async def _darkest_and_lightest(place: Locator, share: float = 1.0) -> tuple[str, str]:
    """Return the darkest and the lightest colour of an element, or of its upper left corner, as #rrggbb."""
    shown = Image.open(io.BytesIO(await place.screenshot())).convert("RGB")
    corner = shown.crop((0, 0, round(shown.width * share), round(shown.height * share)))
    counts = corner.getcolors(corner.width * corner.height)
    assert counts is not None
    colours = sorted(("#{:02x}{:02x}{:02x}".format(*colour) for _, colour in counts), key=luminance)
    return colours[0], colours[-1]


async def test_plots_are_drawn_anew_in_other_colours(past: ViewedRuns) -> None:
    viewer, runs = past
    async with tablet_with(viewer, color_scheme="light") as page:
        await go_to_page(page, f"#/history/{runs.touches}")
        plot = page.get_by_test_id("residual-plot")
        await wait_for_value(lambda: plot.get_attribute("data-marks"))
        for scheme in ("dark", "light"):
            await page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
            theme = "dark" if scheme == "dark" else "usual"
            await expect(page.locator("html")).to_have_attribute("data-theme", theme)
            await at_rest(page)
            inked = await wait_for_value(lambda: _darkest_and_lightest(plot), len)
            assert max(contrast(themes()[theme]["--card"], seen) for seen in inked) > 4.0, theme
