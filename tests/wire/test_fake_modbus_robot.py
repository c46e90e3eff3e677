"""The fake controller against its setup document: through pymodbus, and byte by byte on a bare socket."""

import asyncio
import struct
from collections.abc import AsyncIterator
from typing import Any

import numpy as np
import pytest
import pytest_asyncio
from pymodbus.client import AsyncModbusTcpClient

from cellcal.fake_devices.arm_models import COUNTS_PER_TURN
from cellcal.fake_devices.cell import FakeCell
from cellcal.fake_devices.kinematics import matrix_from_xyzwpr
from cellcal.fake_devices.modbus_robot.device import FakeModbusRobot
from cellcal.fake_devices.modbus_robot.program import HEARTBEAT_S, RefusalReason, RequestState
from cellcal.fake_devices.world import World
from tests.machine_speed import stretched_s
from tests.wire.fake_cells import (
    cause_fault,
    float32_words,
    floats_from,
    int32_words,
    integers_from,
    run_cell,
    text_from,
    wait_until,
)

JOINT_MOVE, JOG, CALIBRATE, RESET, SELECT_TOOL, SELECT_FRAME = range(1, 7)


class ModbusHost:
    """Plays CELLCAL's host with pymodbus."""

    def __init__(self, cell: FakeCell) -> None:
        robot = cell.robots[0]
        assert isinstance(robot, FakeModbusRobot)
        self.cell, self.robot, self.world = cell, robot, cell.world
        self.number = 0
        self.client = AsyncModbusTcpClient(
            "127.0.0.1", port=robot.server.port, timeout=stretched_s(5.0), retries=0
        )

    async def read_registers(self, address: int, count: int) -> list[int]:
        response = await self.client.read_holding_registers(address - 1, count=count)
        assert not response.isError(), response
        return list(response.registers)

    async def write_registers(self, address: int, words: list[int]) -> None:
        response = await self.client.write_registers(address - 1, words)
        assert not response.isError(), response

    async def begin_operation(
        self, operation: int, *, axis: int = 0, target: Any = (0.0,) * 6, speed: float = 50.0
    ) -> None:
        self.number += 1
        target = [*target, *([0.0] * (6 - len(target)))]
        await self.write_registers(
            3003, int32_words(operation, axis) + float32_words(*target, speed) + int32_words(0, self.number)
        )
        await self.write_registers(3001, int32_words(self.number))

    async def read_status(self) -> tuple[int, RequestState, RefusalReason, bool]:
        number, state, reason, moving = integers_from(await self.read_registers(3041, 8))
        return number, RequestState(state), RefusalReason(reason), bool(moving)

    async def run_operation(self, operation: int, **arguments: Any) -> tuple[RequestState, RefusalReason]:
        """Start an operation and wait for its end, keeping the heartbeat up."""
        await self.begin_operation(operation, **arguments)
        beat = 1000
        async with asyncio.timeout(stretched_s(30.0)):
            while True:
                number, state, reason, _ = await self.read_status()
                assert number == self.number
                if state is not RequestState.RUNNING:
                    return state, reason
                beat += 1
                await self.write_registers(3023, int32_words(beat))

    async def joints_deg(self) -> list[float]:
        return floats_from(await self.read_registers(27, 12))

    async def read_alarms(self) -> list[tuple[int, int, str]]:
        found = []
        for place in range(5):
            words = await self.read_registers(2001 + 100 * place, 51)
            found.append((words[0], words[1], text_from(words[11:51])))
        return [alarm for alarm in found if alarm[0] != 0]

    async def power_cycle(self) -> None:
        await cause_fault(self.robot, "power_cycle", off_s=1.0)
        await self.reconnect()

    async def reconnect(self) -> None:
        await wait_until(lambda: self.robot.controller.powered and self.robot.server.is_listening)
        self.client.close()
        assert await self.client.connect()

    async def lose_battery(self, **parameters: Any) -> None:
        await cause_fault(self.robot, "battery_loss", **parameters)
        await self.reconnect()

    async def establish_pulses(self) -> None:
        """Lead the controller from the battery alarm to pulses established."""
        await cause_fault(self.robot, "new_battery")
        await self.write_registers(103, int32_words(1))
        await self.power_cycle()
        for axis in range(1, 7):
            assert await self.run_operation(JOG, axis=axis, target=[8.0], speed=5.0) == (
                RequestState.DONE,
                RefusalReason.NONE,
            )
        assert await self.run_operation(RESET) == (RequestState.DONE, RefusalReason.NONE)


@pytest_asyncio.fixture
async def host() -> AsyncIterator[ModbusHost]:
    async with run_cell() as cell:
        player = ModbusHost(cell)
        assert await player.client.connect()
        try:
            yield player
        finally:
            player.client.close()


# registers


async def test_the_position_block_is_laid_out_as_the_document_says(host: ModbusHost):
    words = await host.read_registers(1, 50)
    assert floats_from(words[26:38]) == pytest.approx([-20.0, 10.0, -25.0, 15.0, -60.0, 20.0], abs=1e-4)
    assert words[25] == words[44] == 1
    assert words[45:47] == [0, 1]
    tool = matrix_from_xyzwpr(floats_from(await host.read_registers(501, 12)))
    arm = host.robot.controller.arm
    tip = arm.believed_flange(np.radians(floats_from(words[26:38])))[0] @ tool
    assert matrix_from_xyzwpr(floats_from(words[:12])) == pytest.approx(tip, abs=1e-5)


async def test_a_32_bit_value_is_sent_low_word_first_and_a_word_high_byte_first(host: ModbusHost):
    count = host.robot.controller.coders.read_counts()[0]
    frame = await exchange_pdu(host, bytes.fromhex("03 003e 0002"))
    assert frame[:2] == bytes([3, 4])
    low, high = struct.unpack(">HH", frame[2:])
    assert struct.unpack("<i", struct.pack("<HH", low, high))[0] == count


async def test_joints_follow_from_counts_mastering_and_interaction(host: ModbusHost):
    zero, counts = (
        integers_from(await host.read_registers(51, 12)),
        integers_from(await host.read_registers(63, 12)),
    )
    interaction = np.array(floats_from(await host.read_registers(131, 72))).reshape(6, 6)
    joints = np.degrees(interaction @ (np.array(counts, dtype=float) - zero))
    assert joints == pytest.approx(await host.joints_deg(), abs=1e-4)
    assert interaction[4, 3] != 0.0
    per_degree, inverse_ratio = (
        floats_from(await host.read_registers(107, 12)),
        floats_from(await host.read_registers(119, 12)),
    )
    turn = np.array(per_degree) * 360.0 * np.array(inverse_ratio)
    assert turn == pytest.approx([float(COUNTS_PER_TURN)] * 6, rel=1e-6)
    assert np.abs(1.0 / np.diag(interaction)) == pytest.approx(np.degrees(per_degree), rel=1e-6)


async def test_identity(host: ModbusHost):
    assert text_from(await host.read_registers(301, 40)) == "F-104711"
    assert text_from(await host.read_registers(341, 40)) == "M-6iB"
    assert text_from(await host.read_registers(381, 40)).startswith("V7")


async def test_unused_registers_read_zero_and_swallow_writes(host: ModbusHost):
    await host.write_registers(10001, [1, 2, 3])
    assert await host.read_registers(10001, 3) == [0, 0, 0]
    await host.write_registers(63, int32_words(1, 2, 3))
    assert integers_from(await host.read_registers(63, 12)) == list(
        host.robot.controller.coders.read_counts()
    )


async def test_half_a_value_cannot_be_written(host: ModbusHost):
    before = await host.read_registers(51, 12)
    response = await host.client.write_register(50, 7)
    assert response.isError()
    assert response.exception_code == 3
    response = await host.client.write_registers(51, [7, 7])
    assert response.exception_code == 3
    assert await host.read_registers(51, 12) == before


async def test_the_program_counter_runs(host: ModbusHost):
    async def read_counter() -> int:
        return integers_from(await host.read_registers(3053, 2))[0]

    first = await read_counter()
    async with asyncio.timeout(stretched_s(10.0)):
        while await read_counter() == first:
            continue


async def test_tools_and_frames_are_written_and_shape_the_position(host: ModbusHost):
    await host.write_registers(551, float32_words(1.0, 2.0, 3.0, 10.0, 20.0, 30.0))
    await host.write_registers(1001, float32_words(100.0, 0.0, 0.0, 0.0, 0.0, 90.0))
    assert floats_from(await host.read_registers(551, 12)) == pytest.approx([1, 2, 3, 10, 20, 30])
    assert (await host.read_registers(576, 1))[0] == 1
    assert await host.run_operation(SELECT_TOOL, axis=2) == (RequestState.DONE, RefusalReason.NONE)
    assert await host.run_operation(SELECT_FRAME, axis=1) == (RequestState.DONE, RefusalReason.NONE)
    words = await host.read_registers(1, 50)
    assert words[45:47] == [1, 2]
    flange = host.robot.controller.arm.believed_flange(np.radians(floats_from(words[26:38])))[0]
    user, tool = matrix_from_xyzwpr([100, 0, 0, 0, 0, 90]), matrix_from_xyzwpr([1, 2, 3, 10, 20, 30])
    assert user @ matrix_from_xyzwpr(floats_from(words[:12])) == pytest.approx(flange @ tool, abs=1e-5)
    assert await host.run_operation(SELECT_TOOL, axis=11) == (RequestState.REFUSED, RefusalReason.BAD_NUMBER)
    assert await host.run_operation(SELECT_FRAME, axis=10) == (RequestState.REFUSED, RefusalReason.BAD_NUMBER)


# telegrams


class RawSocket:
    """A bare socket."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def send_pdu(self, pdu: bytes, tid: int = 1, unit: int = 9) -> None:
        self.writer.write(struct.pack(">HHHB", tid, 0, len(pdu) + 1, unit) + pdu)
        await self.writer.drain()

    async def receive_frame(self) -> tuple[int, int, int, bytes]:
        async with asyncio.timeout(stretched_s(10.0)):
            tid, protocol, length, unit = struct.unpack(">HHHB", await self.reader.readexactly(7))
            return tid, protocol, unit, await self.reader.readexactly(length - 1)

    async def read_rest(self) -> bytes:
        async with asyncio.timeout(stretched_s(10.0)):
            return await self.reader.read(1000)

    async def close(self) -> None:
        self.writer.close()
        try:
            await self.writer.wait_closed()
        except ConnectionError:
            return


@pytest_asyncio.fixture
async def raw_socket(host: ModbusHost) -> AsyncIterator[RawSocket]:
    connection = RawSocket(*await asyncio.open_connection("127.0.0.1", host.robot.server.port))
    yield connection
    await connection.close()


async def exchange_pdu(host: ModbusHost, pdu: bytes) -> bytes:
    connection = RawSocket(*await asyncio.open_connection("127.0.0.1", host.robot.server.port))
    await connection.send_pdu(pdu)
    *_, answer = await connection.receive_frame()
    await connection.close()
    return answer


READ = bytes.fromhex("03 0c00 0002")  # R 3073-3074: unused, reads zero


async def test_an_answer_carries_transaction_and_unit_of_its_request(raw_socket: RawSocket):
    await raw_socket.send_pdu(READ, tid=0xBEEF, unit=200)
    assert await raw_socket.receive_frame() == (0xBEEF, 0, 200, bytes.fromhex("03 04 0000 0000"))


async def test_two_requests_in_one_segment_get_two_answers(raw_socket: RawSocket):
    frame = struct.pack(">HHHB", 5, 0, 6, 1) + READ
    raw_socket.writer.write(frame + frame.replace(b"\x00\x05", b"\x00\x06", 1))
    assert [(await raw_socket.receive_frame())[0] for _ in range(2)] == [5, 6]


async def test_a_request_may_come_byte_by_byte(raw_socket: RawSocket):
    for byte in struct.pack(">HHHB", 5, 0, 6, 1) + READ:
        raw_socket.writer.write(bytes([byte]))
        await raw_socket.writer.drain()
        await asyncio.sleep(0)
    assert (await raw_socket.receive_frame())[3] == bytes.fromhex("03 04 0000 0000")


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("01 0000 0009", "01 02 0000"),
        ("02 0000 0001", "02 01 00"),
        ("04 0000 0001", "04 02 0000"),
        ("05 0003 ff00", "05 0003 ff00"),
        ("06 2710 0001", "06 2710 0001"),
        ("0f 0000 0008 01 ff", "0f 0000 0008"),
        ("10 2710 0001 02 0001", "10 2710 0001"),
        ("03 0000 0000", "83 03"),
        ("03 0000 007e", "83 03"),
        ("03 ffff 0002", "83 02"),
        ("10 2710 0002 02 0001", "90 03"),
        ("10 ffff 0002 04 0001 0001", "90 02"),
        ("06 0032 0001", "86 03"),
        ("03 00", "83 03"),
        ("2b 0e 01 00", "ab 01"),
        ("41", "c1 01"),
    ],
)
async def test_every_function_code_answers_as_the_specification_says(
    host: ModbusHost, request_hex, answer_hex
):
    assert await exchange_pdu(host, bytes.fromhex(request_hex)) == bytes.fromhex(answer_hex)


async def test_garbage_ends_the_connection(raw_socket: RawSocket):
    raw_socket.writer.write(b"GET / HTTP/1.1\r\n\r\n")
    assert await raw_socket.read_rest() == b""


async def test_beyond_its_limit_the_oldest_connection_is_dropped(host: ModbusHost):
    others = [
        RawSocket(*await asyncio.open_connection("127.0.0.1", host.robot.server.port)) for _ in range(4)
    ]
    await others[-1].send_pdu(READ)
    assert (await others[-1].receive_frame())[3][0] == 3
    await wait_until(lambda: host.robot.server.client_count == 4)
    for other in others:
        await other.close()


# moving


async def test_a_joint_move_ends_at_its_target(host: ModbusHost):
    target = [10.0, 20.0, -10.0, 30.0, -40.0, 50.0]
    assert await host.run_operation(JOINT_MOVE, target=target) == (RequestState.DONE, RefusalReason.NONE)
    assert await host.joints_deg() == pytest.approx(target, abs=2e-3)


async def test_a_request_number_counts_once(host: ModbusHost):
    await host.run_operation(JOG, axis=1, target=[5.0])
    before = await host.joints_deg()
    await host.write_registers(3007, float32_words(7.0))
    await host.write_registers(3001, int32_words(host.number))
    assert (await host.read_status())[1] is RequestState.DONE
    assert await host.joints_deg() == pytest.approx(before, abs=1e-4)


async def test_a_jog_turns_one_axis_and_holds_the_others(host: ModbusHost):
    before = await host.joints_deg()
    assert await host.run_operation(JOG, axis=4, target=[30.0]) == (RequestState.DONE, RefusalReason.NONE)
    moved = np.array(await host.joints_deg()) - before
    assert moved == pytest.approx([0, 0, 0, 30, 0, 0], abs=2e-3)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"operation": JOINT_MOVE, "target": [171.0]}, RefusalReason.AXIS_LIMIT),
        ({"operation": JOINT_MOVE, "target": [float("nan")]}, RefusalReason.BAD_NUMBER),
        ({"operation": JOINT_MOVE, "speed": 0.0}, RefusalReason.BAD_NUMBER),
        ({"operation": JOINT_MOVE, "speed": float("inf")}, RefusalReason.BAD_NUMBER),
        ({"operation": JOG, "axis": 0, "target": [1.0]}, RefusalReason.BAD_NUMBER),
        ({"operation": JOG, "axis": 7, "target": [1.0]}, RefusalReason.BAD_NUMBER),
        ({"operation": JOG, "axis": 1, "target": [200.0]}, RefusalReason.AXIS_LIMIT),
        ({"operation": 99}, RefusalReason.BAD_OPERATION),
        ({"operation": 0}, RefusalReason.BAD_OPERATION),
    ],
)
async def test_what_cannot_be_done_is_refused_with_its_reason(host: ModbusHost, arguments, reason):
    before = await host.joints_deg()
    assert await host.run_operation(arguments.pop("operation"), **arguments) == (RequestState.REFUSED, reason)
    assert await host.joints_deg() == before


async def test_without_a_heartbeat_the_arm_stops(host: ModbusHost):
    host.world.clock.time_factor = 1.0
    host.robot.controller.program.heartbeat_s = HEARTBEAT_S
    await host.begin_operation(JOINT_MOVE, target=[160.0, 10.0, -25.0, 15.0, -60.0, 20.0], speed=10.0)
    assert (await host.read_status())[1] is RequestState.RUNNING
    await wait_until(lambda: host.robot.controller.program.state is RequestState.STOPPED)
    number, state, reason, moving = await host.read_status()
    assert (number, state, reason, moving) == (
        host.number,
        RequestState.STOPPED,
        RefusalReason.HEARTBEAT_MISSING,
        False,
    )
    assert -20.0 < (await host.joints_deg())[0] < 0.0


async def test_the_host_can_stop_and_must_take_the_stop_back(host: ModbusHost):
    host.world.clock.time_factor = 5.0
    await host.begin_operation(JOINT_MOVE, target=[160.0, 10.0, -25.0, 15.0, -60.0, 20.0], speed=20.0)
    await host.write_registers(3021, int32_words(1))
    await wait_until(lambda: host.robot.controller.program.state is RequestState.STOPPED)
    assert (await host.read_status())[2:] == (RefusalReason.HOST_STOP, False)
    await host.write_registers(3001, int32_words(77))
    assert (await host.read_status())[:3] == (77, RequestState.REFUSED, RefusalReason.HOST_STOP)
    await host.write_registers(3021, int32_words(0))
    host.number = 77
    assert await host.run_operation(JOG, axis=1, target=[1.0]) == (RequestState.DONE, RefusalReason.NONE)


async def test_a_second_request_is_refused_as_busy_and_the_first_goes_on(host: ModbusHost):
    host.world.clock.time_factor = 20.0
    await host.begin_operation(JOG, axis=1, target=[20.0], speed=20.0)
    await host.begin_operation(JOG, axis=2, target=[20.0])
    assert (await host.read_status())[:3] == (host.number, RequestState.REFUSED, RefusalReason.BUSY)
    await wait_until(lambda: not host.robot.controller.arm.is_moving)
    assert (await host.joints_deg())[:2] == pytest.approx([0.0, 10.0], abs=2e-3)


async def test_an_emergency_stop_stops_and_wants_release_and_reset(host: ModbusHost):
    host.world.clock.time_factor = 5.0
    await host.begin_operation(JOG, axis=1, target=[90.0], speed=20.0)
    await cause_fault(host.robot, "emergency_stop")
    await wait_until(lambda: host.robot.controller.program.state is RequestState.STOPPED)
    assert (await host.read_status())[2] is RefusalReason.EMERGENCY_STOP
    assert integers_from(await host.read_registers(3051, 2)) == [1]
    assert (11, 1, "Operator panel E-stop") in await host.read_alarms()
    assert await host.run_operation(RESET) == (RequestState.REFUSED, RefusalReason.EMERGENCY_STOP)
    await cause_fault(host.robot, "release_emergency_stop")
    assert await host.run_operation(JOG, axis=1, target=[1.0]) == (
        RequestState.REFUSED,
        RefusalReason.ALARM_ACTIVE,
    )
    assert await host.run_operation(RESET) == (RequestState.DONE, RefusalReason.NONE)
    assert await host.run_operation(JOG, axis=1, target=[1.0]) == (RequestState.DONE, RefusalReason.NONE)
    assert await host.read_alarms() == []


async def test_only_auto_moves(host: ModbusHost):
    await cause_fault(host.robot, "t1_mode")
    assert integers_from(await host.read_registers(3049, 2)) == [2]
    assert await host.run_operation(JOG, axis=1, target=[1.0]) == (
        RequestState.REFUSED,
        RefusalReason.NOT_AUTO,
    )
    await cause_fault(host.robot, "auto_mode")
    assert await host.run_operation(JOG, axis=1, target=[1.0]) == (RequestState.DONE, RefusalReason.NONE)


async def test_the_override_slows_down(host: ModbusHost):
    host.world.clock.time_factor = 0.0
    await host.write_registers(105, int32_words(10))
    await host.begin_operation(JOG, axis=1, target=[20.0], speed=20.0)
    host.world.clock.advance(2.0)
    assert np.degrees(host.robot.controller.arm.joint_velocity[0]) == pytest.approx(2.0, rel=1e-6)
    await host.write_registers(105, int32_words(900))
    assert integers_from(await host.read_registers(105, 2)) == [100]


async def test_a_move_that_ends_early_says_done(host: ModbusHost):
    host.world.clock.time_factor = 5.0
    await host.begin_operation(JOG, axis=1, target=[90.0], speed=20.0)
    await cause_fault(host.robot, "early_stop")
    await wait_until(lambda: host.robot.controller.program.state is RequestState.DONE)
    assert (await host.joints_deg())[0] < 60.0


async def test_another_host_can_move_the_arm(host: ModbusHost):
    before = await host.joints_deg()
    await cause_fault(host.robot, "jog_by_hand", axis="J2", rad=0.05)
    await wait_until(lambda: not host.robot.controller.arm.is_moving)
    moved = np.array(await host.joints_deg()) - before
    assert moved == pytest.approx([0, np.degrees(0.05), 0, 0, 0, 0], abs=2e-3)


# losing and finding the position


async def test_a_dead_battery_takes_the_position_and_everything_says_so(host: ModbusHost):
    epoch = integers_from(await host.read_registers(203, 2))[0]
    await host.lose_battery()
    assert integers_from(await host.read_registers(203, 2))[0] == epoch + 1
    assert integers_from(await host.read_registers(99, 2)) == [0]
    assert (await host.read_registers(26, 1)) == [0]
    alarms = await host.read_alarms()
    assert alarms[0] == (11, 62, "BZAL alarm (Group:1 Axis:1)")
    assert len(alarms) == 5
    assert await host.run_operation(JOG, axis=1, target=[1.0]) == (
        RequestState.REFUSED,
        RefusalReason.ALARM_ACTIVE,
    )
    assert await host.run_operation(CALIBRATE) == (RequestState.REFUSED, RefusalReason.ALARM_ACTIVE)
    assert await host.run_operation(RESET) == (RequestState.REFUSED, RefusalReason.ALARM_ACTIVE)
    assert any(host.robot.true_state()["turns_lost"])


async def test_an_acknowledgement_waits_for_the_power_and_needs_a_battery(host: ModbusHost):
    await host.lose_battery()
    await host.write_registers(103, int32_words(1))
    assert integers_from(await host.read_registers(103, 2)) == [1]
    assert await host.run_operation(JOG, axis=1, target=[1.0]) == (
        RequestState.REFUSED,
        RefusalReason.POWER_CYCLE_NEEDED,
    )
    assert await host.run_operation(RESET) == (RequestState.REFUSED, RefusalReason.POWER_CYCLE_NEEDED)
    await host.power_cycle()
    assert (await host.read_alarms())[0][1] == 62  # the battery is still dead
    await cause_fault(host.robot, "new_battery")
    await host.write_registers(103, int32_words(1))
    await host.power_cycle()
    assert (await host.read_alarms())[0] == (11, 75, "Pulse not established (Group:1 Axis:1)")


async def test_after_one_turn_of_every_motor_the_pulses_are_established(host: ModbusHost):
    await host.lose_battery()
    await cause_fault(host.robot, "new_battery")
    await host.write_registers(103, int32_words(1))
    await host.power_cycle()
    assert await host.run_operation(JOINT_MOVE) == (RequestState.REFUSED, RefusalReason.NOT_MASTERED)
    assert await host.run_operation(CALIBRATE) == (RequestState.REFUSED, RefusalReason.PULSE_NOT_ESTABLISHED)
    assert await host.run_operation(RESET) == (RequestState.REFUSED, RefusalReason.PULSE_NOT_ESTABLISHED)
    for axis in range(1, 7):
        assert await host.run_operation(JOG, axis=axis, target=[8.0], speed=50.0) == (
            RequestState.DONE,
            RefusalReason.NONE,
        )
    assert await host.run_operation(RESET) == (RequestState.DONE, RefusalReason.NONE)
    assert await host.read_alarms() == []
    assert await host.run_operation(JOINT_MOVE) == (RequestState.REFUSED, RefusalReason.NOT_MASTERED)


async def test_whole_turns_written_back_restore_the_zero_exactly(host: ModbusHost):
    zero = integers_from(await host.read_registers(51, 12))
    await host.lose_battery(drift_turns=2.0)
    await host.establish_pulses()
    truth = host.robot.true_state()
    right = [old - lost * COUNTS_PER_TURN for old, lost in zip(zero, truth["turns_lost"], strict=True)]
    assert right == truth["true_counts_at_zero"]
    assert host.world.tcp_error_m("fanuc").max() > 0.01
    await host.write_registers(51, int32_words(*right))
    assert host.robot.controller.is_mastered is False
    assert await host.run_operation(CALIBRATE) == (RequestState.DONE, RefusalReason.NONE)
    assert integers_from(await host.read_registers(99, 2)) == [1]
    assert host.world.tcp_error_m("fanuc").max() < 1e-9
    assert np.radians(await host.joints_deg()) == pytest.approx(truth["joints_rad"], abs=1e-5)
    await host.power_cycle()
    assert await host.read_alarms() == []
    assert host.robot.controller.is_mastered is True


async def test_one_turn_wrong_on_one_motor_is_millimetres_at_the_tip(host: ModbusHost):
    wrong = integers_from(await host.read_registers(51, 12))
    wrong[2] += COUNTS_PER_TURN
    await host.write_registers(51, int32_words(*wrong))
    assert host.world.tcp_error_m("fanuc").max() > 0.01
    assert host.robot.controller.shown_joints() == pytest.approx(
        host.robot.controller.arm.joints_rad, abs=1e-5
    )
    await host.run_operation(CALIBRATE)
    assert abs(host.robot.controller.shown_joints()[2] - host.robot.controller.arm.joints_rad[2]) > 0.01


async def test_a_battery_lost_on_one_axis_leaves_the_others_alone(host: ModbusHost):
    await host.lose_battery(axes=["J5"])
    truth = host.robot.true_state()
    assert [alarm["axis"] for alarm in truth["alarms"]] == [4]
    assert [turns for axis, turns in enumerate(truth["turns_lost"]) if axis != 4] == [0] * 5


async def test_a_new_motor_is_off_by_a_fraction_of_a_turn_on_its_axis_only(host: ModbusHost):
    await cause_fault(host.robot, "motor_exchange", axis="J3")
    await host.reconnect()
    await host.establish_pulses()
    shift = (
        np.array(host.robot.true_state()["true_counts_at_zero"])
        - host.robot.true_state()["factory_counts_at_zero"]
    )
    fraction = shift % COUNTS_PER_TURN
    assert 0.05 < fraction[2] / COUNTS_PER_TURN < 0.95
    assert not fraction[[0, 1, 3, 4, 5]].any()


async def test_a_lost_reference_is_off_by_fractions_everywhere(host: ModbusHost):
    await cause_fault(host.robot, "reference_loss", battery="new")
    await host.reconnect()
    await host.establish_pulses()
    shift = (
        np.array(host.robot.true_state()["true_counts_at_zero"])
        - host.robot.true_state()["factory_counts_at_zero"]
    )
    assert (shift % COUNTS_PER_TURN != 0).all()


async def test_a_crash_bends_the_arm_for_good(host: ModbusHost):
    before = np.array(host.robot.true_state()["dh"])
    await cause_fault(host.robot, "crash")
    await host.reconnect()
    await host.establish_pulses()
    bent = np.abs(np.array(host.robot.true_state()["dh"]) - before)
    assert 2e-3 <= bent[:, 1:3].max() <= 5e-3
    assert np.radians(0.3) <= bent[:, [0, 3]].max() <= np.radians(0.6)
    await host.write_registers(51, int32_words(*host.robot.true_state()["true_counts_at_zero"]))
    await host.run_operation(CALIBRATE)
    assert host.world.tcp_error_m("fanuc").max() > 2e-3


async def test_a_dead_battery_forgets_again_at_every_power_cycle(host: ModbusHost):
    await host.lose_battery(axes=["J1"])
    await host.write_registers(103, int32_words(1))
    await host.power_cycle()
    await host.power_cycle()
    assert [alarm[1] for alarm in await host.read_alarms()] == [62]


async def test_a_refused_axis_keeps_its_old_mastering_count(host: ModbusHost):
    before = integers_from(await host.read_registers(51, 12))
    await cause_fault(host.robot, "partial_write", axis="J4")
    await host.write_registers(51, int32_words(*(count + 100 for count in before)))
    after = integers_from(await host.read_registers(51, 12))
    assert [new - old for new, old in zip(after, before, strict=True)] == [100, 100, 100, 0, 100, 100]
    host.robot.clear_faults()
    await host.write_registers(51, int32_words(*before))
    assert integers_from(await host.read_registers(51, 12)) == before


async def test_a_low_battery_is_a_warning_that_lets_the_arm_move(host: ModbusHost):
    await cause_fault(host.robot, "battery_low", axes=["J2"])
    assert await host.read_alarms() == [(11, 65, "BLAL alarm (Group:1 Axis:2)")]
    assert await host.run_operation(JOG, axis=1, target=[1.0]) == (RequestState.DONE, RefusalReason.NONE)


async def test_unmastered_an_axis_runs_into_its_stop(host: ModbusHost):
    await host.lose_battery()
    await host.establish_pulses()
    assert await host.run_operation(JOG, axis=5, target=[-200.0], speed=5.0) == (
        RequestState.STOPPED,
        RefusalReason.ALARM_ACTIVE,
    )
    assert (11, 50, "CLALM alarm (Group:1 Axis:5)") in await host.read_alarms()
    assert np.degrees(host.robot.true_state()["joints_rad"][4]) == pytest.approx(-148.0, abs=1e-6)
    assert await host.run_operation(RESET) == (RequestState.DONE, RefusalReason.NONE)
    assert await host.run_operation(JOG, axis=5, target=[20.0], speed=5.0) == (
        RequestState.DONE,
        RefusalReason.NONE,
    )


async def test_unmastered_an_axis_is_slow(host: ModbusHost):
    await host.lose_battery()
    await host.establish_pulses()
    host.world.clock.time_factor = 0.0
    await host.begin_operation(JOG, axis=1, target=[20.0], speed=40.0)
    host.world.clock.advance(2.0)
    assert np.degrees(host.robot.controller.arm.joint_velocity[0]) == pytest.approx(5.0, rel=1e-6)


async def test_a_power_cycle_drops_the_connection_and_forgets_the_handshake(host: ModbusHost):
    await host.run_operation(JOG, axis=1, target=[1.0])
    connection = RawSocket(*await asyncio.open_connection("127.0.0.1", host.robot.server.port))
    await cause_fault(host.robot, "power_off")
    await wait_until(lambda: host.robot.server.client_count == 0)
    await connection.close()
    with pytest.raises(ConnectionRefusedError):
        await asyncio.open_connection("127.0.0.1", host.robot.server.port)
    await cause_fault(host.robot, "power_on")
    await host.reconnect()
    assert await host.read_status() == (0, RequestState.IDLE, RefusalReason.NONE, False)
    assert host.robot.controller.is_mastered


async def test_losses_are_drawn_from_the_seed():
    lost = []
    for _ in range(2):
        async with run_cell(seed=9) as cell:
            await cell.robots[0].inject_fault("battery_loss", {"off_s": 0.0})
            lost.append(cell.robots[0].true_state()["turns_lost"])
    assert lost[0] == lost[1]


# link faults


async def test_a_slow_answer_comes_late_but_right(host: ModbusHost, raw_socket: RawSocket):
    await cause_fault(host.robot, "slow", delay_s=0.05, count=1)
    await raw_socket.send_pdu(READ, tid=3)
    assert (await raw_socket.receive_frame())[0] == 3


async def test_silence_obeys_nothing_and_a_lost_reply_obeys(host: ModbusHost, raw_socket: RawSocket):
    write = bytes.fromhex("10 0032 0002 04 0001 0000")
    before = host.robot.controller.counts_at_zero[0]
    await cause_fault(host.robot, "silent", count=1)
    await raw_socket.send_pdu(write, tid=1)
    await raw_socket.send_pdu(READ, tid=2)
    assert (await raw_socket.receive_frame())[0] == 2
    assert host.robot.controller.counts_at_zero[0] == before
    await cause_fault(host.robot, "lost_reply", count=1)
    await raw_socket.send_pdu(write, tid=3)
    await raw_socket.send_pdu(READ, tid=4)
    assert (await raw_socket.receive_frame())[0] == 4
    assert host.robot.controller.counts_at_zero[0] == 1


async def test_a_late_answer_comes_before_the_next_under_its_own_number(
    host: ModbusHost, raw_socket: RawSocket
):
    await cause_fault(host.robot, "late")
    await raw_socket.send_pdu(READ, tid=10)
    await raw_socket.send_pdu(bytes.fromhex("03 012c 0001"), tid=11)
    first, second = await raw_socket.receive_frame(), await raw_socket.receive_frame()
    assert (first[0], second[0]) == (10, 11)
    assert (len(first[3]), len(second[3])) == (6, 4)


async def test_a_late_answer_can_pass_for_the_next_one(host: ModbusHost, raw_socket: RawSocket):
    await cause_fault(host.robot, "late_same_tid")
    await raw_socket.send_pdu(bytes.fromhex("03 012c 0002"), tid=10)
    await raw_socket.send_pdu(READ, tid=11)
    tid, _, _, answer = await raw_socket.receive_frame()
    assert tid == 11
    assert answer == b"\x03\x04" + b"-F01"


async def test_a_doubled_answer(host: ModbusHost, raw_socket: RawSocket):
    await cause_fault(host.robot, "duplicate", count=1)
    await raw_socket.send_pdu(READ, tid=12)
    assert await raw_socket.receive_frame() == await raw_socket.receive_frame()


async def test_an_answer_in_pieces_is_whole_in_the_end(host: ModbusHost, raw_socket: RawSocket):
    await cause_fault(host.robot, "half_frames", pause_s=0.001)
    await raw_socket.send_pdu(bytes.fromhex("03 0000 0032"), tid=13)
    assert len((await raw_socket.receive_frame())[3]) == 102


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("wrong_tid", (2, 0, 9, "03 04 0000 0000")),
        ("wrong_unit", (1, 0, 10, "03 04 0000 0000")),
        ("wrong_protocol", (1, 0x1234, 9, "03 04 0000 0000")),
        ("wrong_function", (1, 0, 9, "04 04 0000 0000")),
        ("short_list", (1, 0, 9, "03 02 0000")),
    ],
)
async def test_a_foreign_answer(host: ModbusHost, raw_socket: RawSocket, fault, expected):
    await cause_fault(host.robot, fault, count=1)
    await raw_socket.send_pdu(READ)
    assert await raw_socket.receive_frame() == (*expected[:3], bytes.fromhex(expected[3]))
    await raw_socket.send_pdu(READ)
    assert await raw_socket.receive_frame() == (1, 0, 9, bytes.fromhex("03 04 0000 0000"))


@pytest.mark.parametrize("code", [1, 2, 3, 4, 5, 6, 0x0A, 0x0B])
async def test_every_exception_code_can_be_asked_for(host: ModbusHost, raw_socket: RawSocket, code):
    await cause_fault(host.robot, "exception", code=code, count=1)
    await raw_socket.send_pdu(READ)
    assert (await raw_socket.receive_frame())[3] == bytes([0x83, code])


async def test_an_exception_can_be_for_writes_only(host: ModbusHost, raw_socket: RawSocket):
    await cause_fault(host.robot, "exception", code=6, function=16)
    await raw_socket.send_pdu(READ)
    assert (await raw_socket.receive_frame())[3][0] == 3
    await raw_socket.send_pdu(bytes.fromhex("10 2710 0001 02 0001"))
    assert (await raw_socket.receive_frame())[3] == bytes.fromhex("90 06")


@pytest.mark.parametrize("length", range(14))
async def test_an_answer_cut_after_any_byte(host: ModbusHost, raw_socket: RawSocket, length):
    await cause_fault(host.robot, "cut", bytes=length, count=1)
    await raw_socket.send_pdu(READ)
    assert len(await raw_socket.read_rest()) == min(length, 13)
    assert await raw_socket.read_rest() == b""


async def test_a_write_can_be_obeyed_and_the_line_cut(host: ModbusHost, raw_socket: RawSocket):
    await cause_fault(host.robot, "act_then_cut", count=1)
    await raw_socket.send_pdu(READ)
    assert (await raw_socket.receive_frame())[3][0] == 3
    await raw_socket.send_pdu(bytes.fromhex("10 0032 0002 04 0001 0000"))
    assert await raw_socket.read_rest() == b""
    assert host.robot.controller.counts_at_zero[0] == 1


async def test_a_reset_connection(host: ModbusHost, raw_socket: RawSocket):
    await cause_fault(host.robot, "reset", count=1)
    await raw_socket.send_pdu(READ)
    with pytest.raises(ConnectionResetError):
        await raw_socket.read_rest()


async def test_a_port_that_does_not_listen_for_a_while(host: ModbusHost, raw_socket: RawSocket):
    await cause_fault(host.robot, "refuse", duration_s=0.2)
    with pytest.raises(ConnectionRefusedError):
        await asyncio.open_connection("127.0.0.1", host.robot.server.port)
    await host.reconnect()
    assert len(await host.read_registers(1, 2)) == 2


async def test_a_flapping_link_comes_and_goes(host: ModbusHost):
    await cause_fault(host.robot, "flap", period_s=0.1)
    await wait_until(lambda: not host.robot.server.is_listening)
    await wait_until(lambda: host.robot.server.is_listening)
    await wait_until(lambda: not host.robot.server.is_listening)


# spoilt registers


async def test_frozen_registers_stand_still_with_their_counter(host: ModbusHost):
    await cause_fault(host.robot, "frozen")
    before = await host.read_registers(1, 50), await host.read_registers(3041, 14)
    host.robot.controller.arm.put_joints(np.zeros(6))
    await wait_until(lambda: host.world.clock.real_now_s() > 0.05)
    assert (await host.read_registers(1, 50), await host.read_registers(3041, 14)) == before
    host.robot.clear_faults()
    assert await host.joints_deg() == pytest.approx([0.0] * 6, abs=1e-3)


async def test_nan_registers(host: ModbusHost):
    await cause_fault(host.robot, "nan")
    words = await host.read_registers(1, 50)
    assert words[26:28] == [0x0000, 0x7FC0]
    assert np.isnan(floats_from(words[26:38])).all()
    assert words[44:47] == [1, 0, 1]


async def test_swapped_words(host: ModbusHost):
    right = await host.read_registers(51, 4)
    await cause_fault(host.robot, "swapped_words")
    assert await host.read_registers(51, 4) == [right[1], right[0], right[3], right[2]]


async def test_a_pose_in_metres_and_a_pose_that_does_not_follow(host: ModbusHost):
    right = floats_from(await host.read_registers(1, 6))
    await cause_fault(host.robot, "metres", duration_s=60)
    assert floats_from(await host.read_registers(1, 6)) == pytest.approx([value * 1e-3 for value in right])
    host.robot.clear_faults()
    await cause_fault(host.robot, "stale_pose")
    await host.run_operation(JOG, axis=1, target=[30.0])
    assert floats_from(await host.read_registers(1, 6)) == pytest.approx(right)


async def test_a_value_that_jumps(host: ModbusHost):
    right = await host.joints_deg()
    await cause_fault(host.robot, "value_jump", axis="J2", rad=0.1)
    jumped = np.array(await host.joints_deg()) - right
    assert jumped == pytest.approx([0, np.degrees(0.1), 0, 0, 0, 0], abs=1e-4)


def test_a_universal_robot_cannot_be_behind_modbus():
    with pytest.raises(ValueError, match="no pulse coders"):
        FakeModbusRobot(World(), {"name": "x", "model": "ur10e"})
