"""Two tablets at one run: how soon the other one sees a step, and both see a stopped robot; no press counts twice."""

import asyncio
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from playwright.async_api import Page

from tests.service.tablets_at_cell import TabletsAtCell, expect_enabled, expect_shown, open_tablets_at_cell
from tests.soak.campaign_figures import CampaignFigures

_TIME_FACTOR = 8.0
_SEEN_S = _BANNER_S = 0.5
_WHEN = """([what, there]) => new Promise((done) => { const look = () => {
    if ((document.querySelector(what) !== null) !== there) return false;
    done(Date.now() / 1000); return true; };
    if (look()) return;
    const watch = new MutationObserver(() => look() && watch.disconnect());
    watch.observe(document, {subtree: true, childList: true, attributes: true}); })"""


def two_tablets(rounds: int) -> CampaignFigures:
    """Answer so many questions with double taps, and stop the robot as often."""
    return asyncio.run(_two_tablets(rounds))


async def _two_tablets(rounds: int) -> CampaignFigures:
    steps, banners, once = list[float](), list[float](), 0
    with tempfile.TemporaryDirectory() as folder:
        async with open_tablets_at_cell(Path(folder), time_factor=_TIME_FACTOR) as tablets:
            tablets.release_control()
            for _ in range(rounds):
                seen_s, right = await _answer_question(tablets)
                steps.append(seen_s)
                once += right
            await tablets.no_run()
            for _ in range(rounds):
                banners += await _stop_robot(tablets)
    line = (
        f"two_tablets: {rounds} double taps on one tablet, each one record in {once} cases; the other one sees the "
        f"next step after {_describe_spread(steps)} (at most {_SEEN_S:g} s); {rounds} emergency "
        f"stops are on both after "
        f"{_describe_spread(banners)} (at most {_BANNER_S:g} s)"
    )
    return CampaignFigures(line, max(steps) <= _SEEN_S and max(banners) <= _BANNER_S and once == rounds)


def _describe_spread(found_s: list[float]) -> str:
    ordered = sorted(found_s)
    return f"{ordered[len(ordered) // 2]:.2f} s in the median, {ordered[-1]:.2f} s at most"


async def _times_when(
    pages: tuple[Page, ...], what: str, there: bool, act: Callable[[], Any]
) -> tuple[float, list[float]]:
    """Watch pages, act; return when that was and when each page had what it waits for (one clock) [s]."""
    watching = [asyncio.create_task(page.evaluate(_WHEN, [what, there])) for page in pages]
    await asyncio.sleep(0.2)  # until all watch
    began_s = time.time()
    await act()
    return began_s, [float(await each) for each in watching]


async def _answer_question(tablets: TabletsAtCell) -> tuple[float, bool]:
    first = await tablets.first_question()
    for page in (tablets.tom, tablets.tina):
        await page.locator(f"[data-testid=prompt][data-key={first['key']}]").wait_for()
    await expect_enabled(tablets.tom, "yes")
    box = await tablets.tom.get_by_test_id("yes").bounding_box()
    assert box is not None
    at = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    following = f"[data-testid=prompt]:not([data-key={first['key']}])"
    began_s, (shown_s,) = await _times_when(
        (tablets.tina,), following, True, lambda: tablets.tom.mouse.dblclick(*at)
    )
    await asyncio.sleep(1.0)  # a second answer would have arrived
    return shown_s - began_s, tablets.answered_once_since(first)


async def _stop_robot(tablets: TabletsAtCell) -> list[float]:
    both = (tablets.tom, tablets.tina)
    try:
        began_s, shown_s = await _times_when(
            both, "[data-testid=stopped][role=alert]", True,
            lambda: tablets.fake_client.inject_fault("emergency_stop", device="fanuc"),
        )  # fmt: skip
    finally:
        for mended in ("release_emergency_stop", "press_reset"):
            await tablets.fake_client.inject_fault(mended, device="fanuc")
    for page in both:
        await expect_shown(page, "stopped", there=False)
    return [each_s - began_s for each_s in shown_s]
