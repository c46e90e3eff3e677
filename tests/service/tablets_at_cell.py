"""Two tablets in front of the fake cell, and ways to bring a run where a test begins."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

from playwright.async_api import CDPSession, Page, expect

from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.service.browser_pages import PATIENCE_S
from tests.service.cell_process_session import a_cell
from tests.service.service_client import ServiceClock
from tests.service.service_with_tablets import ServiceWithTablets, open_service_with_tablets
from tests.service.silent_link import SilentLink, open_silent_link
from tests.wire.driver_cases import wait_until


class TabletsAtCell(ServiceWithTablets):
    """The shop with its fake cell, and ways to bring a run where a test begins."""

    fake_client: FakeCellClient
    silent_link: SilentLink
    tom: Page  # behind a link that can be broken, with a screen to touch
    tina: Page

    async def send_order(self, **order: Any) -> None:
        """Give an order past the pages, in no person's name."""
        link = self.app.state.context.link
        async with asyncio.timeout(PATIENCE_S):
            while True:
                rev = link.session["rev"]
                answer = await link.send_order({"id": uuid4().hex, "rev": rev, "who": "test", "order": order})
                if answer.get("code") != "desk.stale":
                    assert answer["ok"], answer
                    return

    async def no_run(self) -> None:
        """Leave whatever the test before left."""
        session = await self.wait_until(lambda session: session["connection"]["connected"])
        if session["run"] is not None:
            await self.send_order(op="stop")
            await self.wait_until(lambda session: session["run"]["outcome"])
            await self.send_order(op="dismiss")
        await self.wait_until(lambda session: session["run"] is None)

    async def first_question(self) -> dict[str, Any]:
        """Begin a run that asks one thing after the other; return its first question."""
        await self.no_run()
        await self.send_order(
            op="start", procedure="six_point_tcp", settings={"tool_number": 1}, hold_to_move=True
        )
        return dict((await self.wait_until(lambda session: session["prompt"]))["prompt"])

    async def waits_for_hold(self) -> None:
        """Bring a run to a move that waits for the button; one that is there already will do, plans cost."""
        session = self.last_session()
        if session is not None and session["waits_for_hold"]:
            return
        await self.no_run()
        await self.send_order(op="start", procedure="mastering_record", settings={}, hold_to_move=True)
        while not (session := await self.wait_until(lambda s: s["prompt"] or s["waits_for_hold"]))[
            "waits_for_hold"
        ]:
            await self.send_order(op="answer", prompt_id=session["prompt"]["id"])

    def answered_once_since(self, first: dict[str, Any]) -> bool:
        """Whether the question shown is the very next one."""
        session = self.last_session()
        assert session is not None
        now, before = (int(prompt["id"].rpartition(":")[2]) for prompt in (session["prompt"], first))
        return now == before + 1

    async def _stays(self) -> bool:
        """Tell whether the motors count the same for a while."""
        before = (await self.fake_client.read_truth())["robots"]["fanuc"]["counts_read"]
        await asyncio.sleep(0.3)
        return bool((await self.fake_client.read_truth())["robots"]["fanuc"]["counts_read"] == before)

    async def wait_for_standstill(self) -> None:
        """Wait until the move waits for the button again, and see that the robot stays where it is."""
        await self.wait_until(lambda session: session["waits_for_hold"])
        await wait_until(self._stays)  # it brakes, and a move that was just ordered is taken back
        assert await self._stays()
        session = self.last_session()
        assert session is not None
        assert session["waits_for_hold"]


@asynccontextmanager
async def open_tablets_at_cell(folder: Path, *, time_factor: float = 20.0) -> AsyncIterator[TabletsAtCell]:
    """Open a shop over the fake cell, with Tom's tablet behind a link that can be broken and Tina's beside it."""
    async with AsyncExitStack() as stack:
        path, fake_client = await stack.enter_async_context(a_cell(folder, time_factor=time_factor))
        tablet_service = await stack.enter_async_context(
            open_service_with_tablets(path, clock=ServiceClock())
        )
        silent_link = await stack.enter_async_context(open_silent_link(tablet_service.port))
        tom = await stack.enter_async_context(
            tablet_service.signed_in_tablet("Tom", port=silent_link.port, has_touch=True)
        )
        tina = await stack.enter_async_context(tablet_service.signed_in_tablet("Tina"))
        tablets = TabletsAtCell(
            tablet_service.app,
            tablet_service.authenticator,
            tablet_service.port,
            tablet_service.browser,
            tablet_service.complaints,
        )
        tablets.fake_client, tablets.silent_link, tablets.tom, tablets.tina = (
            fake_client,
            silent_link,
            tom,
            tina,
        )
        yield tablets


async def expect_shown(page: Page, test_id: str, *, there: bool = True) -> None:
    found = expect(page.get_by_test_id(test_id))
    await (found.to_be_visible() if there else found.to_have_count(0))


async def expect_enabled(page: Page, test_id: str, *, be_pressed: bool = True) -> None:
    found = expect(page.get_by_test_id(test_id))
    await (found.to_be_enabled if be_pressed else found.to_be_disabled)()


async def touch_session(page: Page) -> tuple[CDPSession, dict[str, float]]:
    await page.get_by_test_id("hold").scroll_into_view_if_needed()
    fingers = await page.context.new_cdp_session(page)
    box = await page.get_by_test_id("hold").bounding_box()
    assert box is not None
    return fingers, {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2, "id": 1.0}


async def press_points(fingers: CDPSession, *points: dict[str, float], kind: str = "touchStart") -> None:
    await fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": list(points)})


async def expect_held(page: Page, *, yes: bool = True) -> None:
    await page.locator(f"[data-testid=hold][aria-pressed={str(yes).lower()}]").wait_for()
