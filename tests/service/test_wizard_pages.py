"""The pages of a technician in a browser: what happened, the robot in one glance, a run that was left half-way."""

import re
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import Page, expect

from cellcal.procedures.catalogue import DEFINITIONS
from cellcal.procedures.procedure_guide import INTENTIONS
from cellcal.procedures.run_history import EventKind
from cellcal.service.record.journal_files import open_journal
from cellcal.service.runs.settings_description import schema_of
from tests.service.browser_pages import (
    at_rest,
    go_to_page,
    hold_to_rules,
    hold_to_rules_in_languages,
    layout_faults,
    locales_for,
    unfold,
    wait_for_language,
    wait_for_value,
)
from tests.service.step_page_actions import FakePendant, at_the_pages, wait_for_question

pytestmark = pytest.mark.asyncio(loop_scope="module")
SIZES = ((1280, 800), (800, 1280), (390, 844))
TILES = ("position", "record", "check", "certificate", "devices")
FRAME: dict[str, Any] = {"frame_number": 3, "tip_in_flange_m": [0.0, 0.0, 0.2]}


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def pendant(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[FakePendant]:
    async with at_the_pages(tmp_path_factory.mktemp("wizard")) as found:
        yield found


def raw_names(schema: dict[str, Any]) -> Iterator[str]:
    """Yield the names of settings and of their parts that no person would say."""
    for part in (schema, *schema.get("$defs", {}).values()):
        yield from (name for name in part.get("properties", {}) if "_" in name)


async def unfold_intentions(page: Page) -> None:
    for intention in INTENTIONS:
        await unfold(page.get_by_test_id(f"intention-{intention}"))


async def expect_five_answers_in_viewport(page: Page) -> None:
    for intention in INTENTIONS:
        summary = page.get_by_test_id(f"intention-{intention}").locator("summary").first
        try:
            await expect(summary).to_be_in_viewport(ratio=0.5)
        except AssertionError as error:  # what stands above it is told, too
            raise AssertionError(f"{await page.locator('body').inner_text()}\n{error}") from error


async def test_home_shows_the_robot_in_one_glance_and_five_answers_on_one_screen(
    pendant: FakePendant,
) -> None:
    async with pendant.viewer.open_page() as page:
        for tile in TILES:
            await expect(page.get_by_test_id(f"glance-{tile}")).to_be_in_viewport()
        await expect(page.get_by_test_id("glance-record")).to_have_attribute("data-tone", "warn")  # none yet
        await expect_five_answers_in_viewport(page)
        await hold_to_rules_in_languages(page, "home")


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
async def test_each_procedure_says_when_to_use_it_how_long_it_takes_and_what_is_missing(
    pendant: FakePendant, size: tuple[int, int]
) -> None:
    rows = (await pendant.viewer.client.get("/api/procedures", params={"robot": "fanuc"})).json()
    async with pendant.viewer.open_page(size=size) as page:
        await unfold_intentions(page)
        for row in rows:
            card = page.get_by_test_id(f"procedure-{row['name']}")
            if row["for_other_controllers"]:
                await expect(card).to_have_count(0)
                continue
            await expect(card).to_contain_text(row["when"])
            await expect(card).to_contain_text(f"{row['minutes'][0]} to {row['minutes'][1]} min")
            for lack, remedy in zip(row["lacks"], row["remedies"], strict=True):
                await expect(card).to_contain_text(f"Missing: {lack}. {remedy}")
            await expect(card.get_by_role("link")).to_have_count(0 if row["lacks"] else 1)
        assert await page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        await hold_to_rules(page, f"home at {size}")
        if size == SIZES[-1]:  # a word of German may be wider than a telephone
            await page.get_by_test_id("language").select_option("de")
            await wait_for_language(page, "de")
            for name in ("six_point_tcp", "accuracy_check"):
                await go_to_page(page, f"#/procedure/{name}")
                assert await layout_faults(page) == [], name


@pytest.mark.parametrize("locale", locales_for("raw names"))
async def test_no_page_of_a_procedure_shows_a_raw_name_or_english_in_another_language(
    pendant: FakePendant, locale: str
) -> None:
    async with pendant.viewer.open_page(locale=locale) as page:
        await wait_for_language(page, locale)
        for entry in DEFINITIONS:
            await go_to_page(page, f"#/procedure/{entry.name}")
            await page.get_by_test_id("settings").wait_for(state="attached")
            assert await page.get_by_test_id("settings").locator("> .setting").count() <= 4
            await page.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")
            shown = await page.locator("main").inner_text()
            words = set(re.findall(r"[A-Za-z_]+", shown))
            assert words & set(raw_names(schema_of(entry.name, {}))) == set(), entry.name
            await expect(page.locator("main [lang=en]")).to_have_count(0)


async def test_what_an_engineer_changed_can_be_set_back_to_the_usual_value(pendant: FakePendant) -> None:
    async with pendant.viewer.open_page("#/procedure/mastering_record") as page:
        await unfold(page.get_by_test_id("all-settings"))
        field = page.get_by_test_id("value-samples")
        await expect(page.get_by_test_id("help-samples")).to_contain_text("Usually 5. From 1 to 1000")
        await field.fill("9")
        await field.press("Tab")
        await expect(page.get_by_test_id("changed-settings")).to_contain_text("1")
        await page.get_by_test_id("usual-samples").click()
        await expect(field).to_have_value("5")
        await expect(page.get_by_test_id("changed-settings")).to_have_count(0)


async def test_a_message_that_names_settings_says_what_they_are_called(pendant: FakePendant) -> None:
    async with pendant.viewer.open_page("#/procedure/mastering_record", locale="de") as page:
        await wait_for_language(page, "de")
        await page.get_by_test_id("settings").wait_for(state="attached")
        await page.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")
        for name, share in (("room.wire_low", "0,9"), ("room.wire_high", "0,5")):
            await page.get_by_test_id(f"value-{name}").fill(share)
            await page.get_by_test_id(f"value-{name}").press("Tab")
        await page.locator("section[aria-live] button").click()
        refused = page.get_by_test_id("no-forecast")
        await expect(refused).to_contain_text("Kürzestes Seil, Anteil des Bereichs")
        await expect(refused).not_to_contain_text("wire_low")
        pendant.viewer.complaints.clear()  # the browser tells of a refusal, too


async def test_a_person_who_left_half_way_finds_where_the_robot_stands_on_every_page_and_one_button(
    pendant: FakePendant,
) -> None:
    await pendant.viewer.send_order(op="start", procedure="three_point_frame", settings=FRAME)
    async with pendant.viewer.open_page("#/devices") as page:
        stands = page.get_by_test_id("where-stands")
        await expect(stands).to_contain_text("it waits for your answer")
        await expect(stands).to_contain_text("Nothing moves by this run before you answer.")
        for at in ("#/history", "#/programs", "#/tablet"):
            await go_to_page(page, at)
            await expect(stands).to_be_visible()
        await hold_to_rules(page, "half-way")
        await page.get_by_test_id("to-the-run").click()
        await wait_for_question(page, "pointer_is_mounted")
        await expect(page.get_by_test_id("yes")).to_have_text("The pointer is mounted")
        await expect(page.get_by_test_id("no")).to_have_text("I have no pointer")
        await page.get_by_test_id("no").click()
        await page.get_by_test_id("dismiss").click()
        await expect(stands).to_contain_text("Stopped half-way: User frame from three points")
        await page.get_by_test_id("resume-half-way").click()
        await wait_for_question(page, "pointer_is_mounted")
        await page.get_by_test_id("no").click()
        await page.get_by_test_id("dismiss").click()
        await page.get_by_test_id("leave-half-way").click()
        await expect(stands).to_have_count(0)
    pendant.release_control()


@contextmanager
def a_run_broken_off_in_a_move(pendant: FakePendant, serial: str) -> Iterator[None]:
    """Let the journal hold a run whose process was killed in mid-move; afterwards it has ended."""
    identity = {"identity": {"serial": serial}}
    header = {"procedure": "drift_check", "version": 1, "spec": {}, "cell": {"devices": [identity]}}
    intent = {"step": "capture 2", "attempt": 1, "effect": "move", "inputs": []}
    run_id = f"drift_check-{serial}"
    with open_journal(pendant.config) as journal:
        journal.append(run_id, EventKind.STARTED, header)
        journal.append(run_id, EventKind.INTENT, intent)
    try:
        yield
    finally:
        with open_journal(pendant.config) as journal:
            journal.append(run_id, EventKind.ENDED, {"verdict": "passed"})


async def select_robot_half_way(pendant: FakePendant, page: Page, robot: str) -> None:
    """Select a robot whose run was left, as a person does: who is refused for an older session presses again.

    The browser writes such a refusal into its console, which is no fault of the page.
    """
    button = page.get_by_test_id("where-stands").get_by_role("button", name=f"Select {robot}")

    async def press_and_read() -> str:
        await button.evaluate_all("found => found.forEach(each => each.click())")
        return await page.get_by_test_id("robot").input_value()

    await wait_for_value(press_and_read, lambda selected: selected == robot)
    await at_rest(page)
    complaints = pendant.viewer.complaints
    complaints[:] = [line for line in complaints if "409 (Conflict)" not in line]


async def test_after_a_killed_process_every_page_says_what_a_move_may_have_done(pendant: FakePendant) -> None:
    fanuc, ur = (robot.serial for robot in pendant.config.robots)
    with a_run_broken_off_in_a_move(pendant, fanuc), a_run_broken_off_in_a_move(pendant, ur):
        async with pendant.viewer.open_page("#/devices") as page:
            own, other = (page.get_by_test_id("where-stands").nth(place) for place in (0, 1))
            for at in ("#/devices", "#/history", "#/programs"):
                await go_to_page(page, at)
                await expect(own).to_contain_text("the robot may have moved")
                await expect(own).not_to_contain_text("The robot stands")
                await expect(other).to_contain_text("ur: Stopped half-way")
                await expect(other.get_by_test_id("in-doubt")).to_be_visible()
            await expect(own.get_by_test_id("resume-half-way")).to_be_visible()
            await expect(other.get_by_test_id("resume-half-way")).to_have_count(0)
            await hold_to_rules(page, "in-doubt")
            await select_robot_half_way(pendant, page, "ur")
            await expect(own).to_contain_text("fanuc: Stopped half-way")
            await select_robot_half_way(pendant, page, "fanuc")
            for _ in range(2):
                await own.get_by_test_id("leave-half-way").click()
            await expect(own).to_have_count(0)
    pendant.release_control()


async def test_five_answers_are_on_one_screen_below_the_banner_of_a_run_that_was_left(
    pendant: FakePendant,
) -> None:
    await pendant.viewer.send_order(op="start", procedure="three_point_frame", settings=FRAME)
    async with pendant.viewer.open_page() as page:
        await wait_for_question(page, "pointer_is_mounted")
        await page.get_by_test_id("no").click()
        await page.get_by_test_id("dismiss").click()
        await go_to_page(page, "#/")
        await expect(page.get_by_test_id("where-stands")).to_be_visible()
        await expect_five_answers_in_viewport(page)
        await page.get_by_test_id("leave-half-way").click()
    pendant.release_control()


async def test_larger_words_are_kept_by_the_tablet_and_break_no_rule(pendant: FakePendant) -> None:
    async with pendant.viewer.open_page("#/tablet") as page:
        before = await page.evaluate("parseFloat(getComputedStyle(document.documentElement).fontSize)")
        await page.get_by_test_id("large-text").get_by_role("checkbox").check()
        await hold_to_rules_in_languages(page, "the tablet")
        await page.reload()
        await go_to_page(page, "#/")
        after = await page.evaluate("parseFloat(getComputedStyle(document.documentElement).fontSize)")
        assert after > before
        await hold_to_rules(page, "home with larger words")
