"""A technician with a tablet: does what a page asks, presses its buttons, and looks at how it ends."""

import asyncio
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from playwright.async_api import Locator, Page, ViewportSize, expect
from playwright.async_api import TimeoutError as NotThere

from cellcal.procedures.catalogue import definition_named
from cellcal.procedures.procedure_guide import GUIDE
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.machine_speed import stretched_s
from tests.service.browser_pages import NO_WEBGL, PATIENCE_MS, open_chromium, serve_app, unfold
from tests.stories.day_cell import PACE, day_cell
from tests.stories.form_filling import FormFiller
from tests.stories.page_words import PageWords, label_settings
from tests.stories.technician_actions import AGREEMENTS, STEP_TITLES, ShownStep, TechnicianActions

PATIENCE_S = 600.0
PRESS_MS = 1e3 * stretched_s(4.0)
SLOWEST_ANSWER_S = stretched_s(20.0)
LOOKS_S = 0.15

# What stands in the card of a step: its title, its instruction, and the text of its buttons.
READ_STEP = """cards => cards.map(card => ({
    title: card.querySelector("h2").innerText,
    instruction: card.querySelector("[data-testid=instruction]").innerText,
    buttons: [...card.querySelectorAll("button")].filter(button => button.innerText.trim() !== "").map(button => ({text: button.innerText.trim()})),
}))"""
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
    verdict: str  # the page's word in English: PASS, UNDECIDED, refused
    words: str  # all that the page says of the end
    certificate: str | None  # the name of the signed file that the page offers
    steps: tuple[str, ...]  # English titles of all that the page asked for, without their numbers


class BrowserTechnician:
    """A technician with a tablet, who knows a language and nothing but what the page shows in it."""

    def __init__(
        self, page: Page, actions: TechnicianActions, pictures: Path | None, *, locale: str = "en"
    ) -> None:
        self.page, self.actions, self._pictures = page, actions, pictures
        self.words = PageWords(locale)
        self._taken: set[str] = set()
        self.english: set[str] = set()  # what pages in another language left in English
        self._holds = False

    async def run_story(self, story: ProcedureStory) -> StoryEnd:
        """Run one procedure from its page to its end, sign what it leaves to a person, and close it."""
        ended = await self.run_to_end(story)
        await self.sign_lines()
        await self._button(self._outcome, "close").click()
        await self._outcome.wait_for(state="hidden")
        return ended

    async def run_to_end(self, story: ProcedureStory) -> StoryEnd:
        """Run one procedure from its page until the page tells how it ended."""
        await self._open_home()
        await self._choose_robot(story.robot)
        self.actions.places = story.places
        await self.actions.fake_client.send_command("pace", time_factor=story.pace)
        await self._open_procedure(story)
        await self._start_run(story)
        steps: list[str] = []
        async with asyncio.timeout(PATIENCE_S):
            while not await self._outcome.is_visible():
                step = await self._read_step()
                await self._hold_button(step)
                if step is None:
                    await asyncio.sleep(LOOKS_S)
                    continue
                steps.append(step.title)
                await self._save_picture(f"{story.procedure}_{step.title}".replace(" ", "_"))
                await self.actions.do_step(step, story.robot)
                await self._agree(step, story.robot)
        await self.page.mouse.up()
        self._holds = False
        await self._save_picture(f"{story.procedure}_ended")
        words = await self._outcome.inner_text()
        return StoryEnd(story, self._read_verdict(words), words, await self._save_certificate(), tuple(steps))

    async def sign_lines(self) -> None:
        """Tick every line that a person has to do by hand, and sign; nothing where a run left none."""
        lines = self._outcome.get_by_role("checkbox")
        if not await lines.count():
            return
        sign = self._button(self._outcome, "step_sign")
        for line in await lines.all():
            await expect(sign).to_be_disabled()
            await line.check()
        await sign.click()
        await sign.wait_for(state="hidden")
        await self._save_picture("signed")

    @property
    def _outcome(self) -> Locator:
        return self.page.get_by_role("region", name=self.words.word("outcome_region"), exact=True)

    @property
    def _step(self) -> Locator:
        return self.page.get_by_role("region", name=self.words.word("step_region"), exact=True)

    def _button(self, place: Page | Locator, key: str) -> Locator:
        return place.get_by_role("button", name=self.words.word(key), exact=True)

    async def _read_step(self) -> ShownStep | None:
        """Read what the page asks for now; nothing while the robot works, or where the page has just gone on."""
        shown = await self._step.evaluate_all(READ_STEP)
        if not shown or not shown[0]["buttons"]:
            return None
        title, number = self.words.recognise(shown[0]["title"], STEP_TITLES)
        first_lines = [button["text"].partition("\n")[0] for button in shown[0]["buttons"]]
        agreeing = [line for line in first_lines if self._agreement_of(line) is not None]
        assert len(agreeing) == 1, f"which of {first_lines} means yes to {shown[0]['title']!r}?"
        answer = self._agreement_of(agreeing[0]) or ""
        return ShownStep(title, number, answer, shown[0]["instruction"], agreeing[0])

    def _agreement_of(self, button: str) -> str | None:
        """Return the English words of a button that agrees, None of any other button."""
        if button == self.words.word("enter"):
            return "Enter"
        return next((each for each in AGREEMENTS if self.words.translate(each) == button), None)

    def _read_verdict(self, words: str) -> str:
        """Return the verdict in English, from the line that the page begins with."""
        first = words.strip().splitlines()[0]
        english = PageWords("en")
        verdicts = {self.words.word(key): english.word(key) for key in english.keys_of("verdict_")}
        return next((verdict for shown, verdict in verdicts.items() if first.endswith(shown)), first)

    async def _save_certificate(self) -> str | None:
        link = self._outcome.get_by_role("link", name=self.words.word("signed_data"), exact=True)
        if not await link.count():
            return None
        async with self.page.expect_download() as download:
            await link.click()
        return (await download.value).suggested_filename

    async def _hold_button(self, step: ShownStep | None) -> None:
        """Hold the button from when a move waits for it until something is asked."""
        hold = self._button(self.page, "hold_to_move")
        if step is not None and self._holds:
            await self.page.mouse.up()
            self._holds = False
        elif step is None and not self._holds and await hold.is_visible() and await hold.is_enabled():
            await hold.hover()
            await self.page.mouse.down()
            self._holds = True

    async def _open_home(self) -> None:
        await self.page.get_by_role("link", name=self.words.word("procedures"), exact=True).click()
        await self.page.get_by_role("link", name=self.words.word("devices"), exact=True).wait_for()

    async def _choose_robot(self, robot: str) -> None:
        robots = self.page.get_by_role("combobox", name=self.words.word("robot"), exact=True)
        if not await robots.count():
            return
        await expect(robots).to_be_enabled()  # a run that was closed has gone
        names = await robots.get_by_role("option").all_inner_texts()
        chosen = next(name for name in names if name.startswith(f"{robot} "))
        await robots.select_option(label=chosen)

    async def _open_procedure(self, story: ProcedureStory) -> None:
        """Look for the procedure under what it is for; with a loss, under what else can be done."""
        definition = definition_named(story.procedure)
        title = self.words.translate(definition.title)
        main = self.page.get_by_role("main")
        recover = main.get_by_role("link", name=self.words.word("prepare_recovery"), exact=True)
        heading = main.get_by_role("heading", level=1, name=title, exact=True)
        if story.procedure == "mastering_recovery":
            await recover.click()  # the watch has seen it, and the page begins with it
        else:
            await self._unfold(main, self.words.word(f"intention_{GUIDE[story.procedure].intention}"))
            await main.get_by_role("link", name=f"{self.words.word('open')} {title}", exact=True).click()
        await heading.wait_for()

    async def _unfold(self, main: Locator, group: str) -> None:
        await unfold(main.locator("details", has=self.page.locator("summary", has_text=group)))

    async def _start_run(self, story: ProcedureStory) -> None:
        await self._save_picture(f"{story.procedure}_before")
        await FormFiller(self.page, self.words).fill_in(label_settings(story.procedure, story.settings))
        hold = self.page.get_by_role("checkbox", name=self.words.word("hold_each_move"), exact=True)
        if await hold.count():  # not where a person moves the arm
            await hold.set_checked(story.hold)
        if story.settings:
            await self._save_picture(f"{story.procedure}_filled_in")
        start = self._button(self.page.get_by_role("main"), "start")
        stop = self._button(self.page, "ask_to_stop")
        for _ in range(10):  # the session may have gone on while the page was looked at
            with suppress(NotThere):
                await start.click(timeout=PRESS_MS)
            with suppress(NotThere):
                await stop.or_(self._outcome).first.wait_for(timeout=PRESS_MS)
                return
        raise AssertionError("the page's start button starts nothing")

    async def _agree(self, step: ShownStep, robot: str) -> None:
        """Press the button that agrees until the page has gone on; some buttons want to be held."""
        field = self._step.get_by_role("textbox", name=self.words.word("answer"))
        if await field.count():
            await field.fill(await self.actions.read_display(robot))
        yes = self._step.get_by_role("button", name=step.button)
        for _ in range(5):
            with suppress(NotThere):
                await self._press(yes)
            # a second press might answer what the page has gone on to meanwhile
            if await self._comes_to_be(partial(self._has_gone_on, step)):
                return
        raise AssertionError(f"the page does not go on from {step.title}: {step.instruction}")

    async def _press(self, yes: Locator) -> None:
        await expect(yes).to_be_enabled()
        if self.words.word("step_hold_two_seconds") not in await yes.inner_text():
            await yes.click()
            return
        await yes.hover()
        await self.page.mouse.down()
        await asyncio.sleep(2.4)
        await self.page.mouse.up()

    @staticmethod
    async def _comes_to_be(is_so: Callable[[], Awaitable[bool]]) -> bool:
        for _ in range(round(SLOWEST_ANSWER_S / LOOKS_S)):
            if await is_so():
                return True
            await asyncio.sleep(LOOKS_S)
        return False

    async def _has_gone_on(self, step: ShownStep) -> bool:
        now = await self._read_step()
        return now is None or (now.title, now.number, now.instruction) != (
            step.title,
            step.number,
            step.instruction,
        )

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
        yield BrowserTechnician(page, TechnicianActions(fake_client, {}), pictures, locale=locale[:2])
        assert broken == []
