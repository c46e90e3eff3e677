"""A technician at a page and at the pendant: brings the fake arm where it is asked for, and presses what is shown."""

import math
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
from fastapi import FastAPI
from playwright.async_api import Page, expect
from scipy.optimize import least_squares

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Array, exp_rotation, log_rotation
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.browser_pages import PATIENCE_MS, at_rest
from tests.service.cell_process_session import a_cell
from tests.service.test_pages import PageViewer, view_service

MODEL = load_model("fanuc_m6ib")
HOME = np.radians([5.0, -5.0, 5.0, 12.0, -78.0, 8.0])
NOTHING_HELD_DOWN = re.compile(r"--share: ?0;")
TIP_IN_FLANGE_M = np.array([0.02, 0.01, 0.18])


class FakePendant:
    """The fake robot's pendant."""

    def __init__(self, fake_client: FakeCellClient, viewer: PageViewer, app: FastAPI) -> None:
        self.fake_client, self.viewer, self._app = fake_client, viewer, app
        self.start_rad: list[float] = []

    @property
    def config(self) -> CellConfig:
        """The cell that is served."""
        config: CellConfig = self._app.state.context.config
        return config

    def release_control(self) -> None:
        """Let the browser that pressed last leave: a browser that is closed keeps the session in hand."""
        control = self._app.state.context.control
        if control.current_holder is not None:
            control.release_control(control.current_holder.id)

    async def move_to_joints(self, joints_rad: Any) -> None:
        """Drive the arm by hand to where the controller shows these joints, and see that the service has seen it."""
        target_rad = [float(angle) for angle in joints_rad]
        await self.fake_client.inject_fault("hand_moves", joints=target_rad, device="fanuc")

    async def touch_point(self, pin_m: Array, turned: Array) -> None:
        """Hold the tip at a point, the flange turned as told from how it is at home."""
        home = MODEL.base_flange(HOME[None])[0][:3, :3]
        await self.move_to_joints(joints_for(home @ turned, pin_m))


def joints_for(rotation: Array, tip_m: Array, tip_in_flange_m: Array = TIP_IN_FLANGE_M) -> Array:
    """Return joints at which the flange has an attitude and the tip is at a point."""

    def pose_residuals(joints: Array) -> Array:
        flange = MODEL.base_flange(joints[None])[0]
        away = flange[:3, :3] @ tip_in_flange_m + flange[:3, 3] - tip_m
        return np.concatenate([away * 1e3, log_rotation(rotation.T @ flange[:3, :3]) * 1e3])

    found = least_squares(pose_residuals, HOME, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert np.abs(found.fun).max() < 1e-3, found.fun
    return np.asarray(found.x)


def tip_at_home() -> Array:
    """Return where the tip is while the arm is at home."""
    flange = MODEL.base_flange(HOME[None])[0]
    return np.asarray(flange[:3, :3] @ TIP_IN_FLANGE_M + flange[:3, 3])


def turn_about(axis: str, degrees: float) -> Array:
    """Return a turn of the flange about one of its axes."""
    return exp_rotation(np.eye(3)["xyz".index(axis)] * math.radians(degrees))


@asynccontextmanager
async def at_the_pages(
    folder: Path, *, observe: bool = False, time_factor: float = 500.0
) -> AsyncIterator[FakePendant]:
    """Serve a fake cell and open a browser on it. ``observe``: people move the robot, nothing is commanded."""
    async with a_cell(folder, time_factor=time_factor) as (path, fake_client):
        if observe:
            text = path.read_text(encoding="utf-8")
            path.write_text(text.replace('motion = "commanded"', 'motion = "observe"', 1), encoding="utf-8")
        app = create_app(ServiceSettings(path, open_access=True))
        async with view_service(app) as viewer:
            pendant = FakePendant(fake_client, viewer, app)
            truth = (await fake_client.read_truth())["robots"]["fanuc"]
            pendant.start_rad = truth["controller_joints_rad"]
            yield pendant


async def wait_for_question(page: Page, key: str) -> None:
    """Wait until the page asks this."""
    await page.locator(f'[data-testid=prompt][data-key="{key}"]').wait_for(timeout=PATIENCE_MS)


async def wait_for_reason(page: Page, key: str) -> None:
    """Wait until the page says that this is in the way; an empty key: nothing is."""
    await page.locator(f'[data-testid=meter][data-why="{key}"]').wait_for(timeout=PATIENCE_MS)


async def record_step(page: Page) -> None:
    """Press the button once it can be pressed, and wait until something else is asked, or the run has ended."""
    prompt = page.get_by_test_id("prompt")
    step = await prompt.locator("h2").inner_text()
    await page.get_by_test_id("yes").click(timeout=PATIENCE_MS)
    await page.wait_for_function(
        """step => { const asks = document.querySelector('[data-testid=prompt] h2');
            return asks ? asks.innerText !== step : document.querySelector('[data-testid=outcome]') !== null; }""",
        arg=step,
        timeout=PATIENCE_MS,
    )


async def let_go_early(page: Page) -> None:
    """Hold the main button down for less than it wants, and see that it has been let go."""
    hold = page.get_by_test_id("yes")
    await hold.hover()
    await page.mouse.down()
    await expect(hold).not_to_have_attribute("style", NOTHING_HELD_DOWN)
    await page.mouse.up()
    await expect(hold).to_have_attribute("style", NOTHING_HELD_DOWN)
    await at_rest(page)
