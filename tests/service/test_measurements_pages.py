"""The page of measurements in a real browser: a file is dropped, its result read and saved; a viewer looks."""

import base64
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio
from playwright.async_api import FilePayload, Page, expect

from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from tests.service.browser_pages import hold_to_rules, hold_to_rules_in_languages, unfold, wait_for_language
from tests.service.service_client import ServiceClock
from tests.service.service_with_tablets import (
    ServiceWithTablets,
    open_service_with_tablets,
)
from tests.service.test_measurements_api import bytes_of, two_devices
from tests.service.test_programs_pages import IdleProcess
from tests.unit.helpers.simulated_arm import tracker_points
from tests.unit.test_identify_report import file_of

pytestmark = pytest.mark.asyncio(loop_scope="module")
DROP = """([place, files]) => {
    const data = new DataTransfer();
    for (const [name, content] of Object.entries(files))
        data.items.add(new File([Uint8Array.from(atob(content), (letter) => letter.charCodeAt(0))], name));
    return ['dragover', 'drop'].every((kind) => !place.dispatchEvent(
        new DragEvent(kind, {dataTransfer: data, bubbles: true, cancelable: true}))); }"""


@pytest.fixture(scope="module")
def points_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = file_of(tracker_points("fanuc_m6ib", 60), tmp_path_factory.mktemp("measured") / "points.csv")
    return path


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def tablet_service(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[ServiceWithTablets]:
    path = write_cell_file(tmp_path_factory.mktemp("cell"), "127.0.0.1", seed=1, time_factor=1.0)
    async with open_service_with_tablets(path, process_double=IdleProcess, clock=ServiceClock()) as opened:
        yield opened
        await opened.app.state.identifications.close_all()
        assert opened.complaints == []


async def _drop_files(page: Page, place: str, files: dict[str, bytes]) -> None:
    """Drop files on a place of the page; no place hands them to the browser, which would leave the page for them."""
    encoded = {name: base64.b64encode(content).decode() for name, content in files.items()}
    handle = await page.locator(place).first.element_handle()
    assert await page.evaluate(DROP, [handle, encoded])


async def _drop_file(page: Page, name: str, content: bytes) -> None:
    await expect(page.get_by_test_id("drop")).to_be_visible()  # a page that is still to come takes nothing
    await _drop_files(page, "footer", {name: content})  # beside the marked place, as it happens


async def test_an_engineer_drops_a_file_reads_what_it_says_and_saves_it(
    tablet_service: ServiceWithTablets, points_file: Path
) -> None:
    async with tablet_service.signed_in_tablet("Emil") as page:
        await page.evaluate("location.hash = '#/programs'")
        await page.get_by_test_id("to-measurements").click()
        await expect(page.get_by_test_id("drop")).to_be_visible()
        await hold_to_rules_in_languages(page, "the empty page")
        await _drop_files(page, "h1", {"a.csv": b"1", "b.csv": b"2"})
        await expect(page.get_by_test_id("measurements-told")).to_contain_text("One file at a time")
        await _drop_file(page, points_file.name, bytes_of(points_file))
        await _is_read(page)
        await hold_to_rules_in_languages(page, "the result")
        result = await page.evaluate("location.hash")
        await _is_saved(page, tablet_service)
    async with tablet_service.signed_in_tablet("Vera", size=(390, 844)) as page:
        await page.evaluate("location.hash = '#/measurements'")
        await expect(page.get_by_test_id("may-look")).to_be_visible()
        await expect(page.get_by_test_id("drop")).to_have_count(0)
        await page.evaluate("(place) => (location.hash = place)", result)
        await expect(page.get_by_test_id("saved")).to_contain_text("version 1")
        await hold_to_rules(page, "the result on a phone")


async def _is_read(page: Page) -> None:
    await expect(page.get_by_test_id("found")).to_be_visible()
    before = await page.get_by_test_id("error-before").inner_text()
    held_out = await page.get_by_test_id("error-held-out").inner_text()
    assert float(held_out.split()[0]) < float(before.split()[0]) / 3, (before, held_out)
    plot = page.get_by_test_id("row-errors")
    await expect(plot).to_have_attribute("data-count", "60")
    await expect(plot.locator("svg[role=img] circle.after")).to_have_count(60)
    await expect(plot.locator(".figures")).to_contain_text(f"identified {held_out}")  # covers no point
    await expect(page.get_by_test_id("unknown")).to_contain_text("J1 offset")
    rows = page.get_by_test_id("parameters").locator("tbody tr")
    await expect(rows.first).to_be_hidden()
    await unfold(page.get_by_test_id("parameters"))
    await expect(rows.filter(has_text="J2 offset")).to_contain_text("°")
    for part in ("errors", "reasons"):
        await unfold(page.get_by_test_id(part))
    await expect(page.get_by_test_id("reasons")).to_contain_text("mastering offsets")
    await page.get_by_test_id("language").select_option("de")
    await wait_for_language(page, "de")
    await expect(page.get_by_test_id("reasons")).to_contain_text("Kreuzvalidierung über 40 Blöcke")
    await expect(page.get_by_test_id("reasons")).to_contain_text("vollständige Geometrie")
    await expect(page.get_by_test_id("found").locator("[lang=en]")).to_have_count(0)
    await page.get_by_test_id("language").select_option("en")
    await wait_for_language(page, "en")


async def _is_saved(page: Page, tablet_service: ServiceWithTablets) -> None:
    folder = Path(tablet_service.app.state.context.config.path).parent / "parameter_sets"
    assert not folder.exists()
    await page.get_by_test_id("save-note").fill("after the new gear")
    button = page.get_by_test_id("yes")
    await expect(button).to_be_enabled()
    await button.focus()
    await page.keyboard.down("Enter")
    await expect(page.get_by_test_id("saved")).to_contain_text("version 1")
    await page.keyboard.up("Enter")
    found = ParameterSets(folder).load_set(ParameterSets(folder).robot_serials()[0])
    assert (found.version, found.made_by, found.note) == (1, "Emil", "after the new gear")
    await page.get_by_test_id("to-parameters").click()
    await expect(page.get_by_test_id("versions")).to_contain_text("points.csv")


async def test_a_file_that_does_not_fit_is_reported_with_its_cause_and_cure(
    tablet_service: ServiceWithTablets, points_file: Path
) -> None:
    head, *rows = bytes_of(points_file).decode().splitlines()
    cells = [row.split(",") for row in rows]
    mirrored = [",".join([*row[:6], str(-float(row[6])), *row[7:]]) for row in cells]
    async with tablet_service.signed_in_tablet("Ada") as page:
        await page.evaluate("location.hash = '#/measurements'")
        choice = page.get_by_test_id("measured-file")
        await choice.set_input_files(
            {"name": "mirrored.csv", "mimeType": "text/csv", "buffer": "\n".join([head, *mirrored]).encode()}
        )
        refusal = page.get_by_test_id("not-identified")
        await expect(refusal).to_contain_text("mirror")
        await expect(refusal).to_contain_text("What to do:")
        await page.get_by_test_id("language").select_option("de")
        await wait_for_language(page, "de")
        await expect(refusal).to_contain_text("Was zu tun ist:")
        await expect(refusal.locator("[lang=en]")).to_have_count(0)
        await hold_to_rules(page, "a misfit in de")


async def _open_drawer(page: Page, *testids: str) -> None:
    for testid in testids:
        await unfold(page.get_by_test_id(testid))


def _in_memory(name: str, content: bytes) -> FilePayload:
    return {"name": name, "mimeType": "text/plain", "buffer": content}


async def test_an_engineer_computes_again_with_a_level_and_a_check_file(
    tablet_service: ServiceWithTablets, points_file: Path
) -> None:
    head, *rows = bytes_of(points_file).decode().splitlines()
    async with tablet_service.signed_in_tablet("Emil") as page:
        await page.evaluate("location.hash = '#/measurements'")
        await _drop_file(page, points_file.name, bytes_of(points_file))
        await expect(page.get_by_test_id("found")).to_be_visible()
        await expect(page.get_by_test_id("level")).to_be_hidden()  # the main question first
        await _open_drawer(page, "otherwise", "columns")
        await expect(page.get_by_test_id("column-q2")).to_have_value("joints 2")
        await expect(page.get_by_test_id("column-x")).to_have_value("position 1")
        await hold_to_rules_in_languages(page, "for the engineer")
        await page.get_by_test_id("level").select_option("1")
        check = "\n".join([head, *rows[:20]]).encode()
        await page.get_by_test_id("check-file").set_input_files(_in_memory("check.csv", check))
        await page.get_by_test_id("compute-again").click()
        found = page.get_by_test_id("found")
        await expect(found).to_have_attribute("data-level", "1")
        await expect(page.get_by_test_id("check-error")).to_contain_text("check.csv, 20 rows: 0.")
        await page.get_by_test_id("language").select_option("de")
        await wait_for_language(page, "de")
        await unfold(page.get_by_test_id("reasons"))
        await expect(page.get_by_test_id("reasons")).to_contain_text("verlangt")
        await expect(page.locator("main [lang=en]")).to_have_count(0)


async def test_columns_without_headings_are_named_on_the_page(
    tablet_service: ServiceWithTablets, points_file: Path
) -> None:
    head, *rows = bytes_of(points_file).decode().splitlines()
    names = [f"channel {letter}" for letter in "ABCDEFGHI"]
    assert len(names) == len(head.split(","))
    async with tablet_service.signed_in_tablet("Emil", size=(800, 1280)) as page:
        await page.evaluate("location.hash = '#/measurements'")
        await _drop_file(page, "unclear.csv", "\n".join([",".join(names), *rows]).encode())
        await expect(page.get_by_test_id("not-identified")).to_be_visible()
        labels = [f"joints {k}" for k in range(1, 7)] + [f"position {k}" for k in range(1, 4)]
        for name, meaning in zip(names, labels, strict=True):
            await page.get_by_test_id(f"column-{name}").select_option(meaning)
        await page.get_by_test_id("unit-joints").select_option("deg")
        await page.get_by_test_id("unit-position").select_option("mm")
        await hold_to_rules(page, "columns that were named")
        await page.get_by_test_id("compute-again").click()
        await expect(page.get_by_test_id("found")).to_be_visible()


async def test_readings_of_several_devices_are_shown_side_by_side(tablet_service: ServiceWithTablets) -> None:
    measured, layout = two_devices()
    async with tablet_service.signed_in_tablet("Emil") as page:
        await page.evaluate("location.hash = '#/measurements'")
        await _drop_file(page, "plate.csv", measured)
        await expect(page.get_by_test_id("otherwise")).to_be_visible()
        await _open_drawer(page, "otherwise", "columns")
        await page.get_by_test_id("layout-file").set_input_files(_in_memory("cell.toml", layout))
        await page.get_by_test_id("compute-again").click()
        series = page.get_by_test_id("series").locator("tbody tr")
        await expect(series).to_have_count(2)
        await expect(series.nth(1)).to_contain_text("wire")
        await _open_drawer(page, "parameters", "reasons")
        await hold_to_rules_in_languages(page, "several devices")
        await page.get_by_test_id("language").select_option("de")
        await wait_for_language(page, "de")
        await expect(page.locator("main [lang=en]")).to_have_count(0)
