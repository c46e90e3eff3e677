"""The short stories of the day; the whole day is a campaign (``make soak ARGS=day``)."""

import json
from pathlib import Path
from typing import Any

import pytest
from playwright.async_api import Page, expect

from cellcal.service.cli.certificate import verify
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.browser_pages import hold_to_rules_in_languages
from tests.service.cell_process_session import without_a_wire_to_the_gauge
from tests.service.service_client import ServiceClock
from tests.service.service_with_tablets import open_service_with_tablets
from tests.service.test_pages import view_service
from tests.stories.browser_technician import BrowserTechnician, ProcedureStory, StoryEnd, working_day
from tests.stories.catalogue_day import PROBED, QUICK, day_stories
from tests.stories.day_cell import day_cell
from tests.stories.technician_actions import TechnicianActions

RECORD = ProcedureStory("mastering_record", {"poses": 12})


def certificate_of(folder: Path, ended: StoryEnd) -> tuple[Path, dict[str, Any]]:
    """Return the certificate of a run that has one that holds, and what is signed in it."""
    assert ended.certificate is not None, ended.words
    path = folder / "data" / "certificates" / ended.certificate
    assert verify(path) == 0
    content: dict[str, Any] = json.loads(path.read_bytes())["content"]
    return path, content


async def test_a_technician_teaches_tool_frame_and_workpiece_and_places_a_simulated_base(
    tmp_path: Path,
) -> None:
    async with working_day(tmp_path) as day:
        ended = [await day.run_story(story) for story in day_stories() if story.procedure in QUICK]
    assert [end.words for end in ended if end.verdict != "PASS"] == []
    assert [end.procedure_story.procedure for end in ended] == list(QUICK)
    for end in ended:
        certificate_of(tmp_path, end)


async def test_a_face_that_the_probe_misses_is_reported_to_the_technician(tmp_path: Path) -> None:
    """The slice of the story below: up to its first touch."""
    async with working_day(tmp_path) as day:
        await day.actions.fake_client.inject_fault("stuck_open", device="probe")
        ended = await day.run_story(PROBED)
    assert ended.steps == ("the probe is mounted", "accept the plan")
    assert "touch the z face 1: no contact within" in ended.words


@pytest.mark.soak  # `make soak ARGS=corner_story`: most of it is waiting for a probe that is watched in real time
async def test_a_technician_watches_a_probe_feel_for_a_corner(tmp_path: Path) -> None:
    async with working_day(tmp_path) as day:
        ended = await day.run_story(PROBED)
    assert ended.verdict == "PASS", ended.words
    assert ended.steps == ("the probe is mounted", "accept the plan", "accept the result")
    _, content = certificate_of(tmp_path, ended)
    assert [point["face"] for point in content["result"]["points"]][:6] == ["z", "z", "z", "y", "y", "x"]


async def test_a_recovered_mastering_is_signed_line_by_line_and_the_certificate_says_by_whom(
    tmp_path: Path,
) -> None:
    async with (
        day_cell(tmp_path) as (path, fake_client),
        open_service_with_tablets(path, clock=ServiceClock()) as tablet_service,
        tablet_service.signed_in_tablet("Emil") as page,
    ):
        await tablet_service.wait_until(lambda session: session["connection"]["connected"])
        day = BrowserTechnician(page, TechnicianActions(fake_client, {}), None)
        assert (await day.run_story(RECORD)).verdict == "PASS"
        await fake_client.inject_fault("battery_loss", device="fanuc")
        ended = await day.run_to_end(ProcedureStory("mastering_recovery"))
        assert ended.verdict == "PASS", ended.words
        _, before = certificate_of(tmp_path, ended)
        assert "signed" not in [one["did"] for one in before["sign_off"]]
        await hold_to_rules_in_languages(page, "the end of a run with lines to sign")
        await day.sign_lines()
        await expect(page.get_by_test_id("signed")).to_contain_text("Emil")
        await hold_to_rules_in_languages(page, "the end of a run that is signed")
        await page.reload()
        await expect(page.get_by_test_id("signed")).to_contain_text("Emil")
        certificate_path, content = certificate_of(tmp_path, ended)
        signatures = [one for one in content["sign_off"] if one["did"] == "signed"]
        assert [one["what"] for one in signatures] == content["verdict"]["to_sign"]
        assert {(one["who"], one["people"][0]["role"]) for one in signatures} == {("Emil", "engineer")}
        assert "by Emil (engineer)" in certificate_path.with_suffix(".txt").read_text(encoding="utf-8")
        assert tablet_service.complaints == []


async def test_lengths_are_typed_from_an_instrument_that_has_no_wire_to_the_cell(tmp_path: Path) -> None:
    async with day_cell(tmp_path) as (path, fake_client):
        without_a_wire_to_the_gauge(path)
        async with (
            view_service(create_app(ServiceSettings(path, open_access=True))) as viewer,
            viewer.open_page() as page,
        ):
            day = BrowserTechnician(page, _ClumsyTechnician(fake_client, page), None)
            ended = await day.run_story(ProcedureStory("mastering_record", {"poses": 8, "samples": 1}))
    assert ended.steps.count("capture") == 8
    assert ended.verdict in ("PASS", "UNDECIDED"), ended.words  # eight lengths are few
    _, content = certificate_of(tmp_path, ended)
    assert "typed" in json.dumps(content)


class _ClumsyTechnician(TechnicianActions):
    """Reads a display whose wire is closed, and types a word at first."""

    def __init__(self, fake_client: FakeCellClient, page: Page) -> None:
        super().__init__(fake_client, {})
        self._page, self._begun = page, False

    async def read_display(self, robot: str) -> str:
        if not self._begun:
            self._begun = True
            await self._page.get_by_test_id("value").fill("about a metre")
            await expect(self._page.get_by_role("alert")).to_be_visible()
            await expect(self._page.get_by_test_id("yes")).to_be_disabled()
            await hold_to_rules_in_languages(self._page, "a length that is typed")
        return await super().read_display(robot)
