"""Settings in a real browser: every kind has fields, units and words; what the service refuses is said in them."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import Page, expect

from cellcal.procedures.accuracy_limits import is_in_reach
from cellcal.procedures.catalogue import DEFINITIONS
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.browser_pages import (
    go_to_page,
    hold_to_rules,
    layout_faults,
    locales_for,
    some_of,
    wait_for_language,
)
from tests.service.cell_process_session import a_cell
from tests.service.test_pages import PageViewer, view_cell, view_service
from tests.unit.helpers.usual_settings_file import with_usual

pytestmark = pytest.mark.asyncio(loop_scope="module")
ROOM = "setting-room"
TIP_SPEED = {"de": "Geschwindigkeit der Spitze", "es": "Velocidad de la punta", "zh": "尖端速度"}
NEGATIVE = {"de": "endliche", "es": "finit", "zh": "有限"}


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def page_viewer(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[PageViewer]:
    async with view_cell(tmp_path_factory.mktemp("cell")) as viewer:
        yield viewer


USUAL = """[robot.usual.fixture_alignment]
fixture = "door jig"
points_in_fixture_m = [[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [0.0, 0.4, 0.0], [0.3, 0.2, 0.3]]
rough_base_fixture = { position_m = [0.9, -0.2, -0.1] }
rules = { samples = 30 }"""


async def fill_field(page: Page, test_id: str, text: str) -> None:
    """Type into a field, and go on to the next."""
    await page.get_by_test_id(test_id).fill(text)
    await page.get_by_test_id(test_id).press("Tab")


async def unfold_sections(page: Page) -> None:
    """Open all that is folded."""
    await page.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")


async def request_forecast(page: Page) -> dict[str, Any]:
    """Press the button that asks what will happen; return what was asked."""
    async with page.expect_response("**/api/dry-runs") as answered:
        await page.locator("section[aria-live] button").click()
    request: dict[str, Any] = (await answered.value).request.post_data_json
    return request


async def test_all_settings_unfolded_are_fields_for_gloves_and_none_wants_json(
    page_viewer: PageViewer,
) -> None:
    async with page_viewer.open_page(size=(800, 1280)) as page:
        for entry in DEFINITIONS:
            await go_to_page(page, f"#/procedure/{entry.name}")
            await page.get_by_test_id("settings").wait_for(state="attached")  # one has none
            await unfold_sections(page)
            assert await page.locator("[data-kind=json]").count() == 0, entry.name
            assert await page.evaluate("document.documentElement.scrollWidth <= innerWidth"), entry.name
            assert await layout_faults(page) == [], entry.name
            if entry in some_of(DEFINITIONS, "settings", every=4):
                await hold_to_rules(page, entry.name)


async def test_nothing_begins_while_a_field_shows_what_does_not_count(page_viewer: PageViewer) -> None:
    """Its usual value would be used: not the 0.5 that the screen shows."""
    async with page_viewer.open_page("#/procedure/six_point_tcp") as page:
        await page.get_by_test_id("settings").wait_for()
        await unfold_sections(page)
        await fill_field(page, "value-tool_number", "1.5")
        await expect(page.get_by_text("This is not a whole number.")).to_be_visible()
        await fill_field(page, "value-tool_number", "1")
        start, unread = page.get_by_test_id("start"), page.get_by_test_id("unread")
        for field, typed in (("rms_limit_m", "0.5 kg"), ("rms_limit_m", "1e999"), ("min_move_m", "0.3")):
            await expect(unread).to_have_count(0)
            await fill_field(page, f"value-{field}", typed)
            await expect(unread).to_contain_text("Not taken over yet")
            await expect(start).to_be_disabled()
            await fill_field(page, f"value-{field}", "")
        await expect(unread).to_have_count(0)
        await go_to_page(page, "#/procedure/mastering_recovery")
        await page.get_by_test_id("settings").wait_for()
        await unfold_sections(page)
        await page.get_by_test_id("alarms.battery-add").click()  # a line that is left empty
        await expect(unread).to_contain_text("Not taken over yet")
        await page.get_by_test_id("alarms.battery-remove-1").click()
        await expect(unread).to_have_count(0)


async def test_what_has_parts_is_filled_in_part_by_part(page_viewer: PageViewer) -> None:
    async with page_viewer.open_page("#/procedure/mastering_recovery", locale="de") as page:
        await page.get_by_test_id("settings").wait_for()
        await unfold_sections(page)
        await fill_field(page, "value-room.tip_speed_m_s", "100,5")
        await page.get_by_test_id("room.surroundings.planes-add").click()
        await unfold_sections(page)
        plane = "room.surroundings.planes.0"
        await fill_field(page, f"value-{plane}.name", "Boden")
        for axis, point, normal in zip("xyz", ("0", "0", "-12,5"), ("0", "0", "1"), strict=True):
            await fill_field(page, f"{plane}.point_in_base_m-0-{axis}", point)
            await fill_field(page, f"{plane}.normal_in_base-0-{axis}", normal)
        normals = page.get_by_test_id(f"setting-{plane}.normal_in_base")
        await expect(normals.get_by_test_id("unit")).to_have_count(0)  # a direction has none
        await expect(page.get_by_test_id("value-alarms.battery.0")).to_have_value("SRVO-062")  # the usual one
        await page.get_by_test_id("alarms.battery-add").click()
        await page.get_by_test_id("alarms.battery-remove-1").click()
        settings = (await request_forecast(page))["settings"]
        room = settings["room"]
        assert room["tip_speed_m_s"] == 0.1005
        assert room["surroundings"]["planes"] == [
            {"name": "Boden", "point_in_base_m": [0, 0, -0.0125], "normal_in_base": [0, 0, 1]}
        ]
        assert settings["alarms"] == {"battery": ["SRVO-062"]}
        await page.reload()
        await expect(page.get_by_test_id("value-room.tip_speed_m_s")).to_have_value("100,5")
        await unfold_sections(page)
        await page.get_by_test_id("usual-room").click()
        await expect(page.get_by_test_id("usual-room")).to_have_count(0)
        assert "room" not in (await request_forecast(page))["settings"]


@pytest.mark.parametrize("locale", locales_for("a dry run"))
async def test_a_dry_run_says_how_well_it_would_be_known_and_on_what_that_rests(
    page_viewer: PageViewer, locale: str
) -> None:
    marks: list[str] = []
    for name in ("mastering_record", "accuracy_check"):
        request = {"procedure": name, "robot": "fanuc", "settings": {}}
        forecast = (await page_viewer.client.post("/api/dry-runs", json=request)).json()["forecast"]
        predictions = forecast["predictions"]
        async with page_viewer.open_page(f"#/procedure/{name}", locale=locale) as page:
            await wait_for_language(page, locale)
            await page.get_by_test_id("settings").wait_for()
            await request_forecast(page)
            foretold = page.get_by_test_id("foretold")
            await expect(foretold.locator("dt")).to_have_count(len(predictions))
            await unfold_sections(page)
            limits = [(one["expanded"], limit) for one in predictions for limit in one["limits"].values()]
            shown = [text[0] for text in await foretold.locator(".chip").all_inner_texts()]
            assert shown == ["✓" if is_in_reach(*each) else "✗" for each in limits]
            marks += shown
            for section in ("assumed", "not_checked"):
                lines = page.get_by_test_id(f"foretold_{section}").locator("li")
                await expect(lines).to_have_count(len(forecast[section]))
            await expect(page.locator(".forecast [lang=en]")).to_have_count(0)
            await hold_to_rules(page, "a dry run")
    assert set(marks) == {"✓", "✗"}


@pytest.mark.parametrize("locale", locales_for("refused settings")[:-1])
async def test_settings_that_are_refused_are_named_with_their_bounds(
    page_viewer: PageViewer, locale: str
) -> None:
    async with page_viewer.open_page("#/procedure/mastering_record", locale=locale) as page:
        await wait_for_language(page, locale)
        await page.get_by_test_id("settings").wait_for()
        await unfold_sections(page)
        ask = page.locator("section[aria-live] button")
        await fill_field(page, "value-room.tip_speed_m_s", "400")
        await expect(page.locator("p.fault")).to_contain_text("250 mm/s")
        await expect(page.get_by_test_id("value-room.tip_speed_m_s")).to_have_attribute(
            "aria-invalid", "true"
        )
        await expect(page.locator("main")).to_contain_text(TIP_SPEED[locale])
        await expect(ask).to_be_disabled()  # nothing begins with what the form did not take
        await expect(page.locator(".fault [lang=en]")).to_have_count(0)
        await hold_to_rules(page, "a refusing form")

        await fill_field(page, "value-room.tip_speed_m_s", "100")
        await expect(page.locator("p.fault")).to_have_count(0)
        await expect(ask).to_be_enabled()
        await fill_field(page, "value-room.surroundings.margin_m", "-1000")
        await request_forecast(page)
        refused = page.get_by_test_id("no-forecast")
        await expect(refused).to_contain_text(
            NEGATIVE[locale]
        )  # the cell is refused, and what can be told is
        await expect(refused).not_to_contain_text("--set")  # a tablet has no command line
        await expect(refused.locator("[lang=en]")).to_have_count(0)
        assert [line for line in page_viewer.complaints if "422" not in line and "400" not in line] == []
        page_viewer.complaints.clear()  # the browser tells of a refusal, too


async def test_a_run_that_settings_did_not_let_begin_names_them_as_the_form_does(
    page_viewer: PageViewer,
) -> None:
    async with page_viewer.open_page("#/procedure/six_point_tcp", locale="es") as page:
        await expect(
            page.get_by_test_id("start")
        ).to_be_disabled()  # another client may start it nevertheless
        await page_viewer.send_order(op="start", procedure="six_point_tcp", settings={}, hold_to_move=False)
        reason = page.get_by_test_id("reason")
        await expect(reason).to_contain_text("Número de la herramienta")
        outcome = page.get_by_test_id("outcome")
        await expect(outcome).not_to_contain_text("tool_number")
        await expect(outcome).not_to_contain_text("cellcal")  # a tablet has no command line
        await page.get_by_test_id("dismiss").click()
        await expect(outcome).to_have_count(0)


async def test_a_procedure_that_is_not_there_is_no_dead_end(page_viewer: PageViewer) -> None:
    async with page_viewer.open_page("#/procedure/none") as page:
        await page.get_by_test_id("no-procedure").wait_for()
        await page.locator("main a[href='#/']").click()
        await expect(page.locator("main h1")).to_be_visible()
        await expect(page.get_by_test_id("no-procedure")).to_have_count(0)


TAGS = b"tag,x,y,z\nP1,0.1,0.2,0.3\nP2,0.5,0.2,0.3\nP3,0.1,0.9,0.3\n"


async def test_how_a_file_of_tags_is_written_is_set_in_fields(page_viewer: PageViewer) -> None:
    async with page_viewer.open_page("#/procedure/simulation_cell", size=(800, 1280)) as page:
        needed, start = page.get_by_test_id("still-needed"), page.get_by_test_id("start")
        await expect(needed).to_contain_text("Tags of the simulation, ")
        await expect(start).to_be_disabled()  # the service would refuse it
        await expect(page.get_by_test_id("hold-to-move")).to_have_count(0)  # nothing moves
        await page.get_by_test_id("value-part").select_option("base")
        await unfold_sections(page)
        for field, word in (("columns-position", " x,y, z"), ("sheet", "S"), ("columns-name", "tag")):
            await fill_field(page, f"simulated-{field}", word)
        await page.get_by_test_id("simulated-unit-position").select_option("cm")
        await page.get_by_test_id("simulated-convention").select_option("kuka_abc")
        for name in ("simulated", "measured"):
            file = {"name": f"{name}.csv", "mimeType": "text/csv", "buffer": TAGS}
            await page.get_by_test_id(f"value-{name}").set_input_files(file)
            await expect(page.get_by_test_id(f"setting-{name}")).to_contain_text(f"{name}.csv")
        await fill_field(page, "simulated-sheet", "")
        await expect(needed).to_have_count(0)
        await expect(start).to_be_enabled()
        settings = (await request_forecast(page))["settings"]
        file_settings = {key: value for key, value in settings["simulated"].items() if key != "file"}
        assert file_settings == {
            "columns": {"position": "x,y, z", "name": "tag"},
            "units": {"position": "cm"},
            "convention": "kuka_abc",
        }
        assert settings["measured"].keys() == {"name", "content_base64"}
        await expect(page.get_by_test_id("no-forecast")).to_have_count(0)
        await page.reload()
        await expect(page.get_by_test_id("simulated-convention")).to_have_value("kuka_abc")
        await unfold_sections(page)
        await hold_to_rules(page, "a file of tags")


async def test_settings_from_the_cell_file_are_filled_in(tmp_path: Path) -> None:
    async with (
        a_cell(tmp_path) as (path, _),
        view_service(create_app(ServiceSettings(with_usual(path, USUAL), open_access=True))) as viewer,
    ):
        await _is_filled_in(viewer)


async def _is_filled_in(viewer: PageViewer) -> None:
    async with viewer.open_page("#/procedure/fixture_alignment") as page:
        await expect(page.get_by_test_id("value-fixture")).to_have_value("door jig")
        await unfold_sections(page)
        await expect(page.get_by_test_id("points_in_fixture_m-1-x")).to_have_value("600")
        await expect(page.get_by_test_id("rough_base_fixture-0-y")).to_have_value("-200")
        await expect(page.get_by_test_id("value-rules.samples")).to_have_value("30")
        assert (await request_forecast(page))["settings"] == {}
        await fill_field(page, "value-rules.samples", "12")
        settings = (await request_forecast(page))["settings"]
        assert settings.keys() == {"rules"}
        assert settings["rules"]["samples"] == 12
