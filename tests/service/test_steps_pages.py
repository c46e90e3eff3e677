"""Every kind of step in a real browser over the fake cell: what is refused, and what is shown beforehand.

One browser, one cell and one service serve most of them, one after the other.
"""

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
import pytest_asyncio
from playwright.async_api import Browser, Page, expect

from tests.service.browser_pages import (
    CHOOSE,
    at_rest,
    hold_to_rules_in_languages,
    layout_faults,
    open_chromium,
    unfold,
    wait_for_language,
    wait_for_value,
)
from tests.service.step_page_actions import (
    TIP_IN_FLANGE_M,
    FakePendant,
    at_the_pages,
    let_go_early,
    record_step,
    tip_at_home,
    turn_about,
    wait_for_question,
    wait_for_reason,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")
TILT = 45.0
STEPS = ("ask", "teach", "review", "approve", "capture")  # kinds that are shot here
# what a browser answers where no camera is
NO_CAMERA = """() => { navigator.mediaDevices.getUserMedia =
    () => Promise.reject(new DOMException("Requested device not found", "NotFoundError")); }"""
# whether the step that is current is seen in the list of steps, which scrolls
IN_ITS_LIST = """line => {
    const list = line.parentElement.getBoundingClientRect(), at = line.getBoundingClientRect();
    return at.top >= list.top && at.bottom <= list.bottom; }"""
FRAME = {"frame_number": 3, "tip_in_flange_m": TIP_IN_FLANGE_M.tolist(), "check_above": True}


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def pendant(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[FakePendant]:
    async with at_the_pages(tmp_path_factory.mktemp("steps")) as found:
        yield found


@asynccontextmanager
async def a_run(
    pendant: FakePendant,
    procedure: str,
    *,
    hold: bool = False,
    browser: Browser | None = None,
    **settings: object,
) -> AsyncIterator[Page]:
    """Start a run and look at it; end it afterwards, whatever came of it."""
    viewer = pendant.viewer
    pendant.release_control()
    async with viewer.open_page(browser=browser) as page:
        await viewer.send_order(op="start", procedure=procedure, settings=settings, hold_to_move=hold)
        try:
            yield page
        finally:
            if (await viewer.read_session())["run"]["outcome"] is None:
                await viewer.send_order(op="stop")
                await viewer.wait_until(lambda session: session["run"]["outcome"])
            await viewer.send_order(op="dismiss")


async def _save_screenshots(page: Page, folder: Path, name: str) -> None:
    """Keep what a page looks like, lying and standing, and hold it to the rules for every page."""
    for width, height in ((1280, 800), (800, 1280)):
        await page.set_viewport_size({"width": width, "height": height})
        await page.screenshot(path=folder / f"{name}_{width}.png")
    await _fits_a_telephone(page, name)
    await page.set_viewport_size({"width": 1280, "height": 800})
    await hold_to_rules_in_languages(page, name)
    if name in STEPS:
        await _tells_one_thing(page)


async def _fits_a_telephone(page: Page, name: str) -> None:
    """See that nothing is wider than a telephone in German, whose words are the longest."""
    await page.set_viewport_size({"width": 390, "height": 844})
    choice = page.get_by_test_id("language")
    for locale in ("de", "en"):
        await page.evaluate(CHOOSE, [await choice.element_handle(), locale])
        await wait_for_language(page, locale)
        await at_rest(page)
        assert not await layout_faults(page), (name, locale)


async def _tells_one_thing(page: Page) -> None:
    """See that a step has one title, one instruction, and a picture that is there and said in words."""
    step = page.get_by_test_id("prompt")
    await expect(step.locator("h2")).to_have_count(1)
    await expect(step.get_by_test_id("instruction")).to_have_count(1)
    await expect(step.locator(".first")).to_have_text(re.compile(r"\w"))
    picture = step.get_by_role("img").first
    await expect(picture).to_have_attribute("aria-label", re.compile(r"\w"))
    await wait_for_value(lambda: picture.evaluate("seen => seen.firstElementChild.getBBox().width"))


async def test_a_tool_is_taught_and_nothing_is_recorded_that_tells_nothing(
    pendant: FakePendant, tmp_path: Path
) -> None:
    """U1, U4, U13: attitudes are refused before they are recorded; old and new before two seconds of a press."""
    pin = tip_at_home()
    async with a_run(pendant, "six_point_tcp", tool_number=3, method="four_point") as page:
        await wait_for_question(page, "pin_is_fixed")
        await _save_screenshots(page, tmp_path, "ask")
        await expect(page.locator("[aria-current=step]")).to_have_count(1)
        await page.evaluate("scrollTo(0, document.body.scrollHeight)")
        await expect(page.locator("main h1")).not_to_be_in_viewport()
        await record_step(page)
        await expect(page.locator("main h1")).to_be_in_viewport()  # what is asked next is read from its head
        await pendant.touch_point(pin, np.eye(3))
        await wait_for_reason(page, "")
        await record_step(page)  # the first touch

        await pendant.touch_point(pin, turn_about("x", 5.0))
        await wait_for_reason(page, "tcp.spread_low")
        await expect(page.get_by_test_id("yes")).to_be_disabled()
        spread = page.locator("[data-figure=spread]")
        await wait_for_value(
            lambda: spread.get_attribute("data-value"),
            lambda value: np.isclose(float(value or 0), np.radians(5.0), atol=1e-3),
        )
        await _save_screenshots(page, tmp_path, "teach_refused")
        session = await pendant.viewer.read_session()
        press = {"op": "answer", "prompt_id": session["prompt"]["id"], "value": "yes"}
        early = {"id": "too early", "rev": session["rev"], "order": press}
        refused = await pendant.viewer.client.post("/api/commands", json=early)
        assert (refused.status_code, refused.json()["code"]) == (409, "tcp.spread_low")

        await pendant.touch_point(pin, turn_about("z", 60.0))
        await wait_for_reason(page, "")  # two touches never fix a tip: a roll is as good as any turn
        await record_step(page)
        await pendant.touch_point(pin, turn_about("z", -60.0))
        await wait_for_reason(page, "tcp.one_axis")
        await expect(page.get_by_test_id("yes")).to_be_disabled()

        await page.reload()
        await expect(page.get_by_test_id("points").locator("[data-state=recorded]")).to_have_count(2)
        await expect(page.locator("[aria-current=step]")).to_have_count(1)
        await pendant.touch_point(pin, turn_about("x", TILT))
        await wait_for_reason(page, "")
        await expect(page.locator("[data-figure=tip_u]")).to_be_visible()
        await _save_screenshots(page, tmp_path, "teach")
        await record_step(page)
        for axis, degrees in (("y", TILT), ("x", -TILT), ("y", -TILT), ("x", 30.0)):
            if await _is_asked(page, "accept_tool"):
                break
            await pendant.touch_point(pin, turn_about(axis, degrees))
            await wait_for_reason(page, "")
            await record_step(page)

        await wait_for_question(page, "accept_tool")
        await page.get_by_test_id("review-changes").wait_for()
        assert await page.locator("[aria-current=step]").evaluate(IN_ITS_LIST)
        await _save_screenshots(page, tmp_path, "review")
        await expect(page.get_by_test_id("displacement")).to_contain_text("mm")
        await expect(page.get_by_test_id("review-changes").locator("tbody tr")).to_have_count(4)
        await let_go_early(page)  # a short press writes nothing
        assert (await pendant.viewer.read_session())["prompt"]["key"] == "accept_tool"
        await page.get_by_test_id("yes").hover()
        await page.mouse.down()
        await page.get_by_test_id("outcome").wait_for()
        await page.mouse.up()
        outcome = (await pendant.viewer.read_session())["run"]["outcome"]
        assert outcome["verdict"] == "passed"
        judged = [one for one in outcome["judgement"]["characteristics"] if one["decision"]]
        assert judged
        await expect(page.get_by_test_id("outcome").locator("tbody tr")).to_have_count(len(judged))
        await _save_screenshots(page, tmp_path, "ended")
        found = outcome["result"]["flange_tool"]["position_m"]
        assert np.allclose(found, TIP_IN_FLANGE_M, atol=2e-3)


async def _is_asked(page: Page, key: str) -> bool:
    await page.get_by_test_id("prompt").wait_for()
    return await page.get_by_test_id("prompt").get_attribute("data-key") == key


async def test_points_that_make_no_frame_are_refused(pendant: FakePendant, tmp_path: Path) -> None:
    """U5: too close, on one line, below the plane; a short base is warned of."""
    origin = tip_at_home()
    attitude = np.eye(3)

    async def touch_at(x: float, y: float, z: float) -> None:
        await pendant.touch_point(origin + np.array([x, y, z]), attitude)

    async with a_run(pendant, "three_point_frame", **FRAME) as page:
        await wait_for_question(page, "pointer_is_mounted")
        await record_step(page)
        await touch_at(0.0, 0.0, 0.0)
        await wait_for_question(page, "touch_origin")
        await record_step(page)
        await wait_for_question(page, "touch_on_x")
        await touch_at(0.008, 0.0, 0.0)
        await wait_for_reason(page, "frame.points_close")
        await expect(page.get_by_test_id("yes")).to_be_disabled()
        await touch_at(0.08, 0.0, 0.0)
        await expect(page.get_by_test_id("warning")).to_be_visible()
        await expect(page.get_by_test_id("yes")).to_be_enabled()
        await touch_at(0.25, 0.0, 0.0)
        await expect(page.get_by_test_id("warning")).to_be_hidden()
        await record_step(page)
        await wait_for_question(page, "touch_on_xy")
        await touch_at(0.2, 0.005, 0.0)
        await wait_for_reason(page, "frame.collinear")
        await expect(page.get_by_test_id("yes")).to_be_disabled()
        await _save_screenshots(page, tmp_path, "frame_refused")
        await touch_at(0.0, 0.2, 0.0)
        await wait_for_reason(page, "")
        await expect(page.locator("[data-figure=axes_u]")).to_be_visible()
        await record_step(page)
        await wait_for_question(page, "touch_above")
        await touch_at(0.05, 0.05, -0.05)
        await wait_for_reason(page, "frame.left_handed")
        await expect(page.get_by_test_id("yes")).to_be_disabled()
        await touch_at(0.05, 0.05, 0.05)
        await wait_for_reason(page, "")
        await record_step(page)
        await wait_for_question(page, "accept_frame")
        await expect(page.get_by_test_id("displacement")).to_contain_text("500")


async def test_a_selection_at_the_pendant_blocks_the_page(pendant: FakePendant, tmp_path: Path) -> None:
    """U7: old and new are named, the points stay, and nothing can be recorded until it is put back."""
    tool = int((await pendant.fake_client.read_truth())["robots"]["fanuc"]["active"]["tool_number"])
    async with a_run(pendant, "six_point_tcp", tool_number=3, method="four_point") as page:
        await wait_for_question(page, "pin_is_fixed")
        await record_step(page)
        await pendant.touch_point(tip_at_home(), np.eye(3))
        await record_step(page)
        await pendant.touch_point(tip_at_home(), turn_about("x", TILT))
        await wait_for_reason(page, "")
        await pendant.fake_client.inject_fault("select", tool=tool + 1)
        context_warning = page.get_by_test_id("context-guard")
        await context_warning.wait_for()
        await expect(context_warning).to_contain_text(f"tool {tool + 1} is active, and not tool {tool}")
        await expect(context_warning).to_contain_text("1 recorded so far")
        await _save_screenshots(page, tmp_path, "guard")
        await page.keyboard.press("Escape")
        await expect(context_warning).to_be_visible()
        session = await pendant.viewer.read_session()
        press = {"op": "answer", "prompt_id": session["prompt"]["id"], "value": "yes"}
        early = {"id": "another tool", "rev": session["rev"], "order": press}
        refused = await pendant.viewer.client.post("/api/commands", json=early)
        assert refused.json()["code"] == "context.changed"
        await pendant.fake_client.inject_fault("select", tool=tool)
        await context_warning.wait_for(state="hidden")
        await wait_for_reason(page, "")
        await record_step(page)
        await pendant.viewer.wait_until(lambda session: len(session["prompt"]["data"]["points"]) >= 3)


async def test_a_plan_is_looked_at_before_the_robot_moves(pendant: FakePendant, tmp_path: Path) -> None:
    """Poses with their tips, speed, time, what was checked and what was not; then the motion with its progress."""
    await pendant.move_to_joints(pendant.start_rad)
    async with a_run(pendant, "mastering_record", poses=12) as page:
        await wait_for_question(page, "wire_is_hooked")
        await record_step(page)
        await wait_for_question(page, "accept_plan")
        await expect(page.get_by_test_id("instruction")).to_contain_text("is the wire free, are no cables")
        await expect(page.get_by_test_id("plan-count")).to_have_text(re.compile(r"^\s*12"))
        await expect(page.get_by_test_id("plan-checks").locator(".good")).to_have_count(4)
        await unfold(page.get_by_test_id("plan-poses"))
        rows = page.get_by_test_id("plan-poses").locator("tbody tr")
        await expect(rows).to_have_count(12)
        plan = (await pendant.viewer.read_session())["prompt"]["data"]["plan"]
        for pose in plan["poses"]:
            flange = np.linalg.norm(np.array(pose["tip_in_base_m"]))
            assert 0.1 < flange < 2.0
            assert len(pose["joints_rad"]) == 6
        await page.get_by_test_id("plan-poses").locator("summary").click()
        steps = page.locator("aside ol li")
        await expect(steps.filter(has_text="go again to pose")).to_contain_text("(if needed)")
        await expect(steps.filter(has_text="≈ 0")).to_have_count(0)
        await _save_screenshots(page, tmp_path, "approve")
        await pendant.viewer.send_order(op="pause")
        await page.get_by_test_id("yes").click()
        await pendant.viewer.wait_until(lambda session: session["run"]["state"] == "paused")
        await pendant.viewer.send_order(op="go_on")
        await page.locator("[data-testid=working][data-page=motion]").wait_for()
        await page.get_by_test_id("left").wait_for()
        await expect(page.get_by_test_id("pose-of")).to_have_text(re.compile(r"\d+ of \d+"))
        await _save_screenshots(page, tmp_path, "motion")


async def test_the_approved_plan_is_drawn_until_the_run_has_left_it(
    pendant: FakePendant, tmp_path: Path
) -> None:
    """U3: the next pose stands out, those measured are dimmed, for a reload and a second tablet as well."""
    await pendant.move_to_joints(pendant.start_rad)
    async with a_run(pendant, "mastering_record", hold=True, poses=12) as page:
        await wait_for_question(page, "wire_is_hooked")
        await expect(page.get_by_test_id("ghosts")).to_have_count(0)
        await record_step(page)
        await wait_for_question(page, "accept_plan")
        await page.get_by_test_id("yes").click()
        await page.locator("[data-testid=working][data-page=motion]").wait_for()
        ghosts = page.get_by_test_id("ghosts")
        await expect(ghosts).to_have_attribute("data-next", "1")
        await expect(ghosts).to_have_attribute("data-measured", "0")
        await page.get_by_test_id("hold").hover()
        await page.mouse.down()
        await pendant.viewer.wait_until(lambda session: len(session["run"]["series"]["measured"]) >= 3)
        await page.mouse.up()
        waits = await pendant.viewer.wait_until(lambda session: session["waits_for_hold"])
        taken = len(waits["run"]["series"]["measured"])
        assert taken < 12, "the fake cell is too fast to let go of the button"
        async with pendant.viewer.open_page() as second:
            for tablet in (page, second):
                await tablet.reload()
                await expect(tablet.get_by_test_id("ghosts")).to_have_attribute("data-next", str(taken + 1))
                drawn = await wait_for_value(lambda tablet=tablet: tablet.evaluate("window.__robot?.ghosts"))  # type: ignore[misc]
                states = ["measured"] * taken + ["next"] + ["to_do"] * (11 - taken)
                assert [ghost["state"] for ghost in drawn] == states
        await unfold(page.get_by_test_id("legend"))
        await _save_screenshots(page, tmp_path, "series")
        await page.locator("aside").screenshot(path=tmp_path / "series_drawn.png")
        await page.get_by_test_id("hold").hover()
        await page.mouse.down()
        await page.get_by_test_id("outcome").wait_for()
        await page.mouse.up()
        await expect(ghosts).to_have_count(0)


async def test_more_speed_turned_up_at_the_pendant_waits_for_a_yes(
    pendant: FakePendant, tmp_path: Path
) -> None:
    """U7: old and new are named, the points stay, and the robot stands until a person agrees; less is never asked."""
    await pendant.move_to_joints(pendant.start_rad)
    await pendant.fake_client.inject_fault("override", device="fanuc", percent=30)
    async with a_run(pendant, "mastering_record", hold=True, poses=12) as page:
        await wait_for_question(page, "wire_is_hooked")
        await record_step(page)
        await wait_for_question(page, "accept_plan")
        await page.get_by_test_id("yes").click()
        await page.locator("[data-testid=working][data-page=motion]").wait_for()
        await page.get_by_test_id("hold").hover()
        await page.mouse.down()
        await pendant.viewer.wait_until(lambda session: len(session["run"]["series"]["measured"]) >= 2)
        await pendant.fake_client.inject_fault("override", device="fanuc", percent=100)
        await wait_for_question(page, "may_move_faster")
        await page.mouse.up()
        instruction = page.get_by_test_id("instruction")
        await expect(instruction).to_contain_text("The speed override stands at 100 %, and was 30 % at most")
        taken = len((await pendant.viewer.read_session())["run"]["series"]["measured"])
        assert 2 <= taken < 12
        stood = (await pendant.fake_client.read_truth())["robots"]["fanuc"]["joints_rad"]
        await _save_screenshots(page, tmp_path, "faster")
        assert (await pendant.fake_client.read_truth())["robots"]["fanuc"]["joints_rad"] == pytest.approx(
            stood, abs=1e-9
        )
        await page.get_by_test_id("yes").click()
        await page.get_by_test_id("hold").hover()
        await page.mouse.down()
        await pendant.viewer.wait_until(lambda session: len(session["run"]["series"]["measured"]) > taken)
        await pendant.fake_client.inject_fault("override", device="fanuc", percent=60)
        await page.get_by_test_id("outcome").wait_for()
        await page.mouse.up()
    await pendant.fake_client.inject_fault("override", device="fanuc", percent=100)


async def test_a_photo_is_taken_with_the_camera_or_the_page_says_what_else_to_do(
    pendant: FakePendant,
) -> None:
    """Witness marks: a real picture of the browser's camera; no camera, a forbidden one, and one out of reach."""
    async with (
        open_chromium(whole=True) as browser,
        a_run(pendant, "mastering_record", browser=browser, poses=12) as page,
    ):
        await wait_for_question(page, "wire_is_hooked")
        opens, hint = page.get_by_test_id("open-camera"), page.get_by_test_id("photo-told")
        await opens.click()  # it was not allowed
        await expect(hint).to_contain_text("Allow it in the browser's settings")
        await page.context.grant_permissions(["camera"])
        await opens.click()
        await expect(hint).to_have_count(0)
        await expect(page.get_by_test_id("shoot")).to_be_enabled()
        await hold_to_rules_in_languages(page, "camera")
        await page.get_by_test_id("shoot").click()
        picture = page.get_by_test_id("photo").locator("img")
        await expect(picture).to_have_count(1)
        await wait_for_value(lambda: picture.evaluate("seen => seen.naturalWidth"), lambda wide: wide >= 640)
        run_id = (await pendant.viewer.read_session())["run"]["id"]
        stored_photos = (await pendant.viewer.client.get(f"/api/runs/{run_id}/pictures")).json()
        assert [each["media_type"] for each in stored_photos] == ["image/jpeg"]
        await expect(page.get_by_test_id("camera")).to_have_count(0)

        await page.evaluate(NO_CAMERA)
        await opens.click()
        await expect(hint).to_contain_text("This device has no camera")
        async with page.expect_file_chooser() as chosen:
            await page.get_by_test_id("take-photo").click()
        (first,) = await picture.all()
        jpeg = await page.request.get(pendant.viewer.url + "/" + str(await first.get_attribute("src")))
        async with page.expect_response(lambda answer: answer.request.method == "POST") as kept_too:
            await (await chosen.value).set_files(
                {"name": "p.jpg", "mimeType": "image/jpeg", "buffer": await jpeg.body()}
            )
        assert (await kept_too.value).ok
        await expect(hint).to_have_count(0)
        await expect(page.get_by_test_id("photo").first).to_be_visible()


async def test_settings_show_their_units_and_doubt_what_looks_like_another_one(pendant: FakePendant) -> None:
    """U8: a comma is a decimal sign, metres typed into millimetres are asked about."""
    asked_for: list[dict[str, object]] = []
    async with pendant.viewer.open_page("#/procedure/three_point_frame", locale="de") as page:
        page.on(
            "request",
            lambda request: asked_for.append(request.post_data_json) if "dry-runs" in request.url else None,
        )
        await page.get_by_test_id("value-frame_number").fill("3")
        for axis, text in (("x", "20,5"), ("y", "0"), ("z", "0,18")):
            box = page.get_by_test_id(f"tip_in_flange_m-0-{axis}")
            await box.fill(text)
            await box.press("Tab")
        doubt = page.get_by_test_id("unit-doubt")
        await doubt.wait_for()
        await expect(doubt).to_contain_text("0,18 m = 180,0 mm")
        await page.get_by_test_id("unit-meant").click()
        await unfold(page.get_by_test_id("all-settings"))
        await page.get_by_test_id("value-sigma_m").fill("0,125")
        await page.get_by_test_id("value-sigma_m").press("Tab")
        units = page.get_by_test_id("settings").locator("[data-testid=unit]")
        await wait_for_value(units.all_inner_texts, lambda value: set(value) == {"mm"})
        await page.get_by_role("button", name="Zeigen, was geschehen wird").click()
        await page.locator("ol li").first.wait_for()
        await expect(page.get_by_test_id("start")).to_be_in_viewport(
            ratio=1.0
        )  # however many settings there are
        settings = asked_for[-1]["settings"]
        assert settings == {"frame_number": 3, "tip_in_flange_m": [0.0205, 0.0, 0.18], "sigma_m": 0.000125}
        await page.reload()
        await expect(page.get_by_test_id("value-sigma_m")).to_have_value("0,125")


async def test_a_swinging_wire_is_waited_for(tmp_path: Path) -> None:
    """U2, U6: recording waits for the arm to be there, for the wire to rest for a second, and for fresh values."""
    async with (
        at_the_pages(tmp_path, observe=True) as pendant,
        a_run(pendant, "mastering_record", poses=12) as page,
    ):
        await wait_for_question(page, "wire_is_hooked")
        await record_step(page)
        await wait_for_question(page, "accept_plan")
        await page.get_by_test_id("yes").click()
        await wait_for_question(page, "move_by_hand")
        await wait_for_reason(page, "robot.not_there")
        target = (await pendant.viewer.read_session())["prompt"]["data"]["target"]
        swinging = asyncio.create_task(_swing_wire(pendant))
        await page.locator("[data-testid=settle][data-settled=false]").first.wait_for()
        await pendant.move_to_joints(target["joints_rad"])
        await wait_for_reason(page, "gauge.not_settled")
        await expect(page.get_by_test_id("yes")).to_be_disabled()
        await _save_screenshots(page, tmp_path, "capture")
        swinging.cancel()
        with suppress(asyncio.CancelledError):
            await swinging
        await wait_for_reason(page, "")
        await expect(page.get_by_test_id("yes")).to_be_enabled()
        await pendant.fake_client.inject_fault("node_off")
        await page.locator("[data-testid=gauge][data-stale=true]").first.wait_for()
        await expect(page.get_by_test_id("yes")).to_be_disabled()


async def _swing_wire(pendant: FakePendant) -> None:
    """Let the wire's reading go to and fro by some millimetres, twice a second."""
    way = 0.004
    while True:
        await pendant.fake_client.inject_fault("wire_offset", m=way)
        way = -way
        await asyncio.sleep(0.25)
