"""The pages in a real browser over the fake cell: what they show is true, in four languages, and asks no other host.

One browser, one cell and one service serve every test of this file, one after the other.
"""

import asyncio
import json
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

import httpx
import numpy as np
import pytest
import pytest_asyncio
from fastapi import FastAPI
from playwright.async_api import Browser, Page, Route, expect

from cellcal.calibration.arm.kinematics import load_model
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.browser_pages import (
    COUNT_ASKED,
    LOCALES,
    NO_WEBGL,
    PATIENCE_MS,
    PATIENCE_S,
    ROOT,
    at_rest,
    go_to_page,
    hold_to_rules,
    layout_faults,
    locales_for,
    open_chromium,
    serve_app,
    unfold,
    wait_for_language,
    wait_for_value,
)
from tests.service.cell_process_session import a_cell
from tests.service.http_limits import NO_IDLE_CONNECTIONS
from tests.service.openapi_check import DescribedApi

VIEWPORTS = ((1280, 800), (1024, 768), (800, 1280))
MOST_BYTES = 450_000
NO_REVIEW: dict[str, Any] = {
    "run_id": "r",
    "along": "wire",
    "signed": True,
    "least": 0,
    "points": [],
    "places": [],
}
NO_REVIEW |= dict.fromkeys(("rms_m", "max_m", "u_m", "signed_rms_m", "signed_u_m", "validation"))
CHECKED: dict[str, Any] = {
    "run_id": "r",
    "word": "pass",
    "finding": "intact",
    "sentence": "",
    "by_this_cell": True,
    "sha256": "0",
    "public_key": "1",
}

pytestmark = pytest.mark.asyncio(loop_scope="module")


class PageViewer:
    """A browser at the service, and what it asked for and complained of."""

    def __init__(self, browser: Browser, url: str) -> None:
        self.browser, self.url = browser, url
        self.client = httpx.AsyncClient(base_url=url, timeout=PATIENCE_S, limits=NO_IDLE_CONNECTIONS)
        self.complaints: list[str] = []
        self.requested_hosts: set[str] = set()

    @asynccontextmanager
    async def open_page(
        self,
        at: str = "#/",
        locale: str = "en",
        size: tuple[int, int] = (1280, 800),
        browser: Browser | None = None,
    ) -> AsyncIterator[Page]:
        """Open a page of its own, wait until live values flow, and hold it to a clean console."""
        context = await (browser or self.browser).new_context(viewport={"width": size[0], "height": size[1]})
        context.set_default_timeout(PATIENCE_MS)
        await context.add_init_script(COUNT_ASKED)
        await context.add_init_script(f"localStorage.setItem('locale', {json.dumps(locale)})")
        if locale != "en":  # drawn in software a picture costs seconds, and is the same in every language
            await context.add_init_script(NO_WEBGL)
        page = await context.new_page()
        page.on("console", lambda line: self.complaints.append(line.text) if line.type == "error" else None)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self.requested_hosts.add(request.url))
        try:
            await page.goto(f"{self.url}/{at}")
            await page.get_by_test_id("device-robot").wait_for()
            yield page
        finally:
            await context.close()
        assert self.complaints == []
        assert {
            httpx.URL(url).host for url in self.requested_hosts if not url.startswith(("blob:", "data:"))
        } == {"127.0.0.1"}

    async def send_order(self, **order: Any) -> None:
        """Give an order as a person does: who looked at an older session looks again."""
        async with asyncio.timeout(PATIENCE_S):
            while True:
                rev = (await self.read_session())["rev"]
                envelope = {"id": uuid4().hex, "rev": rev, "order": order}
                answer = await self.client.post("/api/commands", json=envelope)
                if answer.status_code != 409:
                    break
        assert answer.status_code == 200, answer.text

    async def read_session(self) -> dict[str, Any]:
        """Return the present session."""
        return dict((await self.client.get("/api/session")).json()["session"])

    async def wait_until(self, true: Any) -> dict[str, Any]:
        """Wait for a session of which something is true."""
        async with asyncio.timeout(PATIENCE_S):
            while True:
                with suppress(httpx.TransportError, TypeError):
                    session = await self.read_session()
                    if true(session):
                        return session
                await asyncio.sleep(0.05)


@asynccontextmanager
async def view_service(app: FastAPI) -> AsyncIterator[PageViewer]:
    """Serve an app and open a browser at it, until its cell is connected."""
    async with serve_app(app) as url, open_chromium() as browser:
        viewer = PageViewer(browser, url)
        viewer.client.event_hooks = {"response": [DescribedApi(app).check_answer]}
        async with viewer.client:
            await viewer.wait_until(lambda session: session["connection"]["connected"])
            yield viewer


@asynccontextmanager
async def view_cell(folder: Path) -> AsyncIterator[PageViewer]:
    """Serve a fake cell, and look at it in Chromium."""
    async with (
        a_cell(folder) as (path, _),
        view_service(create_app(ServiceSettings(path, open_access=True))) as viewer,
    ):
        yield viewer


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def page_viewer(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[PageViewer]:
    async with view_cell(tmp_path_factory.mktemp("cell")) as viewer:
        yield viewer


async def _shown_picture(page: Page, robot: str = "fanuc") -> dict[str, Any]:
    """Return what the picture shows, once it shows that robot in some posture."""
    async with asyncio.timeout(PATIENCE_S):
        while True:
            shown = await page.evaluate("window.__robot ?? null")
            if shown and shown["robot"] == robot and shown["joints_rad"] and shown["frames"]:
                return dict(shown)
            await asyncio.sleep(0.05)


async def test_the_picture_stands_as_the_robot_does_and_follows_it(page_viewer: PageViewer) -> None:
    async with page_viewer.open_page() as page:
        for robot, model in (("fanuc", "fanuc_m6ib"), ("ur", "ur10e")):
            await page_viewer.send_order(op="select_robot", robot=robot)
            shown = await _shown_picture(page, robot)
            # The picture's own chain of links ends where the solver's model puts the flange, FANUC's coupling too.
            flange_m = load_model(model).base_flange(np.array([shown["joints_rad"]]))[0, :3, 3]
            assert np.allclose(shown["flange_m"], flange_m, atol=1e-6)
        await page_viewer.send_order(op="select_robot", robot="fanuc")
        await unfold(page.get_by_test_id("joints"))
        shown = await _shown_picture(page)
        await expect(page.get_by_test_id("joints").locator("dd")).to_have_count(6)
        await wait_for_value(
            lambda: _shown_degrees(page),
            lambda value: np.allclose(np.rad2deg(shown["joints_rad"]), value, atol=0.02),
        )


async def _shown_degrees(page: Page) -> list[float]:
    texts = await page.get_by_test_id("joints").locator("dd").all_inner_texts()
    return [float(text.rstrip("°") or "nan") for text in texts]  # nothing is shown while the list unfolds


async def test_a_still_robot_costs_no_picture_and_a_moving_one_few(page_viewer: PageViewer) -> None:
    async with page_viewer.open_page() as page:
        await _shown_picture(page)
        await expect(page.get_by_test_id("doubt")).not_to_contain_text(_page_texts("en")["doubt_waits"])
        await at_rest(page)  # frames and the doubt of the tool come late, and are drawn
        before = await wait_for_value(lambda: _frames_after(page, 300), lambda value: value[0] == value[1])
        assert await _frames_after(page, 1000) == [before[1], before[1]]
        await page.evaluate(
            "() => { for (let i = 0; i < 60; i++) document.querySelector('.turns button').click(); }"
        )
        drawn = await wait_for_value(
            lambda: _frames_after(page, 300), lambda value: before[1] < value[0] == value[1]
        )
        assert drawn[1] <= before[1] + 4  # sixty wishes in one moment


async def _frames_after(page: Page, wait_ms: int) -> list[int]:
    """Return how many pictures were drawn, and how many after a while."""
    first = (await _shown_picture(page))["frames"]
    await page.wait_for_timeout(wait_ms)
    return [first, (await _shown_picture(page))["frames"]]


async def test_without_webgl_there_are_numbers(page_viewer: PageViewer) -> None:
    async with page_viewer.open_page() as page:
        await page.add_init_script(NO_WEBGL)
        await page.reload()
        await page.get_by_test_id("joints").locator("dd").nth(5).wait_for()
        await expect(page.locator(".picture")).to_be_hidden()
        assert await page.evaluate("window.__robot === undefined")


async def test_every_page_is_for_everybody_in_four_languages(page_viewer: PageViewer) -> None:
    places = ("#/", "#/procedure/mastering_record", "#/history", "#/devices")
    for locale in LOCALES:
        async with page_viewer.open_page(locale=locale) as page:
            await wait_for_language(page, locale)
            ways = await page.locator("nav a").all_inner_texts()
            assert len(set(ways)) == len(ways) == 5, f"two buttons that lead elsewhere read alike: {ways}"
            for place in places:
                await go_to_page(page, place)
                await hold_to_rules(page, f"{place} in {locale}")


# Where the lines below the picture stand, and whether a lost connection is told.
STANDS = "() => Math.round(document.querySelector('[data-testid=joints] summary').getBoundingClientRect().top + scrollY)"
# The page's clock runs ten times slower: a busy machine must not look like a link that is not there.
SEEN_OFFLINE = """{ const now = Date.now, start = now(); Date.now = () => start + (now() - start) / 10;
    window.__offline = false; new MutationObserver(() => {
    window.__offline ||= document.querySelector('[data-testid=offline]') !== null; })
    .observe(document, {childList: true, subtree: true}); }"""


async def test_what_comes_late_moves_no_line_from_under_a_finger(page_viewer: PageViewer) -> None:
    """A page that opens tells of no lost connection, and its first list comes into the place that it is left."""
    async with page_viewer.open_page(size=(820, 1180)) as page:
        listed = asyncio.Event()

        async def hold_list(route: Route) -> None:
            await listed.wait()
            await route.continue_()

        await page.route("**/api/procedures?*", hold_list)
        await page.add_init_script(SEEN_OFFLINE)
        await page.reload()
        await page.get_by_test_id("device-robot").wait_for()
        await expect(page.get_by_test_id("gauge").first).to_be_visible()
        before = await page.evaluate(STANDS)
        listed.set()
        await page.get_by_test_id("intention-check").wait_for()
        await at_rest(page)
        assert abs(await page.evaluate(STANDS) - before) <= 24  # half of what a glove needs
        assert not await page.evaluate("window.__offline")


@pytest.mark.parametrize("locale", LOCALES)
async def test_unfolded_answers_fit_on_a_telephone(page_viewer: PageViewer, locale: str) -> None:
    async with page_viewer.open_page(locale=locale, size=(390, 844)) as page:
        await wait_for_language(page, locale)
        await page.get_by_test_id("intention-check").wait_for()
        await page.evaluate("document.querySelectorAll('details').forEach(part => { part.open = true; })")
        assert await layout_faults(page) == []


async def test_a_run_from_its_start_to_its_place_in_the_history(page_viewer: PageViewer) -> None:
    """The main buttons stay in view beside the picture; an ended run shows its readings."""
    await page_viewer.send_order(op="start", procedure="mastering_record", settings={}, hold_to_move=True)
    session = await page_viewer.wait_until(lambda session: session["prompt"])
    for size in VIEWPORTS:
        async with page_viewer.open_page(size=(820, 1180)) as page:
            await _shown_picture(page)
            for button in ("yes", "no", "stop"):
                await wait_for_value(
                    page.get_by_test_id(button).bounding_box,
                    lambda box, height=size[1]: box is not None and box["y"] + box["height"] <= height,
                )
    for locale in locales_for("the run"):
        async with page_viewer.open_page(locale=locale) as page:
            await wait_for_language(page, locale)
            await hold_to_rules(page, f"the run in {locale}")
    async with page_viewer.open_page(f"#/history/{session['run']['id']}") as page:
        await expect(page.get_by_test_id("verdict")).to_have_attribute("data-verdict", "running")
    await page_viewer.send_order(op="stop")
    run_id = (await page_viewer.wait_until(lambda session: session["run"]["outcome"]))["run"]["id"]
    assert run_id == session["run"]["id"]
    await page_viewer.send_order(op="dismiss")
    readings = (await page_viewer.client.get(f"/api/runs/{run_id}/points")).json()["readings"]
    assert readings
    async with page_viewer.open_page(f"#/history/{run_id}") as page:
        await expect(page.get_by_test_id("readings").locator("tbody tr")).to_have_count(len(readings))
        await hold_to_rules(page, "the details of a run")


async def test_points_not_used_are_marked_by_shape_and_said_in_words(page_viewer: PageViewer) -> None:
    names = [f"capture {i + 1}" for i in range(12)]
    dots = [{"name": n, "value_m": 1e-4 * (i + 1), "used": i != 7, "reason": ""} for i, n in enumerate(names)]
    dots[7]["reason"] = "does not fit the others"
    common = {"at_utc": "2026-01-05T08:00:00Z", "length_m": 1.0, "samples": 5}
    expected_rows = [
        common | {"step": dot["name"], "used": dot["used"], "reason": dot["reason"]} for dot in dots
    ]
    measured = {"readings": expected_rows, "series": [{"kind": "spread", "what": "", "points": dots}]}
    run: dict[str, Any] = {"run_id": "r", "procedure": "drift_check", "started_utc": common["at_utc"]}
    run |= {"begun_by": "watch", "begun_as": []}
    run |= {"state": "passed", "reason": "", "spec": {}, "findings": [], "result": None, "judgement": None}
    async with page_viewer.open_page() as page:
        await page.route("**/api/runs/r", lambda route: route.fulfill(json=run))
        await page.route("**/api/runs/r/points", lambda route: route.fulfill(json=measured))
        await page.route("**/api/runs/r/review", lambda route: route.fulfill(json=NO_REVIEW))
        await page.route("**/api/runs/r/certificate/check", lambda route: route.fulfill(json=CHECKED))
        await go_to_page(page, "#/history/r")
        plot = page.get_by_test_id("plot")
        await expect(plot.locator("svg[role=img] circle")).to_have_count(11)
        await expect(plot.get_by_test_id("rejected")).to_have_count(1)
        await expect(page.get_by_test_id("readings")).to_contain_text("does not fit the others")


async def test_a_cold_page_with_its_picture_is_light(page_viewer: PageViewer) -> None:
    sizes: list[int] = []
    async with page_viewer.open_page() as page:
        await _shown_picture(page)  # or the first load would be counted, too
        line = await page.context.new_cdp_session(page)
        await line.send("Network.enable")
        line.on("Network.loadingFinished", lambda value: sizes.append(int(value["encodedDataLength"])))
        await line.send("Network.clearBrowserCache")
        await page.reload()
        await _shown_picture(page)
        await expect(page.get_by_test_id("doubt")).not_to_contain_text(_page_texts("en")["doubt_waits"])
        await at_rest(page)
    assert 100_000 < sum(sizes) <= MOST_BYTES


async def test_every_language_has_every_text_and_its_blanks() -> None:
    texts = {locale: _page_texts(locale) for locale in LOCALES}
    for locale in LOCALES:
        assert texts[locale].keys() == texts["en"].keys()
        for key, text in texts[locale].items():
            assert text.strip(), (locale, key)
            assert _placeholders(text) == _placeholders(texts["en"][key]), (locale, key)


def _page_texts(locale: str) -> dict[str, str]:
    found: dict[str, str] = json.loads((ROOT / f"web/src/locales/{locale}.json").read_text(encoding="utf-8"))
    return found


def _placeholders(text: str) -> list[str]:
    return sorted(re.findall(r"\{(\w+)\}", text))


async def test_the_catalogue_is_compressed_for_clients_that_accept_it(page_viewer: PageViewer) -> None:
    """The schemas of all settings are the most that a first page is told; they repeat themselves."""
    plain = await page_viewer.client.get("/api/procedures", headers={"accept-encoding": "identity"})
    packed = await page_viewer.client.get("/api/procedures", headers={"accept-encoding": "gzip"})
    assert "content-encoding" not in plain.headers
    assert packed.headers["content-encoding"] == "gzip"
    assert packed.num_bytes_downloaded < len(plain.content) / 4
    assert packed.json() == plain.json()


@pytest.mark.parametrize("locale", locales_for("a drift check due"))
async def test_the_first_page_says_when_a_drift_check_is_due_and_that_it_was(
    page_viewer: PageViewer, locale: str
) -> None:
    async with page_viewer.open_page(locale=locale) as page:
        due = page.get_by_test_id("due-drift_check")
        await expect(due).to_have_attribute("data-late", "false")
        found = (await page_viewer.client.get("/api/procedures")).json()
        late = [{**each, "due": "2020-01-31"} if each["due"] else each for each in found]
        await page.route("**/api/procedures*", lambda route: route.fulfill(json=late))
        await page.reload()
        await expect(due).to_have_attribute("data-late", "true")
        await expect(due).to_contain_text("2020")
        await hold_to_rules(page, f"a check that was due, in {locale}")
