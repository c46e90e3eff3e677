"""Nothing but the answer to this very request may become a measurement (rows F01-F20, F37-F47, F53)."""

import asyncio
import math
import struct
from pathlib import Path
from typing import Any

import pytest
from pymodbus.client import AsyncModbusTcpClient

from cellcal.calibration.geometry import Pose
from cellcal.drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    MotionStoppedError,
    RefusedError,
    UnreachableError,
    WireProtocolError,
)
from cellcal.drivers.interfaces import Readiness
from cellcal.drivers.wire.modbus import ModbusLink
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.machine_speed import stretched_s
from tests.wire.contract_robot import wait_for_motion
from tests.wire.driver_cases import open_retrying, until_ready, wait_until
from tests.wire.robot_cases import ROBOTS

CASE = ROBOTS["modbus_robot"]


async def read_truth(fake_client: FakeCellClient) -> dict[str, Any]:
    return dict((await fake_client.read_truth())["robots"]["fanuc"])


async def check_healed(fanuc: Any, fake_client: FakeCellClient) -> None:
    """After every fault the very next readings are right again."""
    await fake_client.send_command("clear")
    await until_ready(fanuc, Readiness.READY)
    assert (await fanuc.read_joints()).joints_rad == pytest.approx(
        (await read_truth(fake_client))["controller_joints_rad"], abs=1e-5
    )
    assert list(await fanuc.encoder_counts()) == (await read_truth(fake_client))["counts_read"]


class TestAnswersThatAreNotOurs:
    @pytest.mark.parametrize(
        ("fault", "parameters", "error"),
        [
            ("silent", {}, DeviceTimeoutError),
            ("slow", {"delay_s": 1.0}, DeviceTimeoutError),
            ("late", {}, DeviceError),
            ("late_same_tid", {}, DeviceError),
            ("wrong_tid", {}, DeviceTimeoutError),
            ("wrong_unit", {}, DeviceTimeoutError),
            ("wrong_protocol", {}, DeviceTimeoutError),
            ("wrong_function", {}, WireProtocolError),
            ("short_list", {}, WireProtocolError),
            ("lost_reply", {}, DeviceTimeoutError),
            ("reset", {}, UnreachableError),
            ("refuse", {}, UnreachableError),
            ("cut", {"bytes": 0}, UnreachableError),
            ("cut", {"bytes": 7}, UnreachableError),
            ("cut", {"bytes": 20}, UnreachableError),
        ],
    )
    async def test_become_an_error_that_names_the_device_and_a_remedy(
        self,
        fanuc: Any,
        fake_client: FakeCellClient,
        fault: str,
        parameters: dict[str, Any],
        error: type[DeviceError],
    ) -> None:
        fault_parameters = {
            key: stretched_s(value) if key == "delay_s" else value for key, value in parameters.items()
        }
        await fake_client.inject_fault(fault, device="fanuc", **fault_parameters)
        with pytest.raises(error) as failure:
            await fanuc.read_joints()
        assert str(failure.value).startswith("fanuc: ")
        assert failure.value.remedy
        await check_healed(fanuc, fake_client)

    async def test_a_right_answer_in_pieces_is_still_right(
        self, fanuc: Any, fake_client: FakeCellClient
    ) -> None:
        await fake_client.inject_fault("half_frames", device="fanuc")
        for _ in range(3):
            reading = await fanuc.read_joints()
            assert reading.joints_rad == pytest.approx(
                (await read_truth(fake_client))["controller_joints_rad"], abs=1e-5
            )

    async def test_a_doubled_answer_is_used_once(self, fanuc: Any, fake_client: FakeCellClient) -> None:
        """pymodbus drops two frames of more than 264 bytes together: then the link is silent, never wrong."""
        await fake_client.inject_fault("duplicate", device="fanuc")
        for _ in range(5):
            data, epoch = await fanuc.read_mastering(), await fanuc.encoder_epoch()
            assert list(data.counts_at_zero) == (await read_truth(fake_client))["counts_at_zero"]
            assert epoch == (await read_truth(fake_client))["epoch"]
        with pytest.raises(DeviceTimeoutError):
            await fanuc.read_joints()
        await check_healed(fanuc, fake_client)

    async def test_a_late_answer_never_meets_the_next_request(
        self, fanuc: Any, fake_client: FakeCellClient
    ) -> None:
        """One answer is held back for so long that it would arrive on the next connection."""
        for _ in range(3):
            await fake_client.inject_fault("slow", device="fanuc", delay_s=stretched_s(0.7), count=1)
            with pytest.raises(DeviceTimeoutError):
                await fanuc.read_joints()
            await fanuc.jog_axis(0, 0.02, speed_rad_s=0.5)
            reading = await fanuc.read_joints()
            assert reading.joints_rad == pytest.approx(
                (await read_truth(fake_client))["controller_joints_rad"], abs=1e-5
            )

    async def test_a_cancelled_request_leaves_no_answer_behind(
        self, fanuc: Any, fake_client: FakeCellClient
    ) -> None:
        await fake_client.inject_fault("slow", device="fanuc", delay_s=0.2, count=1)
        asking = asyncio.create_task(fanuc.read_joints())
        await asyncio.sleep(0.05)
        asking.cancel()
        await asyncio.wait({asking})
        await check_healed(fanuc, fake_client)

    @pytest.mark.parametrize("code", [1, 2, 3, 4])
    async def test_an_exception_says_what_is_wrong(
        self, fanuc: Any, fake_client: FakeCellClient, code: int
    ) -> None:
        await fake_client.inject_fault("exception", device="fanuc", code=code)
        with pytest.raises(RefusedError) as failure:
            await fanuc.read_joints()
        assert failure.value.vendor_code == code
        assert failure.value.remedy
        await check_healed(fanuc, fake_client)

    @pytest.mark.parametrize("code", [10, 11])
    async def test_a_gateway_without_its_device_is_a_lost_link(
        self, fanuc: Any, fake_client: FakeCellClient, code: int
    ) -> None:
        await fake_client.inject_fault("exception", device="fanuc", code=code)
        with pytest.raises(UnreachableError):
            await fanuc.read_joints()
        await check_healed(fanuc, fake_client)

    @pytest.mark.parametrize("code", [5, 6])
    async def test_a_busy_device_is_asked_again_but_never_written_to_twice(
        self, fanuc: Any, fake_client: FakeCellClient, code: int
    ) -> None:
        await fake_client.inject_fault("exception", device="fanuc", code=code, count=2)
        assert (await fanuc.read_joints()).joints_rad
        await fake_client.inject_fault("exception", device="fanuc", code=code, function=16, count=1)
        with pytest.raises(RefusedError):
            await fanuc.write_mastering((await fanuc.read_mastering()).counts_at_zero)
        await fake_client.inject_fault("exception", device="fanuc", code=code)
        with pytest.raises(RefusedError):
            await fanuc.read_joints()
        await check_healed(fanuc, fake_client)

    @pytest.mark.parametrize("code", [5, 6])
    async def test_a_device_that_is_busy_during_the_greeting_is_asked_again(
        self, cell: CellConfig, fake_client: FakeCellClient, code: int
    ) -> None:
        await fake_client.inject_fault("exception", device="fanuc", code=code, count=2)
        async with cell.robot_named("fanuc").open() as robot:
            assert (await robot.read_joints()).joints_rad
        await fake_client.inject_fault("exception", device="fanuc", code=code)
        with pytest.raises(RefusedError, match="Modbus exception"):
            async with cell.robot_named("fanuc").open() as robot:
                await robot.read_joints()

    async def test_the_last_frames_are_kept_for_the_journal(
        self, cell: CellConfig, fake_client: FakeCellClient
    ) -> None:
        config = cell.robot_named("fanuc")
        link = ModbusLink("fanuc", config.address, config.port, deadline_s=stretched_s(2.0))
        await link.read(301, 40)
        sent, received = link.trace.list_frames()[-2:]
        assert (sent.direction, received.direction) == (">", "<")
        assert sent.data.endswith("03012c0028")
        assert bytes.fromhex(received.data)[9:17] == b"-F0174\x31\x31"
        await link.close()


class TestValuesThatCannotBe:
    async def test_a_program_that_stands_still_makes_every_reading_stale(
        self, fanuc: Any, fake_client: FakeCellClient
    ) -> None:
        await fake_client.inject_fault("frozen", device="fanuc")
        for read in (fanuc.read_joints, fanuc.encoder_counts, fanuc.flange_pose):
            with pytest.raises(UnreachableError, match=r"stale.*Start the background program CELLCAL"):
                await read()
        assert (await fanuc.read_condition()).readiness is Readiness.UNREACHABLE
        await check_healed(fanuc, fake_client)

    async def test_a_program_that_dies_during_a_move_is_noticed(
        self, fanuc: Any, fake_client: FakeCellClient
    ) -> None:
        move = asyncio.create_task(fanuc.move_joints(CASE.away_rad, speed_rad_s=CASE.slow_rad_s))
        await wait_for_motion(fake_client, CASE)
        await fake_client.inject_fault("frozen", device="fanuc")
        with pytest.raises(UnreachableError, match="CELLCAL"):
            await move
        await wait_for_motion(fake_client, CASE, expected=False)
        await check_healed(fanuc, fake_client)

    async def test_not_a_number_is_never_a_joint_angle(self, fanuc: Any, fake_client: FakeCellClient) -> None:
        await fake_client.inject_fault("nan", device="fanuc")
        with pytest.raises(WireProtocolError) as failure:
            await fanuc.read_joints()
        assert "7fc0" in failure.value.frame
        await check_healed(fanuc, fake_client)

    async def test_swapped_words_do_not_pass_for_a_drive_train(
        self, fanuc: Any, fake_client: FakeCellClient
    ) -> None:
        await fake_client.inject_fault("swapped_words", device="fanuc")
        with pytest.raises(DeviceError):
            await fanuc.drive_train()
        await check_healed(fanuc, fake_client)


class TestMotionThatGoesWrong:
    @pytest.mark.parametrize(
        ("fault", "readiness"),
        [("emergency_stop", Readiness.STOPPED), ("t1_mode", Readiness.NOT_READY)],
    )
    async def test_a_switch_stops_the_arm_and_refuses_the_next_move(
        self, fanuc: Any, fake_client: FakeCellClient, fault: str, readiness: Readiness
    ) -> None:
        move = asyncio.create_task(fanuc.move_joints(CASE.away_rad, speed_rad_s=CASE.slow_rad_s))
        await wait_for_motion(fake_client, CASE)
        await fake_client.inject_fault(fault, device="fanuc")
        with pytest.raises(MotionStoppedError):
            await move
        assert (await fanuc.read_condition()).readiness is readiness
        with pytest.raises(MotionStoppedError):
            await fanuc.move_joints(CASE.home_rad, speed_rad_s=0.5)
        assert not (await read_truth(fake_client))["moving"]

    async def test_a_move_that_ends_early_is_not_called_done(
        self, fanuc: Any, fake_client: FakeCellClient
    ) -> None:
        move = asyncio.create_task(fanuc.move_joints(CASE.away_rad, speed_rad_s=CASE.slow_rad_s))
        await wait_for_motion(fake_client, CASE)
        await fake_client.inject_fault("early_stop", device="fanuc")
        with pytest.raises(MotionStoppedError, match=r"deg from its target"):
            await move

    async def test_a_target_beyond_the_limits_is_refused(
        self, fanuc: Any, fake_client: FakeCellClient
    ) -> None:
        with pytest.raises(RefusedError, match="range") as failure:
            await fanuc.move_joints((6.0, *CASE.home_rad[1:]), speed_rad_s=0.5)
        assert failure.value.vendor_code == 3
        assert not (await read_truth(fake_client))["moving"]

    async def test_an_active_alarm_refuses_motion_and_names_itself(
        self, fanuc: Any, fake_client: FakeCellClient
    ) -> None:
        await fake_client.inject_fault("alarm", device="fanuc", code="SRVO-050", axis="J2")
        condition = await fanuc.read_condition()
        assert condition.readiness is Readiness.NOT_READY
        assert [(alarm.code, alarm.axis) for alarm in condition.alarms] == [("SRVO-050", 1)]
        with pytest.raises(RefusedError):
            await fanuc.move_joints(CASE.away_rad, speed_rad_s=0.5)

    async def test_a_low_battery_is_reported_but_stops_nothing(
        self, fanuc: Any, fake_client: FakeCellClient
    ) -> None:
        await fake_client.inject_fault("battery_low", device="fanuc", axes="J4")
        condition = await fanuc.read_condition()
        assert condition.readiness is Readiness.READY
        assert "SRVO-065" in condition.message
        assert "ON" in condition.remedy
        await fanuc.move_joints(CASE.away_rad, speed_rad_s=0.5)

    async def test_a_robot_moved_by_another_master_takes_no_request(
        self, fanuc: Any, fake_client: FakeCellClient
    ) -> None:
        await fake_client.inject_fault("jog_by_hand", device="fanuc", axis="J1", rad=0.5, speed_rad_s=0.02)
        with pytest.raises(RefusedError) as failure:
            await fanuc.move_joints(CASE.away_rad, speed_rad_s=0.5)
        assert failure.value.vendor_code == 4
        await wait_for_motion(fake_client, CASE, expected=False)

    async def test_the_speed_is_capped_before_it_is_sent(
        self, fanuc: Any, cell: CellConfig, fake_client: FakeCellClient
    ) -> None:
        await fanuc.move_joints(CASE.away_rad, speed_rad_s=3.0)
        config = cell.robot_named("fanuc")
        link = ModbusLink("raw", config.address, config.port, deadline_s=stretched_s(2.0))
        low, high = await link.read(3019, 2)
        await link.close()
        (sent_deg_s,) = struct.unpack("<f", struct.pack("<2H", low, high))
        assert sent_deg_s == pytest.approx(math.degrees(config.speed_limit_rad_s), rel=1e-6)

    async def test_a_write_that_was_done_but_not_answered_is_put_right(
        self, fanuc: Any, fake_client: FakeCellClient
    ) -> None:
        """The controller obeyed without an answer: the old data are put back on a new connection."""
        before = await fanuc.read_mastering()
        await fake_client.inject_fault("act_then_cut", device="fanuc", count=1)
        with pytest.raises(UnreachableError, match="restored"):
            await fanuc.write_mastering(tuple(count + 999 for count in before.counts_at_zero))
        assert await fanuc.read_mastering() == before


class TestFrames:
    async def test_the_flange_pose_does_not_depend_on_the_active_frames(
        self, fanuc: Any, fake_client: FakeCellClient
    ) -> None:
        plain = await fanuc.flange_pose()
        await fanuc.write_tool_frame(3, Pose((0.02, -0.05, 0.2), (0.5, 0.5, 0.5, 0.5)))
        await fanuc.write_user_frame(4, Pose((0.7, 0.1, -0.2), (0.8, 0.0, 0.6, 0.0)))
        await fake_client.inject_fault("select", device="fanuc", tool=3, frame=4)
        pose = await fanuc.flange_pose()
        assert pose.position_m == pytest.approx(plain.position_m, abs=2e-6)
        assert pose.quaternion == pytest.approx(plain.quaternion, abs=2e-6)

    @pytest.mark.parametrize("number", [0, 11])
    async def test_a_frame_that_does_not_exist_is_refused(self, fanuc: Any, number: int) -> None:
        with pytest.raises(RefusedError, match="1 to 10"):
            await fanuc.read_tool_frame(number)


async def test_other_clients_of_the_controller_do_not_disturb(fanuc: Any, cell: CellConfig) -> None:
    config = cell.robot_named("fanuc")
    clients = [AsyncModbusTcpClient(config.address, port=config.port, reconnect_delay=0) for _ in range(2)]
    for client in clients:
        assert await client.connect()
    await fanuc.move_joints(CASE.away_rad, speed_rad_s=0.5)
    for client in clients:
        client.close()


async def test_the_whole_way_of_a_battery_loss(fresh_fakes: tuple[Path, FakeCellClient]) -> None:
    """Each condition says what is next: battery, acknowledge, power cycle, one turn per axis, mastering."""
    path, fake_client = fresh_fakes
    async with open_retrying(read_cell_file(path).robot_named("fanuc")) as robot:
        epoch, drive = await robot.encoder_epoch(), await robot.drive_train()
        await fake_client.inject_fault("battery_loss", device="fanuc")
        condition = await until_ready(robot, Readiness.POSITION_LOST)
        assert {alarm.code for alarm in condition.alarms} == {"SRVO-062"}
        assert condition.stop is None
        await fake_client.inject_fault("emergency_stop", device="fanuc")
        stop = (await robot.read_condition()).stop
        assert stop is not None
        assert "E-stop" in stop.message
        await fake_client.inject_fault("release_emergency_stop", device="fanuc")
        assert await robot.encoder_epoch() == epoch + 1
        assert not (await robot.read_mastering()).mastered
        with pytest.raises(RefusedError):
            await robot.move_joints((0.0,) * 6, speed_rad_s=0.5)
        with pytest.raises(RefusedError, match="Cartesian"):
            await robot.flange_pose()

        await fake_client.inject_fault("new_battery", device="fanuc")
        await robot.reset_position_alarms()
        assert "off and on" in (await robot.read_condition()).remedy
        with pytest.raises(RefusedError, match="off and on"):
            await robot.jog_axis(0, 0.01, speed_rad_s=0.1)
        await fake_client.inject_fault("power_cycle", device="fanuc")

        async def waits_for_its_index() -> bool:
            return {alarm.code for alarm in (await robot.read_condition()).alarms} == {"SRVO-075"}

        await wait_until(waits_for_its_index)
        with pytest.raises(RefusedError) as failure:
            await robot.write_mastering((await robot.read_mastering()).counts_at_zero)
        assert failure.value.vendor_code == 2
        for axis, turn_rad in enumerate(abs(drive.radians_per_turn().diagonal())):
            await robot.jog_axis(axis, 1.05 * float(turn_rad), speed_rad_s=0.05)
        await robot.reset_position_alarms()
        assert (await robot.read_condition()).alarms == ()
        found = await robot.write_mastering(tuple((await read_truth(fake_client))["true_counts_at_zero"]))
        assert found.mastered
        assert (await robot.read_condition()).readiness is Readiness.READY
        now = await read_truth(fake_client)
        assert now["controller_joints_rad"] == pytest.approx(now["joints_rad"], abs=1e-6)


async def test_a_power_cycle_is_survived_by_connecting_again(
    fresh_fakes: tuple[Path, FakeCellClient],
) -> None:
    path, fake_client = fresh_fakes
    async with open_retrying(read_cell_file(path).robot_named("fanuc")) as robot:
        await robot.move_joints(CASE.home_rad, speed_rad_s=0.5)
        move = asyncio.create_task(robot.move_joints(CASE.away_rad, speed_rad_s=CASE.slow_rad_s))
        await wait_for_motion(fake_client, CASE)
        await fake_client.inject_fault("power_cycle", device="fanuc", off_s=10.0)
        with pytest.raises(DeviceError):
            await move
        await until_ready(robot, Readiness.READY)
        await robot.move_joints(CASE.home_rad, speed_rad_s=0.5)
