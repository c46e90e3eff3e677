"""Names that are programs, in Chromium: they are shown letter by letter, and nothing of them runs."""

import json
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from playwright.async_api import Page, Route, expect

from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.people.pin_hashing import pepper_of
from cellcal.service.people.roles import Role
from tests.service.browser_pages import at_rest, go_to_page
from tests.service.service_client import ServiceClock, cheap_hasher
from tests.service.service_with_tablets import ServiceWithTablets, give_pin, open_service_with_tablets
from tests.service.test_people_pages import OneQuestionProcess
from tests.service.test_sign_in import XSS

WHO, PIN = XSS[1], "161803"
ALL = " ".join(XSS)
# What would have been made of a text that was taken for a part of the page.
MADE = """[...document.querySelectorAll(
    'script, svg[onload], img[onerror], [href^="javascript:"], [src^="javascript:"]')]
    .filter(one => !one.src?.startsWith(location.origin)).map(one => one.outerHTML)"""


class HostileNamesProcess(OneQuestionProcess):
    """A cell process that gets such names from robots, devices and people."""

    def __init__(self, app: FastAPI) -> None:
        super().__init__(app)
        device = {"name": ALL, "state": "stopped", "message": ALL, "remedy": ALL, "age_s": 0.1, "due": ALL}
        roles: dict[str, Any] = {"robot": None, "gauge": {"length_m": 1.0, "sigma_m": 1e-4}}
        devices = [device | {"role": role, "value": value, "settle": None} for role, value in roles.items()]
        self.live_values = {"rev": 1, "at_s": time.time(), "devices": devices, "record": None}

    @property
    def session(self) -> dict[str, Any]:
        session_state = super().session
        session_state["run"] |= {
            "title": ALL,
            "step": ALL,
            "found": list(XSS),
            "does": "read",
            "left_s": None,
            "series": None,
        }
        session_state["run"]["phases"] = [{"name": text, "repeats": None, "adaptive": False} for text in XSS]
        if session_state["prompt"]:
            session_state["prompt"] |= {"text": "\n".join(XSS), "step": ALL, "unit": XSS[2]}
        session_state["robots"] = [{"name": text, "model": text, "serial": text} for text in XSS]
        session_state["losses"] = [
            {"robot": text, "what": "lost", "detected_by": text, "mode": text, "words": text, "procedure": None,
             "settings": {}, "reasons": [text]} for text in XSS
        ]  # fmt: skip
        return session_state | {
            "cell": ALL,
            "robot": WHO,
            "connection": {"connected": True, "message": ALL, "remedy": ALL},
        }


async def _answer_runs(route: Route) -> None:
    runs = [
        {"run_id": text, "procedure": text, "started_utc": "2026-01-01T00:00:00+00:00", "state": "refused",
         "reason": text, "robot_serial": text, "begun_by": text, "begun_as": [], "word": "",
         "ended_utc": "2026-01-01T00:00:00+00:00"} for text in XSS
    ]  # fmt: skip
    await route.fulfill(json=runs)


@asynccontextmanager
async def _signed_in_under_hostile_name(
    tablet_service: ServiceWithTablets, page: Page
) -> AsyncIterator[list[str]]:
    """Enrol a tablet and sign in under such a name; return what ran."""
    ran: list[str] = []

    async def note_dialog(dialog: Any) -> None:
        ran.append(dialog.message)
        await dialog.dismiss()

    page.on("dialog", note_dialog)
    page.on("console", lambda line: ran.append(line.text) if "Content Security Policy" in line.text else None)
    await tablet_service.enrol_tablet(page, XSS[6])
    await page.evaluate("location.hash = '#/sign-in'")
    people = page.get_by_test_id("person")
    for text in XSS:
        await expect(people.filter(has_text=text).first).to_be_visible()
    await people.filter(has_text=WHO).click()
    await give_pin(page, PIN)
    await expect(page.get_by_test_id("who")).to_contain_text(WHO)
    yield ran


async def test_names_that_are_programs_are_shown_and_nothing_of_them_runs(tmp_path: Path) -> None:
    path = write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0)
    async with (
        open_service_with_tablets(
            path, process_double=HostileNamesProcess, clock=ServiceClock()
        ) as tablet_service,
        tablet_service.browser_context() as context,
    ):
        hasher = cheap_hasher(pepper_of(tablet_service.authenticator.data_dir))
        for text in XSS:
            tablet_service.authenticator.accounts.add_person(
                text, Role.TECHNICIAN, hasher.hash_secret(PIN), "test"
            )
        page = await context.new_page()
        await page.route("**/api/runs", _answer_runs)
        async with _signed_in_under_hostile_name(tablet_service, page) as ran:
            process_double = tablet_service.app.state.context.link
            for place in ("#/", "#/history", "#/devices", "#/parameters", "#/sign-in"):
                await go_to_page(page, place)
                assert await page.evaluate(MADE) == [], place
            await go_to_page(page, "#/")
            await expect(page.get_by_test_id("prompt")).to_contain_text(XSS[0])
            process_double.end_run("refused", ALL, ALL)
            await expect(page.get_by_test_id("reason")).to_contain_text(XSS[0])
            await go_to_page(page, "#/history")
            assert await page.get_by_test_id("run").count() == len(XSS)
            await at_rest(page)
            assert (await page.evaluate(MADE), ran) == ([], [])
            await page.evaluate("alert('this one is heard')")
            assert ran == ["this one is heard"], json.dumps(ran)
    assert tablet_service.complaints == []
