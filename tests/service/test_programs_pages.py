"""The page of programs in a real browser: an engineer makes a preview and takes it away, a viewer looks."""

import io
import re
import shutil
import zipfile
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import Page, expect

from cellcal.service.demo.fake_cell import write_cell_file
from tests.example_projects import FOLDER
from tests.service.browser_pages import (
    hold_to_rules,
    hold_to_rules_in_languages,
    locales_for,
    unfold,
    wait_for_language,
)
from tests.service.service_client import ServiceClock
from tests.service.service_with_tablets import ServiceWithTablets, open_service_with_tablets, sign_in

pytestmark = pytest.mark.asyncio(loop_scope="module")
PROGRAMS = FOLDER / "cell_1" / "programs"
NUMBERS = re.compile(rb"([XYZWPR]) = *-?[\d.]+ +(mm|deg)")


class IdleProcess:
    """Takes the place of the cell process: the cell is there, and no run is."""

    session: dict[str, Any] = {  # noqa: RUF012  never written to
        "rev": 1, "cell": "cell 7", "robots": [{"name": "fanuc", "model": "m6ib", "serial": "1"}],
        "robot": "fanuc", "level": "commanded", "losses": [], "waits_for_hold": False,
        "journal_end": "", "troubles": [],
        "connection": {"connected": True, "message": "", "remedy": ""}, "run": None, "prompt": None,
    }  # fmt: skip

    live_values: dict[str, Any] | None = None

    def __init__(self, _: object) -> None: ...

    async def send_order(self, command: dict[str, Any]) -> dict[str, Any]:
        """Take a letting go; nothing else is ordered here."""
        assert command["order"] == {"op": "hold", "held": False}, command
        return {"ok": True, "rev": 1}


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def tablet_service(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[ServiceWithTablets]:
    folder = tmp_path_factory.mktemp("cell")
    shutil.copytree(FOLDER, folder / "projects")
    path = write_cell_file(folder, "127.0.0.1", seed=1, time_factor=1.0)
    async with open_service_with_tablets(path, process_double=IdleProcess, clock=ServiceClock()) as opened:
        yield opened
        await opened.app.state.programs.close_all()
        assert opened.complaints == []


@pytest.fixture
def tablet_files(tmp_path: Path) -> list[Path]:
    """Programs on the tablet, one of them damaged."""
    bad = tmp_path / "RACK_PICK.LS"
    bad.write_bytes((PROGRAMS / bad.name).read_bytes().replace(b"X =   600.000  mm", b"X =   {00.000  mm", 1))
    good = shutil.copy(PROGRAMS / "DOOR_SPOTS.LS", tmp_path)
    return [Path(good), bad]


async def test_an_engineer_moves_programs_looks_and_takes_them_away(
    tablet_service: ServiceWithTablets, tablet_files: list[Path]
) -> None:
    sources = [path.read_bytes() for path in tablet_files]
    async with tablet_service.signed_in_tablet("Emil") as page:
        await _ask_for_a_move(page, tablet_files)
        await page.get_by_test_id("make").click()
        await expect(page.get_by_test_id("made")).to_be_visible()
        await _is_reported(page)
        await _is_taken(page, sources[0])
        assert [path.read_bytes() for path in tablet_files] == sources
        for locale in sorted({*locales_for("the preview"), "de"}):
            await page.get_by_test_id("language").select_option(locale)
            await wait_for_language(page, locale)
            await hold_to_rules(page, f"the preview in {locale}")
            if locale == "de":
                await expect(page.get_by_test_id("refused")).to_contain_text("dies wird nicht verstanden")
                await expect(page.get_by_test_id("refused")).to_contain_text("Sichern Sie das Programm")
        await page.get_by_test_id("language").select_option("en")
        preview = await page.evaluate("location.hash")
        await expect(page.get_by_test_id("checked")).to_be_visible()
        await expect(page.get_by_test_id("nothing-new")).to_have_count(0)
    await _check_viewer_page(tablet_service, preview)
    async with tablet_service.signed_in_tablet("Emil") as page:
        await _nothing_is_claimed_where_nothing_was_changed(page, tablet_files)


async def _nothing_is_claimed_where_nothing_was_changed(page: Page, files: list[Path]) -> None:
    """A cell without the tools that the programs use: no point was checked, and no program is new."""
    await page.evaluate("location.hash = '#/programs'")
    await page.get_by_test_id("files").set_input_files(files)
    await page.get_by_test_id("way-move").click()
    await page.get_by_test_id("cell").select_option("here:fanuc")
    await page.get_by_test_id("offset-x").fill("820")
    await page.get_by_test_id("offset-x").press("Tab")
    await page.get_by_test_id("make").click()
    await expect(page.get_by_test_id("nothing-new")).to_be_visible()
    await expect(page.get_by_test_id("checked")).to_have_count(0)


async def _ask_for_a_move(page: Page, files: list[Path]) -> None:
    await page.locator("nav a[href='#/programs']").click()
    await expect(page.get_by_test_id("make")).to_be_disabled()
    await page.get_by_test_id("cell").select_option("here:fanuc")
    await page.get_by_test_id("files").set_input_files(files)
    await expect(page.get_by_test_id("missing")).to_contain_text("No identified parameters")
    await expect(page.get_by_test_id("make")).to_be_disabled()  # and nothing can be compensated
    await page.get_by_test_id("way-move").click()
    await page.get_by_test_id("cell").select_option("kept:door line, cell 1")
    await expect(page.get_by_test_id("missing")).to_be_visible()  # nothing has moved yet
    await page.get_by_test_id("offset-x").fill("820")
    await page.get_by_test_id("offset-x").press("Tab")
    await page.get_by_test_id("frame").fill("2")
    await expect(page.get_by_test_id("make")).to_be_enabled()
    await hold_to_rules_in_languages(page, "the question")
    await page.get_by_test_id("cell").select_option("here:fanuc")
    await unfold(page)
    await page.get_by_test_id("add-tool").click()
    await hold_to_rules(page, "tools that are entered")
    await page.get_by_test_id("cell").select_option("kept:door line, cell 1")


async def _is_reported(page: Page) -> None:
    """Points that fail are told by shape and word, the damaged file by line and column."""
    left_count = int(await page.get_by_test_id("made").get_attribute("data-left") or 0)
    assert 0 < left_count < 16
    rows = page.get_by_test_id("points-table").locator("tbody tr")
    await expect(rows).to_have_count(16)
    await expect(rows.locator("xpath=self::*[@data-verdict='reach']")).to_have_count(left_count)
    await expect(rows.first).to_contain_text("✗ out of reach")
    await expect(rows.first).to_contain_text("left as it was")
    await expect(rows.last).to_contain_text("✓ fits")
    await expect(rows.last).to_contain_text("mm")
    await expect(page.get_by_test_id("refused")).to_contain_text("RACK_PICK.LS, line 36, column")
    await expect(page.get_by_test_id("refused")).to_contain_text("Save the program again")
    await expect(page.get_by_test_id("notes")).to_contain_text("PR[1]")
    picture = page.get_by_test_id("programs-picture")
    await expect(picture.locator("svg[role=img] circle")).to_have_count(2 * (16 - left_count))
    await expect(picture.locator("svg[role=img] .left")).to_have_count(2 * left_count)
    await expect(page.get_by_test_id("made")).to_contain_text("NOT for collision")


async def _is_taken(page: Page, source: bytes) -> None:
    async with page.expect_download() as download:
        await page.get_by_test_id("take").click()
    path = await (await download.value).path()
    name = (await download.value).suggested_filename
    with zipfile.ZipFile(io.BytesIO(path.read_bytes())) as archive:
        folder = name.removesuffix(".zip")
        assert set(archive.namelist()) == {
            f"{folder}/programs/DOOR_SPOTS.LS",
            *(f"{folder}/report/report.{kind}" for kind in ("html", "csv", "json")),
        }
        new = archive.read(f"{folder}/programs/DOOR_SPOTS.LS")
    assert new != source
    assert NUMBERS.sub(rb"\1 \2", new) == NUMBERS.sub(rb"\1 \2", source), "only coordinates may differ"


async def _check_viewer_page(tablet_service: ServiceWithTablets, preview: str) -> None:
    async with tablet_service.signed_in_tablet("Vera", size=(800, 1280)) as page:
        await page.evaluate(f"location.hash = {preview!r}")
        await expect(page.get_by_test_id("may-not-take")).to_be_visible()
        await expect(page.get_by_test_id("take")).to_have_count(0)
        await expect(page.get_by_test_id("points-table").locator("tbody tr")).to_have_count(16)
        await hold_to_rules(page, "the preview on an upright tablet")
        await page.get_by_test_id("make-others").click()
        await expect(page.get_by_test_id("may-look")).to_be_visible()
        await expect(page.get_by_test_id("ask")).to_have_count(0)
        await expect(page.get_by_test_id("jobs").locator("li")).to_have_count(1)
        await sign_in(page, "Ada")
        await page.locator("nav a[href='#/programs']").click()
        await expect(page.get_by_test_id("ask")).to_be_visible()
        await hold_to_rules(page, "the question on an upright tablet")
