"""Primary interface, dashboard and script ports of the fake controller, and its faults."""

import asyncio
import math
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import numpy as np
import pytest

from tests.wire.fake_ur import fake_ur
from tests.wire.rtde_client import DEADLINE_S, RawRtde, start_client

SUB_PACKAGES = {
    0: 47,
    1: 251,
    2: 37,
    3: 75,
    4: 101,
    5: 225,
    6: 445,
    7: 61,
    8: 9,
    9: 53,
    10: 43,
    11: 26,
    12: 8,
}


@asynccontextmanager
async def open_connection(
    host: str, port: int
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    async with asyncio.timeout(DEADLINE_S):
        reader, writer = await asyncio.open_connection(host, port)
    try:
        yield reader, writer
    finally:
        writer.close()
        with suppress(ConnectionError):
            await writer.wait_closed()


async def robot_state(reader: asyncio.StreamReader) -> dict[int, bytes]:
    """Return the sub-packages of the next robot state, as a client must: message packages left aside."""
    while True:
        async with asyncio.timeout(DEADLINE_S):
            size, kind = struct.unpack(">iB", await reader.readexactly(5))
            body = await reader.readexactly(size - 5)
        if kind == 16:
            break
    parts = {}
    while body:
        length, sub = struct.unpack_from(">IB", body)
        parts[sub], body = body[5:length], body[length:]
    return parts


def flange_by_dh(
    theta: np.ndarray, a: np.ndarray, d: np.ndarray, alpha: np.ndarray, q: np.ndarray
) -> np.ndarray:
    pose = np.eye(4)
    for i in range(6):
        c, s, ca, sa = (
            math.cos(theta[i] + q[i]),
            math.sin(theta[i] + q[i]),
            math.cos(alpha[i]),
            math.sin(alpha[i]),
        )
        pose = pose @ np.array(
            [[c, -s * ca, s * sa, a[i] * c], [s, c * ca, -c * sa, a[i] * s], [0, sa, ca, d[i]], [0, 0, 0, 1]]
        )
    return pose


async def _read_on(client: RawRtde) -> None:
    while True:
        await client.read_package()


async def send_lines(host: str, *lines: str) -> list[str]:
    async with open_connection(host, 29999) as (reader, writer), asyncio.timeout(DEADLINE_S):
        assert await reader.readline() == b"Connected: Universal Robots Dashboard Server\n"
        answers = []
        for line in lines:
            writer.write(line.encode() + b"\n")
            answers.append((await reader.readline()).decode())
        assert all(answer.endswith("\n") and "\r" not in answer for answer in answers)
        return [answer[:-1] for answer in answers]


async def test_the_primary_interface_tells_a_calibration_that_explains_the_tool_pose() -> None:
    async with fake_ur() as robot:
        host = robot.server.address
        async with (
            await start_client(host, ["actual_q", "actual_TCP_pose"]) as rtde,
            open_connection(host, 30001) as (
                reader,
                _,
            ),
        ):
            state, values = await robot_state(reader), await rtde.read_package()
    assert {sub: len(body) + 5 for sub, body in state.items()} == SUB_PACKAGES
    theta, a, d, alpha = np.array(struct.unpack_from(">24d", state[5], 24)).reshape(4, 6)
    pose = flange_by_dh(theta, a, d, alpha, np.array(values["actual_q"]))
    assert pose[:3, 3] == pytest.approx(values["actual_TCP_pose"][:3], abs=1e-10)
    assert struct.unpack_from(">6d", state[4]) == pytest.approx(values["actual_TCP_pose"])
    assert [struct.unpack_from(">d", state[1], 41 * i)[0] for i in range(6)] == list(values["actual_q"])
    assert max(abs(d)) > 10.0  # nearly parallel joints: their common normals are far away and cancel
    assert struct.unpack_from(">i", state[6], 440 - 8)[0] == 2  # UR10


async def test_the_dashboard_answers_word_for_word() -> None:
    async with fake_ur() as robot:
        found = await send_lines(
            robot.server.address,
            "PolyscopeVersion",
            "get serial number",
            "robotmode",
            "safetystatus",
            "programState",
            "running",
            "stop",
            "close popup",
            "popup hello",
            "addToLog hello",
            "load a.urp",
            "get loaded program",
            "make tea",
            "quit",
        )
    assert found == [
        "URSoftware 5.11.1.108318 (Nov 18 2021)",
        "20225500042",
        "Robotmode: RUNNING",
        "Safetystatus: NORMAL",
        "STOPPED cell.urp",
        "Program running: false",
        "Stopped",
        "closing popup",
        "showing popup",
        "Added log message",
        "Loading program: a.urp",
        "Loaded program: a.urp",
        "could not understand: 'make tea'",
        "Disconnected",
    ]


async def test_power_comes_back_step_by_step_after_an_emergency_stop() -> None:
    async with fake_ur() as robot:
        host = robot.server.address
        async with await start_client(host, ["robot_mode", "safety_mode", "safety_status_bits"]) as rtde:
            await robot.inject_fault("emergency_stop", {})
            found = await rtde.wait_for("safety_mode", 7)
            assert found["robot_mode"] != 7
            assert found["safety_status_bits"] == 1 << 6 | 1 << 7 | 1 << 10
            assert await send_lines(host, "power on", "brake release") == ["Powering on", "Brake releasing"]
            assert (await rtde.read_package())["robot_mode"] == 3
            await robot.inject_fault("release_emergency_stop", {"power": False})
            await send_lines(host, "power on")
            await rtde.wait_for("robot_mode", 5)
            await send_lines(host, "brake release")
            assert (await rtde.wait_for("robot_mode", 7))["safety_status_bits"] == 1


async def test_a_protective_stop_is_unlocked_when_its_time_has_come() -> None:
    async with fake_ur() as robot:
        host = robot.server.address
        await robot.inject_fault("protective_stop", {"unlock_after_s": 3600.0})
        async with await start_client(host, ["safety_mode", "safety_status_bits"]) as rtde:
            assert (await rtde.wait_for("safety_mode", 3))["safety_status_bits"] == 1 << 2 | 1 << 10
        assert "until 5s" in (await send_lines(host, "unlock protective stop"))[0]
    async with fake_ur() as robot:
        await robot.inject_fault("protective_stop", {})
        assert await send_lines(robot.server.address, "unlock protective stop") == [
            "Protective stop releasing"
        ]
        assert robot.true_state()["safety_mode"] == "NORMAL"


@pytest.mark.parametrize("port", [30001, 30002, 30003])
async def test_a_program_sent_to_any_script_port_moves_the_arm(port: int) -> None:
    async with fake_ur(time_factor=20.0) as robot:
        target = [q + 0.2 for q in robot.true_state()["joints_rad"]]
        async with (
            await start_client(robot.server.address, ["runtime_state", "actual_q"]) as rtde,
            open_connection(robot.server.address, port) as (_, writer),
        ):
            writer.write(f"def go():\n\tmovej({target}, a=1.4, v=1.0)\nend\n".encode())
            await rtde.wait_for("runtime_state", 2)
            assert (await rtde.wait_for("runtime_state", 1))["actual_q"] == pytest.approx(target)


async def test_a_single_stop_line_ends_the_program_that_moves() -> None:
    async with fake_ur() as robot:
        host, start = robot.server.address, robot.true_state()["joints_rad"]
        async with (
            await start_client(host, ["actual_q", "actual_qd", "runtime_state"]) as rtde,
            open_connection(host, 30003) as (reader, writer),
        ):
            writer.write(f"def go():\n movej({[q + 2.0 for q in start]}, a=1.0, v=0.5)\nend\n".encode())
            while (await rtde.read_package())["actual_qd"][0] < 0.05:
                pass
            writer.write(b"stopj(4.0)\n")
            values = await rtde.wait_for("runtime_state", 1)
            while any(values["actual_qd"]):
                values = await rtde.read_package()
            assert values["actual_q"][0] - start[0] < 1.0
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(reader.read(1), 0.05)  # 30003 says nothing


async def test_in_local_control_nothing_starts() -> None:
    async with fake_ur() as robot:
        host = robot.server.address
        await robot.inject_fault("local_mode", {})
        assert (await send_lines(host, "is in remote control"))[0] == "false"
        assert "remote control" in (await send_lines(host, "play"))[0]
        async with (
            await start_client(host, ["runtime_state"]) as rtde,
            open_connection(host, 30003) as (_, writer),
        ):
            writer.write(b"def go():\n movej([0,0,0,0,0,0])\nend\n")
            assert {(await rtde.read_package())["runtime_state"] for _ in range(30)} == {1}
            await robot.inject_fault("remote_mode", {})
            writer.write(b"def go():\n sync()\nend\n")
            await rtde.wait_for("runtime_state", 2)


async def test_another_client_moves_the_robot() -> None:
    async with fake_ur(time_factor=20.0) as robot:
        before = robot.true_state()["joints_rad"]
        async with await start_client(robot.server.address, ["runtime_state", "actual_q"]) as rtde:
            await robot.inject_fault("other_client_moves", {"axis": "J2", "rad": 0.3})
            await rtde.wait_for("runtime_state", 2)
            after = (await rtde.wait_for("runtime_state", 1))["actual_q"]
        assert np.subtract(after, before) == pytest.approx([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])


async def test_a_cut_rtde_link_leaves_the_ports_open() -> None:
    async with fake_ur() as robot, await start_client(robot.server.address, ["timestamp"]) as rtde:
        await robot.inject_fault("link_loss_rtde", {})
        with pytest.raises((asyncio.IncompleteReadError, ConnectionError)):
            await _read_on(rtde)
        async with await start_client(robot.server.address, ["timestamp"]) as again:
            assert (await again.read_package())["timestamp"] > 0.0


async def test_closed_ports_refuse_and_open_again_when_the_fault_is_cleared() -> None:
    async with fake_ur() as robot:
        await robot.inject_fault("link_loss_all", {})
        for port in (30001, 30002, 30003, 30004, 29999):
            with pytest.raises(ConnectionRefusedError):
                await asyncio.open_connection(robot.server.address, port)
        robot.clear_faults()
        async with asyncio.timeout(DEADLINE_S):
            while True:
                try:
                    async with await start_client(robot.server.address, ["timestamp"]) as rtde:
                        await rtde.read_package()
                        break
                except ConnectionRefusedError:
                    await asyncio.sleep(0.01)


async def test_a_stalled_link_is_silent_both_ways_until_restored() -> None:
    async with fake_ur() as robot, await start_client(robot.server.address, ["timestamp"], 500.0) as rtde:
        await robot.inject_fault("link_stall", {})
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(_read_on(rtde), 0.3)
        assert robot.true_state()["connections"]["30004"] == 1
        await robot.inject_fault("link_restore", {})
        assert (await rtde.read_package())["timestamp"] > 0.0


async def test_names_that_the_controller_does_not_know_today() -> None:
    async with fake_ur() as robot, await RawRtde.connect(robot.server.address) as client:
        assert await client.negotiate_version()
        await robot.inject_fault("not_found", {"variable": "actual_q"})
        assert await client.set_up_outputs(["timestamp", "actual_q"]) == (0, ["DOUBLE", "NOT_FOUND"])
        robot.clear_faults()
        assert await client.set_up_outputs(["timestamp", "actual_q"]) == (1, ["DOUBLE", "VECTOR6D"])


async def test_a_late_script_runs_later_and_unknown_faults_are_refused() -> None:
    async with (
        fake_ur() as robot,
        await start_client(robot.server.address, ["timestamp", "runtime_state"]) as rtde,
    ):
        await robot.inject_fault("late_script", {"delay_s": 0.4})
        async with open_connection(robot.server.address, 30003) as (_, writer):
            sent = (await rtde.read_package())["timestamp"]
            writer.write(b"def go():\n sync()\nend\n")
            assert (await rtde.wait_for("runtime_state", 2))["timestamp"] - sent >= 0.4
        with pytest.raises(ValueError, match="no fault is called 'tea_break'"):
            await robot.inject_fault("tea_break", {})
        with pytest.raises(ValueError, match="does not know degrees"):
            await robot.inject_fault("other_client_moves", {"degrees": 3})


async def test_a_frozen_controller_repeats_its_last_packet() -> None:
    async with fake_ur() as robot, await start_client(robot.server.address, ["timestamp"]) as rtde:
        await rtde.read_package()
        await robot.inject_fault("frozen", {})
        last = -1.0
        while (now := (await rtde.read_package())["timestamp"]) != last:
            last = now
        assert {(await rtde.read_package())["timestamp"] for _ in range(20)} == {last}
        robot.clear_faults()
        async with asyncio.timeout(DEADLINE_S):
            while (await rtde.read_package())["timestamp"] == last:
                pass


async def test_a_hand_moves_the_arm_and_the_controller_knows() -> None:
    async with fake_ur() as robot:
        before = robot.true_state()["joints_rad"]
        async with await start_client(robot.server.address, ["actual_q"]) as rtde:
            await robot.inject_fault("hand_moves", {"axis": "J6", "rad": -0.25})
            async with asyncio.timeout(DEADLINE_S):
                while (after := (await rtde.read_package())["actual_q"]) == tuple(before):
                    pass
        assert np.subtract(after, before) == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.0, -0.25])


async def test_power_off_in_a_move_stops_the_arm_at_once() -> None:
    async with fake_ur() as robot:
        host, start = robot.server.address, robot.true_state()["joints_rad"]
        async with (
            await start_client(host, ["actual_q", "actual_qd", "robot_mode"]) as rtde,
            open_connection(host, 30003) as (_, writer),
        ):
            writer.write(f"def go():\n movej({[q + 2.0 for q in start]}, a=1.0, v=0.5)\nend\n".encode())
            while (await rtde.read_package())["actual_qd"][0] < 0.05:
                pass
            assert await send_lines(host, "power off") == ["Powering off"]
            values = await rtde.wait_for("robot_mode", 3)
            assert not any(values["actual_qd"])
            assert (await rtde.read_package())["actual_q"] == values["actual_q"]


async def test_a_move_beyond_a_joint_limit_is_a_protective_stop() -> None:
    async with fake_ur(time_factor=50.0) as robot:
        host = robot.server.address
        async with (
            await start_client(host, ["actual_q", "safety_mode"]) as rtde,
            open_connection(host, 30002) as (_, writer),
        ):
            writer.write(b"def go():\n movej([7.0,-1.5,-1.5,-1.5,1.5,0.0], a=1.4, v=1.0)\nend\n")
            stopped = await rtde.wait_for("safety_mode", 3)
            assert -math.pi / 2 <= stopped["actual_q"][0] <= 2 * math.pi
