"""The driver of the Remote Motion Interface against its simulator, and the simulator against clients of others."""

import asyncio
import time
from collections.abc import AsyncIterator
from typing import Any

import fanuc_ucl.rmi.proto as ucl
import numpy as np
import pytest
from fanuc_rmi import RobotClient
from fanuc_ucl import JointFormat, JointTemplate, rmi

from cellcal.drivers.errors import (
    DeviceTimeoutError,
    MotionStoppedError,
    RefusedError,
    WireProtocolError,
)
from cellcal.drivers.fanuc.rmi.rmi_state import RmiStatus, condition_of
from cellcal.drivers.interfaces import AlarmKind, Readiness
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.driver_cases import open_retrying, wait_until
from tests.wire.link_cuts import cut_links
from tests.wire.robot_cases import ROBOTS, open_at_home

CASE = ROBOTS["fanuc_rmi"]
CUTS = 25  # a thousand in `make soak`
READY = RmiStatus(
    has_servo_power=True, pendant_enabled=False, motion_runs=False, single_step=False,
    next_sequence_id=1, override=1.0,
)  # fmt: skip


@pytest.fixture
async def rmi_robot(cell: CellConfig, fake_client: FakeCellClient) -> AsyncIterator[Any]:
    """The FANUC behind the Remote Motion Interface, healthy and at home."""
    async with open_at_home(CASE, cell, fake_client) as robot:
        yield robot
        await CASE.heal(fake_client, robot)


async def truth_of(fake_client: FakeCellClient) -> dict[str, Any]:
    return dict((await fake_client.read_truth())["robots"][CASE.name])


@pytest.mark.parametrize(
    ("changed", "texts", "readiness"),
    [
        ({}, (), Readiness.READY),
        ({"pendant_enabled": True}, (), Readiness.NOT_READY),
        ({"single_step": True}, (), Readiness.NOT_READY),
        ({"has_servo_power": False}, (), Readiness.STOPPED),
        ({"has_servo_power": False}, ("SRVO-001 Operator panel E-stop",), Readiness.STOPPED),
        ({"has_servo_power": False}, ("SRVO-062 BZAL alarm (Group:1 Axis:3)",), Readiness.POSITION_LOST),
        ({"has_servo_power": False}, ("SRVO-075 Pulse not established (G:1 A:6)",), Readiness.POSITION_LOST),
    ],
)
def test_a_status_says_who_must_act(
    changed: dict[str, bool], texts: tuple[str, ...], readiness: Readiness
) -> None:
    from dataclasses import replace

    condition = condition_of(replace(READY, **changed), texts)  # type: ignore[arg-type]
    assert condition.readiness is readiness
    assert bool(condition.remedy) is (readiness is not Readiness.READY)
    if readiness is Readiness.POSITION_LOST:
        assert condition.alarms[0].kind is AlarmKind.TURNS
        assert condition.alarms[0].axis in (2, 5)


COLLISION = "SRVO-050 Collision Detect alarm (G:1 A:2)"


async def test_the_client_fanuc_ucl_reads_moves_and_leaves(
    cell: CellConfig, fake_client: FakeCellClient
) -> None:
    await fake_client.inject_fault("clear_alarms", device=CASE.name)
    await fake_client.inject_fault("sequence_restarts", device=CASE.name)  # as this client expects it
    config = cell.robot_named(CASE.name)
    target = (-18.0, 12.0, -24.0, 14.0, -58.0, 21.0)

    async with open_retrying(config) as robot:
        stood_rad = (await robot.read_joints()).joints_rad

    def session() -> tuple[Any, ...]:
        driver = rmi.RmiDriver(rmi.RmiDriverConfig(config.address))
        driver.connect()
        try:
            status = driver.send(ucl.FrcGetStatus()).wait_timeout(5)
            joints = driver.send(ucl.FrcReadJointAngles()).wait_timeout(5)
            position = driver.send(ucl.FrcReadCartesianPosition()).wait_timeout(5)
            active = driver.send(ucl.FrcGetUFrameUTool()).wait_timeout(
                5
            )  # its frames want x, the manual says X
            driver.send(ucl.FrcInitialize()).wait_timeout(5)
            angles = ucl.JointAngles(JointFormat.FanucDeg, JointTemplate.SIX, *target)
            moved = driver.send(
                ucl.FrcJointMotionJRep(angles, ucl.SpeedType.MilliSeconds, 2000, ucl.TermType.FINE, 0)
            ).wait_timeout(20)
            driver.send(ucl.FrcAbort()).wait_timeout(5)
        finally:
            driver.disconnect().wait_timeout(5)
        return status, joints, position, active, moved

    def read_alarm() -> tuple[Any, ...]:
        driver = rmi.RmiDriver(rmi.RmiDriverConfig(config.address))
        driver.connect()
        try:
            return driver.send(ucl.FrcGetStatus()).wait_timeout(5), driver.send(
                ucl.FrcReadError()
            ).wait_timeout(5)
        finally:
            driver.disconnect().wait_timeout(5)

    status, joints, position, active, moved = await asyncio.to_thread(session)
    assert status.servo_ready
    assert moved.error_id == 0
    found = joints.joints(JointFormat.FanucDeg, JointTemplate.SIX).as_array()
    assert np.radians(found[:6]) == pytest.approx(stood_rad, abs=1e-6)
    assert position is not None
    assert (active.u_frame_number, active.u_tool_number) == (0, 1)
    assert np.degrees((await truth_of(fake_client))["joints_rad"]) == pytest.approx(target, abs=1e-6)
    await fake_client.inject_fault("alarm", device=CASE.name, text=COLLISION)
    status, alarm = await asyncio.to_thread(read_alarm)
    assert not status.servo_ready
    assert alarm.error_data == COLLISION
    await fake_client.inject_fault("clear_alarms", device=CASE.name)


async def test_the_client_fanuc_rmi_reads_frames_moves_and_leaves(
    cell: CellConfig, fake_client: FakeCellClient, tmp_path: Any
) -> None:
    await fake_client.inject_fault("clear_alarms", device=CASE.name)
    await fake_client.inject_fault("sequence_restarts", device=CASE.name, on=False)
    config = cell.robot_named(CASE.name)
    status = await truth_of(fake_client)

    def session(sequence_id: int) -> dict[str, Any]:
        client = RobotClient(config.address)
        client.connect()
        client.initialize(uframe=0, utool=1)
        found = client.read_utool_data(1) | {"active": client.get_uframe_utool()}
        target = {f"J{axis}": angle for axis, angle in enumerate((-20.0, 10.0, -25.0, 15.0, -60.0, 20.0), 1)}
        client.joint_absolute(target, 20, sequence_id)
        found["joints"] = client.read_joint_coordinates(str(tmp_path / "joints.jsonl"))["JointAngle"]
        client.abort()
        client.close()
        return dict(found)

    async with open_retrying(config) as robot:
        next_id = (await robot._link.send_command("FRC_GetStatus"))["NextSequenceID"]

    def read_alarm() -> dict[str, Any]:
        client = RobotClient(config.address)
        client.connect()
        found = client.read_error({"ErrorID": 2556957})  # it asks after a refusal only
        client.close()
        return dict(found)

    found = await asyncio.to_thread(session, next_id)
    assert "180" in str(found)
    assert found["active"] == {"UFrameNumber": 0, "UToolNumber": 1}
    assert found["joints"]["J1"] == pytest.approx(-20.0)
    assert not (await truth_of(fake_client))["moving"]
    assert np.degrees((await truth_of(fake_client))["joints_rad"])[0] == pytest.approx(-20.0)
    assert status["servo_power"]
    await fake_client.inject_fault("alarm", device=CASE.name, text=COLLISION)
    assert (await asyncio.to_thread(read_alarm))["ErrorData"] == COLLISION
    await fake_client.inject_fault("clear_alarms", device=CASE.name)


async def test_packets_in_pieces_and_unasked_ones_do_no_harm(
    rmi_robot: Any, fake_client: FakeCellClient
) -> None:
    expected = (await rmi_robot.read_joints()).joints_rad
    for fault in ("split", "unasked"):
        await fake_client.inject_fault(fault, device=CASE.name)
        assert (await rmi_robot.read_joints()).joints_rad == expected
        await fake_client.send_command("clear")


async def test_a_packet_that_is_none_is_an_error_and_the_link_comes_back(
    rmi_robot: Any, fake_client: FakeCellClient
) -> None:
    await fake_client.inject_fault("garbage", device=CASE.name, count=1)
    with pytest.raises(WireProtocolError, match="no JSON"):
        await rmi_robot.read_joints()
    assert (await rmi_robot.read_joints()).joints_rad


async def test_a_second_client_learns_that_another_one_is_connected(rmi_robot: Any, cell: CellConfig) -> None:
    config = cell.robot_named(CASE.name).model_copy(update={"deadline_s": 0.5})
    with pytest.raises(DeviceTimeoutError):
        async with config.open() as other:
            await other.read_joints()
    assert (await rmi_robot.read_joints()).joints_rad  # the first one is not disturbed


async def test_a_fault_during_a_move_ends_it_with_the_alarm(
    rmi_robot: Any, fake_client: FakeCellClient
) -> None:
    move = asyncio.create_task(rmi_robot.move_joints(CASE.away_rad, speed_rad_s=CASE.slow_rad_s))
    await wait_until(lambda: _moves(fake_client))
    await fake_client.inject_fault(
        "alarm", device=CASE.name, text="SRVO-050 Collision Detect alarm (G:1 A:2)"
    )
    with pytest.raises(MotionStoppedError, match="SRVO-050"):
        await move


async def test_a_lost_encoder_is_named_and_no_move_is_ordered(
    rmi_robot: Any, fake_client: FakeCellClient
) -> None:
    await fake_client.inject_fault("alarm", device=CASE.name)
    condition = await rmi_robot.read_condition()
    assert condition.readiness is Readiness.POSITION_LOST
    assert "person at the pendant" in condition.remedy
    with pytest.raises(RefusedError, match="SRVO-062"):
        await rmi_robot.move_joints(CASE.away_rad, speed_rad_s=0.5)


async def test_links_cut_at_any_moment_leave_one_motion_and_the_right_place(
    rmi_robot: Any, fake_client: FakeCellClient
) -> None:
    missed, most_queued = await cut_links(rmi_robot, CASE, fake_client, CUTS, "hang_up")
    assert missed == 0
    assert most_queued <= 1


async def test_a_stop_is_seen_standing(rmi_robot: Any, fake_client: FakeCellClient) -> None:
    move = asyncio.create_task(rmi_robot.move_joints(CASE.away_rad, speed_rad_s=CASE.slow_rad_s))
    await wait_until(lambda: _moves(fake_client))
    began_s = time.monotonic()
    await rmi_robot.stop()
    print(f"standing after {time.monotonic() - began_s:.3f} s")
    assert not (await truth_of(fake_client))["moving"]
    with pytest.raises(MotionStoppedError):
        await move


async def _moves(fake_client: FakeCellClient) -> bool:
    return bool((await truth_of(fake_client))["moving"])


async def _stands(fake_client: FakeCellClient) -> bool:
    return not await _moves(fake_client)
