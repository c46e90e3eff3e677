"""The fence around ur-rtde: kill it, hang it, cut its link, and see how long it takes to be told."""

import asyncio
import os
import signal
import tempfile
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from cellcal.drivers.errors import DeviceError
from cellcal.drivers.interfaces import Readiness
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.soak.figures import Figures
from tests.wire.cases import ROBOTS, opened, until, until_ready
from tests.wire.fakes import running

PROMISE_S = 2.0
_PATIENCE_S = 30.0
_CASE = ROBOTS["universal_robots"]
_CHILD = "cellcal.drivers.universal_robots.child"
Mischief = Callable[[FakeCellClient], Awaitable[None]]


def fence(rounds: int) -> Figures:
    """Every mischief during a move: an error with a remedy within 2 s, and the next move works."""
    delays = asyncio.run(_campaign(rounds))
    worst = {name: max(times) for name, times in delays.items()}
    told = sum(len(times) for times in delays.values())
    line = (
        f"fence: {told} of {rounds * len(_MISCHIEF)} failures told with a remedy, the next move worked each "
        f"time; slowest {max(worst.values()):.2f} s (at most {PROMISE_S:g} s): "
        + ", ".join(f"{name} {seconds:.2f}" for name, seconds in worst.items())
    )
    return Figures(line, told == rounds * len(_MISCHIEF) and max(worst.values()) <= PROMISE_S)


async def _campaign(rounds: int) -> dict[str, list[float]]:
    delays: dict[str, list[float]] = {name: [] for name in _MISCHIEF}
    with tempfile.TemporaryDirectory() as folder, running(Path(folder)) as (path, door):
        config = read_cell_file(path).robot_named(_CASE.name).model_copy(update={"watchdog_hz": 5.0})
        async with opened(config) as robot:
            for _ in range(rounds):
                for name, mischief in _MISCHIEF.items():
                    delays[name].append(await _one(robot, door, mischief))
    return delays


async def _one(robot: Any, door: FakeCellClient, mischief: Mischief) -> float:
    await _CASE.heal(door, robot)
    await robot.move_joints(_CASE.home_rad, speed_rad_s=0.5)
    move = asyncio.create_task(robot.move_joints(_CASE.away_rad, speed_rad_s=_CASE.slow_rad_s))
    await until(lambda: _moves(door))
    started_s = time.monotonic()
    await mischief(door)
    try:
        async with asyncio.timeout(_PATIENCE_S):
            await move
    except DeviceError as error:
        delay_s = time.monotonic() - started_s
        if not error.remedy:
            raise AssertionError(f"no remedy: {error}") from error
    else:
        raise AssertionError("the move ended as if nothing had happened")
    await _CASE.heal(door, robot)
    await until_ready(robot, Readiness.READY)
    return delay_s


async def _moves(door: FakeCellClient) -> bool:
    return bool((await door.read_truth())["robots"][_CASE.name]["moving"])


def _signal(number: signal.Signals) -> Mischief:
    async def send(_: FakeCellClient) -> None:
        for pid in _our_children():
            os.kill(pid, number)

    return send


def _our_children() -> list[int]:
    return [int(process.name) for process in Path("/proc").glob("[0-9]*") if _is_our_child(process)]


def _is_our_child(process: Path) -> bool:
    try:
        words = (process / "cmdline").read_bytes().split(b"\0")
        parent = (process / "stat").read_text(encoding="ascii").rpartition(")")[2].split()[1]
    except OSError:
        return False
    return _CHILD.encode() in words and int(parent) == os.getpid()


def _fault(name: str) -> Mischief:
    async def happen(door: FakeCellClient) -> None:
        await door.inject_fault(name, device=_CASE.name)

    return happen


_MISCHIEF: dict[str, Mischief] = {
    "killed": _signal(signal.SIGKILL),
    "crashed": _signal(signal.SIGSEGV),
    "hung": _signal(signal.SIGSTOP),
    "RTDE cut": _fault("link_loss_rtde"),
    "all ports cut": _fault("link_loss_all"),
    "stalled": _fault("link_stall"),
}
