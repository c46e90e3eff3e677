"""The picture of the cell in a real browser: plans as ghosts, the wire, frames, the doubt about the tool."""

import asyncio
import json
from collections.abc import AsyncIterator
from typing import Any

import httpx
import numpy as np
import pytest
import pytest_asyncio
from playwright.async_api import Page, WebSocketRoute, expect

from cellcal.calibration.arm.kinematics import load_model
from tests.service.browser_pages import at_rest, unfold, wait_for_value
from tests.service.cell_with_history import ROBOT, PastRuns
from tests.service.past_cell_view import view_past_cell
from tests.service.test_pages import NO_WEBGL, PageViewer

pytestmark = pytest.mark.asyncio(loop_scope="module")
POSES: list[dict[str, Any]] = [
    {"name": f"pose {k}", "joints_rad": [0.2 * k, 0.1, -0.1 * k, 0.3, 0.5, 0.0]} for k in range(1, 5)
]
PLAN = {
    "id": "r:1", "kind": "confirm", "key": "accept_plan", "text": "May it move?", "unit": "",
    "step": "accept the plan", "page": "approve", "data": {"plan": {"poses": POSES}},
}  # fmt: skip

ViewedRuns = tuple[PageViewer, PastRuns]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def picture_view(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[ViewedRuns]:
    async with view_past_cell(tmp_path_factory.mktemp("cell")) as found:
        yield found


async def wait_for_picture(page: Page, what: str) -> Any:
    """Return something of the picture once it is there."""
    return await wait_for_value(
        lambda: page.evaluate(f"window.__robot?.frames ? window.__robot.{what} : null")
    )


async def feed_question(
    page: Page, prompt: dict[str, Any] | None, change: Any = None
) -> list[WebSocketRoute]:
    """Put a question into every session that the page is told, and change live values on their way."""
    lines: list[WebSocketRoute] = []

    def forward_messages(line: WebSocketRoute) -> None:
        server = line.connect_to_server()
        lines.append(line)

        def change_message(message: str | bytes) -> None:
            content = json.loads(message)
            if content["kind"] == "session" and prompt is not None:
                content["content"]["prompt"] = prompt
            if content["kind"] == "live" and change is not None:
                change(content["content"])
            line.send(json.dumps(content))

        server.on_message(change_message)

    await page.route_web_socket("**/api/screen", forward_messages)
    return lines


def flange_of(joints_rad: list[float]) -> np.ndarray:
    return np.asarray(load_model("fanuc_m6ib").base_flange(np.array([joints_rad]))[0][:3, 3])


async def test_every_planned_pose_is_a_ghost_where_the_model_has_it(picture_view: ViewedRuns) -> None:
    async with picture_view[0].open_page() as page:
        await feed_question(page, PLAN)
        await page.reload()
        ghosts = await wait_for_picture(page, "ghosts")
        assert [ghost["name"] for ghost in ghosts] == [pose["name"] for pose in POSES]
        for ghost, pose in zip(ghosts, POSES, strict=True):
            assert np.abs(np.array(ghost["flange_m"]) - flange_of(pose["joints_rad"])).max() < 1e-4
        bar = page.get_by_test_id("ghosts")
        await expect(bar).to_contain_text("pose 1")
        await bar.locator("button").last.click()
        await expect(bar).to_contain_text("pose 2")


async def test_without_a_plan_there_is_no_ghost(picture_view: ViewedRuns) -> None:
    async with picture_view[0].open_page() as page:
        await wait_for_picture(page, "joints_rad")
        await at_rest(page)
        assert await page.evaluate("window.__robot.ghosts") == []
        await expect(page.get_by_test_id("ghosts")).to_have_count(0)


async def test_the_wire_goes_from_its_anchor_to_the_hook(picture_view: ViewedRuns) -> None:
    viewer, past = picture_view
    setup = past.config.gauges[0].setup
    async with viewer.open_page() as page:
        anchor, hook = await wait_for_picture(page, "wire_m")
        joints = await page.evaluate("window.__robot.joints_rad")
        flange = load_model("fanuc_m6ib").base_flange(np.array([joints]))[0]
        expected_hook = flange[:3, :3] @ np.array(setup.hook_in_flange_m) + flange[:3, 3]
        assert np.abs(np.array(anchor) - setup.anchor_in_base_m).max() < 1e-9
        assert np.abs(np.array(hook) - expected_hook).max() < 1e-4


async def test_frames_are_named_and_the_doubt_is_drawn_to_a_stated_scale(picture_view: ViewedRuns) -> None:
    viewer, _ = picture_view
    async with viewer.open_page() as page:
        ellipsoid = await wait_for_picture(page, "ellipsoid")
        axes = ["base", "tool 3", "user frame 2"]
        await wait_for_value(
            lambda: page.evaluate("window.__robot.axes"), lambda uncertainty: uncertainty == axes
        )
        joints = ",".join(str(q) for q in await page.evaluate("window.__robot.joints_rad"))
        uncertainty = (await viewer.client.get(f"/api/models/{ROBOT}/uncertainty?joints_rad={joints}")).json()
        assert np.allclose(ellipsoid["semi_axes_m"], uncertainty["semi_axes_m"], rtol=0.02)
        drawn_m = max(ellipsoid["semi_axes_m"]) * ellipsoid["times"]
        assert 0.1 <= drawn_m <= 0.25
        legend = page.get_by_test_id("legend")
        await unfold(legend)
        await expect(page.get_by_test_id("doubt")).to_contain_text(
            f"{max(uncertainty['semi_axes_m']) * 1e3:.3f}"
        )
        await expect(page.get_by_test_id("doubt")).to_contain_text(f"{ellipsoid['times']:g} times")
        await expect(legend).to_contain_text("floor")  # from the cell file


async def test_the_picture_follows_a_moving_arm_twelve_times_a_second_at_most(
    picture_view: ViewedRuns,
) -> None:
    turned = 0.0

    def turn_joint(live: dict[str, Any]) -> None:
        nonlocal turned
        turned += 0.01
        for device in live["devices"]:
            if device["role"] == "robot" and device["value"]:
                device["value"]["joints_rad"] = [turned, *device["value"]["joints_rad"][1:]]

    async with picture_view[0].open_page() as page:
        await feed_question(page, None, turn_joint)
        await page.reload()
        await wait_for_picture(page, "joints_rad")
        before, at = await page.evaluate("[window.__robot.frames, performance.now()]")
        while turned < 0.5:
            await asyncio.sleep(0.1)
        await wait_for_value(lambda: page.evaluate("window.__robot.frames"), lambda frames: frames > before)
        after, then = await page.evaluate("[window.__robot.frames, performance.now()]")
        assert after <= before + 12.0 * (then - at) / 1000.0 + 1
        await wait_for_value(  # a few messages behind at most, once this computer lets it
            lambda: page.evaluate("window.__robot.joints_rad[0]"), lambda at: abs(at - turned) < 0.05
        )


@pytest.mark.parametrize(
    ("renderer", "smooth", "most_hz"),
    [("ANGLE (Google, Vulkan 1.3 (SwiftShader Device))", False, 3.0), ("ANGLE (Intel, Iris Xe)", True, 12.0)],
)
async def test_a_picture_that_the_processor_computes_is_drawn_plainly(
    picture_view: ViewedRuns, renderer: str, smooth: bool, most_hz: float
) -> None:
    script = f"""{{ const getParameter = WebGL2RenderingContext.prototype.getParameter;
        WebGL2RenderingContext.prototype.getParameter = function (name) {{
            return name === 0x9246 ? {json.dumps(renderer)} : getParameter.call(this, name); }} }}"""
    async with picture_view[0].open_page() as page:
        await page.add_init_script(script)
        await page.reload()
        await wait_for_picture(page, "joints_rad")
        is_smooth, rate_hz = await page.evaluate(
            """() => [document.querySelector('canvas').getContext('webgl2').getContextAttributes().antialias,
                window.__robot.most_hz]"""
        )
        assert is_smooth is smooth
        assert rate_hz == pytest.approx(most_hz)


async def test_without_webgl_frames_and_doubt_are_words(picture_view: ViewedRuns) -> None:
    async with picture_view[0].open_page() as page:
        await page.add_init_script(NO_WEBGL)
        await page.reload()
        await page.get_by_test_id("joints").locator("dd").nth(5).wait_for()
        await unfold(page.get_by_test_id("legend"))
        await expect(page.get_by_test_id("doubt")).to_contain_text("mm")
        await expect(page.get_by_test_id("legend")).to_contain_text("tool 3")


async def test_what_a_broken_plan_holds_is_not_drawn(picture_view: ViewedRuns) -> None:
    bad = PLAN | {
        "data": {"plan": {"poses": [{"name": "x"}, {"name": "y", "joints_rad": [None] * 6}, POSES[0]]}}
    }
    async with picture_view[0].open_page() as page:
        await feed_question(page, bad)
        await page.reload()
        assert [ghost["name"] for ghost in await wait_for_picture(page, "ghosts")] == ["pose 1"]


async def test_another_robot_has_another_picture_and_nothing_known_of_its_tool(
    picture_view: ViewedRuns,
) -> None:
    answer: httpx.Response = await picture_view[0].client.get("/api/models/ur/frames")
    assert answer.json() == []
