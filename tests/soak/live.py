"""What is live on a page, in a real browser: how soon a value is shown that was read, and how soon a tap is computed.

Clocks are of one computer: the cell process says when it sends, and how old each value was then; the page notes when its
text or its picture has it. Drawing is done in software here, so that a tablet is sooner.
"""

import asyncio
import statistics
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from playwright.async_api import Page

from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.browser_pages import go_to_page, wait_for_value
from tests.service.cell_process_session import a_cell
from tests.service.cell_with_history import SPOILT_STEP
from tests.service.past_cell_view import view_past_cell
from tests.service.test_pages import PageViewer, view_service
from tests.service.test_review_pages import plot_points, tap_point
from tests.soak.campaign_figures import CampaignFigures

_TIME_FACTOR = 20.0  # of the fake cell: the arm moves nearly all the time
_WARM_S = 3.0  # a page that was opened just now draws its first pictures
_LEAST_HZ, _FOLLOWED_S, _COMPUTED_S = 8.0, 0.3, 1.0
# Every message as it comes, every text of the gauge, and every posture of the picture as it is drawn.
_LISTEN = """{ const now = () => Date.now() / 1000;
    window.__told = []; window.__gauge = []; window.__drawn = [];
    const Socket = window.WebSocket;
    window.WebSocket = class extends Socket { constructor(...all) { super(...all);
        this.addEventListener('message', (event) => {
            const {kind, content} = JSON.parse(event.data);
            if (kind === 'live') window.__told.push(content); }); } };
    new MutationObserver(() => {
        const text = document.querySelector('[data-testid=gauge] output')?.textContent;
        if (text && text !== window.__gauge.at(-1)?.[0]) window.__gauge.push([text, now()]); })
        .observe(document, {subtree: true, childList: true, characterData: true});
    const look = () => { const first = window.__robot?.joints_rad?.[0];
        if (first !== undefined && first !== window.__drawn.at(-1)?.[0]) window.__drawn.push([first, now()]);
        requestAnimationFrame(look); };
    look(); }"""
# When a tap began, and when its answer was drawn: two frames after the page had it.
_TIMED = """{ document.addEventListener('pointerdown', () => { window.__tapMs = performance.now(); }, true);
    const ask = window.fetch;
    window.fetch = async (...all) => { const answer = await ask(...all);
        if (!String(all[0]).includes('what-if')) return answer;
        const read = answer.json.bind(answer);
        answer.json = async () => { const told = await read();
            const drawn = () => { window.__tookMs = performance.now() - window.__tapMs; };
            requestAnimationFrame(() => requestAnimationFrame(drawn));
            return told; };
        return answer; }; }"""


@dataclass(frozen=True)
class ShownDelays:
    """How long after they were read values were shown [s], and how often [Hz]."""

    late_s: list[float]
    rate_hz: float

    def describe(self) -> str:
        """Return it in words."""
        return f"{_describe_spread(self.late_s)}, {self.rate_hz:.1f} a second"


def live(count: int) -> CampaignFigures:
    """Look for so many seconds at a gauge and at an arm that moves; then tap as many points of a result."""
    with tempfile.TemporaryDirectory() as folder:
        gauge, picture = asyncio.run(_follow_values(Path(folder), float(count)))
    with tempfile.TemporaryDirectory() as folder:
        taps_s = asyncio.run(_tap_points(Path(folder), count))
    line = (
        f"live: U2 a gauge's value is shown after {gauge.describe()} (at least {_LEAST_HZ:g}); U3 "
        f"the picture has the "
        f"joints after {picture.describe()} while the arm moves (at most {_FOLLOWED_S:g} s); U9 "
        f"{len(taps_s)} taps are "
        f"computed and drawn after {_describe_spread(taps_s)} (at most {_COMPUTED_S:g} s)"
    )
    soon = max(picture.late_s) <= _FOLLOWED_S and max(taps_s) <= _COMPUTED_S
    return CampaignFigures(line, gauge.rate_hz >= _LEAST_HZ and soon)


async def _follow_values(folder: Path, span_s: float) -> tuple[ShownDelays, ShownDelays]:
    async with (
        a_cell(folder, time_factor=_TIME_FACTOR) as (path, _),
        view_service(create_app(ServiceSettings(path, open_access=True))) as viewer,
        _moving_arm(viewer),
        viewer.open_page() as page,
    ):
        await page.add_init_script(_LISTEN)
        await page.reload()
        await wait_for_value(lambda: page.evaluate("window.__drawn.length > 0 && window.__gauge.length > 0"))
        await asyncio.sleep(_WARM_S)
        await page.evaluate("{ window.__told = []; window.__gauge = []; window.__drawn = []; }")
        await asyncio.sleep(span_s)
        messages, gauge, drawn = await page.evaluate("[window.__told, window.__gauge, window.__drawn]")
    lengths = [(f"{1e3 * value['length_m']:.2f}", at_s) for value, at_s in _read_values(messages, "gauge")]
    joints = [(value["joints_rad"][0], at_s) for value, at_s in _read_values(messages, "robot")]
    return _match_shown(lengths, gauge, span_s), _match_shown(joints, drawn, span_s)


@asynccontextmanager
async def _moving_arm(viewer: PageViewer) -> AsyncIterator[None]:
    """Take a record again and again, answering what is asked."""

    async def move_arm() -> None:
        while True:
            session = await viewer.read_session()
            run, prompt = session["run"], session["prompt"]
            if run is None:
                await viewer.send_order(
                    op="start", procedure="mastering_record", settings={}, hold_to_move=False
                )
            elif run["outcome"]:
                await viewer.send_order(op="dismiss")
            elif prompt:
                await viewer.send_order(op="answer", prompt_id=prompt["id"], value="yes")
            await asyncio.sleep(0.2)

    task = asyncio.create_task(move_arm())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def _read_values(messages: list[dict[str, Any]], role: str) -> list[tuple[dict[str, Any], float]]:
    """Return the values of a device as they came, and when each was read."""
    found = (
        (each["at_s"], device) for each in messages for device in each["devices"] if device["role"] == role
    )
    return [(device["value"], at_s - device["age_s"]) for at_s, device in found if device["value"]]


def _match_shown(read: list[tuple[Any, float]], shown: list[tuple[Any, float]], span_s: float) -> ShownDelays:
    """Match what was shown with what was read last before it; the same value may come again."""
    late_s = []
    for value, at_s in shown:
        before = [read_s for read_value, read_s in read if read_value == value and read_s <= at_s]
        if before:
            late_s.append(at_s - max(before))
    return ShownDelays(late_s, len(late_s) / span_s)


async def _tap_points(folder: Path, count: int) -> list[float]:
    async with view_past_cell(folder) as (viewer, past), viewer.open_page() as page:
        await page.add_init_script(_TIMED)
        await page.reload()
        await go_to_page(page, f"#/history/{past.spoilt}")
        return [await _tap_reading(page) for _ in range(count)]


async def _tap_reading(page: Page) -> float:
    """Take the same reading out, or put it back; the plot may have been drawn anew."""
    place = int(SPOILT_STEP.split()[1]) - 1
    await page.evaluate("window.__tookMs = null")
    await tap_point(page, (await plot_points(page))[place])
    return float(await wait_for_value(lambda: page.evaluate("window.__tookMs"))) / 1e3


def _describe_spread(found_s: list[float]) -> str:
    return f"{1e3 * statistics.median(found_s):.0f} ms in the median, {1e3 * max(found_s):.0f} ms at most"
