"""Judging in a real browser: residuals, what if, before and after, the map, comparisons, and the way back."""

import asyncio
import io
import json
import re
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from openpyxl import load_workbook
from playwright.async_api import Locator, Page, expect

from cellcal.service.engineering.parameters.parameter_sets import FOLDER, ParameterSets
from tests.service.browser_pages import (
    at_rest,
    go_to_page,
    hold_to_rules,
    layout_faults,
    locales_for,
    unfold,
    wait_for_language,
    wait_for_value,
)
from tests.service.cell_with_history import SERIAL, SPOILT_STEP, PastRuns
from tests.service.longer_texts import lengthen_page_texts
from tests.service.past_cell_view import view_past_cell
from tests.service.step_page_actions import let_go_early
from tests.service.test_pages import PageViewer

pytestmark = pytest.mark.asyncio(loop_scope="module")
ViewedRuns = tuple[PageViewer, PastRuns]
READINGS = 16 + 5  # of the arm's own target, and of the point of its tool
RUNS = "rows => rows.map(row => row.dataset.run)"
COLOUR_AT = """([x, y]) => {
    const plot = document.querySelector('[data-testid=residual-plot]'), canvas = plot.querySelector('canvas');
    const over = plot.querySelector('.u-over').getBoundingClientRect(), box = canvas.getBoundingClientRect();
    const scale = canvas.width / box.width;
    return [...canvas.getContext('2d').getImageData(
        (over.left - box.left + x) * scale, (over.top - box.top + y) * scale, 1, 1).data]; }"""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def review_view(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[ViewedRuns]:
    async with view_past_cell(tmp_path_factory.mktemp("cell")) as found:
        yield found


async def plot_points(page: Page) -> list[list[int]]:
    """Return where the plot has its points, once it is drawn."""
    plot = page.get_by_test_id("residual-plot")
    await wait_for_value(lambda: plot.get_attribute("data-marks"))
    await at_rest(page)  # what comes below it can narrow the page, and the plot with it
    found: list[list[int]] = json.loads(await plot.get_attribute("data-marks") or "")
    return found


async def tap_point(page: Page, at: list[int]) -> dict[str, Any]:
    """Tap a point of the plot; return the service's answer."""
    async with page.expect_response("**/what-if") as answer:
        await page.locator("[data-testid=residual-plot] .u-over").click(position={"x": at[0], "y": at[1]})
    answer_json: dict[str, Any] = await (await answer.value).json()
    return answer_json


async def test_a_tap_puts_a_reading_back_and_takes_it_out_again(review_view: ViewedRuns) -> None:
    viewer, past = review_view
    async with viewer.open_page(f"#/history/{past.spoilt}") as page:
        at = await plot_points(page)
        card = page.get_by_test_id("residuals")
        assert len(at) == READINGS
        await expect(card).to_have_attribute("data-count", str(READINGS))
        await expect(card).to_have_attribute("data-signed", "true")
        fit = page.get_by_test_id("fit-u")
        signed = await fit.inner_text()  # of a review that is there, with its marks
        odd = int(SPOILT_STEP.split()[1]) - 1
        refit = await tap_point(page, at[odd])
        assert [p["used"] for p in refit["points"]] == [True] * READINGS
        await page.get_by_test_id("what-if").wait_for()
        await expect(card).to_have_attribute("data-signed", "false")
        await expect(fit).to_contain_text(signed)  # beside the other figure, and called signed
        await expect(page.get_by_test_id("took")).to_have_attribute("data-ms", re.compile(r"\d+"))
        await page.get_by_test_id("as-signed").click()
        await expect(card).to_have_attribute("data-signed", "true")
        await expect(fit).to_have_text(signed)


async def test_an_outlier_differs_in_shape_and_colour(review_view: ViewedRuns) -> None:
    viewer, past = review_view
    async with viewer.open_page(f"#/history/{past.spoilt}") as page:
        at = await plot_points(page)
        odd = int(SPOILT_STEP.split()[1]) - 1
        blue = await page.evaluate(COLOUR_AT, at[0])
        assert blue[2] > blue[0] + 60
        cross = await page.evaluate(COLOUR_AT, at[odd])
        assert cross[0] > cross[2] + 60
        beside = [at[odd][0] + 4, at[odd][1]]  # a dot fills this place, a cross does not
        assert await page.evaluate(COLOUR_AT, beside) != cross
        assert (await page.evaluate(COLOUR_AT, [at[0][0] + 4, at[0][1]]))[2] > blue[0] + 60


async def test_the_table_shows_and_does_the_same_as_the_plot(review_view: ViewedRuns) -> None:
    viewer, past = review_view
    async with viewer.open_page(f"#/history/{past.spoilt}") as page:
        await plot_points(page)
        await unfold(page.get_by_test_id("residuals"))
        rows = page.get_by_test_id("residual-table").locator("tbody tr")
        await expect(rows).to_have_count(READINGS)
        await expect(page.locator("tr[data-outlier=true]")).to_have_count(1)
        review = (await viewer.client.get(f"/api/runs/{past.spoilt}/review")).json()
        for i, point in enumerate(review["points"]):
            await expect(rows.nth(i)).to_contain_text(f"{point['residual_m'] * 1e3:.3f} mm")
        await rows.nth(0).get_by_role("button").click()
        await page.get_by_test_id("what-if").wait_for()
        await page.locator("tr[data-used=false]").nth(1).wait_for()
        await expect(rows.nth(0)).to_have_attribute("data-used", "false")


async def test_too_few_readings_are_refused_in_words(review_view: ViewedRuns) -> None:
    viewer, past = review_view
    async with viewer.open_page(f"#/history/{past.touches}") as page:
        at = await plot_points(page)
        await unfold(page.get_by_test_id("residuals"))
        rows = page.get_by_test_id("residual-table").locator("tbody tr")
        refused = page.get_by_test_id("what-if-refused")
        for i in range(len(at)):
            async with page.expect_response("**/what-if"):
                await rows.nth(i).get_by_role("button").click()
            await expect(page.get_by_test_id("residuals")).to_have_attribute("aria-busy", "false")
            if await refused.count():
                break
        await expect(refused).to_contain_text("3")
        await wait_for_value(lambda: _complaints_of(viewer))
        assert [line for line in viewer.complaints if "422" not in line] == []
        viewer.complaints.clear()  # the browser tells of a refusal, too


async def test_a_frames_point_is_left_out_by_a_tap_and_put_back_in_the_table(review_view: ViewedRuns) -> None:
    viewer, past = review_view
    async with viewer.open_page(f"#/history/{past.moved}") as page:
        at, table = await plot_points(page), page.get_by_test_id("fit-values")
        assert len(at) == 4
        signed = await table.inner_text()
        refit = await tap_point(page, at[2])
        assert [p["used"] for p in refit["points"]] == [True, True, False, True]
        await page.get_by_test_id("what-if").wait_for()
        value = refit["values"][0]
        assert abs(value["value"] - value["signed"]) > 1e-5
        await expect(table).to_contain_text(f"{value['value'] * 1e3:.3f} mm")
        await expect(table).to_contain_text(f"{value['signed'] * 1e3:.3f} mm")
        await unfold(page.get_by_test_id("residuals"))
        rows = page.get_by_test_id("residual-table").locator("tbody tr")
        for i, point in enumerate(refit["points"]):
            await expect(rows.nth(i)).to_contain_text(f"{point['residual_m'] * 1e3:.3f} mm")
            await expect(rows.nth(i)).to_have_attribute("data-used", str(point["used"]).lower())
        await rows.nth(2).get_by_role("button").click()
        await expect(page.get_by_test_id("residuals")).to_have_attribute("data-signed", "true")
        await expect(table).to_have_text(signed, use_inner_text=True)


@pytest.mark.parametrize("locale", locales_for("a point that cannot be spared"))
async def test_a_point_that_cannot_be_spared_is_refused_in_the_pages_language(
    review_view: ViewedRuns, locale: str
) -> None:
    viewer, past = review_view
    async with viewer.open_page(f"#/history/{past.frame}", locale=locale) as page:
        await wait_for_language(page, locale)
        await plot_points(page)
        await unfold(page.get_by_test_id("residuals"))
        rows = page.get_by_test_id("residual-table").locator("tbody tr")
        async with page.expect_response("**/what-if") as answer:  # residuals of zero lie on the plot's edge
            await rows.nth(1).get_by_role("button").click()
        refusal = await (await answer.value).json()
        refused = page.get_by_test_id("what-if-refused")
        await expect(refused).to_contain_text("3")
        if locale != "en":
            await expect(refused).not_to_contain_text(refusal["message"])
        await expect(refused.locator("[lang=en]")).to_have_count(0)
        await expect(page.get_by_test_id("residuals")).to_have_attribute("data-signed", "true")
        await wait_for_value(lambda: _complaints_of(viewer))
        assert [line for line in viewer.complaints if "422" not in line] == []
        viewer.complaints.clear()


async def test_settings_that_differ_are_rows_with_units(review_view: ViewedRuns) -> None:
    viewer, past = review_view
    async with viewer.open_page("#/history", locale="de") as page:
        await page.get_by_test_id("run").first.wait_for()
        for run in (past.frame, past.moved):
            await page.locator(f"[data-run='{run}']").get_by_test_id("pick").click()
        table = page.get_by_test_id("settings-differ")
        sigma = table.locator("[data-path=old_sigma_m]")
        await expect(sigma).to_contain_text("0,500 mm")
        await expect(table.locator("[data-path='points_in_frame_m.4']")).to_contain_text(
            "300,000 / 200,000 / 100,000 mm"
        )
        words = await table.inner_text()
        assert not re.search(r"null|[\[\]{}_]|\d\.\d", words), words


async def _complaints_of(viewer: PageViewer) -> list[str]:
    return viewer.complaints


async def test_before_and_after_and_the_map_say_what_the_service_says(review_view: ViewedRuns) -> None:
    viewer, past = review_view
    review = (await viewer.client.get(f"/api/runs/{past.calibration}/review")).json()
    async with viewer.open_page(f"#/history/{past.calibration}") as page:
        for which in ("before", "after"):
            spread = page.get_by_test_id(f"spread-{which}")
            for key in ("mean_m", "rms_m", "max_m", "u_m"):
                await expect(spread).to_contain_text(f"{review['validation'][which][key] * 1e3:.3f} mm")
        card = page.get_by_test_id("error-map")
        await expect(card.locator("figure circle")).to_have_count(2 * len(review["places"]))
        most = max(place["u_m"] for place in review["places"])
        await page.get_by_test_id("map-u").click()
        await expect(card).to_contain_text(f"{most * 1e3:.3f}")


async def test_the_certificate_is_named_hashed_and_checked_on_the_page(review_view: ViewedRuns) -> None:
    viewer, past = review_view
    async with viewer.open_page(f"#/history/{past.calibration}") as page:
        await page.get_by_test_id("verified").wait_for()
        signed = (await viewer.client.get(f"/api/runs/{past.calibration}/certificate.json")).json()
        await expect(page.get_by_test_id("certificate-word")).to_have_text("PASS")
        await unfold(page.get_by_test_id("certificate-marks"))
        await expect(page.get_by_test_id("certificate-id")).to_have_text(past.calibration)
        await expect(page.get_by_test_id("certificate-hash")).to_have_text(signed["sha256"])
        for kind, begins in (("html", b"<!"), ("pdf", b"%PDF")):
            link = await page.get_by_test_id(f"certificate-{kind}").get_attribute("href")
            content = (await viewer.client.get(f"/{str(link).removeprefix('./')}")).content
            assert content.lstrip().lower().startswith(begins.lower())
        path = past.config.cell.data_dir / "certificates" / f"{past.calibration}.json"
        certificate_bytes = path.read_bytes()
        path.write_bytes(
            certificate_bytes.replace(b"Anna", b"Anne", 1)
            if b"Anna" in certificate_bytes
            else certificate_bytes.replace(b"pass", b"fail", 1)
        )
        await page.get_by_test_id("verify").click()
        await page.locator("[data-testid=certified][data-finding=tampered]").wait_for()
        path.write_bytes(certificate_bytes)


async def test_the_history_is_newest_first_filtered_and_compared(review_view: ViewedRuns) -> None:
    viewer, past = review_view
    async with viewer.open_page("#/history") as page:
        rows = page.get_by_test_id("run")
        runs_answer = (await viewer.client.get("/api/runs")).json()
        newest = [
            line["run_id"] for line in sorted(runs_answer, key=lambda x: x["started_utc"], reverse=True)
        ]
        await wait_for_value(lambda: rows.evaluate_all(RUNS), lambda shown: shown == newest)
        await page.get_by_test_id("filter").fill("Robot Calibration")
        await expect(rows).to_have_count(2)
        for i in range(2):
            await page.get_by_test_id("pick").nth(i).click()
        card = page.get_by_test_id("compared")
        await card.locator("tr[data-changed]").first.wait_for()
        compared = (await viewer.client.get(f"/api/runs/{past.spoilt}/against/{past.calibration}")).json()
        lines = len(compared["figures"]) + len(compared["settings"])
        await expect(card.locator("tbody tr")).to_have_count(lines)


async def test_the_way_back_is_shown_first_held_two_seconds_and_saves_a_version(
    review_view: ViewedRuns,
) -> None:
    viewer, past = review_view
    sets = ParameterSets(past.config.path.parent / FOLDER)
    newest = sets.load_set(SERIAL).version
    async with viewer.open_page("#/parameters") as page:
        await expect(page.get_by_test_id("versions").locator("tbody tr")).to_have_count(newest)
        await expect(page.get_by_test_id("yes")).to_have_count(0)  # not before the difference was shown
        await page.get_by_test_id("back-to").select_option("1")
        hold = page.get_by_test_id("yes")
        await hold.wait_for()
        await page.get_by_test_id("changes").wait_for()
        await let_go_early(page)  # a tap is not enough
        assert sets.load_set(SERIAL).version == newest
        await page.get_by_test_id("why").fill("the tool was bent")
        await hold.hover()
        await page.mouse.down()
        await page.locator(f"tr[data-version='{newest + 1}']").wait_for()
        await page.mouse.up()
        await expect(page.get_by_test_id("go-back-told")).to_contain_text("1")
    parameter_set = sets.load_set(SERIAL)
    assert (parameter_set.version, parameter_set.rolls_back_to, parameter_set.note) == (
        newest + 1,
        1,
        "the tool was bent",
    )


async def test_trends_have_a_point_for_each_version_and_run(review_view: ViewedRuns) -> None:
    viewer, past = review_view
    async with viewer.open_page(f"#/parameters/{SERIAL}") as page:
        await page.get_by_test_id("procedure").select_option("robot_calibration")
        trend = (
            await viewer.client.get(f"/api/trend?robot_serial={SERIAL}&procedure=robot_calibration")
        ).json()
        plots = page.get_by_test_id("trend")
        await page.locator("[data-testid=trend] [data-drawn]").nth(1).wait_for()
        versions = ParameterSets(past.config.path.parent / FOLDER).load_set(SERIAL).version
        await expect(page.get_by_test_id("versions").locator("tbody tr")).to_have_count(versions)
        await expect(plots.nth(0)).to_have_attribute("data-count", str(versions))
        assert len(trend[0]["points"]) == 2
        await expect(plots.nth(1)).to_have_attribute("data-count", "2")


@pytest.mark.parametrize(("locale", "words"), [("en", "not determined"), ("zh", "未能确定")])
async def test_what_was_not_determined_is_written_in_words_and_not_drawn(
    review_view: ViewedRuns, locale: str, words: str
) -> None:
    viewer, _ = review_view
    stored = (await viewer.client.get(f"/api/parameters/{SERIAL}?version=1")).json()["parameters"]
    unseen = next(value for value in stored if value["name"] == "J1 offset")
    assert not unseen[
        "determined"
    ]  # the base stands where the readings put it, and turns with the first axis
    async with viewer.open_page(f"#/parameters/{SERIAL}", locale=locale) as page:
        chosen = page.get_by_test_id("parameter")
        section = page.locator("section", has=chosen)
        await expect(section.get_by_test_id("trend")).to_have_count(1)  # the first that was determined
        await expect(section.get_by_test_id("not-determined")).to_have_count(0)
        await chosen.select_option("J1 offset")
        await expect(section.get_by_test_id("not-determined")).to_contain_text(words)
        await expect(section.get_by_test_id("trend")).to_have_count(0)
        row = page.get_by_test_id("changes").locator("tr", has=page.locator("td.soft")).first
        await expect(row).to_contain_text(words)


async def test_tables_are_taken_away_from_the_pages_that_show_them(review_view: ViewedRuns) -> None:
    viewer, past = review_view
    shown = {
        "#/history": [past.spoilt, past.spoilt],  # in the table of runs, and in that of their results
        f"#/history/{past.spoilt}": [SPOILT_STEP],
        "#/parameters": [SERIAL],
    }
    async with viewer.open_page() as page:
        for place, words in shown.items():
            await go_to_page(page, place)
            links = page.get_by_test_id("exports").locator("a")
            await expect(links).to_have_count(2 * len(words))
            for k, word in enumerate(words):
                table, book = [await download_file(page, links.nth(2 * k + form)) for form in (0, 1)]
                assert word in table.decode("utf-8-sig"), place
                sheet = load_workbook(io.BytesIO(book)).active
                assert len(list(sheet.iter_rows())) == table.count(b"\r\n"), place


async def download_file(page: Page, link: Locator) -> bytes:
    """Press a link that takes a file away; return what is in the file."""
    async with page.expect_download() as coming:
        await link.click()
    return await asyncio.to_thread((await (await coming.value).path()).read_bytes)


def places_of(past: PastRuns) -> tuple[str, ...]:
    return (
        f"#/history/{past.spoilt}",
        f"#/history/{past.touches}",
        "#/history",
        "#/parameters",
        "#/devices",
        "#/",
        "#/procedure/robot_calibration",
    )


async def open_unfolded(page: Page, place: str) -> None:
    """Open a page, and all that is folded on it."""
    await go_to_page(page, place)
    await page.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")


@pytest.mark.parametrize("locale", locales_for("pages that judge"))
async def test_pages_that_judge_are_for_everybody(review_view: ViewedRuns, locale: str) -> None:
    viewer, past = review_view
    async with viewer.open_page(locale=locale) as page:
        await wait_for_language(page, locale)
        for place in places_of(past)[:4]:
            await open_unfolded(page, place)
            await hold_to_rules(page, f"{place} in {locale}")
            await expect(page.locator("main [lang=en]")).to_have_count(0)


async def test_texts_that_are_forty_percent_longer_fit_everywhere(review_view: ViewedRuns) -> None:
    viewer, past = review_view
    async with viewer.open_page(size=(800, 1280)) as page:
        history = await lengthen_page_texts(page, "history")
        await page.get_by_test_id("device-robot").wait_for()
        await expect(page.locator("nav")).to_contain_text(history)
        for place in places_of(past):
            await open_unfolded(page, place)
            await at_rest(page)
            assert await layout_faults(page) == [], place


async def test_the_pages_are_built_of_files_of_their_own(review_view: ViewedRuns) -> None:
    viewer, past = review_view
    async with viewer.open_page() as page:
        for place in places_of(past):
            await go_to_page(page, place)
    assert {url.split("/")[2] for url in viewer.requested_hosts if url.startswith("http")} == {
        viewer.url.split("/")[2]
    }
