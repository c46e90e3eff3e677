"""The pages of a cell with a wire, a tracker, a touch probe and a dial gauge: each shows what it has, and no more."""

import json
import re
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import expect

from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.browser_pages import ROOT, go_to_page, hold_to_rules, locales_for, wait_for_value
from tests.service.instrument_cell import full_cell
from tests.service.test_pages import PageViewer, view_service
from tests.service.test_view3d import feed_question

pytestmark = pytest.mark.asyncio(loop_scope="module")
RULES = {"poses": 5, "first": 4, "candidates": 40, "samples": 1}


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def page_viewer(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[PageViewer]:
    with full_cell(tmp_path_factory.mktemp("cell"), tracker_due="2020-01-31") as (path, _):
        async with view_service(create_app(ServiceSettings(path, open_access=True))) as viewer:
            yield viewer


def device_of(live: dict[str, Any], role: str) -> dict[str, Any]:
    found: dict[str, Any] = next(device for device in live["devices"] if device["role"] == role)
    return found


async def test_the_panel_warns_of_no_value_that_an_instrument_does_not_tell(page_viewer: PageViewer) -> None:
    changed: dict[str, Any] = {}
    async with page_viewer.open_page("#/devices") as page:
        for role in ("robot", "gauge", "tracker", "probe", "dial"):
            await expect(page.get_by_test_id(f"panel-{role}")).to_have_attribute("data-state", "ready")
            age = page.get_by_test_id(f"age-{role}")
            await expect(age).to_have_attribute("data-silent", "false")
            await expect(age).to_contain_text(re.compile(r"\d\.\d s"))
        await expect(page.get_by_test_id("panel-dial")).to_contain_text("plunger is free")
        await expect(page.get_by_test_id("due-tracker")).to_have_attribute("data-lapsed", "true")
        await feed_question(page, None, lambda live: device_of(live, "tracker").update(changed))
        changed |= {"value": None}  # another test may have read it before
        await page.reload()
        await expect(page.get_by_test_id("panel-tracker")).to_contain_text("none yet")
        # a state that is old, or bad, is warned of
        changed |= {"age_s": 60.0}
        age = page.get_by_test_id("age-tracker")
        await expect(age).to_have_attribute("data-silent", "true")
        await expect(age).to_contain_text("no answer for a while")
        changed |= {"asked": True}  # a reading may take its time
        await expect(age).to_have_attribute("data-silent", "false")
        await expect(age).to_contain_text("being read by the run")
        changed |= {
            "asked": False,
            "age_s": 0.1,
            "state": "not_ready",
            "message": "No reflector in the beam.",
        }
        await expect(page.get_by_test_id("panel-tracker")).to_have_attribute("data-state", "not_ready")
        await expect(page.get_by_test_id("panel-tracker")).to_contain_text("No reflector in the beam")


@pytest.mark.parametrize("locale", locales_for("a typed gauge"))
async def test_what_a_person_types_when_asked_is_never_too_old(page_viewer: PageViewer, locale: str) -> None:
    texts = json.loads((ROOT / f"web/src/locales/{locale}.json").read_text(encoding="utf-8"))
    typed = {"live": False, "typed": True, "state": "ready", "age_s": 900.0, "value": None, "settle": None}
    async with page_viewer.open_page(locale=locale) as page:
        await feed_question(page, None, lambda live: device_of(live, "gauge").update(typed))
        await page.reload()
        gauge = page.get_by_test_id("gauge")
        await expect(gauge).to_contain_text(texts["typed_when_asked"])
        await expect(gauge).to_have_attribute("data-stale", "false")
        await hold_to_rules(page, f"a typed gauge, {locale}")
        await go_to_page(page, "#/devices")
        await expect(page.get_by_test_id("age-gauge")).to_have_text(texts["typed_when_asked"])
        await expect(page.get_by_test_id("panel-gauge").locator(".old")).to_have_count(0)


@pytest.mark.parametrize("locale", locales_for("instruments"))
async def test_the_panel_is_held_to_the_rules_in_every_language(page_viewer: PageViewer, locale: str) -> None:
    async with page_viewer.open_page("#/devices", locale=locale, size=(800, 1280)) as page:
        await expect(page.get_by_test_id("age-tracker")).to_have_attribute("data-silent", "false")
        await hold_to_rules(page, f"every kind of instrument, {locale}")


async def test_a_capture_by_the_tracker_shows_the_tracker_and_not_the_wire(page_viewer: PageViewer) -> None:
    """The run is a real one; the page follows the instrument that it reads."""
    settings = {"method": "tracker", "rules": RULES}
    await page_viewer.send_order(op="start", procedure="drift_check", settings=settings, hold_to_move=False)

    async def shown_state() -> str:
        session = await page_viewer.read_session()
        if prompt := session["prompt"]:
            await page_viewer.send_order(op="answer", prompt_id=prompt["id"], value="yes")
        assert session["run"]["outcome"] is None, session["run"]["outcome"]
        return str(session["run"]["instrument"])

    assert await wait_for_value(shown_state) == "tracker"
    await page_viewer.send_order(op="pause")  # it would be over before a busy computer has opened the page
    await page_viewer.wait_until(lambda session: session["run"]["state"] == "paused")
    async with page_viewer.open_page("#/run") as page:
        gauge = page.locator("aside [data-testid=gauge]")
        await expect(gauge).to_have_attribute("data-role", "tracker")
        await expect(gauge).to_contain_text(
            re.compile(r"x -?\d+\.\d{3}\s+y .* mm\s+\(station 1\), \d+(\.\d)? s ago")
        )
        await expect(page.get_by_test_id("working")).to_be_visible()
    await page_viewer.send_order(op="stop")
    await page_viewer.wait_until(lambda session: session["run"]["outcome"])
    await page_viewer.send_order(op="dismiss")


@pytest.mark.parametrize("locale", ["en", "zh"])
async def test_the_end_of_a_run_offers_the_readable_certificate_first(
    page_viewer: PageViewer, locale: str
) -> None:
    """PDF and page in the reader's language, then what is signed; each is there."""
    if not (await page_viewer.read_session())["run"]:
        settings = {"method": "wire", "rules": RULES | {"samples": 5}}
        await page_viewer.send_order(
            op="start", procedure="drift_check", settings=settings, hold_to_move=False
        )

    async def run_outcome() -> dict[str, Any] | None:
        session = await page_viewer.read_session()
        if prompt := session["prompt"]:
            await page_viewer.send_order(op="answer", prompt_id=prompt["id"], value="yes")
        found: dict[str, Any] | None = session["run"]["outcome"]
        return found

    ended = await wait_for_value(run_outcome)
    assert ended is not None
    assert ended["certificate"], ended
    async with page_viewer.open_page("#/run", locale=locale, size=(800, 1280)) as page:
        links = page.get_by_test_id("outcome").locator("a.button")
        await expect(links).to_have_count(3)
        at = [str(await link.get_attribute("href")) for link in await links.all()]
        assert [one.rpartition("/")[2] for one in at] == [
            f"certificate.pdf?language={locale}",
            f"certificate.html?language={locale}",
            "certificate.json",
        ]
        pdf, html, signed = [await page_viewer.client.get(one.removeprefix(".")) for one in at]
        assert pdf.content.startswith(b"%PDF")
        assert f'<html lang="{locale}">' in html.text
        assert signed.json()["content"]["run"]["procedure"] == "drift_check"
        await hold_to_rules(page, f"the end of a run, {locale}")
