"""The demo's cell has what procedures measure, and a technician who jogs the arm: they end with a verdict there."""

import asyncio
import itertools
from typing import Any

import httpx
import numpy as np
import pytest
from playwright.async_api import expect

from cellcal.service.demo.demo_fixtures import BASE_FRAME, DOWN, PIN_IN_BASE_M, TIP_IN_FLANGE_M, place_for
from tests.service.browser_pages import NO_WEBGL, PATIENCE_MS, open_chromium
from tests.service.test_demo_pages import PATIENCE_S, a_demo, poll_until

TOUCHED = ("six_point_tcp", "three_point_frame", "frame_offset", "end_effector_points")
_presses = itertools.count(1)


async def test_procedures_that_a_person_teaches_pass_in_the_demo_with_nothing_to_type() -> None:
    async with a_demo("--port", "0", "--time-factor", "600") as (_, client):
        await poll_until(client, "/api/demo", lambda answer: not answer["preparing"])
        nothing = await client.post("/api/demo/jog", json={})
        assert nothing.status_code == 422
        assert "no step" in nothing.json()["message"]
        for procedure in TOUCHED:
            outcome = await _run_procedure(client, procedure)
            assert (outcome["judgement"] or {}).get("word") == "pass", (procedure, outcome)


async def test_the_button_that_jogs_the_arm_comes_with_the_step_and_makes_it_recordable() -> None:
    async with a_demo("--port", "0", "--time-factor", "600") as (_, client), open_chromium() as browser:
        await poll_until(client, "/api/demo", lambda answer: not answer["preparing"])
        page = await browser.new_page(viewport={"width": 1280, "height": 800})
        page.set_default_timeout(PATIENCE_MS)
        await page.add_init_script(NO_WEBGL)
        await page.goto(str(client.base_url))
        await _start_run(client, "six_point_tcp")
        await page.get_by_test_id("yes").click()  # the pin is fixed
        await page.get_by_test_id("demo-jog").click()
        record = page.get_by_test_id("yes")
        await expect(record).to_be_enabled()
        await record.click()
        await expect(page.locator("[data-testid=points] li[data-state=recorded]")).to_have_count(1)
        await expect(page.get_by_test_id("demo-last")).to_contain_text("Arm jogged")


async def _start_run(client: httpx.AsyncClient, procedure: str) -> None:
    session = (await poll_until(client, "/api/session", lambda answer: _is_free(answer["session"])))[
        "session"
    ]
    if session["run"] is not None:
        session = await _send_order(client, session, {"op": "dismiss"})
    order = {"op": "start", "procedure": procedure, "settings": {}, "hold_to_move": False}
    await _send_order(client, session, order)


def _is_free(session: dict[str, Any]) -> bool:
    return bool(session["connection"]["connected"]) and (session["run"] is None or session["run"]["outcome"])


async def _send_order(
    client: httpx.AsyncClient, session: dict[str, Any], order: dict[str, Any]
) -> dict[str, Any]:
    command = {"id": f"press {next(_presses)}", "rev": session["rev"], "order": order}
    await client.post("/api/commands", json=command)
    session_now: dict[str, Any] = (await client.get("/api/session")).json()["session"]
    return session_now


async def _run_procedure(client: httpx.AsyncClient, procedure: str) -> dict[str, Any]:
    """Run a procedure: jog where the demo can, and agree to everything; return how it ended."""
    await _start_run(client, procedure)
    jogged = set[str]()
    async with asyncio.timeout(PATIENCE_S):
        while True:
            session = (await client.get("/api/session")).json()["session"]
            prompt, outcome = session["prompt"], session["run"] and session["run"]["outcome"]
            if outcome:
                return dict(outcome)
            if prompt is not None:
                if prompt["id"] not in jogged and (await client.get("/api/demo")).json()["can_jog"]:
                    (await client.post("/api/demo/jog", json={})).raise_for_status()
                    jogged.add(prompt["id"])
                yes = {"op": "answer", "prompt_id": prompt["id"], "value": "yes"}
                await _send_order(client, session, yes)
            await asyncio.sleep(0.1)


def test_a_touch_puts_the_tip_on_what_is_touched() -> None:
    for key in ("touch", "touch_about_x", "touch_about_y", "touch_4", "touch_11", "touch_anew_2"):
        assert _expected_tip("six_point_tcp", key) == pytest.approx(PIN_IN_BASE_M)
    assert _expected_tip("three_point_frame", "touch_origin") == pytest.approx(BASE_FRAME[:3, 3])
    moved = _expected_tip("frame_offset", "touch_point_2_again") - _expected_tip(
        "frame_offset", "touch_point_1"
    )
    assert np.linalg.norm(moved) == pytest.approx(0.4)  # a workpiece moves as a whole
    along = _expected_tip("six_point_tcp", "along_x") - PIN_IN_BASE_M
    assert along / np.linalg.norm(along) == pytest.approx(DOWN[:, 0])


@pytest.mark.parametrize(
    ("procedure", "key"),
    [
        ("six_point_tcp", "accept_tool"),
        ("six_point_tcp", "hold_tool"),
        ("three_point_frame", "touch_point_1"),
        ("frame_offset", "touch_point_9"),
        ("mastering_recovery", "touch"),
    ],
)
def test_an_instruction_unknown_to_the_technician_is_not_jogged(procedure: str, key: str) -> None:
    assert place_for(procedure, key) is None


def _expected_tip(procedure: str, key: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    base_flange = place_for(procedure, key)
    assert base_flange is not None
    return np.asarray(base_flange[:3, :3] @ np.array(TIP_IN_FLANGE_M) + base_flange[:3, 3])
