"""Every sentence of the MasteringStore and JogsAxes interfaces as a test."""

import asyncio
import math
from typing import Any

import numpy as np
import pytest

from cellcal.drivers.errors import BusyError, MotionStoppedError, RefusedError
from cellcal.drivers.interfaces import MasteringData
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.contract_robot import AT_TARGET_RAD, truth_of, wait_for_motion
from tests.wire.robot_cases import RobotCase


class MasteringContract:
    """Mixed into a test class; only for robots that write mastering."""

    async def test_counts_and_drive_train_give_the_joints(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        truth = await truth_of(fake_client, robot_case)
        counts, data, drive = (
            await robot.encoder_counts(),
            await robot.read_mastering(),
            await robot.drive_train(),
        )
        assert list(counts) == truth["counts_read"]
        assert list(data.counts_at_zero) == truth["counts_at_zero"]
        assert data.mastered
        joints = drive.to_joints(np.array(counts), np.array(data.counts_at_zero))
        assert list(joints) == pytest.approx((await robot.read_joints()).joints_rad, abs=2e-6)
        assert np.array(drive.radians_per_count) == pytest.approx(
            np.array(truth["radians_per_count"]), rel=1e-6
        )
        assert set(drive.counts_per_turn) == {2**19}

    async def test_written_mastering_is_effective_and_read_back(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        before = await robot.read_mastering()
        joints = (await robot.read_joints()).joints_rad
        shifted = tuple(count + 1000 * (axis + 1) for axis, count in enumerate(before.counts_at_zero))
        try:
            found = await robot.write_mastering(shifted)
            assert found.counts_at_zero == shifted
            assert found.mastered
            truth = await truth_of(fake_client, robot_case)
            assert tuple(truth["counts_at_zero"]) == shifted
            assert (await robot.read_joints()).joints_rad != pytest.approx(joints, abs=1e-6)
        finally:
            await robot.write_mastering(before.counts_at_zero)
        assert (await robot.read_joints()).joints_rad == pytest.approx(joints, abs=1e-6)

    @pytest.mark.parametrize("mastered", [False, True])
    async def test_earlier_data_come_back_with_their_flag(self, robot: Any, mastered: bool) -> None:
        before = await robot.read_mastering()
        other = MasteringData(tuple(count + 300 for count in before.counts_at_zero), mastered)
        try:
            assert await robot.restore_mastering(other) == other
            assert await robot.read_mastering() == other
        finally:
            assert await robot.restore_mastering(before) == before

    @pytest.mark.parametrize("axis", range(6))
    async def test_after_a_partial_write_the_old_data_are_back(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient, axis: int
    ) -> None:
        before = await robot.read_mastering()
        await fake_client.inject_fault("partial_write", device=robot_case.name, axis=f"J{axis + 1}")
        shifted = tuple(count + 5000 for count in before.counts_at_zero)
        with pytest.raises(RefusedError, match=f"axis {axis + 1} was not written.*restored"):
            await robot.write_mastering(shifted)
        assert await robot.read_mastering() == before
        truth = await truth_of(fake_client, robot_case)
        assert tuple(truth["counts_at_zero"]) == before.counts_at_zero

    @pytest.mark.parametrize("after_s", [0.0, 0.002, 0.005, 0.01, 0.02, 0.04])
    async def test_a_cancelled_write_leaves_all_axes_or_none(self, robot: Any, after_s: float) -> None:
        before = await robot.read_mastering()
        shifted = tuple(count + 7000 for count in before.counts_at_zero)
        writing = asyncio.create_task(robot.write_mastering(shifted))
        await asyncio.sleep(after_s)
        writing.cancel()
        await asyncio.wait({writing})
        found = await robot.read_mastering()
        try:
            assert found.mastered
            expected_counts = before.counts_at_zero if writing.cancelled() else shifted
            assert found.counts_at_zero == expected_counts
        finally:
            await robot.write_mastering(before.counts_at_zero)

    async def test_mastering_that_is_no_number_is_refused(self, robot: Any) -> None:
        before = await robot.read_mastering()
        for bad in ((1, 2, 3), (2**40, *before.counts_at_zero[1:])):
            with pytest.raises(RefusedError):
                await robot.write_mastering(bad)
        assert await robot.read_mastering() == before

    async def test_acknowledging_a_healthy_robot_does_nothing(
        self, robot: Any, robot_case: RobotCase
    ) -> None:
        epoch = await robot.encoder_epoch()
        await robot.reset_position_alarms()
        await robot.reset_position_alarms()
        assert await robot.encoder_epoch() == epoch
        await robot.move_joints(robot_case.home_rad, speed_rad_s=0.5)

    async def test_a_jog_turns_one_joint_by_its_angle(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        for axis in range(robot.capabilities.axes):
            before = (await robot.read_joints()).joints_rad
            await robot.jog_axis(axis, -0.03, speed_rad_s=0.2)
            assert not (await truth_of(fake_client, robot_case))["moving"]
            expected = tuple(value - 0.03 * (i == axis) for i, value in enumerate(before))
            assert (await robot.read_joints()).joints_rad == pytest.approx(expected, abs=AT_TARGET_RAD)

    async def test_a_cancelled_jog_stops_the_arm_and_re_raises(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        jog = asyncio.create_task(robot.jog_axis(0, 0.8, speed_rad_s=robot_case.slow_rad_s))
        await wait_for_motion(fake_client, robot_case)
        with pytest.raises(BusyError):
            await robot.jog_axis(1, 0.1, speed_rad_s=0.1)
        jog.cancel()
        with pytest.raises(asyncio.CancelledError):
            await jog
        assert not (await truth_of(fake_client, robot_case))["moving"]

    async def test_a_jog_that_is_stopped_raises(
        self, robot: Any, robot_case: RobotCase, fake_client: FakeCellClient
    ) -> None:
        jog = asyncio.create_task(robot.jog_axis(0, 0.8, speed_rad_s=robot_case.slow_rad_s))
        await wait_for_motion(fake_client, robot_case)
        await robot.stop()
        with pytest.raises(MotionStoppedError):
            await jog

    @pytest.mark.parametrize(("axis", "angle"), [(-1, 0.1), (6, 0.1), (0, math.nan)])
    async def test_a_jog_that_makes_no_sense_is_refused(self, robot: Any, axis: int, angle: float) -> None:
        with pytest.raises(RefusedError):
            await robot.jog_axis(axis, angle, speed_rad_s=0.1)
