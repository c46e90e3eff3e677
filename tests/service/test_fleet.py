"""The fleet in a browser: two hundred cells, only what changed is drawn, and nothing on the page commands a cell."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi.routing import APIRoute, APIWebSocketRoute, iter_route_contexts
from playwright.async_api import Page, expect

from cellcal.service.people.authentication import Authenticator
from cellcal.service.record.signing import CheckedDocument, check_document, station_key
from cellcal.service.site import fleet
from cellcal.service.site.alarms import CellAlarm
from cellcal.service.site.fleet import Fleet
from cellcal.service.site.keys import StationKeys
from cellcal.service.site.link_files import EnrolledCell, StationsFile
from cellcal.service.site.signed_messages import MessageSigner
from cellcal.service.web.fleet import PAGE, FleetContext, create_fleet_app
from cellcal.service.web.pages import DIST
from tests.service.browser_pages import (
    PATIENCE_MS,
    PATIENCE_S,
    hold_to_rules,
    open_chromium,
    serve_app,
    unfold,
    wait_for_language,
    wait_for_value,
)
from tests.service.loopback_site import SITE, LoopbackSite, free_port, live_of, session_of, wait_until
from tests.service.service_client import another_browser

ROOT = Path(__file__).parents[2]
CELLS = 200


@pytest.fixture(autouse=True)
def no_silent_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    """No cell is silent for having spoken once only, however slow this computer is."""
    monkeypatch.setattr(fleet, "SILENT_S", 1e6)


ALARM = {
    "id": "device.stopped:fanuc",
    "code": "device.stopped",
    "source": "fanuc",
    "text": "E-stop.",
    "remedy": "Look.",
}
DRIFT = [{"run_id": f"d{k}", "robot_serial": "F-1", "ended_utc": f"2026-0{k}-01T00:00:00Z", "change_rms_m": k * 4e-5,
          "change_max_m": k * 9e-5, "word": "pass"} for k in range(1, 7)]  # fmt: skip
CERTIFICATE = {"run_id": "frame-1", "procedure": "three_point_frame", "robot_serial": "F-1", "word": "pass",
               "ended_utc": "2026-05-02T10:00:00+00:00"}  # fmt: skip
RUN = {"id": "r", "procedure": "drift_check", "title": "", "state": "running", "step": "capture 3", "index": 3,
       "expected": 20, "verdict": None}  # fmt: skip
# Alarm, its cure, whose calibration, a run, its step, a certificate, what is due, what is not believed.
SAID = {
    "de": ("von ihrem Dienst ist nichts zu hören", "Lassen Sie es durchführen.",
           "Kalibrierung von gauge_7: war fällig am", "Roboterkalibrierung", "Driftprüfung", "Messung 3",
           "Benutzerkoordinaten aus drei Punkten", "Zertifikat am Bus",
           "eine Nachricht hat nicht die Teile einer signierten"),
    "es": ("no se sabe nada de su servicio", "Haga que se realice.", "calibración de gauge_7: venció el",
           "Calibración del robot", "Control de deriva", "medición 3", "Sistema de usuario con tres puntos",
           "certificado en el bus", "un mensaje no tiene las partes de uno firmado"),
    "zh": ("收不到其服务的消息", "请安排执行。", "gauge_7 的校准\uff1a已于", "用拉绳或跟踪仪标定机器人", "漂移检查", "测量 3",
           "三点法用户坐标系", "总线证书", "消息缺少签名消息应有的部分"),
}  # fmt: skip


class PlayedFleet:
    """A monitor whose cells are played: what they say is signed and opened as on the bus."""

    def __init__(self, folder: Path, count: int) -> None:
        self.names = [f"cell-{k:03d}" for k in range(count)]
        self.key, self.is_linked, self._seq = station_key(folder), True, 0
        enrolled = EnrolledCell(public_key=self.key.public_key, enrolled_utc="2026-01-01T00:00:00+00:00")
        self.fleet = Fleet(StationsFile(site=SITE, cells=dict.fromkeys(self.names, enrolled)))
        self.certificates: dict[str, bytes] = {}

    def fetch_certificate(self, cell: str, run_id: str) -> tuple[bytes, CheckedDocument]:
        raw = self.certificates[run_id]
        return raw, check_document(raw, expected_key=self.key.public_key)

    def publish_state(self, cell: str, /, **changes: Any) -> None:
        """Let a cell tell its state."""
        self._seq += 1
        body = {
            "cell": f"Line 3, {cell}", "alarms": [], "run": None, "asks": None, "attended": True, "drift": [],
            "certificate": None, "due": [], "outbox": {"first": 1, "last": 1},
        } | changes  # fmt: skip
        key = StationKeys(SITE, cell).state_key
        self.fleet.take_sample(
            key, MessageSigner(self.key, cell, "1").sign_message(key, self._seq, body), time.monotonic()
        )
        self.fleet.note_liveliness(StationKeys(SITE, cell).alive_key, alive=True)
        self.fleet.open_newest_states(most=10_000)

    def add_all_cells(self) -> None:
        for k, cell in enumerate(self.names):
            due = [{"what": "calibration of wire", "due": "2020-01-01" if k == 5 else "2099-01-01"}]
            self.publish_state(
                cell, drift=DRIFT[: k % 7], certificate=CERTIFICATE if k % 2 else None, due=due,
                run=RUN if k % 10 == 0 else None, asks={"key": "x", "step": "y"} if k % 20 == 0 else None,
            )  # fmt: skip

    def remove_cell(self, cell: str) -> None:
        self.fleet.note_liveliness(StationKeys(SITE, cell).alive_key, alive=False)


@asynccontextmanager
async def page_of(
    hall: PlayedFleet, folder: Path, size: tuple[int, int] = (1280, 800), expected: str = "no complaint"
) -> AsyncIterator[Page]:
    assert (DIST / PAGE).is_file(), "The pages are not built: run `make pages`."
    app = create_fleet_app(hall, folder)
    async with serve_app(app) as url, open_chromium() as browser:
        context = await browser.new_context(viewport={"width": size[0], "height": size[1]})
        context.set_default_timeout(PATIENCE_MS)
        page = await context.new_page()
        complaints: list[str] = []
        page.on("console", lambda line: complaints.append(line.text) if line.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on(
            "request",
            lambda request: complaints.append(request.url) if not request.url.startswith(url) else None,
        )
        await page.goto(f"{url}/api/sign-in/console?token={app.state.context.authenticator.console_token()}")
        await page.get_by_test_id(f"cell-{hall.names[-1]}" if hall.names else "no-cells").wait_for()
        yield page
        await context.close()
        assert [complaint for complaint in complaints if not re.search(expected, complaint)] == []


async def test_two_hundred_cells_are_shown_and_only_what_changed_is_drawn(tmp_path: Path) -> None:
    hall = PlayedFleet(tmp_path, CELLS)
    hall.add_all_cells()
    async with page_of(hall, tmp_path) as page:
        rows = page.locator("tbody tr")
        await expect(rows).to_have_count(CELLS)
        whole = f"{CELLS} of {CELLS} online\nAlarms: 0"
        await wait_for_value(page.get_by_test_id("sum").inner_text, lambda value: value == whole)
        await expect(page.get_by_test_id("cell-cell-005")).to_contain_text("overdue")
        await expect(page.get_by_test_id("cell-cell-006")).to_contain_text("0.240 mm")
        await expect(page.get_by_test_id("cell-cell-020")).to_contain_text("waits for a person")
        await page.evaluate(
            """() => {
                document.querySelectorAll('tbody tr').forEach((row, k) => { row.kept = row.dataset.testid; });
                window.touched = new Set();
                new MutationObserver((all) => all.forEach((one) => {
                    const node = one.target.nodeType === 1 ? one.target : one.target.parentElement;
                    window.touched.add(node.closest('tr')?.dataset.testid ?? node.tagName);
                })).observe(document.querySelector('tbody'),
                            {subtree: true, childList: true, attributes: true, characterData: true});
            }"""
        )
        hall.publish_state("cell-020", run=RUN | {"index": 4, "step": "capture 4"}, asks=None)
        hall.remove_cell("cell-042")
        gone = page.locator('[data-testid="cell-cell-042"][data-link="offline"]')
        await gone.wait_for()
        await page.get_by_text("4/20").wait_for()
        touched = set(await page.evaluate("[...window.touched]"))
        assert touched <= {
            "cell-cell-020",
            "cell-cell-042",
            "TBODY",
        }  # the body: a row went up, and was not made anew
        kept_rows = await page.evaluate(
            "[...document.querySelectorAll('tbody tr')].filter(r => r.kept === r.dataset.testid).length"
        )
        assert kept_rows == CELLS
        grey = await gone.evaluate("row => getComputedStyle(row).backgroundColor")
        assert len(set(re.findall(r"\d+", grey))) > 0
        assert grey != await page.get_by_test_id("cell-cell-043").evaluate(
            "row => getComputedStyle(row).backgroundColor"
        )
        await gone.get_by_text("s ago").wait_for()

        hall.publish_state("cell-150", alarms=[ALARM])
        await page.get_by_text("E-stop.").wait_for()
        await expect(rows.first).to_have_attribute("data-testid", "cell-cell-150")
        await page.get_by_role("button", name="Only what needs a look").click()
        waiting = [f"cell-cell-{k:03d}" for k in range(0, CELLS, 20) if k != 20]
        shown = await rows.evaluate_all("rows => rows.map(row => row.dataset.testid)")
        assert shown == ["cell-cell-150", "cell-cell-042", *sorted([*waiting, "cell-cell-005"])]
        await page.get_by_role("button", name="Only what needs a look").click()
        await page.get_by_test_id("find").fill("cell-15")
        await expect(rows).to_have_count(10)


async def test_no_one_is_shut_out_in_any_language(tmp_path: Path) -> None:
    hall = PlayedFleet(tmp_path, 12)
    hall.add_all_cells()
    hall.publish_state("cell-003", alarms=[ALARM])
    hall.remove_cell("cell-004")
    async with page_of(hall, tmp_path, (800, 1280)) as page:
        for locale, word in (
            ("en", "offline"),
            ("de", "stumm|offline"),
            ("es", "desconectada"),
            ("zh", "离线"),
        ):
            await page.locator("select").select_option(locale)
            await page.locator("tr.offline").get_by_text(re.compile(word)).first.wait_for()
            await wait_for_language(page, locale)
            await hold_to_rules(page, locale)
            assert await page.evaluate("document.documentElement.scrollWidth <= innerWidth"), locale
            whole = "all => all.every(e => e.getBoundingClientRect().right <= innerWidth)"
            assert await page.locator("tbody td").evaluate_all(whole), locale  # also what is due
            assert not re.search(r"fleet_|verdict_|\{\w+\}", await page.locator("body").inner_text()), locale
            words = json.loads((ROOT / f"web/src/locales/{locale}.json").read_text(encoding="utf-8"))
            await expect(page.get_by_test_id("safety")).to_have_text(words["safety"])


async def test_a_site_without_cells_says_how_one_is_added(tmp_path: Path) -> None:
    hall = PlayedFleet(tmp_path, 0)
    async with page_of(hall, tmp_path) as page:
        await expect(page.get_by_test_id("no-cells")).to_contain_text("cellcal site enroll")
        await expect(page.get_by_test_id("lost")).to_have_count(0)


async def test_cell_messages_are_shown_in_the_language_of_the_page(tmp_path: Path) -> None:
    hall = PlayedFleet(tmp_path, 2)
    silent = CellAlarm("desk.silent", "cell", "nothing is heard of its cell process", "Look at its service.")
    late = CellAlarm("due", "calibration of gauge_7", "was due on 2020-01-01", "Have it done.")
    broken = CellAlarm("run.broken", "robot_calibration", "Nothing was sent.")
    hall.publish_state(
        "cell-000", alarms=[each.as_json() for each in (silent, late, broken)], run=RUN, certificate=CERTIFICATE,
        due=[{"what": "certificate on the bus", "due": "2099-01-01"}],
    )  # fmt: skip
    hall.fleet.take_sample(StationKeys(SITE, "cell-001").state_key, b'{"forged": 1}', time.monotonic())
    hall.publish_state("cell-001")
    hall.fleet.take_sample(StationKeys(SITE, "cell-001").state_key, b'{"forged": 1}', time.monotonic())
    hall.fleet.open_newest_states()
    english = (
        "heard of",
        "was due",
        "calibration of",
        "Robot calibration",
        "Drift check",
        "three points",
        "on the bus",
    )
    async with page_of(hall, tmp_path) as page:
        row = page.get_by_test_id("cell-cell-000")
        await expect(row).to_contain_text("Drift check against the reference")
        await unfold(page)
        for locale, expected_texts in SAID.items():
            await page.locator("select").select_option(locale)
            await wait_for_language(page, locale)
            for words in expected_texts:
                await expect(page.locator("main")).to_contain_text(words)
            shown = await page.locator("main").inner_text()
            assert [word for word in english if word in shown] == [], locale
            await expect(page.locator("[lang=en]")).to_have_count(0)


async def test_a_lost_monitor_is_reported_and_old_values_are_grey(tmp_path: Path) -> None:
    hall = PlayedFleet(tmp_path, 3)
    hall.add_all_cells()
    async with page_of(hall, tmp_path, expected="40[13]") as page:  # refusals, as the browser tells them
        hall.is_linked = False
        await page.get_by_text("The site's router does not answer").wait_for()
        hall.is_linked = True
        await page.get_by_text("The site's router does not answer").wait_for(state="detached")
        await page.context.clear_cookies()
        await page.reload()
        await page.get_by_text("Open the address that the monitor printed").wait_for()


async def test_a_page_receives_only_what_changed(tmp_path: Path) -> None:
    hall = PlayedFleet(tmp_path, 50)
    hall.add_all_cells()
    app_context = FleetContext(hall, Authenticator(tmp_path))
    sent: dict[str, bytes] = {}
    app_context.update_rows()
    assert len(json.loads(app_context.changes_message(sent))["rows"]) == 50
    app_context.update_rows()
    assert json.loads(app_context.changes_message(sent))["rows"] == []
    hall.publish_state("cell-007", alarms=[ALARM])
    hall.remove_cell("cell-008")
    app_context.update_rows()
    message = json.loads(app_context.changes_message(sent))
    assert [(row["cell"], row["link"], len(row["alarms"])) for row in message["rows"]] == [
        ("cell-007", "online", 1), ("cell-008", "offline", 0),
    ]  # fmt: skip
    assert message["ages"].keys() == {"cell-008"}
    hall.fleet.take_sample(StationKeys(SITE, "cell-009").state_key, b'{"forged": 1}', time.monotonic())
    hall.fleet.open_newest_states()
    assert json.loads(app_context.changes_message(sent))["not_believed"][0]["cell"] == "cell-009"


WRONG: list[dict[str, Any]] = [
    {"alarms": [{"id": 5}]},
    {"alarms": "x"},
    {"drift": [DRIFT[0] | {"change_rms_m": "much"}]},
    {"run": {"state": "x"}},
    {"certificate": {"word": "pass"}},
    {"due": [None]},
    {"cell": 7},
    {"outbox": None},
    {"attended": "yes"},
]


@pytest.mark.parametrize("wrong", WRONG)
def test_a_cell_of_another_version_spoils_nothing(tmp_path: Path, wrong: dict[str, Any]) -> None:
    hall = PlayedFleet(tmp_path, 3)
    hall.add_all_cells()
    before = hall.fleet.cell_views(time.monotonic())[1]
    hall.publish_state("cell-001", **wrong)
    assert hall.fleet.flaws[-1]["cell"] == "cell-001"
    assert "another version" in hall.fleet.flaws[-1]["what"]
    after = hall.fleet.cell_views(time.monotonic())[1]
    assert (after.name, after.alarms, after.drift, after.due) == (
        before.name,
        before.alarms,
        before.drift,
        before.due,
    )


async def test_access_needs_sign_in_and_no_route_commands_a_cell(tmp_path: Path) -> None:
    hall = PlayedFleet(tmp_path, 2)
    hall.add_all_cells()
    app = create_fleet_app(hall, tmp_path)
    for context in iter_route_contexts(app.routes):
        route = context.original_route
        if isinstance(route, APIRoute):
            assert (context.methods or set()) <= {"GET", "HEAD"}, route.path
        else:
            assert isinstance(route, APIWebSocketRoute) or route.name in ("assets", "openapi"), route
    async with another_browser(app) as browser:
        app.state.context.update_rows()
        for path in ("/api/fleet", "/api/fleet/cell-000/certificates/x.json", "/openapi.json"):
            assert (await browser.get(path)).status_code == 401, path
        assert (await browser.get("/api/fleet", headers={"host": "evil.example"})).status_code == 421
        assert (await browser.get("/api/fleet", headers={"origin": "http://evil.example"})).status_code == 403
        assert (await browser.get("/api/sign-in/console", params={"token": "guess"})).status_code >= 400
        token = app.state.context.authenticator.console_token()
        assert (await browser.get("/api/sign-in/console", params={"token": token})).status_code == 303
        assert len((await browser.get("/api/fleet")).json()["rows"]) == 2
        assert (
            (await browser.get("/api/fleet"))
            .headers["content-security-policy"]
            .startswith("default-src 'self'")
        )
        hall.certificates = {
            "good": hall.key.sign_document("cellcal certificate 1", {"a": 1}).encode(),
            "forged": station_key(tmp_path / "thief")
            .sign_document("cellcal certificate 1", {"a": 1})
            .encode(),
        }
        good = await browser.get("/api/fleet/cell-000/certificates/good.json")
        assert (good.status_code, good.content) == (200, hall.certificates["good"])
        forged = await browser.get("/api/fleet/cell-000/certificates/forged.json")
        assert forged.status_code == 422
        assert "not its certificate" in forged.json()["message"]
        assert (await browser.get("/api/sign-in/console", params={"token": token})).status_code >= 400


def test_the_command_serves_states_from_a_real_bus(tmp_path: Path) -> None:
    site, port = LoopbackSite(tmp_path, "cell-07"), free_port()
    with site.start_router():
        monitor = subprocess.Popen(
            [sys.executable, "-m", "cellcal", "monitor", str(site.folder), "--port", str(port)],
            stderr=subprocess.PIPE, text=True, env=os.environ | {"COLUMNS": "300"},
        )  # fmt: skip
        try:
            assert monitor.stderr is not None
            assert SITE in monitor.stderr.readline()
            address = monitor.stderr.readline().removeprefix("Open once: ").strip()
            with httpx.Client(timeout=PATIENCE_S) as browser, site.publish_cell("cell-07") as say:

                def cell_state() -> dict[str, Any]:
                    row: dict[str, Any] = browser.get(f"http://127.0.0.1:{port}/api/fleet").json()["rows"][0]
                    return row

                def is_stopped() -> bool:
                    say("session", session_of("cell-07"))  # as a cell process does, again and again
                    say("live", live_of(state="stopped"))
                    return bool(cell_state()["link"] == "online" and cell_state()["alarms"])

                wait_until(lambda: _is_answering(browser, address))
                wait_until(is_stopped)
                assert cell_state()["alarms"][0]["text"] == "E-stop."
            with httpx.Client(timeout=PATIENCE_S) as stranger:
                assert stranger.get(f"http://127.0.0.1:{port}/api/fleet").status_code == 401
        finally:
            monitor.terminate()
            monitor.communicate(timeout=PATIENCE_S)


def _is_answering(browser: httpx.Client, address: str) -> bool:
    try:
        return browser.get(address).status_code == 303
    except httpx.TransportError:
        return False
