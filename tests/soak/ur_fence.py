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
from tests.soak.campaign_figures import CampaignFigures
from tests.wire.driver_cases import open_retrying, until_ready, wait_until
from tests.wire.fake_devices_process import run_fakes
from tests.wire.robot_cases import ROBOTS

PROMISE_S = 2.0
_PATIENCE_S = 30.0
_CASE = ROBOTS["universal_robots"]
_CHILD = "cellcal.drivers.universal_robots.child"
Mischief = Callable[[FakeCellClient], Awaitable[None]]


def fence(rounds: int) -> CampaignFigures:
    """Every mischief during a move: an error with a remedy within 2 s, and the next move works."""
    delays = asyncio.run(_run_rounds(rounds))
    worst = {name: max(times) for name, times in delays.items()}
    reported_count = sum(len(times) for times in delays.values())
    line = (
        f"fence: {reported_count} of {rounds * len(_MISCHIEF)} failures told with a remedy, the "
        f"next move worked each "
        f"time; slowest {max(worst.values()):.2f} s (at most {PROMISE_S:g} s): "
        + ", ".join(f"{name} {seconds:.2f}" for name, seconds in worst.items())
    )
    return CampaignFigures(
        line, reported_count == rounds * len(_MISCHIEF) and max(worst.values()) <= PROMISE_S
    )


async def _run_rounds(rounds: int) -> dict[str, list[float]]:
    delays: dict[str, list[float]] = {name: [] for name in _MISCHIEF}
    with tempfile.TemporaryDirectory() as folder, run_fakes(Path(folder)) as (path, fake_client):
        config = read_cell_file(path).robot_named(_CASE.name).model_copy(update={"watchdog_hz": 5.0})
        async with open_retrying(config) as robot:
            for _ in range(rounds):
                for name, mischief in _MISCHIEF.items():
                    delays[name].append(await _time_mischief(robot, fake_client, mischief))
    return delays


async def _time_mischief(robot: Any, fake_client: FakeCellClient, mischief: Mischief) -> float:
    await _CASE.heal(fake_client, robot)
    await robot.move_joints(_CASE.home_rad, speed_rad_s=0.5)
    move = asyncio.create_task(robot.move_joints(_CASE.away_rad, speed_rad_s=_CASE.slow_rad_s))
    await wait_until(lambda: _is_moving(fake_client))
    started_s = time.monotonic()
    await mischief(fake_client)
    try:
        async with asyncio.timeout(_PATIENCE_S):
            await move
    except DeviceError as error:
        delay_s = time.monotonic() - started_s
        if not error.remedy:
            raise AssertionError(f"no remedy: {error}") from error
    else:
        raise AssertionError("the move ended as if nothing had happened")
    await _CASE.heal(fake_client, robot)
    await until_ready(robot, Readiness.READY)
    return delay_s


async def _is_moving(fake_client: FakeCellClient) -> bool:
    return bool((await fake_client.read_truth())["robots"][_CASE.name]["moving"])


def _signal_mischief(number: signal.Signals) -> Mischief:
    async def send_signal(_: FakeCellClient) -> None:
        for pid in _our_children():
            os.kill(pid, number)

    return send_signal


def _our_children() -> list[int]:
    return [int(process.name) for process in Path("/proc").glob("[0-9]*") if _is_our_child(process)]


def _is_our_child(process: Path) -> bool:
    try:
        words = (process / "cmdline").read_bytes().split(b"\0")
        parent = (process / "stat").read_text(encoding="ascii").rpartition(")")[2].split()[1]
    except OSError:
        return False
    return _CHILD.encode() in words and int(parent) == os.getpid()


def _fault_mischief(name: str) -> Mischief:
    async def cause_fault(fake_client: FakeCellClient) -> None:
        await fake_client.inject_fault(name, device=_CASE.name)

    return cause_fault


_MISCHIEF: dict[str, Mischief] = {
    "killed": _signal_mischief(signal.SIGKILL),
    "crashed": _signal_mischief(signal.SIGSEGV),
    "hung": _signal_mischief(signal.SIGSTOP),
    "RTDE cut": _fault_mischief("link_loss_rtde"),
    "all ports cut": _fault_mischief("link_loss_all"),
    "stalled": _fault_mischief("link_stall"),
}
