"""The contract of a robot, against a controller that executes the listings CELLCAL and CELLCAL_BG as they ship."""

import asyncio
import math
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest

from cellcal.drivers.errors import DeviceTimeoutError, MotionStoppedError, RefusedError, WrongDeviceError
from cellcal.drivers.interfaces import Readiness
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.contract_robot import RobotContract, far_move, truth_of, wait_for_motion
from tests.wire.driver_cases import open_retrying, until_ready, wait_until
from tests.wire.fake_devices_process import run_fakes
from tests.wire.robot_cases import RobotCase, open_at_home
from tests.wire.tp_cell import TP_CASE, TP_CELL


@pytest.fixture(scope="module")
def fake_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, FakeCellClient]]:
    with run_fakes(tmp_path_factory.mktemp("cell"), TP_CELL) as cell:
        yield cell


@pytest.fixture
def cell(fake_process: tuple[Path, FakeCellClient]) -> CellConfig:
    return read_cell_file(fake_process[0])


@pytest.fixture
def robot_case() -> RobotCase:
    return TP_CASE


@pytest.fixture
async def robot(robot_case: RobotCase, cell: CellConfig, fake_client: FakeCellClient) -> AsyncIterator[Any]:
    async with open_at_home(robot_case, cell, fake_client) as robot:
        yield robot


class TestListings(RobotContract):
    """Every sentence of the Robot interface."""

    async def test_no_joint_is_faster_than_the_speed_that_was_asked_for(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        speed_rad_s = 0.2
        move = asyncio.create_task(robot.move_joints(robot_case.away_rad, speed_rad_s=speed_rad_s))
        await wait_for_motion(fake_client, robot_case)
        first = await self.truth_beyond(fake_client, robot_case, robot_case.home_rad[0] + 0.5)
        second = await self.truth_beyond(fake_client, robot_case, robot_case.home_rad[0] + 1.5)
        passed_s = second["time_s"] - first["time_s"]
        joints = [truth["robots"][robot_case.name]["joints_rad"] for truth in (first, second)]
        fastest = max(abs(b - a) for a, b in zip(*joints, strict=True)) / passed_s
        assert 0.5 * speed_rad_s < fastest <= speed_rad_s * (1 + 1e-6)
        move.cancel()
        await asyncio.wait({move})

    async def truth_beyond(
        self, fake_client: FakeCellClient, robot_case: RobotCase, first_joint_rad: float
    ) -> dict[str, Any]:
        """Return the truth once J1 has passed an angle."""
        found: list[dict[str, Any]] = []

        async def has_passed() -> bool:
            found.append(dict(await fake_client.read_truth()))
            return bool(found[-1]["robots"][robot_case.name]["joints_rad"][0] > first_joint_rad)

        await wait_until(has_passed)
        return found[-1]

    async def test_a_speed_below_one_per_cent_is_refused(self, robot: Any, robot_case: RobotCase) -> None:
        with pytest.raises(RefusedError, match="less than 1 %"):
            await robot.move_joints(robot_case.away_rad, speed_rad_s=math.radians(0.5))

    async def test_an_axis_limit_is_refused_and_named(self, robot: Any, robot_case: RobotCase) -> None:
        with pytest.raises(RefusedError, match="limit"):
            await robot.move_joints((3.4, *robot_case.home_rad[1:]), speed_rad_s=0.5)
        await robot.move_joints(robot_case.home_rad, speed_rad_s=0.5)

    async def test_the_mode_switch_stops_the_arm_and_is_named(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        move = far_move(robot, robot_case)
        await wait_for_motion(fake_client, robot_case)
        await fake_client.inject_fault("t1_mode")
        with pytest.raises(MotionStoppedError) as failure:
            await move
        assert "AUTO" in str(failure.value)
        assert not (await truth_of(fake_client, robot_case))["moving"]

    async def test_after_an_emergency_stop_start_does_not_resume_the_old_motion(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        move = far_move(robot, robot_case)
        await wait_for_motion(fake_client, robot_case)
        await fake_client.inject_fault("emergency_stop")
        with pytest.raises(MotionStoppedError, match="emergency stop"):
            await move
        await fake_client.inject_fault("release_emergency_stop")
        await fake_client.inject_fault("press_reset")
        stood = (await truth_of(fake_client, robot_case))["joints_rad"]
        await fake_client.inject_fault(
            "start_program"
        )  # without an abort: the task goes on where it was paused
        await until_ready(robot, Readiness.READY)
        assert (await truth_of(fake_client, robot_case))["joints_rad"] == pytest.approx(stood, abs=1e-9)
        await robot.move_joints(robot_case.home_rad, speed_rad_s=0.5)

    async def test_a_program_that_was_not_started_after_a_restart_is_named(
        self, robot: Any, robot_case: RobotCase, cell: CellConfig, fake_client: FakeCellClient
    ) -> None:
        await fake_client.inject_fault("power_cycle", off_s=1.0)
        async with open_retrying(cell.robot_named(robot_case.name)) as again:
            await until_ready(again, Readiness.READY)
            with pytest.raises(DeviceTimeoutError, match="CELLCAL did not take the request"):
                await again.move_joints(robot_case.away_rad, speed_rad_s=0.5)
            assert not (await truth_of(fake_client, robot_case))["moving"]
            await fake_client.inject_fault("start_program")
            await fake_client.send_command("clear")
            await again.move_joints(robot_case.home_rad, speed_rad_s=0.5)


async def test_a_robot_that_lost_its_mastering_is_not_moved(tmp_path: Path) -> None:
    with run_fakes(tmp_path, TP_CELL) as (path, fake_client):
        async with open_retrying(read_cell_file(path).robot_named("fanuc")) as robot:
            await fake_client.inject_fault("memory_loss")
            stood = (await truth_of(fake_client, TP_CASE))["joints_rad"]
            with pytest.raises(RefusedError, match="not mastered"):
                await robot.move_joints(TP_CASE.away_rad, speed_rad_s=0.5)
            assert (await truth_of(fake_client, TP_CASE))["joints_rad"] == pytest.approx(stood, abs=1e-9)
            assert not robot.capabilities.jogs_single_axes
            assert not robot.capabilities.writes_mastering


async def test_the_profile_of_the_simulated_controller_refuses_a_real_one(tmp_path: Path) -> None:
    with run_fakes(tmp_path, TP_CELL) as (path, _):
        config = read_cell_file(path).robot_named("fanuc").model_copy(update={"profile": "fanuc_hmi"})
        with pytest.raises(WrongDeviceError, match="fanuc_hmi is for the simulated controller"):
            async with config.open():
                pytest.fail("it was opened")
