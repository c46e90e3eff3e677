"""A technician with a tablet: does what a page asks, presses its buttons, and looks at how it ends."""

import asyncio
import json
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from playwright.async_api import Page, ViewportSize, expect
from playwright.async_api import TimeoutError as NotThere

from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.machine_speed import stretched_s
from tests.service.browser_pages import NO_WEBGL, PATIENCE_MS, open_chromium, serve_app
from tests.stories.day_cell import PACE, day_cell
from tests.stories.form_filling import fill_in
from tests.stories.technician_actions import TechnicianActions

PATIENCE_S = 600.0
PRESS_MS = 1e3 * stretched_s(4.0)
LOOKS_S = 0.15

SCREEN = ViewportSize(width=1280, height=800)


@dataclass(frozen=True)
class ProcedureStory:
    """One procedure of the day, and what the technician brings to it."""

    procedure: str
    settings: dict[str, Any] = field(default_factory=dict)
    places: dict[str, Any] = field(default_factory=dict)
    robot: str = "fanuc"
    hold: bool = False  # the technician keeps a finger on the button while the robot moves
    pace: float = PACE  # of the world's clock: a probe is watched in real time


# Words that only English has, and what is called so in the day's cell.
ENGLISH = re.compile(r"\b(the|of|about|is|are|again|with|took|has no|looking|reading)\b", re.IGNORECASE)
NAMES = re.compile(r"wire of (fanuc|second)")


@dataclass(frozen=True)
class StoryEnd:
    """How a story ended, as the page tells it."""

    procedure_story: ProcedureStory
    verdict: str
    words: str
    certificate: str | None
    question_keys: tuple[str, ...]  # keys of all that the page asked for


class BrowserTechnician:
    """A technician with a tablet."""

    def __init__(self, page: Page, actions: TechnicianActions, pictures: Path | None) -> None:
        self.page, self.actions, self._pictures = page, actions, pictures
        self._taken: set[str] = set()
        self.english: set[str] = set()  # what pages in another language left in English
        self._holds = False

    async def run_story(self, story: ProcedureStory) -> StoryEnd:
        """Run one procedure from its page to its end, sign what it leaves to a person, and close it."""
        ended = await self.run_to_end(story)
        await self.sign_lines()
        await self.page.get_by_test_id("dismiss").click()
        await self._wait_until(lambda value: value["run"] is None)
        return ended

    async def run_to_end(self, story: ProcedureStory) -> StoryEnd:
        """Run one procedure from its page until the page tells how it ended."""
        await self._choose_robot(story.robot)
        self.actions.places = story.places
        await self.actions.fake_client.send_command("pace", time_factor=story.pace)
        await self._start_run(story)
        question_keys: list[str] = []
        async with asyncio.timeout(PATIENCE_S):
            while True:
                session = await self.read_session()
                run, prompt = session["run"], session["prompt"]
                if run and run["outcome"]:
                    break
                await self._hold_button(session["waits_for_hold"], prompt)
                if prompt is None:
                    await asyncio.sleep(LOOKS_S)
                    continue
                question_keys.append(prompt["key"])
                await self._save_picture(f"{story.procedure}_{prompt['key']}")
                await self.actions.do_action(prompt, story.robot)
                await self._press_offered(prompt)
        await self.page.mouse.up()
        self._holds = False
        await self.page.get_by_test_id("outcome").wait_for()
        await self._save_picture(f"{story.procedure}_ended")
        outcome = run["outcome"]
        words = f"{outcome['verdict']}: {outcome['reason']} {outcome['remedy']}"
        return StoryEnd(
            story, self._outcome_word(outcome), words, outcome.get("certificate"), tuple(question_keys)
        )

    async def sign_lines(self) -> None:
        """Tick every line that a person has to do by hand, and sign; nothing where a run left none."""
        lines = self.page.get_by_test_id("sign").get_by_role("checkbox")
        if not await lines.count():
            return
        sign = self.page.get_by_test_id("sign-off")
        for line in await lines.all():
            await expect(sign).to_be_disabled()
            await line.check()
        await sign.click()
        await self.page.get_by_test_id("signed").wait_for()
        await self._save_picture("signed")

    async def _hold_button(self, is_wanted: bool, prompt: dict[str, Any] | None) -> None:
        """Hold the button from when a move waits for it until something is asked."""
        if prompt is not None and self._holds:
            await self.page.mouse.up()
            self._holds = False
        elif is_wanted and not self._holds:
            await self.page.get_by_test_id("hold").hover()
            await self.page.mouse.down()
            self._holds = True

    @staticmethod
    def _outcome_word(outcome: dict[str, Any]) -> str:
        judged = outcome.get("judgement") or {}
        return str(judged.get("word") or outcome["verdict"])

    async def read_session(self) -> dict[str, Any]:
        """Return the session as this tablet's service has it."""
        answer = await self.page.evaluate("async () => (await fetch('/api/session')).json()")
        return dict(answer["session"])

    async def _wait_until(self, true: Any) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while not true(await self.read_session()):
                await asyncio.sleep(LOOKS_S)

    async def _choose_robot(self, robot: str) -> None:
        await self._wait_until(lambda session: session["connection"]["connected"])
        if (await self.read_session())["robot"] != robot:
            await self.page.get_by_test_id("robot").select_option(robot)
            await self._wait_until(
                lambda session: session["robot"] == robot and session["connection"]["connected"]
            )

    async def _start_run(self, story: ProcedureStory) -> None:
        await self.page.evaluate(f"location.hash = '#/procedure/{story.procedure}'")
        await self.page.get_by_test_id("start").wait_for()
        await self._save_picture(f"{story.procedure}_before")
        await fill_in(self.page, story.settings)
        await self.page.get_by_test_id("hold-to-move").set_checked(story.hold)
        if story.settings:
            await self._save_picture(f"{story.procedure}_filled_in")
        await self._press_start()
        await self._wait_until(lambda session: session["run"] is not None)

    async def _press_start(self) -> None:
        """Press until the run is there: the session may have gone on while the page was looked at."""
        for _ in range(10):
            with suppress(NotThere):
                await self.page.get_by_test_id("start").click(timeout=PRESS_MS)
            for _ in range(30):
                if (await self.read_session())["run"] is not None:
                    return
                await asyncio.sleep(LOOKS_S)
        raise AssertionError("the page's start button starts nothing")

    async def _press_offered(self, prompt: dict[str, Any]) -> None:
        """Press what the page offers until the page has gone on; some buttons want to be held."""
        asks = self.page.locator(f"[data-testid=prompt][data-key={json.dumps(prompt['key'])}]")
        yes = asks.get_by_test_id("yes")  # and not what the page has gone on to
        if prompt["kind"] == "enter":
            await asks.get_by_test_id("value").fill(await self.actions.read_display(prompt))
        for _ in range(40):
            try:
                await yes.hover(timeout=PRESS_MS)
                if await yes.get_attribute("data-hold") is None:
                    await yes.click(timeout=PRESS_MS)
                else:
                    await self.page.mouse.down()
                    await asyncio.sleep(2.4)
                    await self.page.mouse.up()
            except NotThere:
                await asyncio.sleep(0.1)
            for _ in range(20):
                session = await self.read_session()
                if (session["prompt"] or {}).get("id") != prompt["id"]:
                    return
                await asyncio.sleep(0.05)
        raise AssertionError(f"the page does not go on from {prompt['key']}: {prompt['text']}")

    async def _save_picture(self, name: str) -> None:
        if self._pictures is not None and name not in self._taken:
            self._taken.add(name)
            await self.page.wait_for_timeout(300)
            self.english.update(await self.page.locator("main span[lang=en]").all_inner_texts())
            if await self.page.locator("html").get_attribute("lang") != "en":
                page_text = NAMES.sub("", await self.page.locator("body").inner_text())
                self.english.update(line for line in page_text.splitlines() if ENGLISH.search(line))
            # as high as the page: what stays at a lower screen's edge would lie over the middle of the picture
            high = await self.page.evaluate("document.documentElement.scrollHeight")
            whole = ViewportSize(width=SCREEN["width"], height=max(SCREEN["height"], high))
            await self.page.set_viewport_size(whole)
            await self.page.screenshot(
                path=self._pictures / f"{len(self._taken):03d}_{name}.png", full_page=True
            )
            await self.page.set_viewport_size(SCREEN)


@asynccontextmanager
async def working_day(
    folder: Path, pictures: Path | None = None, *, locale: str = "en-US"
) -> AsyncIterator[BrowserTechnician]:
    """Run the cell, its service and a browser at it, which speaks that language."""
    async with (
        day_cell(folder) as (path, fake_client),
        serve_app(create_app(ServiceSettings(path, open_access=True))) as url,
        open_chromium() as browser,
    ):
        page = await browser.new_page(viewport=SCREEN, locale=locale)
        page.set_default_timeout(PATIENCE_MS)
        broken: list[str] = []
        page.on("pageerror", lambda error: broken.append(str(error)))
        if pictures is None:
            await page.add_init_script(NO_WEBGL)  # drawn in software a picture costs a core
        await page.goto(url)
        await page.get_by_test_id("device-robot").wait_for()
        yield BrowserTechnician(page, TechnicianActions(fake_client, {}), pictures)
        assert broken == []
