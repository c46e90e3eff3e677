"""A lost position of a Yaskawa in a real browser: from the home page to the certificate, and stopped half-way."""

import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from playwright.async_api import Locator, Page, expect

from cellcal.drivers.interfaces import Instruction
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.procedures.guided_cures import AXES, PendantWorker, guided_fakes
from tests.service.browser_pages import go_to_page
from tests.service.test_pages import PageViewer, view_service

pytestmark = pytest.mark.asyncio(loop_scope="module")
RECORD = {"poses": 16, "samples": 2}
PLACES = (
    "#/",
    "#/history",
    "#/devices",
    "#/procedure/position_record",
    "#/procedure/position_cure",
    "#/programs",
)
LOSS_IDS = ("loss", "loss-first", "stopped", "where-stands")


@asynccontextmanager
async def yaskawa_with_record(folder: Path) -> AsyncIterator[tuple[PageViewer, PendantWorker]]:
    """Serve a simulated Yaskawa whose position record was taken, with a person at its pendant."""
    with guided_fakes(folder, "yaskawa") as (path, hands):
        async with view_service(create_app(ServiceSettings(path, open_access=True))) as viewer:
            await viewer.send_order(
                op="start", procedure="position_record", settings=RECORD, hold_to_move=False
            )
            await answer_until_ended(viewer, hands)
            await viewer.send_order(op="dismiss")
            await viewer.wait_until(lambda session: session["run"] is None)
            yield viewer, hands


async def answer_until_ended(viewer: PageViewer, hands: PendantWorker) -> None:
    """Do what a run asks for, past the pages, until it passed."""
    last_id = None
    while True:
        session = await viewer.wait_until(
            lambda s, last=last_id: s["run"]["outcome"] or (s["prompt"] or {"id": last})["id"] != last
        )
        if session["run"]["outcome"]:
            assert session["run"]["outcome"]["verdict"] == "passed", session["run"]["outcome"]
            return
        prompt = session["prompt"]
        await hands.confirm(Instruction(prompt["key"], prompt["text"]))
        await viewer.send_order(op="answer", prompt_id=prompt["id"])
        last_id = prompt["id"]


async def do_one(page: Page, hands: PendantWorker) -> str:
    """Do what the page asks for and say so; return the key of the question, or "" where the run ended."""
    prompt, outcome = page.get_by_test_id("prompt"), page.get_by_test_id("outcome")
    await expect(prompt.or_(outcome)).to_be_visible()
    if await outcome.count():
        return ""
    key = str(await prompt.get_attribute("data-key"))
    words = page.get_by_test_id("instruction")
    text = await words.inner_text()
    await hands.confirm(Instruction(key, text))
    await page.get_by_test_id("yes").click()
    await expect(without_question(page, key, text).or_(outcome)).to_be_visible()
    return key


def without_question(page: Page, key: str, text: str) -> Locator:
    """Return the page once it asks for something else, or works."""
    same = page.locator(f'[data-testid="prompt"][data-key="{key}"]').filter(
        has=page.get_by_test_id("instruction").get_by_text(text.splitlines()[0], exact=True)
    )
    return page.locator("main").filter(has_not=same)


async def begin_cure(page: Page) -> None:
    """Begin the cure by the one button of the home page."""
    await go_to_page(page, "#/")
    await page.get_by_test_id("first-button").click()
    await page.get_by_test_id("hold-to-move").uncheck()
    await page.get_by_test_id("start").click()


async def test_a_cure_is_walked_by_its_pages_and_no_page_shows_the_loss_after_it(tmp_path: Path) -> None:
    async with yaskawa_with_record(tmp_path) as (viewer, hands), viewer.open_page() as page:
        await hands.lose_position((1, 4))
        await expect(page.get_by_test_id("loss-first")).to_be_visible()
        await go_to_page(page, "#/procedure/position_cure")
        axes = page.get_by_test_id("setting-axes_again").get_by_role("button")
        assert [name.split()[-1] for name in await axes.all_inner_texts()] == list(AXES["yaskawa"])
        for axis, pressed in ((0, True), (5, True), (0, False)):
            await axes.nth(axis).click()
            await expect(axes.nth(axis)).to_have_attribute("aria-pressed", str(pressed).lower())
        await begin_cure(page)
        keys = []
        while key := await do_one(page, hands):
            keys.append(key)
        assert sum(key.startswith("bring_back_") for key in keys) == 3, keys  # two are lost, one was named
        await expect(page.get_by_test_id("outcome")).to_have_attribute("data-verdict", "pass")
        await expect(page.get_by_test_id("certificate-pdf")).to_be_visible()
        await page.get_by_test_id("dismiss").click()
        await viewer.wait_until(lambda session: session["run"] is None and not session["losses"])
        for place in PLACES:
            await go_to_page(page, place)
            for test_id in LOSS_IDS:
                await expect(page.get_by_test_id(test_id)).to_have_count(0)
        await go_to_page(page, "#/devices")
        await expect(page.get_by_test_id("panel-robot")).to_contain_text(
            re.compile(r"S\s-?\d.*T\s-?\d", re.DOTALL)
        )
        await go_to_page(page, "#/")
        await expect(page.get_by_test_id("glance").locator('[data-tone="bad"]')).to_have_count(0)


async def test_a_second_loss_after_a_stop_half_way_is_refused_and_begun_anew(tmp_path: Path) -> None:
    async with yaskawa_with_record(tmp_path) as (viewer, hands), viewer.open_page() as page:
        await hands.lose_position((1,))
        await begin_cure(page)
        assert (await do_one(page, hands)).startswith("bring_back_")
        await expect(page.get_by_test_id("prompt")).not_to_have_attribute(
            "data-key", "bring_back_absolute_data"
        )
        await page.get_by_test_id("stop").click()
        await page.get_by_test_id("dismiss").click()
        await viewer.wait_until(lambda session: session["run"] is None)
        await hands.lose_position((4,))
        await viewer.wait_until(lambda session: session["losses"])
        await go_to_page(page, "#/")
        await expect(page.get_by_test_id("loss-first")).to_be_visible()
        await page.get_by_test_id("resume-half-way").click()
        reason = page.get_by_test_id("reason")
        await expect(reason).to_contain_text("B lost its position after this run had begun")
        await expect(page.get_by_test_id("outcome")).to_contain_text("Start a new run")
        await page.get_by_test_id("dismiss").click()
        await expect(page.get_by_test_id("loss-first")).to_be_visible()
        await expect(page.get_by_test_id("resume-half-way")).to_have_count(0)
        await begin_cure(page)
        keys = []
        while key := await do_one(page, hands):
            keys.append(key)
        await expect(page.get_by_test_id("outcome")).to_have_attribute("data-verdict", "pass")
        assert sum(key.startswith("bring_back_") for key in keys) == 2, keys  # the one of the first run, too
