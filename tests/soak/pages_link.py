"""The pages' link broken again and again: how soon a page says so and comes back, and the hold button lets go."""

import asyncio
import tempfile
import time
from pathlib import Path

from playwright.async_api import Page

from tests.service.tablets_at_cell import (
    TabletsAtCell,
    expect_enabled,
    expect_held,
    expect_shown,
    open_tablets_at_cell,
    press_points,
    touch_session,
)
from tests.soak.campaign_figures import CampaignFigures

_HOLE_S = 8.0
_TIME_FACTOR = 8.0  # of the fake cell: moves of a second or so
_NOTICED_S, _BACK_S, _RELEASED_S = 3.0, 2.0, 0.5
_WHEN = """([id, there]) => new Promise((done) => { const look = setInterval(() => {
    if ((document.querySelector(`[data-testid=${id}]`) !== null) !== there) return;
    clearInterval(look); done(Date.now() / 1000); }, 10); })"""


def pages_link(rounds: int) -> CampaignFigures:
    """So many holes of eight seconds while a question is answered, and as many while the button is held."""
    return asyncio.run(_pages_link(rounds))


async def _pages_link(rounds: int) -> CampaignFigures:
    noticed: list[float] = []
    back: list[float] = []
    released: list[float] = []
    once = stood = 0
    with tempfile.TemporaryDirectory() as folder:
        async with open_tablets_at_cell(Path(folder), time_factor=_TIME_FACTOR) as tablets:
            tablets.release_control()
            for number in range(rounds):
                seen_s, back_s, right = await _answer_into_a_hole(tablets, late=number % 2 == 1)
                noticed.append(seen_s)
                back.append(back_s)
                once += right
            for number in range(rounds):
                released_s, still = await _hold_into_a_hole(tablets, late=number % 2 == 1)
                released += released_s
                stood += still
    reached = (
        max(noticed) <= _NOTICED_S and max(back) <= _BACK_S and max(released) <= _RELEASED_S
        and once == stood == rounds
    )  # fmt: skip
    line = (
        f"pages_link: {rounds} holes of {_HOLE_S:g} s: noticed in {max(noticed):.2f} s at most, back in "
        f"{max(back):.2f} s, {once} of {rounds} presses counted once, hold let go in {max(released):.2f} s "
        f"({len(released)} on the way), "
        f"{stood} of {rounds} stood still when the link was back"
    )
    return CampaignFigures(line, reached)


async def _time_until_shown(page: Page, test_id: str, *, there: bool) -> float:
    return float(await page.evaluate(_WHEN, [test_id, there]))


async def _answer_into_a_hole(tablets: TabletsAtCell, *, late: bool) -> tuple[float, float, bool]:
    first = await tablets.first_question()
    page = tablets.tom
    await expect_enabled(page, "yes")
    began_s = time.time()
    tablets.silent_link.break_link(late=late)
    await page.get_by_test_id("yes").click()
    seen_s = await _time_until_shown(page, "offline", there=True) - began_s
    await asyncio.sleep(max(began_s + _HOLE_S - time.time(), 0.0))
    healed_s = time.time()
    tablets.silent_link.mend_link()
    back_s = await _time_until_shown(page, "offline", there=False) - healed_s
    session = await tablets.wait_until(lambda session: session["prompt"]["id"] != first["id"])
    await page.locator(f"[data-testid=prompt][data-key={session['prompt']['key']}]").wait_for()
    await asyncio.sleep(1.0)
    return seen_s, back_s, tablets.answered_once_since(first)


async def _hold_into_a_hole(tablets: TabletsAtCell, *, late: bool) -> tuple[list[float], bool]:
    await tablets.waits_for_hold()
    page = tablets.tom
    await expect_enabled(page, "hold")
    fingers, at = await touch_session(page)
    await press_points(fingers, at)
    await expect_held(page)
    moving = await tablets.wait_until(lambda session: not session["waits_for_hold"])
    began_s = time.time()
    tablets.silent_link.break_link(late=late)
    stopped = await tablets.wait_until(lambda session: session["waits_for_hold"])
    released_s = time.time() - began_s
    on_the_way = stopped["run"]["found"] == moving["run"]["found"]  # or it had arrived, and measured first
    await asyncio.sleep(max(began_s + _HOLE_S - time.time(), 0.0))
    tablets.silent_link.mend_link()
    await expect_shown(page, "offline", there=False)
    await tablets.wait_for_standstill()
    await press_points(fingers, kind="touchEnd")
    return [released_s] if on_the_way else [], True
