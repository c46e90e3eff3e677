"""A fake Universal Robots controller for one test, on a loopback address of its own."""

import asyncio
import json
import random
import sys
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Any

from cellcal.fake_devices.universal_robots.device import FakeUniversalRobot, create_device
from cellcal.fake_devices.world import World
from tests.machine_speed import stretched_s

ROBOT_API_PORT = 8089  # 80 needs more rights than a test has
CHILD_DEADLINE_S = stretched_s(60.0)


@asynccontextmanager
async def fake_ur(
    time_factor: float = 1.0, model: str = "ur10e", seed: int = 3, settings: Mapping[str, Any] | None = None
) -> AsyncIterator[FakeUniversalRobot]:
    """Start one; its address is ``robot.server.address``. ``settings`` are those of [fake.robots.NAME]."""
    robot = await _start_robot(time_factor, model, seed, settings or {})
    try:
        yield robot
    finally:
        await robot.stop()


async def _start_robot(
    time_factor: float, model: str, seed: int, settings: Mapping[str, Any]
) -> FakeUniversalRobot:
    rng = random.SystemRandom()
    for _ in range(20):
        address = f"127.{rng.randint(1, 250)}.{rng.randint(0, 250)}.{rng.randint(1, 250)}"
        world = World(seed, time_factor)
        robot = create_device(
            world,
            {
                "name": "ur",
                "model": model,
                "address": address,
                "serial": "20225500042",
                "robot_api_port": ROBOT_API_PORT,
                "settings": settings,
            },
        )
        with suppress(OSError):
            await robot.start()
            return robot
    raise AssertionError("no free loopback address")


class WheelProcess:
    """A child process with the unmodified ur_rtde wheel; it may hang or crash, this test may not."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process

    async def read_line(self) -> dict[str, Any]:
        """Return the next thing the child says."""
        assert self.process.stdout is not None
        async with asyncio.timeout(CHILD_DEADLINE_S):
            while raw := await self.process.stdout.readline():
                if raw.startswith(b"{"):
                    found: dict[str, Any] = json.loads(raw)
                    return found
        raise AssertionError(f"the child ended with {await self.process.wait()}")

    async def go_on(self) -> None:
        """Let the child run past its pause."""
        assert self.process.stdin is not None
        self.process.stdin.write(b"\n")
        await self.process.stdin.drain()


@asynccontextmanager
async def run_wheel(robot: FakeUniversalRobot, scenario: str) -> AsyncIterator[WheelProcess]:
    """Run a scenario of tests/wire/ur_wheel_child.py against a fake; kill it at the end if need be."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "tests.wire.ur_wheel_child",
        robot.server.address,
        scenario,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    try:
        yield WheelProcess(process)
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        await process.communicate()
