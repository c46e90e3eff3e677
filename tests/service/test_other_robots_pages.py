"""What every page says of a robot that is not selected, and of a recovery that the watch began: in a real browser.

The cell process is a double of two robots; what it tells of real ones is in test_unselected_robots and test_unattended_recovery.
"""

import re
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import Page, expect

from cellcal.calibration.message import make_message
from cellcal.service.demo.fake_cell import write_cell_file
from tests.service.browser_pages import go_to_page, hold_to_rules, locales_for, wait_for_language
from tests.service.service_client import ServiceClock
from tests.service.service_with_tablets import ServiceWithTablets, open_service_with_tablets
from tests.service.test_people_pages import OneQuestionProcess

pytestmark = pytest.mark.asyncio(loop_scope="module")

LOSS: dict[str, Any] = {
    "robot": "fanuc", "what": "lost", "detected_by": make_message("the controller reports: {condition_message}", condition_message="SRVO-062"), "mode": "M1",
    "words": "turns of the motors are lost; the zero comes back exactly if nothing was exchanged",
    "procedure": "mastering_recovery", "settings": {},
    "reasons": ["another robot was selected at the desk", make_message("the alarm {not_known} is unknown here", not_known="SYST-001")],
    "alone_wanted": True,
}  # fmt: skip
LOST = {  # in sentences that begin as such
    "en": "exchanged. The controller reports: SRVO-062.",
    "de": "getauscht wurde. Die Steuerung meldet: SRVO-062.",
    "es": "no se cambió nada. El controlador comunica: SRVO-062.",
    "zh": "零点可精确恢复。 控制器报告",
}
SENTENCES = {
    "en": ("Protective stop", "another robot was selected at the desk", "the monitoring"),
    "de": ("Schutzhalt", "ein anderer Roboter war ausgewählt", "Überwachung"),
    "es": ("Parada de protección", "estaba seleccionado otro robot", "la vigilancia"),
    "zh": ("保护性停止", "当时选中的是另一台机器人", "监视程序"),
}


class TwoRobotsProcess(OneQuestionProcess):
    """The cell process of two robots: with ur selected nothing is under way; with fanuc the watch has begun a run."""

    selected = "ur"

    @property
    def session(self) -> dict[str, Any]:
        session_state = super().session
        robots = [{"name": name, "model": "m", "serial": name} for name in ("fanuc", "ur")]
        session_state |= {"robots": robots, "robot": self.selected, "losses": [LOSS]}
        if self.selected == "ur":
            return session_state | {"run": None, "prompt": None}
        prompt = session_state["prompt"] | {"key": "saved_counts", "text": COUNTS, "step": "the saved counts"}
        return session_state | {"run": session_state["run"] | {"who": "watch"}, "prompt": prompt}

    def tell_live(self) -> None:
        """Tell of both robots; the one that is not selected stands in a protective stop."""
        other = "fanuc" if self.selected == "ur" else "ur"
        remedy = "Find out what the arm met, then clear the protective stop at the pendant."
        fine = {"state": "ready", "message": "", "remedy": "", "age_s": 0.1, "value": None, "due": ""}
        stopped = fine | {"state": "stopped", "message": "protective stop.", "remedy": remedy}
        devices = [fine | {"role": "robot", "name": self.selected}]
        devices += [stopped | {"role": "other_robot", "name": name} for name in (other, "third")]
        self.live_values = {"rev": self.rev, "at_s": 0.0, "devices": devices, "record": None}
        self._app.state.context.screens.broadcast(
            "live", self.live_values
        )  # and to a page whose line opens just now

    async def send_order(self, command: dict[str, Any]) -> dict[str, Any]:
        if command["order"]["op"] == "select_robot":
            self.selected = command["order"]["robot"]
        return await super().send_order(command)


COUNTS = (
    "The recovery starts from the counts that were saved while the robot was healthy. "
    "Counts at zero: J1 -17450754, J2 10042494. Last healthy counts: J1 -1697832, J2 12313007."
)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def tablet_service(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[ServiceWithTablets]:
    path = write_cell_file(tmp_path_factory.mktemp("cell"), "127.0.0.1", seed=1, time_factor=1.0)
    async with open_service_with_tablets(
        path, process_double=TwoRobotsProcess, clock=ServiceClock()
    ) as opened:
        yield opened
        assert opened.complaints == []


async def test_another_robots_stop_and_loss_are_on_every_page_and_the_watch_is_named(
    tablet_service: ServiceWithTablets,
) -> None:
    process_double: TwoRobotsProcess = tablet_service.app.state.context.link
    async with tablet_service.signed_in_tablet("Tom") as page:
        process_double.ask_question("saved_counts")
        for locale in locales_for("a stop"):
            await _change_language(page, locale)
            await go_to_page(page, "#/devices")
            process_double.tell_live()
            await expect(page.get_by_test_id("other-fanuc")).to_contain_text(SENTENCES[locale][0])
            panel = page.get_by_test_id("panel-third")
            await expect(panel).to_contain_text(re.compile(SENTENCES[locale][0], re.IGNORECASE))
            await expect(page.get_by_test_id("loss")).to_contain_text(SENTENCES[locale][1])
            await expect(page.get_by_test_id("loss")).to_contain_text(LOST[locale])
            await hold_to_rules(page, locale)
        await page.get_by_test_id("loss").get_by_role("button").click()
        await tablet_service.wait_until(lambda _: process_double.selected == "fanuc")
        for locale in locales_for("a loss"):
            await _change_language(page, locale)
            await go_to_page(page, "#/history")
            await expect(page.get_by_test_id("alone")).to_be_visible()
            await page.get_by_test_id("alone").get_by_role("link").click()
            await expect(page.get_by_test_id("run-who")).to_contain_text(SENTENCES[locale][2])
            await expect(page.get_by_test_id("yes")).to_be_visible()
            process_double.tell_live()
            await expect(page.get_by_test_id("other-ur")).to_be_visible()
            await expect(page.get_by_test_id("gauge")).to_have_count(
                0
            )  # another robot's joints are no reading
            await hold_to_rules(page, locale)


async def _change_language(page: Page, locale: str) -> None:
    await page.get_by_test_id("language").select_option(locale)
    await wait_for_language(page, locale)
