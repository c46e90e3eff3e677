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
from tests.service.browsers import LOCALES, at_rest, comes, cramped, go, hold_to_rules, speaks
from tests.service.longer import lengthened
from tests.service.lookers import looking_back
from tests.service.reviewed import SERIAL, SPOILT_STEP, Past
from tests.service.steps import let_go_early
from tests.service.test_pages import Looking

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.xdist_group("review pages")]
Seen = tuple[Looking, Past]
READINGS = 16 + 5  # of the arm's own target, and of the point of its tool
RUNS = "rows => rows.map(row => row.dataset.run)"
COLOUR_AT = """([x, y]) => {
    const plot = document.querySelector('[data-testid=residual-plot]'), canvas = plot.querySelector('canvas');
    const over = plot.querySelector('.u-over').getBoundingClientRect(), box = canvas.getBoundingClientRect();
    const scale = canvas.width / box.width;
    return [...canvas.getContext('2d').getImageData(
        (over.left - box.left + x) * scale, (over.top - box.top + y) * scale, 1, 1).data]; }"""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def seen(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Seen]:
    async with looking_back(tmp_path_factory.mktemp("cell")) as found:
        yield found


async def marks(page: Page) -> list[list[int]]:
    """Return where the plot has its points, once it is drawn."""
    plot = page.get_by_test_id("residual-plot")
    await comes(lambda: plot.get_attribute("data-marks"))
    await at_rest(page)  # what comes below it can narrow the page, and the plot with it
    found: list[list[int]] = json.loads(await plot.get_attribute("data-marks") or "")
    return found


async def tap(page: Page, at: list[int]) -> dict[str, Any]:
    """Tap a point of the plot; return the service's answer."""
    async with page.expect_response("**/what-if") as answer:
        await page.locator("[data-testid=residual-plot] .u-over").click(position={"x": at[0], "y": at[1]})
    told: dict[str, Any] = await (await answer.value).json()
    return told


async def test_a_tap_puts_a_reading_back_and_takes_it_out_again(seen: Seen) -> None:
    looks, past = seen
    async with looks.page(f"#/history/{past.spoilt}") as page:
        at = await marks(page)
        card = page.get_by_test_id("residuals")
        assert len(at) == READINGS
        await expect(card).to_have_attribute("data-count", str(READINGS))
        await expect(card).to_have_attribute("data-signed", "true")
        fit = page.get_by_test_id("fit-u")
        signed = await fit.inner_text()  # of a review that is there, with its marks
        odd = int(SPOILT_STEP.split()[1]) - 1
        told = await tap(page, at[odd])
        assert [p["used"] for p in told["points"]] == [True] * READINGS
        await page.get_by_test_id("what-if").wait_for()
        await expect(card).to_have_attribute("data-signed", "false")
        await expect(fit).to_contain_text(signed)  # beside the other figure, and called signed
        await expect(page.get_by_test_id("took")).to_have_attribute("data-ms", re.compile(r"\d+"))
        await page.get_by_test_id("as-signed").click()
        await expect(card).to_have_attribute("data-signed", "true")
        await expect(fit).to_have_text(signed)


async def test_an_outlier_differs_in_shape_and_colour(seen: Seen) -> None:
    looks, past = seen
    async with looks.page(f"#/history/{past.spoilt}") as page:
        at = await marks(page)
        odd = int(SPOILT_STEP.split()[1]) - 1
        blue = await page.evaluate(COLOUR_AT, at[0])
        assert blue[2] > blue[0] + 60
        cross = await page.evaluate(COLOUR_AT, at[odd])
        assert cross[0] > cross[2] + 60
        beside = [at[odd][0] + 4, at[odd][1]]  # a dot fills this place, a cross does not
        assert await page.evaluate(COLOUR_AT, beside) != cross
        assert (await page.evaluate(COLOUR_AT, [at[0][0] + 4, at[0][1]]))[2] > blue[0] + 60


async def test_the_table_tells_and_does_the_same_as_the_plot(seen: Seen) -> None:
    looks, past = seen
    async with looks.page(f"#/history/{past.spoilt}") as page:
        await marks(page)
        await page.get_by_test_id("residuals").locator("summary").click()
        rows = page.get_by_test_id("residual-table").locator("tbody tr")
        await expect(rows).to_have_count(READINGS)
        await expect(page.locator("tr[data-outlier=true]")).to_have_count(1)
        review = (await looks.client.get(f"/api/runs/{past.spoilt}/review")).json()
        for i, point in enumerate(review["points"]):
            await expect(rows.nth(i)).to_contain_text(f"{point['residual_m'] * 1e3:.3f} mm")
        await rows.nth(0).get_by_role("button").click()
        await page.get_by_test_id("what-if").wait_for()
        await page.locator("tr[data-used=false]").nth(1).wait_for()
        await expect(rows.nth(0)).to_have_attribute("data-used", "false")


async def test_too_few_readings_are_refused_in_words(seen: Seen) -> None:
    looks, past = seen
    async with looks.page(f"#/history/{past.touches}") as page:
        at = await marks(page)
        await page.get_by_test_id("residuals").locator("summary").click()
        rows = page.get_by_test_id("residual-table").locator("tbody tr")
        refused = page.get_by_test_id("what-if-refused")
        for i in range(len(at)):
            async with page.expect_response("**/what-if"):
                await rows.nth(i).get_by_role("button").click()
            await expect(page.get_by_test_id("residuals")).to_have_attribute("aria-busy", "false")
            if await refused.count():
                break
        await expect(refused).to_contain_text("3")
        await comes(lambda: _complaints_of(looks))
        assert [line for line in looks.complaints if "422" not in line] == []
        looks.complaints.clear()  # the browser tells of a refusal, too


async def test_a_frames_point_is_left_out_by_a_tap_and_put_back_in_the_table(seen: Seen) -> None:
    looks, past = seen
    async with looks.page(f"#/history/{past.moved}") as page:
        at, table = await marks(page), page.get_by_test_id("fit-values")
        assert len(at) == 4
        signed = await table.inner_text()
        told = await tap(page, at[2])
        assert [p["used"] for p in told["points"]] == [True, True, False, True]
        await page.get_by_test_id("what-if").wait_for()
        value = told["values"][0]
        assert abs(value["value"] - value["signed"]) > 1e-5
        await expect(table).to_contain_text(f"{value['value'] * 1e3:.3f} mm")
        await expect(table).to_contain_text(f"{value['signed'] * 1e3:.3f} mm")
        await page.get_by_test_id("residuals").locator("summary").click()
        rows = page.get_by_test_id("residual-table").locator("tbody tr")
        for i, point in enumerate(told["points"]):
            await expect(rows.nth(i)).to_contain_text(f"{point['residual_m'] * 1e3:.3f} mm")
            await expect(rows.nth(i)).to_have_attribute("data-used", str(point["used"]).lower())
        await rows.nth(2).get_by_role("button").click()
        await expect(page.get_by_test_id("residuals")).to_have_attribute("data-signed", "true")
        await expect(table).to_have_text(signed, use_inner_text=True)


@pytest.mark.parametrize("locale", LOCALES)
async def test_a_point_that_cannot_be_spared_is_refused_in_the_pages_language(
    seen: Seen, locale: str
) -> None:
    looks, past = seen
    async with looks.page(f"#/history/{past.frame}", locale=locale) as page:
        await speaks(page, locale)
        await marks(page)
        await page.get_by_test_id("residuals").locator("summary").click()
        rows = page.get_by_test_id("residual-table").locator("tbody tr")
        async with page.expect_response("**/what-if") as answer:  # residuals of zero lie on the plot's edge
            await rows.nth(1).get_by_role("button").click()
        told = await (await answer.value).json()
        refused = page.get_by_test_id("what-if-refused")
        await expect(refused).to_contain_text("3")
        if locale != "en":
            await expect(refused).not_to_contain_text(told["message"])
        await expect(refused.locator("[lang=en]")).to_have_count(0)
        await expect(page.get_by_test_id("residuals")).to_have_attribute("data-signed", "true")
        await comes(lambda: _complaints_of(looks))
        assert [line for line in looks.complaints if "422" not in line] == []
        looks.complaints.clear()


async def test_settings_that_differ_are_rows_with_units(seen: Seen) -> None:
    looks, past = seen
    async with looks.page("#/history", locale="de") as page:
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


async def _complaints_of(looks: Looking) -> list[str]:
    return looks.complaints


async def test_before_and_after_and_the_map_say_what_the_service_says(seen: Seen) -> None:
    looks, past = seen
    review = (await looks.client.get(f"/api/runs/{past.calibration}/review")).json()
    async with looks.page(f"#/history/{past.calibration}") as page:
        for which in ("before", "after"):
            spread = page.get_by_test_id(f"spread-{which}")
            for key in ("mean_m", "rms_m", "max_m", "u_m"):
                await expect(spread).to_contain_text(f"{review['validation'][which][key] * 1e3:.3f} mm")
        card = page.get_by_test_id("error-map")
        await expect(card.locator("figure circle")).to_have_count(2 * len(review["places"]))
        most = max(place["u_m"] for place in review["places"])
        await page.get_by_test_id("map-u").click()
        await expect(card).to_contain_text(f"{most * 1e3:.3f}")


async def test_the_certificate_is_named_hashed_and_checked_on_the_page(seen: Seen) -> None:
    looks, past = seen
    async with looks.page(f"#/history/{past.calibration}") as page:
        await page.get_by_test_id("verified").wait_for()
        signed = (await looks.client.get(f"/api/runs/{past.calibration}/certificate.json")).json()
        await expect(page.get_by_test_id("certificate-word")).to_have_text("PASS")
        await expect(page.get_by_test_id("certificate-id")).to_have_text(past.calibration)
        await expect(page.get_by_test_id("certificate-hash")).to_have_text(signed["sha256"])
        for kind, begins in (("html", b"<!"), ("pdf", b"%PDF")):
            link = await page.get_by_test_id(f"certificate-{kind}").get_attribute("href")
            content = (await looks.client.get(f"/{str(link).removeprefix('./')}")).content
            assert content.lstrip().lower().startswith(begins.lower())
        path = past.config.cell.data_dir / "certificates" / f"{past.calibration}.json"
        kept = path.read_bytes()
        path.write_bytes(
            kept.replace(b"Anna", b"Anne", 1) if b"Anna" in kept else kept.replace(b"pass", b"fail", 1)
        )
        await page.get_by_test_id("verify").click()
        await page.locator("[data-testid=certified][data-finding=tampered]").wait_for()
        path.write_bytes(kept)


async def test_the_history_is_newest_first_filtered_and_compared(seen: Seen) -> None:
    looks, past = seen
    async with looks.page("#/history") as page:
        rows = page.get_by_test_id("run")
        told = (await looks.client.get("/api/runs")).json()
        newest = [line["run_id"] for line in sorted(told, key=lambda x: x["started_utc"], reverse=True)]
        await comes(lambda: rows.evaluate_all(RUNS), lambda shown: shown == newest)
        await page.get_by_test_id("filter").fill("Robot Calibration")
        await expect(rows).to_have_count(2)
        for i in range(2):
            await page.get_by_test_id("pick").nth(i).click()
        card = page.get_by_test_id("compared")
        await card.locator("tr[data-changed]").first.wait_for()
        compared = (await looks.client.get(f"/api/runs/{past.spoilt}/against/{past.calibration}")).json()
        lines = len(compared["figures"]) + len(compared["settings"])
        await expect(card.locator("tbody tr")).to_have_count(lines)


async def test_the_way_back_is_shown_first_held_two_seconds_and_saves_a_version(seen: Seen) -> None:
    looks, past = seen
    sets = ParameterSets(past.config.path.parent / FOLDER)
    newest = sets.load_set(SERIAL).version
    async with looks.page("#/parameters") as page:
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
    held = sets.load_set(SERIAL)
    assert (held.version, held.rolls_back_to, held.note) == (newest + 1, 1, "the tool was bent")


async def test_trends_have_a_point_for_each_version_and_run(seen: Seen) -> None:
    looks, past = seen
    async with looks.page(f"#/parameters/{SERIAL}") as page:
        await page.get_by_test_id("procedure").select_option("robot_calibration")
        told = (
            await looks.client.get(f"/api/trend?robot_serial={SERIAL}&procedure=robot_calibration")
        ).json()
        plots = page.get_by_test_id("trend")
        await page.locator("[data-testid=trend] [data-drawn]").nth(1).wait_for()
        versions = ParameterSets(past.config.path.parent / FOLDER).load_set(SERIAL).version
        await expect(page.get_by_test_id("versions").locator("tbody tr")).to_have_count(versions)
        await expect(plots.nth(0)).to_have_attribute("data-count", str(versions))
        assert len(told[0]["points"]) == 2
        await expect(plots.nth(1)).to_have_attribute("data-count", "2")


@pytest.mark.parametrize(("locale", "words"), [("en", "not determined"), ("zh", "未能确定")])
async def test_what_was_not_determined_is_said_in_words_and_not_drawn(
    seen: Seen, locale: str, words: str
) -> None:
    looks, _ = seen
    stored = (await looks.client.get(f"/api/parameters/{SERIAL}?version=1")).json()["parameters"]
    unseen = next(value for value in stored if value["name"] == "J1 offset")
    assert not unseen[
        "determined"
    ]  # the base stands where the readings put it, and turns with the first axis
    async with looks.page(f"#/parameters/{SERIAL}", locale=locale) as page:
        chosen = page.get_by_test_id("parameter")
        section = page.locator("section", has=chosen)
        await expect(section.get_by_test_id("trend")).to_have_count(1)  # the first that was determined
        await expect(section.get_by_test_id("not-determined")).to_have_count(0)
        await chosen.select_option("J1 offset")
        await expect(section.get_by_test_id("not-determined")).to_contain_text(words)
        await expect(section.get_by_test_id("trend")).to_have_count(0)
        row = page.get_by_test_id("changes").locator("tr", has=page.locator("td.soft")).first
        await expect(row).to_contain_text(words)


async def test_tables_are_taken_away_from_the_pages_that_show_them(seen: Seen) -> None:
    looks, past = seen
    shown = {
        "#/history": [past.spoilt, past.spoilt],  # in the table of runs, and in that of their results
        f"#/history/{past.spoilt}": [SPOILT_STEP],
        "#/parameters": [SERIAL],
    }
    async with looks.page() as page:
        for place, words in shown.items():
            await go(page, place)
            links = page.get_by_test_id("exports").locator("a")
            await expect(links).to_have_count(2 * len(words))
            for k, word in enumerate(words):
                table, book = [await taken(page, links.nth(2 * k + form)) for form in (0, 1)]
                assert word in table.decode("utf-8-sig"), place
                sheet = load_workbook(io.BytesIO(book)).active
                assert len(list(sheet.iter_rows())) == table.count(b"\r\n"), place


async def taken(page: Page, link: Locator) -> bytes:
    """Press a link that takes a file away; return what is in the file."""
    async with page.expect_download() as coming:
        await link.click()
    return await asyncio.to_thread((await (await coming.value).path()).read_bytes)


def places_of(past: Past) -> tuple[str, ...]:
    return (
        f"#/history/{past.spoilt}",
        f"#/history/{past.touches}",
        "#/history",
        "#/parameters",
        "#/devices",
        "#/",
        "#/procedure/robot_calibration",
    )


async def unfolded(page: Page, place: str) -> None:
    """Open a page, and all that is folded on it."""
    await go(page, place)
    await page.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")


@pytest.mark.parametrize("locale", LOCALES)
async def test_pages_that_judge_are_for_everybody(seen: Seen, locale: str) -> None:
    looks, past = seen
    async with looks.page(locale=locale) as page:
        await speaks(page, locale)
        for place in places_of(past)[:4]:
            await unfolded(page, place)
            await hold_to_rules(page, f"{place} in {locale}")
            await expect(page.locator("main [lang=en]")).to_have_count(0)


async def test_texts_that_are_forty_percent_longer_fit_everywhere(seen: Seen) -> None:
    looks, past = seen
    async with looks.page(size=(800, 1280)) as page:
        history = await lengthened(page, "history")
        await page.get_by_test_id("device-robot").wait_for()
        await expect(page.locator("nav")).to_contain_text(history)
        for place in places_of(past):
            await unfolded(page, place)
            await at_rest(page)
            assert await cramped(page) == [], place


async def test_the_pages_are_built_of_files_of_their_own(seen: Seen) -> None:
    looks, past = seen
    async with looks.page() as page:
        for place in places_of(past):
            await go(page, place)
    assert {url.split("/")[2] for url in looks.asked if url.startswith("http")} == {looks.url.split("/")[2]}
