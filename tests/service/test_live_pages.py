"""What live values show: each as it comes, none that is old, and a device panel that says what is wrong."""

import re
from collections.abc import AsyncIterator
from typing import Any

import numpy as np
import pytest
import pytest_asyncio
from playwright.async_api import expect

from tests.service.browser_pages import go_to_page, hold_to_rules, wait_for_value
from tests.service.test_pages import PageViewer, view_cell
from tests.service.test_view3d import feed_question

pytestmark = pytest.mark.asyncio(loop_scope="module")
CAPTURE = {
    "id": "r:1", "kind": "confirm", "key": "move_by_hand", "text": "Bring the arm to pose 1.", "unit": "",
    "step": "capture 1", "page": "capture", "data": {},
}  # fmt: skip
# Every text that the gauge shows from now on.
WATCH = """() => { window.__lengths = [];
    const shown = document.querySelector('[data-testid=prompt] [data-testid=gauge] output');
    new MutationObserver(() => window.__lengths.push(shown.textContent))
        .observe(shown, {subtree: true, childList: true, characterData: true}); }"""

# A screen that says which locks were asked for: the browser takes one back when its page is hidden.
WAKE = """{ window.__locks = [];
    const request = async (kind) => {
        const lock = {kind, released: false, release: async () => { lock.released = true; }};
        document.addEventListener('visibilitychange', () => { lock.released ||= document.hidden; });
        window.__locks.push(lock); return lock; };
    Object.defineProperty(Navigator.prototype, 'wakeLock', {value: {request}, configurable: true}); }"""
NO_WAKE = {
    "unknown": "Object.defineProperty(Navigator.prototype, 'wakeLock', {value: undefined})",
    "refused": """Object.defineProperty(Navigator.prototype, 'wakeLock', {value: {request: async () => {
        window.__refused = (window.__refused ?? 0) + 1; throw new DOMException('low', 'NotAllowedError'); }}})""",
}
UNRELEASED_LOCKS = "window.__locks.filter(lock => !lock.released).map(lock => lock.kind)"
HIDDEN = """(hidden) => { Object.defineProperty(document, 'hidden', {value: hidden, configurable: true});
    document.dispatchEvent(new Event('visibilitychange')); }"""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def page_viewer(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[PageViewer]:
    async with view_cell(tmp_path_factory.mktemp("cell")) as viewer:
        yield viewer


def gauge_of(live: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = next(device for device in live["devices"] if device["role"] == "gauge")
    return found


async def test_every_live_value_is_shown_and_none_that_is_old(page_viewer: PageViewer) -> None:
    """U2: the service tells ten values a second; the page shows each, and two dashes when no more come."""
    live_values: list[str] = []
    silent = False

    def note_value(live: dict[str, Any]) -> None:
        gauge = gauge_of(live)
        if silent:
            gauge["age_s"] = 60.0
        else:
            live_values.append(f"{1000.0 + len(live_values):.2f}")
            gauge |= {"value": {"length_m": float(live_values[-1]) * 1e-3}, "age_s": 0.0}

    await page_viewer.send_order(op="start", procedure="mastering_record", settings={}, hold_to_move=False)
    await page_viewer.wait_until(lambda session: session["prompt"])
    async with page_viewer.open_page() as page:
        await feed_question(page, CAPTURE, note_value)
        await page.reload()
        gauge = page.get_by_test_id("prompt").get_by_test_id("gauge")
        await expect(gauge).to_have_attribute("data-stale", "false")
        await page.evaluate(WATCH)

        async def lengths() -> list[str]:
            shown: list[str] = await page.evaluate("window.__lengths")
            return [text for text in shown if text != "--"]  # this computer may be late

        shown = await wait_for_value(lengths, lambda shown: len(shown) >= 50)
        first = live_values.index(shown[0])
        missed = set(live_values[first : live_values.index(shown[-1])]) - set(shown)
        assert len(missed) <= len(shown) // 5, missed  # two that come at once are drawn as one
        silent = True
        await expect(gauge).to_have_attribute("data-stale", "true")
        await expect(gauge.locator("output")).to_have_text("--")
        await expect(page.get_by_test_id("yes")).to_be_disabled()
    await page_viewer.send_order(op="stop")
    await page_viewer.wait_until(lambda session: session["run"]["outcome"])
    await page_viewer.send_order(op="dismiss")


async def test_the_panel_says_of_each_device_what_it_is_and_what_is_wrong(page_viewer: PageViewer) -> None:
    """U23: state, age, what it said last, and when its calibration is due, by a word where it was."""
    changed: dict[str, Any] = {"due": "2999-12-31"}
    async with page_viewer.open_page() as page:
        await feed_question(page, None, lambda live: gauge_of(live).update(changed))
        await page.reload()
        await go_to_page(page, "#/devices")
        for role in ("robot", "gauge"):
            panel = page.get_by_test_id(f"panel-{role}")
            await expect(panel).to_have_attribute("data-state", "ready")
            await expect(panel).to_contain_text(re.compile(r"\d+\.\d s"))
        due = page.get_by_test_id("due-gauge")
        await expect(due).to_contain_text("2999")
        await expect(due).to_have_attribute("data-lapsed", "false")
        changed |= {
            "due": "2020-01-31", "state": "unreachable", "age_s": 60.0,
            "message": "wire: nothing is heard of it.", "remedy": "Look at its cable.",
        }  # fmt: skip
        panel = page.get_by_test_id("panel-gauge")
        await expect(due).to_have_attribute("data-lapsed", "true")
        await expect(due).to_contain_text("✗")
        await expect(panel).to_have_attribute("data-state", "unreachable")
        for words in ("nothing is heard of it", "Look at its cable"):
            await expect(panel).to_contain_text(words)
        await hold_to_rules(page, "a device that is wrong")


async def test_the_picture_has_the_joints_that_the_service_tells(page_viewer: PageViewer) -> None:
    """U3: joint by joint, to a thousandth of a radian."""
    joint_messages: list[list[float]] = []

    def note_joints(live: dict[str, Any]) -> None:
        joint_messages.extend(
            d["value"]["joints_rad"] for d in live["devices"] if d["role"] == "robot" and d["value"]
        )

    async with page_viewer.open_page() as page:
        await feed_question(page, None, note_joints)
        await page.reload()
        await wait_for_value(
            lambda: page.evaluate("window.__robot?.joints_rad ?? null"),
            lambda value: (
                value and joint_messages and np.allclose(value, joint_messages[-1], rtol=0.0, atol=1e-3)
            ),
        )
        assert np.abs(joint_messages[-1]).max() > 0.01  # not the posture in which every arm is drawn first


async def test_the_screen_stays_on_while_a_run_goes_on_and_no_longer(page_viewer: PageViewer) -> None:
    async with page_viewer.open_page() as page:
        await page.add_init_script(WAKE)
        await page.reload()
        await page.get_by_test_id("device-robot").wait_for()

        async def read_wake_locks() -> list[str]:
            found: list[str] = await page.evaluate(UNRELEASED_LOCKS)
            return found

        assert await page.evaluate("window.__locks") == []
        await page_viewer.send_order(
            op="start", procedure="mastering_record", settings={}, hold_to_move=False
        )
        await page.get_by_test_id("prompt").wait_for()
        await wait_for_value(read_wake_locks, lambda kinds: kinds == ["screen"])
        await go_to_page(page, "#/history")  # whatever is looked at meanwhile
        await page.evaluate(HIDDEN, True)
        assert await read_wake_locks() == []
        await page.evaluate(HIDDEN, False)
        await wait_for_value(read_wake_locks, lambda kinds: kinds == ["screen"])
        await page_viewer.send_order(op="stop")
        await wait_for_value(read_wake_locks, lambda kinds: not kinds)
        await page.evaluate(HIDDEN, True)
        await page.evaluate(HIDDEN, False)
        assert await read_wake_locks() == []  # the page of a run that has ended keeps nothing on
        await page_viewer.send_order(op="dismiss")


@pytest.mark.parametrize("how", NO_WAKE)
async def test_a_browser_that_cannot_keep_its_screen_on_runs_as_any_other(
    page_viewer: PageViewer, how: str
) -> None:
    async with page_viewer.open_page() as page:
        await page.add_init_script(NO_WAKE[how])
        await page_viewer.send_order(
            op="start", procedure="mastering_record", settings={}, hold_to_move=False
        )
        await page.reload()
        await page.get_by_test_id("prompt").wait_for()
        if how == "refused":
            await wait_for_value(lambda: page.evaluate("window.__refused"), lambda times: times == 1)
            await page.evaluate(HIDDEN, False)
            await wait_for_value(lambda: page.evaluate("window.__refused"), lambda times: times == 2)
        await page_viewer.send_order(op="stop")
        await page_viewer.wait_until(lambda session: session["run"]["outcome"])
        await page_viewer.send_order(op="dismiss")
