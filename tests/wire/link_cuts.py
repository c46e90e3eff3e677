"""Links that are cut at any moment of a move."""

import asyncio
import contextlib
from typing import Any

import numpy as np

from cellcal.drivers.errors import DeviceError
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.driver_cases import wait_until
from tests.wire.robot_cases import RobotCase

_AT_TARGET_RAD = 5e-4


async def cut_links(
    robot: Any, case: RobotCase, fake_client: FakeCellClient, cuts: int, fault: str
) -> tuple[int, int]:
    """Cut the link at random moments of moves; return how many of the moves after it missed, and the longest queue."""
    rng = np.random.default_rng(5)
    missed = 0

    async def truth() -> dict[str, Any]:
        return dict((await fake_client.read_truth())["robots"][case.name])

    async def stands() -> bool:
        return not (await truth())["moving"]

    for _ in range(cuts):
        target = np.array(case.home_rad) + rng.uniform(-0.2, 0.2, 6)
        move = asyncio.create_task(robot.move_joints(tuple(target), speed_rad_s=0.5))
        await asyncio.sleep(float(rng.uniform(0.0, 0.05)))
        await fake_client.inject_fault(fault, device=case.name)
        with contextlib.suppress(DeviceError):
            await move
        await wait_until(stands)
        await robot.move_joints(tuple(target), speed_rad_s=0.5)
        missed += not np.allclose((await truth())["joints_rad"], target, rtol=0, atol=_AT_TARGET_RAD)
    return missed, int((await truth())["most_queued"])
