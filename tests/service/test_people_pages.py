"""The pages of people in a real browser: enrol, sign in and out, roles, the PIN again, a second person.

The cell process is a double that asks one question that writes; what needs devices is in test_two_tablets.
"""

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from fastapi import FastAPI
from playwright.async_api import Page, Response, Route, expect

from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.people.sessions import FRESH_S, IDLE_S
from cellcal.service.web.middleware import RequestBudget
from tests.service.browser_pages import hold_to_rules_in_languages
from tests.service.service_client import PINS, ServiceClock
from tests.service.service_with_tablets import (
    ServiceWithTablets,
    give_pin,
    open_service_with_tablets,
    sign_in,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")


class OneQuestionProcess:
    """Takes the place of the cell process: asks the same question anew, and keeps who said yes to it."""

    def __init__(self, app: FastAPI) -> None:
        self._app = app
        self.rev = 1
        self.key = "wire_is_hooked"
        self.orders: list[tuple[str, str]] = []
        self.live_values: dict[str, Any] | None = None
        self.outcome: dict[str, Any] | None = None

    @property
    def session(self) -> dict[str, Any]:
        prompt = {"id": f"run:{self.rev}", "kind": "confirm", "key": self.key, "step": "write mastering"}
        prompt |= {
            "text": "Write the new mastering?\nJ1: 100 -> 200 counts",
            "unit": "",
            "page": "ask",
            "data": {},
        }
        run: dict[str, Any] = {"id": "run", "procedure": "mastering_recovery", "title": "Mastering recovery"}
        run |= {"state": "running", "step": "write mastering", "index": 1, "expected": 2, "phases": []}
        run |= {"found": [], "who": "Anna", "events": [], "outcome": self.outcome, "hold_to_move": True}
        if self.outcome is not None:
            run["state"] = "ended"
        return {
            "rev": self.rev, "cell": "cell 7", "robots": [{"name": "fanuc", "model": "m6ib", "serial": "1"}],
            "robot": "fanuc", "level": "commanded", "losses": [], "waits_for_hold": False,
            "journal_end": "", "troubles": [],
            "connection": {"connected": True, "message": "", "remedy": ""}, "run": run,
            "prompt": None if self.outcome else prompt,
        }  # fmt: skip

    def ask_question(self, key: str) -> None:
        """Ask something else."""
        self.key, self.outcome = key, None
        self._publish_session()

    def end_run(self, verdict: str, reason: str, remedy: str) -> None:
        """Let the run end so."""
        self.outcome = {"verdict": verdict, "reason": reason, "remedy": remedy}
        self._publish_session()

    def _publish_session(self) -> None:
        self.rev += 1
        self._app.state.context.screens.broadcast("session", self.session)

    async def send_order(self, command: dict[str, Any]) -> dict[str, Any]:
        order = command["order"]
        if order["op"] == "hold":
            return {"ok": True, "rev": self.rev}
        self.orders.append((order["op"], command["who"]))
        self.ask_question(self.key)
        return {"ok": True, "rev": self.rev}


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def tablet_service(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[ServiceWithTablets]:
    path = write_cell_file(tmp_path_factory.mktemp("cell"), "127.0.0.1", seed=1, time_factor=1.0)
    async with open_service_with_tablets(
        path, process_double=OneQuestionProcess, clock=ServiceClock()
    ) as opened:
        yield opened
        assert opened.complaints == []


@pytest_asyncio.fixture(loop_scope="module", autouse=True)
async def one_question(tablet_service: ServiceWithTablets) -> AsyncIterator[OneQuestionProcess]:
    double: OneQuestionProcess = tablet_service.app.state.context.link
    double.orders.clear()
    tablet_service.release_control()
    yield double
    tablet_service.authenticator.accounts._guess_clock = tablet_service.authenticator.clock
    tablet_service.authenticator.sessions._clock = tablet_service.authenticator.clock


@asynccontextmanager
async def unknown_tablet(tablet_service: ServiceWithTablets, **settings: Any) -> AsyncIterator[Page]:
    async with tablet_service.browser_context(**settings) as context:
        page = await context.new_page()
        page.on("pageerror", lambda error: tablet_service.complaints.append(str(error)))
        yield page


async def expect_shown(page: Page, test_id: str) -> None:
    await expect(page.get_by_test_id(test_id)).to_be_visible()


async def expect_gone(page: Page, test_id: str) -> None:
    await expect(page.get_by_test_id(test_id)).to_have_count(0)


async def expect_disabled(page: Page, test_id: str) -> None:
    await expect(page.get_by_test_id(test_id)).to_be_disabled()


async def expect_enabled(page: Page, test_id: str) -> None:
    await expect(page.get_by_test_id(test_id)).to_be_enabled()


async def test_an_unenrolled_browser_sees_nothing(tablet_service: ServiceWithTablets) -> None:
    async with unknown_tablet(tablet_service) as page:
        await page.goto(f"http://127.0.0.1:{tablet_service.port}/")
        await expect_shown(page, "unknown-device")
        await expect(page.locator("body")).not_to_contain_text("cell 7")
        await page.goto(f"http://127.0.0.1:{tablet_service.port}/#/enrol/no-such-token")
        await page.get_by_test_id("enrol-device").click()
        await expect_shown(page, "enrol-fault")
        await tablet_service.enrol_tablet(page, "tablet 3")
        await expect(page).not_to_have_url(re.compile("enrol/+[^/]"))  # the token must not be readable
        await page.reload()  # the key is kept: it comes in by itself, looks on and may ask for a stop
        await page.evaluate("location.hash = '#/'")
        await expect_shown(page, "looks-on")
        await expect_disabled(page, "yes")
        await expect_enabled(page, "stop")
        await page.get_by_test_id("to-sign-in").click()
        await expect_shown(page, "people")


async def test_an_answer_from_before_the_enrolment_ends_no_session(
    tablet_service: ServiceWithTablets,
) -> None:
    """It says that the device is unknown, so the device proves itself again: not over a person who signed in meanwhile."""
    requested, answered = asyncio.Event(), asyncio.Event()

    async def delay_answer(route: Route) -> None:
        answer = await route.fetch(max_retries=3)  # the service may close an idle connection just then
        requested.set()
        await asyncio.sleep(2.0)
        await route.fulfill(response=answer)
        answered.set()

    async with unknown_tablet(tablet_service) as page:
        await page.goto(f"http://127.0.0.1:{tablet_service.port}/")
        await expect_shown(page, "unknown-device")
        await page.route("**/api/sign-in", delay_answer, times=1)
        await requested.wait()
        await tablet_service.enrol_tablet(page, "tablet that looked early")
        await sign_in(page, "Tom")
        await answered.wait()
        await page.wait_for_timeout(500)  # what follows from the answer may happen
        await page.reload()
        await expect(page.get_by_test_id("who")).to_have_attribute("data-role", "technician")


async def test_a_person_signs_in_orders_and_signs_out(
    tablet_service: ServiceWithTablets, one_question: OneQuestionProcess
) -> None:
    one_question.ask_question("wire_is_hooked")
    async with tablet_service.signed_in_tablet("Tom") as page:
        await page.get_by_test_id("yes").click()
        await tablet_service.wait_until(lambda _: one_question.orders)
        assert one_question.orders == [("answer", "Tom")]
        await page.get_by_test_id("sign-out").click()
        await expect_shown(page, "sign-in")
        await page.get_by_test_id("look-on").click()
        await expect_disabled(page, "yes")
        await page.get_by_test_id("stop").click()
        await tablet_service.wait_until(lambda _: len(one_question.orders) == 2)
        assert one_question.orders[1] == ("stop", "tablet of Tom")


async def test_wrong_pins_are_reported_and_then_delayed(tablet_service: ServiceWithTablets) -> None:
    async with unknown_tablet(tablet_service) as page:
        await tablet_service.enrol_tablet(page, "tablet 4")
        await page.evaluate("location.hash = '#/sign-in'")
        await page.get_by_test_id("person").filter(has_text="Tina").click()
        now_s = tablet_service.authenticator.clock()
        tablet_service.authenticator.accounts._guess_clock = lambda: (
            now_s
        )  # an hour, also where keys are pressed slowly
        for _ in range(5):
            await give_pin(page, "999000")
            await expect_shown(page, "secret-fault")
        await give_pin(page, PINS["Tina"])
        await expect(page.get_by_test_id("secret-fault")).to_contain_text("60 min")
        tablet_service.authenticator.accounts._guess_clock = lambda: now_s + 3601.0
        await give_pin(page, PINS["Tina"])
        await page.locator("[data-testid=who][data-role=technician]").wait_for()


@pytest.mark.parametrize("name", ["Vera", "Ada"])
async def test_what_a_role_may_not_do_is_not_offered(
    tablet_service: ServiceWithTablets, one_question: OneQuestionProcess, name: str
) -> None:
    one_question.ask_question("wire_is_hooked")
    async with tablet_service.signed_in_tablet(name) as page:
        await expect_shown(page, "looks-on")
        for button in ("yes", "no", "hold"):
            await expect_disabled(page, button)
            await page.get_by_test_id(button).click(force=True)
        await expect_enabled(page, "stop")
        await page.get_by_test_id("stop").click()
        await tablet_service.wait_until(lambda _: one_question.orders)
        assert one_question.orders == [("stop", name)]  # nothing that was pressed before it came


async def test_an_approval_asks_for_the_pin_and_then_goes_through(
    tablet_service: ServiceWithTablets, one_question: OneQuestionProcess
) -> None:
    one_question.ask_question("accept_plan")
    async with tablet_service.signed_in_tablet("Tom") as page:
        now_s = tablet_service.authenticator.clock()
        tablet_service.authenticator.sessions._clock = lambda: now_s + FRESH_S + 30.0
        await page.get_by_test_id("yes").click()
        await expect_shown(page, "dialog")
        await expect_shown(page, "dialog-stop")
        await page.get_by_test_id("dialog-close").click()
        await expect_gone(page, "dialog")
        await expect(page.get_by_test_id("yes")).to_be_focused()  # a keyboard goes on where it was
        assert one_question.orders == []
        await page.get_by_test_id("yes").click()
        await give_pin(page, PINS["Tom"])
        await tablet_service.wait_until(lambda _: one_question.orders)
        await expect_gone(page, "dialog")
        assert one_question.orders == [("answer", "Tom")]


async def test_the_dialog_for_the_pin_comes_with_its_pad(
    tablet_service: ServiceWithTablets, one_question: OneQuestionProcess
) -> None:
    """A pad that comes later moves the buttons below it: a press that has begun ends beside what it was meant for."""
    one_question.ask_question("accept_plan")
    requested, may_come = asyncio.Event(), asyncio.Event()

    async def delay_script(route: Route) -> None:
        requested.set()
        await may_come.wait()
        await route.continue_()

    async with tablet_service.signed_in_tablet("Tom") as page:
        now_s = tablet_service.authenticator.clock()
        tablet_service.authenticator.sessions._clock = lambda: now_s + FRESH_S + 30.0
        await page.route("**/api/sign-in/people", delay_script)
        await page.get_by_test_id("yes").click()
        await requested.wait()
        assert await page.get_by_test_id("dialog").count() == 0
        may_come.set()
        await expect_shown(page, "dialog")
        assert await page.get_by_test_id("secret").is_visible()
        await page.get_by_test_id("dialog-close").click()
        await expect_gone(page, "dialog")


async def test_a_screen_left_alone_still_stops_and_the_pin_opens_it(
    tablet_service: ServiceWithTablets, one_question: OneQuestionProcess
) -> None:
    one_question.ask_question("wire_is_hooked")
    async with tablet_service.signed_in_tablet("Emil") as page:
        now_s = tablet_service.authenticator.clock()
        tablet_service.authenticator.sessions._clock = lambda: now_s + IDLE_S + 30.0
        await expect_shown(page, "locked")
        await expect_disabled(page, "yes")
        await expect_enabled(page, "stop")
        await page.get_by_test_id("unlock").click()
        await give_pin(page, PINS["Emil"])
        await expect_enabled(page, "yes")
        await expect_gone(page, "locked")


async def test_writing_takes_a_second_person_beside_the_first(
    tablet_service: ServiceWithTablets, one_question: OneQuestionProcess
) -> None:
    one_question.ask_question("accept_mastering")
    async with tablet_service.signed_in_tablet("Tom") as page:
        await page.get_by_test_id("yes").click()
        await expect_shown(page, "dialog")
        await page.keyboard.press("Escape")
        await expect_gone(page, "dialog")
        await expect(page.get_by_test_id("yes")).to_be_focused()
        await page.keyboard.press("Enter")
        names = page.get_by_test_id("dialog").get_by_test_id("person").locator("strong")
        await expect(names).to_have_text(["Emil", "Tina"])  # no viewer, no admin, not Tom
        await page.get_by_test_id("person").filter(has_text="Tina").click()
        await give_pin(page, "000999")
        await expect_shown(page, "secret-fault")
        assert one_question.orders == []
        await give_pin(page, PINS["Tina"])
        await expect_gone(page, "dialog")
        assert one_question.orders == [("answer", "Tom and Tina")]


async def test_the_second_person_may_approve_at_a_screen_of_their_own(
    tablet_service: ServiceWithTablets, one_question: OneQuestionProcess
) -> None:
    one_question.ask_question("accept_mastering")
    async with tablet_service.signed_in_tablet("Tom") as tom, tablet_service.signed_in_tablet("Tina") as tina:
        await tom.get_by_test_id("yes").click()
        await expect_shown(tom, "dialog")
        await expect_shown(tina, "second-wanted")
        await expect_disabled(tina, "no")
        await tina.get_by_test_id("yes").click()
        await expect_gone(tom, "dialog")
        assert one_question.orders == [("answer", "Tom and Tina")]


async def test_an_engineer_writes_alone_with_a_passphrase(
    tablet_service: ServiceWithTablets, one_question: OneQuestionProcess
) -> None:
    one_question.ask_question("accept_mastering")
    async with tablet_service.signed_in_tablet("Emil") as page:
        await page.get_by_test_id("yes").click()
        await tablet_service.wait_until(lambda _: one_question.orders)
        assert one_question.orders == [("answer", "Emil")]


async def test_the_pages_of_people_are_for_everybody(
    tablet_service: ServiceWithTablets, one_question: OneQuestionProcess
) -> None:
    one_question.ask_question("accept_mastering")
    async with unknown_tablet(tablet_service) as page:
        await page.goto(f"http://127.0.0.1:{tablet_service.port}/")
        await expect_shown(page, "unknown-device")
        await hold_to_rules_in_languages(page, "unknown")
        token = tablet_service.authenticator.accounts.create_enrolment("tablet", "test")
        await page.evaluate("hash => { location.hash = hash; }", f"#/enrol/{token}")
        await expect_shown(page, "enrol")
        await hold_to_rules_in_languages(page, "enrol")
        await page.get_by_test_id("enrol-device").click()
        await expect_shown(page, "enrolled")
        await page.evaluate("location.hash = '#/sign-in'")
        await expect_shown(page, "people")
        await hold_to_rules_in_languages(page, "names")
        await page.get_by_test_id("person").filter(has_text="Tom").click()
        await page.set_viewport_size({"width": 800, "height": 1280})
        await hold_to_rules_in_languages(page, "the PIN")
        await page.get_by_test_id("other-person").click()
        await sign_in(page, "Tom")
        await page.get_by_test_id("yes").click()
        await expect_shown(page, "dialog")
        await hold_to_rules_in_languages(page, "a second person")


async def test_a_tablet_waits_its_turn_where_many_sign_in_behind_one_address(tmp_path: Path) -> None:
    path = write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0)
    clock = ServiceClock()
    few = RequestBudget(burst=2.0, rate_hz=1.0, clock=clock)
    async with open_service_with_tablets(
        path, process_double=OneQuestionProcess, clock=ServiceClock(), sign_ins=few
    ) as shared:
        refused: list[str] = []

        def note_refusal(answer: Response) -> None:
            if answer.status == 429:
                refused.append(answer.headers["retry-after"])
                clock.pass_by(1.0)  # the time that the page is asked to wait

        async with shared.browser_context() as context:
            page = await context.new_page()
            page.on("response", note_refusal)
            await shared.enrol_tablet(page, "tablet of Tom")
            await sign_in(page, "Tom")
        assert refused == ["1", "1"]  # the device's proof and the PIN
