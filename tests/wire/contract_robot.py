"""Every sentence of the Robot interface as a test, run against every driver by ``test_contracts.py``."""

import asyncio
import math
from collections.abc import Callable
from typing import Any

import pytest

from cellcal.drivers.errors import BusyError, DeviceError, MotionStoppedError, RefusedError, WrongDeviceError
from cellcal.drivers.interfaces import ActiveFrames, Readiness
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.driver_cases import open_retrying, until_ready, wait_until
from tests.wire.robot_cases import RobotCase

AT_TARGET_RAD = math.radians(0.1)
ABILITIES = {
    "jogs_single_axes": ("jog_axis",),
    "reads_encoder_counts": ("encoder_counts", "drive_train", "encoder_epoch"),
    "reads_mastering": ("read_mastering",),
    "writes_mastering": ("write_mastering", "restore_mastering", "reset_position_alarms"),
    "writes_tool_frame": ("read_tool_frame", "write_tool_frame"),
    "writes_user_frame": ("read_user_frame", "write_user_frame"),
    "tells_active_frames": ("active_frames",),
    "tells_mode": ("controller_mode",),
    "tells_speed_override": ("speed_override",),
    "shows_position_data": ("position_data",),
    "keeps_position_history": ("position_history",),
}


def needs(*flags: str) -> Callable[[Any], Any]:
    """Mark a test of an ability that not every robot claims."""

    def mark(test: Any) -> Any:
        test.needed_flags = flags
        return test

    return mark


async def truth_of(fake_client: FakeCellClient, case: RobotCase) -> dict[str, Any]:
    return dict((await fake_client.read_truth())["robots"][case.name])


async def wait_for_motion(fake_client: FakeCellClient, case: RobotCase, *, expected: bool = True) -> None:
    """Wait until the arm moves, or stands."""

    async def as_expected() -> bool:
        return bool((await truth_of(fake_client, case))["moving"]) is expected

    await wait_until(as_expected)


async def is_seen_moving(fake_client: FakeCellClient, case: RobotCase, move: asyncio.Task[None]) -> bool:
    """Wait until the arm moves, and return True; False where its move was over before anything was seen of it."""
    while not move.done():
        if (await truth_of(fake_client, case))["moving"]:
            return True
        await asyncio.sleep(0.01)
    return False


def refuse_other_frames(reported_frames: ActiveFrames, truth: dict[str, Any]) -> None:
    """Compare what a robot tells of its tool, frame and payload with the truth."""
    assert reported_frames.tool_number == truth["tool_number"]
    assert reported_frames.user_frame_number == truth["user_frame_number"]
    assert reported_frames.payload_kg == truth["payload_kg"]
    assert reported_frames.flange_tool is not None
    for shown, true in zip(reported_frames.flange_tool.to_matrix()[:3], truth["flange_tool"], strict=False):
        assert list(shown) == pytest.approx(true, abs=1e-6)


async def until_reading_fails(robot: Any) -> None:
    """Read on: a driver may hand out readings that are younger than its limit for a moment."""
    while True:
        await robot.read_joints()
        await asyncio.sleep(0.02)


def far_move(robot: Any, case: RobotCase) -> asyncio.Task[None]:
    return asyncio.create_task(robot.move_joints(case.away_rad, speed_rad_s=case.slow_rad_s))


class RobotContract:
    """Mixed into a test class. A robot is asked for what it claims; without a claim it must refuse."""

    @pytest.fixture(autouse=True)
    def _skip_what_is_not_claimed(
        self, request: pytest.FixtureRequest, robot_case: RobotCase, cell: CellConfig
    ) -> None:
        can = cell.robot_named(robot_case.name).capabilities
        for flag in getattr(request.function, "needed_flags", ()):
            if not getattr(can, flag):
                pytest.skip(f"this robot does not claim {flag}")

    @needs("moves_joints")
    async def test_a_move_returns_when_the_arm_has_settled_at_the_target(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        await robot.move_joints(robot_case.away_rad, speed_rad_s=0.5)
        truth = await truth_of(fake_client, robot_case)
        assert not truth["moving"]
        assert robot_case.believed_joints(truth) == pytest.approx(robot_case.away_rad, abs=AT_TARGET_RAD)
        reading = await robot.read_joints()
        assert not reading.moving
        assert reading.joints_rad == pytest.approx(robot_case.away_rad, abs=AT_TARGET_RAD)

    @needs("moves_joints")
    async def test_a_move_may_be_asked_for_twice(self, robot: Any, robot_case: RobotCase) -> None:
        await robot.move_joints(robot_case.home_rad, speed_rad_s=0.5)
        await robot.move_joints(robot_case.home_rad, speed_rad_s=0.5)

    @needs("moves_joints")
    async def test_a_move_that_is_stopped_raises(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        move = far_move(robot, robot_case)
        await wait_for_motion(fake_client, robot_case)
        name, parameters = robot_case.stop_fault
        await fake_client.inject_fault(name, device=robot_case.name, **parameters)
        with pytest.raises(MotionStoppedError) as failure:
            await move
        assert failure.value.remedy
        condition = await robot.read_condition()
        assert condition.readiness is Readiness.STOPPED
        assert condition.remedy

    @needs("moves_joints")
    async def test_a_cancelled_move_stops_the_arm_waits_for_standstill_and_re_raises(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        move = far_move(robot, robot_case)
        await wait_for_motion(fake_client, robot_case)
        move.cancel()
        with pytest.raises(asyncio.CancelledError):
            await move
        truth = await truth_of(fake_client, robot_case)
        assert not truth["moving"]
        assert robot_case.believed_joints(truth) != pytest.approx(robot_case.away_rad, abs=0.05)
        await robot.move_joints(robot_case.home_rad, speed_rad_s=0.5)

    @needs("moves_joints")
    async def test_a_robot_that_is_slowed_down_while_it_moves_still_arrives(
        self, robot_case: RobotCase, cell: CellConfig, fake_client: FakeCellClient
    ) -> None:
        config = cell.robot_named(robot_case.name).model_copy(update=robot_case.impatient)
        async with open_retrying(config) as robot:
            await robot_case.heal(fake_client, robot)
            while True:
                await robot.move_joints(robot_case.home_rad, speed_rad_s=0.5)
                move = asyncio.create_task(robot.move_joints(robot_case.away_rad, speed_rad_s=1.0))
                if await is_seen_moving(fake_client, robot_case, move):
                    break
                await move  # its error, or else the machine was too busy to see a motion of half a second
            fault, parameters = robot_case.slow_fault
            await fake_client.inject_fault(fault, device=robot_case.name, **parameters)
            await move
            reading = await robot.read_joints()
            assert reading.joints_rad == pytest.approx(robot_case.away_rad, abs=AT_TARGET_RAD)

    @needs("moves_joints")
    async def test_a_second_command_during_a_move_raises_busy_at_once(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        move = far_move(robot, robot_case)
        await wait_for_motion(fake_client, robot_case)
        with pytest.raises(BusyError):
            await robot.move_joints(robot_case.home_rad, speed_rad_s=0.5)
        await wait_for_motion(fake_client, robot_case)  # between two steps of a move the arm may stand
        assert not move.done(), "the first move was disturbed"
        move.cancel()
        await asyncio.wait({move})

    @needs("moves_joints")
    async def test_stop_may_be_called_at_any_time_also_twice(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        await robot.stop()
        move = far_move(robot, robot_case)
        await wait_for_motion(fake_client, robot_case)
        await robot.stop()
        assert not (await truth_of(fake_client, robot_case))["moving"]
        await robot.stop()
        with pytest.raises(MotionStoppedError):
            await move
        await robot.move_joints(robot_case.home_rad, speed_rad_s=0.5)

    async def test_reading_never_moves_the_arm(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        before = (await truth_of(fake_client, robot_case))["joints_rad"]
        await robot.identify()
        await robot.read_condition()
        await robot.read_joints()
        if robot.capabilities.tells_flange_pose:
            await robot.flange_pose()
        truth = await truth_of(fake_client, robot_case)
        assert truth["joints_rad"] == pytest.approx(before, abs=1e-9)
        assert not truth["moving"]

    async def test_a_reading_is_what_the_controller_believes(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        reading = await robot.read_joints()
        believed = robot_case.believed_joints(await truth_of(fake_client, robot_case))
        assert reading.joints_rad == pytest.approx(believed, abs=1e-5)
        assert reading.raw

    @needs("tells_flange_pose")
    async def test_the_flange_pose_is_near_where_the_flange_is(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        pose = await robot.flange_pose()
        truth = (await truth_of(fake_client, robot_case))["base_flange"]
        for row in range(3):  # the world's hidden errors are some millimetres and tenths of a degree
            assert pose.position_m[row] == pytest.approx(truth[row][3], abs=0.03)
            assert list(pose.rotation_matrix()[row]) == pytest.approx(truth[row][:3], abs=0.03)

    @needs("tells_flange_pose", "tells_active_frames")
    async def test_the_active_tool_is_the_controllers_and_a_switch_is_seen(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        pose, before = await robot.flange_pose(), await robot.active_frames()
        refuse_other_frames(before, (await truth_of(fake_client, robot_case))["active"])
        await fake_client.inject_fault("tool_switched", device=robot_case.name)
        after = await robot.active_frames()
        refuse_other_frames(after, (await truth_of(fake_client, robot_case))["active"])
        assert after.flange_tool.position_m != pytest.approx(before.flange_tool.position_m, abs=1e-3)
        assert (await robot.flange_pose()).position_m == pytest.approx(pose.position_m, abs=1e-5)

    @needs("tells_mode")
    async def test_the_mode_is_the_one_switched_to(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        fault, before, after = robot_case.mode_fault
        assert await robot.controller_mode() == before
        await fake_client.inject_fault(fault, device=robot_case.name)
        assert await robot.controller_mode() == after

    @needs("tells_speed_override")
    async def test_the_speed_override_is_the_one_turned_to(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        fault, parameters = robot_case.slow_fault
        assert await robot.speed_override() == pytest.approx(1.0)
        await fake_client.inject_fault(fault, device=robot_case.name, **parameters)
        assert await robot.speed_override() == pytest.approx(0.15)

    @pytest.mark.parametrize("bad", [math.nan, math.inf])
    async def test_a_target_that_is_no_number_is_refused_and_nothing_moves(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient, bad: float
    ) -> None:
        before = (await truth_of(fake_client, robot_case))["joints_rad"]
        with pytest.raises(RefusedError):
            await robot.move_joints((bad, *robot_case.home_rad[1:]), speed_rad_s=0.5)
        with pytest.raises(RefusedError):
            await robot.move_joints(robot_case.home_rad, speed_rad_s=bad)
        with pytest.raises(RefusedError):
            await robot.move_joints(robot_case.home_rad[:-1], speed_rad_s=0.5)
        assert (await truth_of(fake_client, robot_case))["joints_rad"] == pytest.approx(before, abs=1e-9)

    @pytest.mark.parametrize("way", range(3))
    async def test_every_call_ends_within_its_deadline_when_the_link_is_cut(
        self, robot: Any, robot_case: RobotCase, cell: CellConfig, fake_client: FakeCellClient, way: int
    ) -> None:
        fault, parameters = robot_case.link_faults[way]
        await fake_client.inject_fault(fault, device=robot_case.name, **parameters)
        async with asyncio.timeout(2 * cell.robot_named(robot_case.name).deadline_s):
            with pytest.raises(DeviceError) as failure:
                await until_reading_fails(robot)
        assert robot_case.name in str(failure.value)
        assert failure.value.remedy
        await fake_client.send_command("clear")

    @needs("moves_joints")
    @pytest.mark.parametrize("way", range(3))
    async def test_a_link_lost_during_a_move_is_an_error_that_says_what_to_do(
        self, robot: Any, robot_case: RobotCase, cell: CellConfig, fake_client: FakeCellClient, way: int
    ) -> None:
        move = far_move(robot, robot_case)
        await wait_for_motion(fake_client, robot_case)
        fault, parameters = robot_case.link_faults[way]
        await fake_client.inject_fault(fault, device=robot_case.name, **parameters)
        async with asyncio.timeout(2 * cell.robot_named(robot_case.name).deadline_s):
            with pytest.raises(DeviceError) as failure:
                await move
        assert failure.value.remedy
        await fake_client.send_command("clear")
        await wait_for_motion(fake_client, robot_case, expected=False)
        believed = robot_case.believed_joints(await truth_of(fake_client, robot_case))
        assert believed != pytest.approx(robot_case.away_rad, abs=0.05), "the arm went on without us"

    @pytest.mark.parametrize("way", range(3))
    async def test_an_unreachable_robot_has_a_condition_too_and_comes_back(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient, way: int
    ) -> None:
        fault, parameters = robot_case.link_faults[way]
        await fake_client.inject_fault(fault, device=robot_case.name, **parameters)
        condition = await until_ready(robot, Readiness.UNREACHABLE)
        assert condition.message
        assert condition.remedy
        await fake_client.send_command("clear")
        await until_ready(robot, Readiness.READY)
        assert (await robot.read_joints()).joints_rad

    async def test_the_serial_number_is_checked_at_connect(
        self, robot: Any, robot_case: RobotCase, cell: CellConfig
    ) -> None:
        config = cell.robot_named(robot_case.name)
        assert (await robot.identify()).serial == config.serial
        if robot_case.stranger is None:
            pytest.skip("nothing on this link tells who answers")
        wrong = config.model_copy(update=robot_case.stranger)
        with pytest.raises(WrongDeviceError, match="X-000000"):
            async with wrong.open():
                pytest.fail("a stranger was let in")

    async def test_what_is_not_claimed_is_refused_with_what_to_do(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        can, before = robot.capabilities, (await truth_of(fake_client, robot_case))["joints_rad"]
        calls = [] if can.moves_joints else [robot.move_joints(robot_case.away_rad, speed_rad_s=0.5)]
        calls += [] if can.tells_flange_pose else [robot.flange_pose()]
        if not calls:
            pytest.skip("this robot claims all of it")
        for call in calls:
            with pytest.raises(RefusedError) as refusal:
                await call
            assert refusal.value.remedy
        assert (await truth_of(fake_client, robot_case))["joints_rad"] == pytest.approx(before, abs=1e-9)

    async def test_flags_and_methods_agree(self, robot: Any) -> None:
        for flag, methods in ABILITIES.items():
            has = [callable(getattr(robot, method, None)) for method in methods]
            assert all(has) if getattr(robot.capabilities, flag) else not any(has), flag

    async def test_frames_that_are_written_are_read_back(self, robot: Any) -> None:
        from cellcal.calibration.geometry import Pose

        frame = Pose((0.1, -0.02, 0.3), (0.5, 0.5, -0.5, 0.5))
        for kind in ("tool", "user"):
            if getattr(robot.capabilities, f"writes_{kind}_frame"):
                found = await getattr(robot, f"write_{kind}_frame")(2, frame)
                assert found == await getattr(robot, f"read_{kind}_frame")(2)
                assert found.position_m == pytest.approx(frame.position_m, abs=1e-6)
                assert found.quaternion == pytest.approx(frame.quaternion, abs=1e-6)
