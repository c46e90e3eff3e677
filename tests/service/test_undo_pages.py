"""U13 in a browser over the fake robot: old and new first, two seconds of a press, and back to the last byte."""

import json
import re
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import Page, expect
from pydantic_core import to_jsonable_python

from cellcal.drivers.interfaces import MasteringData
from cellcal.procedures.canonical_json import canonical_json
from cellcal.procedures.run_history import EventKind
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.record.journal import Journal
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.mastering_backups import mastering_backups
from tests.service.browser_pages import hold_to_rules, hold_to_rules_in_languages, wait_for_value
from tests.service.step_page_actions import FakePendant, at_the_pages, let_go_early, wait_for_question

pytestmark = pytest.mark.asyncio(loop_scope="module")
SERIAL = "F-104711"
NO_CHANGE = "\N{EN DASH}"
OFF = (0, 40_000, -30_000, 0, 9_000, 0)  # counts by which the backup is another mastering


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def pendant(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[FakePendant]:
    async with at_the_pages(tmp_path_factory.mktemp("undo")) as found:
        yield found


async def on_the_robot(pendant: FakePendant) -> bytes:
    """Return what the fake controller holds, in its stored form."""
    robot = (await pendant.fake_client.read_truth())["robots"]["fanuc"]
    data = MasteringData(tuple(robot["counts_at_zero"]), robot["mastered"])
    return canonical_json(to_jsonable_python(data)).encode()


def journal_write(
    journal: Journal, held_before: dict[str, Any], robot: dict[str, Any], name: str = "earlier"
) -> None:
    """Let the journal hold a run that wrote the present mastering over another one, and broke off there."""
    run_id = f"robot_calibration-{name}"
    identity = {"vendor": "FANUC", "model": "M-6iB", "serial": SERIAL, "firmware": "1"}
    header = {
        "procedure": "robot_calibration", "version": 1, "spec": {},
        "cell": {"devices": [{"role": "robot", "identity": identity}]},
    }  # fmt: skip
    read = {
        "step": "read the bench",
        "inputs": [],
        "effect": "none",
        "value": held_before | {"epoch": robot["epoch"]},
    }
    journal.append(run_id, EventKind.STARTED, header, key="started")
    journal.append(run_id, EventKind.FINDING, read)
    inputs = [[robot["counts_at_zero"]], {}]
    body = {"step": "write the mastering", "attempt": 1, "effect": "write", "inputs": inputs}
    journal.append(run_id, EventKind.INTENT, body)


def config_of(pendant: FakePendant) -> CellConfig:
    return read_cell_file(pendant._app.state.context.settings.cell_file)


async def start_undo(page: Page) -> None:
    await page.evaluate("location.hash = '#/procedure/mastering_undo'")
    await page.get_by_test_id("start").click()
    await wait_for_question(page, "accept_mastering")
    await expect(page.get_by_test_id("yes")).to_be_enabled()


async def hold_undo_button(page: Page, pendant: FakePendant) -> dict[str, Any]:
    """Hold the button until the run has ended, however long the machine takes."""
    await page.get_by_test_id("yes").hover()
    await page.mouse.down()
    ended = await pendant.viewer.wait_until(lambda session: session["run"]["outcome"])
    await page.mouse.up()
    await pendant.viewer.send_order(op="dismiss")
    outcome: dict[str, Any] = ended["run"]["outcome"]
    return outcome


async def test_a_written_mastering_is_undone_and_redone_to_the_last_byte(
    pendant: FakePendant, tmp_path: Path
) -> None:
    original = await on_the_robot(pendant)
    robot = (await pendant.fake_client.read_truth())["robots"]["fanuc"]
    other = [count + off for count, off in zip(robot["counts_at_zero"], OFF, strict=True)]
    backup = canonical_json({"counts_at_zero": other, "mastered": True}).encode()
    with open_journal(config_of(pendant)) as journal:
        journal_write(journal, {"counts_at_zero": other}, robot)
        backups = mastering_backups(journal.list_events(), SERIAL)
    assert [len(backups), backups[0].of_run] == [1, "robot_calibration-earlier"]

    async with pendant.viewer.open_page() as page:
        banner = page.get_by_test_id("loss")
        await expect(banner).to_contain_text("holds a mastering that was not confirmed")
        await expect(banner.get_by_role("link")).to_have_attribute("href", "#/procedure/mastering_undo")
        await page.screenshot(path=tmp_path / "unconfirmed_1280.png")
        await hold_to_rules(page, "unconfirmed")
        await start_undo(page)
        rows = page.get_by_test_id("review-changes").locator("tbody tr")
        await expect(rows).to_have_count(7)  # six axes and whether it is mastered
        await expect(rows.nth(6).locator("td")).to_have_text(
            ["mastered", "yes", re.compile("yes"), NO_CHANGE]
        )
        await expect(page.get_by_test_id("review-unmasters")).to_have_count(0)
        await expect(page.get_by_test_id("displacement")).to_have_text(re.compile(r"[1-9]\d*\.\d\d mm"))
        await expect(page.get_by_test_id("levers").locator("li")).to_have_count(6)
        await page.screenshot(path=tmp_path / "undo_1280.png")
        await hold_to_rules_in_languages(page, "undo")
        assert await on_the_robot(pendant) == original
        await let_go_early(page)
        assert await on_the_robot(pendant) == original  # one second is not two
        outcome = await hold_undo_button(page, pendant)
        assert (outcome["verdict"], outcome["judgement"]["word"]) == ("passed", "pass"), json.dumps(outcome)
        assert await on_the_robot(pendant) == backup
        await expect(banner).to_have_count(0)

        await start_undo(page)
        assert (await hold_undo_button(page, pendant))["verdict"] == "passed"
        await wait_for_value(lambda: on_the_robot(pendant), lambda value: value == original)

        with open_journal(config_of(pendant)) as journal:
            lost = {"mastering": {"counts_at_zero": other, "mastered": False}}
            journal_write(journal, lost, robot, "over a lost one")
        # the watch tells of it within ten seconds; a press made for the session before is refused
        await expect(banner).to_contain_text("holds a mastering that was not confirmed")
        await start_undo(
            page
        )  # what it goes back to is no mastering, and no text must be unfolded to learn it
        await expect(page.get_by_test_id("review-unmasters")).to_contain_text("NOT be mastered")
        await expect(rows.nth(6).locator("td")).to_have_text(["mastered", "yes", re.compile("no"), NO_CHANGE])
        await pendant.viewer.send_order(op="stop")
        await pendant.viewer.wait_until(lambda session: session["run"]["outcome"])
        await pendant.viewer.send_order(op="dismiss")
