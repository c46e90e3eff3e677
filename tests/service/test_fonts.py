"""Chinese on a device that has no Chinese font: the pages bring their own, and no other device fetches it."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path

import pytest
from playwright.async_api import Page, expect

from tests.service.browser_pages import at_rest, open_chromium, serve_app, wait_for_language, wait_for_value
from tests.service.service_client import open_service_client

LATIN_ONLY = """<?xml version="1.0"?><fontconfig><dir>/usr/share/fonts/truetype/dejavu</dir>
<cachedir>{cache}</cachedir></fontconfig>"""
OURS = "Noto Sans SC"
SMALL = "/assets/pages-"  # cut to the characters of our own texts
RARE = "龘龖"  # in no text; a person may be called so


@asynccontextmanager
async def sign_in_page(
    folder: Path, locale: str, **environment: str
) -> AsyncIterator[tuple[Page, list[str]]]:
    """Open the first page; yield the fonts that it fetched, too."""
    fetched: list[str] = []
    async with (
        open_service_client(folder / "cell") as service_client,
        serve_app(service_client.app, lifespan="off") as url,
        open_chromium(**environment) as browser,
    ):
        page = await browser.new_page(locale=locale)
        page.on(
            "request", lambda request: fetched.append(request.url) if request.url.endswith(".woff2") else None
        )
        await page.goto(url)
        await expect(page.locator("main h1").first).to_be_visible()
        await at_rest(page)
        yield page, fetched


async def fonts_of(page: Page, place: str) -> dict[str, tuple[bool, int]]:
    """Return what a text is drawn with: whether the page brought it, and how many glyphs are of it."""
    devtools = await page.context.new_cdp_session(page)
    await devtools.send("DOM.enable")
    await devtools.send("CSS.enable")
    root = await devtools.send("DOM.getDocument")
    node = await devtools.send("DOM.querySelector", {"nodeId": root["root"]["nodeId"], "selector": place})
    answer = await devtools.send("CSS.getPlatformFontsForNode", {"nodeId": node["nodeId"]})
    return {one["familyName"]: (one["isCustomFont"], int(one["glyphCount"])) for one in answer["fonts"]}


@pytest.mark.asyncio
@pytest.mark.parametrize("chosen_later", [False, True])
async def test_a_device_without_a_chinese_font_is_given_one(tmp_path: Path, chosen_later: bool) -> None:
    config = tmp_path / "fonts.conf"
    config.write_text(LATIN_ONLY.format(cache=tmp_path / "cache"))
    locale = "en-US" if chosen_later else "zh-CN"
    async with sign_in_page(tmp_path, locale, FONTCONFIG_FILE=str(config)) as (page, fetched):
        if chosen_later:
            await page.get_by_test_id("language").select_option("zh")
            await wait_for_language(page, "zh")
        for place in ("main h1", "header nav a"):
            text = await page.locator(place).first.inner_text()
            chinese = sum(one > "\u2fff" for one in text)
            assert chinese, text
            ours = partial(glyphs_of_ours, page, place)
            assert await wait_for_value(ours, lambda count, all_=chinese: count == all_), place  # type: ignore[misc]
        assert fetched
        assert all(SMALL in url for url in fetched), "our own texts need no whole piece of the font"
        await page.evaluate("name => document.querySelector('main h1').textContent = name", RARE)
        assert await wait_for_value(
            partial(glyphs_of_ours, page, "main h1"), lambda count: count == len(RARE)
        )
        assert not all(SMALL in url for url in fetched)


async def glyphs_of_ours(page: Page, place: str) -> int:
    fonts = await fonts_of(page, place)
    return sum(count for name, (brought, count) in fonts.items() if brought and name.startswith(OURS))


@pytest.mark.asyncio
@pytest.mark.parametrize("locale", ["zh-CN", "de-DE"])
async def test_a_device_with_its_own_fonts_fetches_none(tmp_path: Path, locale: str) -> None:
    async with sign_in_page(tmp_path, locale) as (page, fetched):
        fonts = await fonts_of(page, "main h1")
        assert fonts
        assert not any(brought for brought, _ in fonts.values())
        assert not fetched
