"""The fake controller's RTDE against bytes and tables typed from the maker's guide."""

import asyncio
import struct
from contextlib import AsyncExitStack
from itertools import pairwise

import pytest

from tests.wire.fake_ur import fake_ur
from tests.wire.rtde_client import RawRtde, start_client

RECEIVE = (  # what ur_rtde 1.6.5 asks a 5.11 controller for, with the byte at which it expects each field
    "timestamp@1 target_q@9 target_qd@57 target_qdd@105 target_current@153 target_moment@201 actual_q@249"
    " actual_qd@297 actual_current@345 joint_control_output@393 actual_TCP_pose@441 actual_TCP_speed@489"
    " actual_TCP_force@537 target_TCP_pose@585 target_TCP_speed@633 actual_digital_input_bits@681"
    " joint_temperatures@689 actual_execution_time@737 robot_mode@745 joint_mode@749 safety_mode@773"
    " actual_tool_accelerometer@777 speed_scaling@801 target_speed_fraction@809 actual_momentum@817"
    " actual_main_voltage@825 actual_robot_voltage@833 actual_robot_current@841 actual_joint_voltage@849"
    " actual_digital_output_bits@897 runtime_state@905 standard_analog_input0@909 standard_analog_input1@917"
    " standard_analog_output0@925 standard_analog_output1@933 robot_status_bits@941 safety_status_bits@945"
    " ft_raw_wrench@949 payload@997 payload_cog@1005 payload_inertia@1029 output_int_register_2@1077"
)
DOCUMENT = {
    "DOUBLE": "target_execution_time io_current actual_robot_energy_consumed tool_analog_input0"
    " tool_analog_input1 actual_robot_braking_energy_dissipated euromap67_24V_voltage"
    " euromap67_24V_current tool_output_current"
    " tool_temperature tcp_force_scalar joint_position_deviation_ratio collision_detection_ratio"
    " output_double_register_0 output_double_register_47 input_double_register_0 input_double_register_47",
    "VECTOR6D": "actual_current_window tcp_offset actual_TCP_acceleration target_TCP_acceleration actual_qdd"
    " wrench_calc_from_currents target_base_acceleration target_base_wrench actual_moment",
    "VECTOR3D": "elbow_position elbow_velocity target_gravity",
    "INT32": "safety_status encoder0_raw encoder1_raw tool_output_voltage time_scale_source"
    " output_int_register_0 output_int_register_47 input_int_register_0 input_int_register_47",
    "UINT32": "analog_io_types euromap67_input_bits euromap67_output_bits tool_mode tool_analog_input_types"
    " script_control_line output_bit_registers0_to_31 output_bit_registers32_to_63"
    " input_bit_registers0_to_31 input_bit_registers32_to_63",
    "UINT64": "control_step actual_configurable_digital_input_bits actual_configurable_digital_output_bits",
    "UINT8": "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode",
    "BOOL": "output_bit_register_64 output_bit_register_127 input_bit_register_64 input_bit_register_127",
}
INPUTS = {
    "INT32": "input_int_register_0 input_int_register_47",
    "DOUBLE": "input_double_register_0 input_double_register_47 speed_slider_fraction"
    " standard_analog_output_0 standard_analog_output_1",
    "UINT32": "input_bit_registers0_to_31 input_bit_registers32_to_63 speed_slider_mask",
    "BOOL": "input_bit_register_64 input_bit_register_127",
    "UINT8": "standard_digital_output_mask standard_digital_output configurable_digital_output_mask"
    " configurable_digital_output tool_digital_output_mask tool_digital_output"
    " standard_analog_output_mask standard_analog_output_type",
    "VECTOR6D": "external_force_torque",
}


def split_table(table: dict[str, str]) -> tuple[list[str], list[str]]:
    pairs = [(name, kind) for kind, names in table.items() for name in names.split()]
    return [name for name, _ in pairs], [kind for _, kind in pairs]


async def test_the_handshake_byte_for_byte() -> None:
    async with fake_ur() as robot:
        reader, writer = await asyncio.open_connection(robot.server.address, 30004)
        writer.write(bytes.fromhex("0005560002"))
        assert await reader.readexactly(4) == bytes.fromhex("00045601")
        writer.write(bytes.fromhex("000376"))
        assert await reader.readexactly(19) == bytes.fromhex("001376") + struct.pack(">4I", 5, 11, 1, 108318)
        names = b"timestamp,robot_mode,"
        writer.write(struct.pack(">HBd", 11 + len(names), 0x4F, 125.0) + names)
        assert await reader.readexactly(16) == b"\x00\x10\x4f\x01DOUBLE,INT32"
        writer.write(bytes.fromhex("000353"))
        assert await reader.readexactly(4) == bytes.fromhex("00045301")
        size, kind, recipe, _, mode = struct.unpack(">HBBdi", await reader.readexactly(16))
        assert (size, kind, recipe, mode) == (16, 0x55, 1, 7)
        writer.close()
        await writer.wait_closed()


async def test_halves_and_several_telegrams_in_one_write() -> None:
    async with fake_ur() as robot:
        reader, writer = await asyncio.open_connection(robot.server.address, 30004)
        writer.write(bytes.fromhex("0005560002000376000376"[:-2]))
        assert await reader.readexactly(23) == bytes.fromhex("00045601001376") + struct.pack(
            ">4I", 5, 11, 1, 108318
        )
        writer.write(bytes.fromhex("76"))
        assert (await reader.readexactly(19))[:3] == bytes.fromhex("001376")
        writer.close()
        await writer.wait_closed()


async def test_the_wheels_list_lies_where_the_wheel_reads_it() -> None:
    names = [part.split("@")[0] for part in RECEIVE.split()]
    names += [f"output_int_register_{i}" for i in range(12, 20)]
    names += [f"output_double_register_{i}" for i in range(12, 20)]
    async with fake_ur() as robot, await start_client(robot.server.address, names, 500.0) as client:
        kind, payload = await client.receive()
        assert (kind, len(payload)) == ("U", 1177)
        offset = 1
        for name, typed_as in zip(client.names, client.kinds, strict=True):
            place = next((int(p.split("@")[1]) for p in RECEIVE.split() if p.startswith(name + "@")), offset)
            assert offset == place, name
            offset += {"VECTOR6D": 48, "VECTOR6INT32": 24, "VECTOR3D": 24, "INT32": 4, "UINT32": 4}.get(
                typed_as, 8
            )
        assert struct.unpack_from(">6d", payload, 249) == pytest.approx(robot.true_state()["joints_rad"])


async def test_every_documented_field_has_its_documented_type() -> None:
    async with fake_ur() as robot, await RawRtde.connect(robot.server.address) as client:
        assert await client.negotiate_version()
        names, kinds = split_table(DOCUMENT)
        assert await client.set_up_outputs(names) == (1, kinds)
        assert await client.start_stream()
        await client.read_package()
        names, kinds = split_table(INPUTS)
        assert await client.set_up_inputs(names) == (1, kinds)


async def test_protocol_1_has_no_frequency_and_no_recipe_id() -> None:
    async with fake_ur() as robot, await RawRtde.connect(robot.server.address) as client:
        assert not await client.negotiate_version(3)
        assert await client.negotiate_version(1)
        assert await client.set_up_outputs(["timestamp", "actual_q"]) == (None, ["DOUBLE", "VECTOR6D"])
        assert await client.start_stream()
        first, second = await client.read_package(), await client.read_package()
        assert second["timestamp"] - first["timestamp"] == pytest.approx(0.008)
        assert first["actual_q"] == pytest.approx(robot.true_state()["joints_rad"])


async def test_clients_at_different_rates_each_get_every_step_of_theirs() -> None:
    async with fake_ur() as robot, AsyncExitStack() as open_clients:
        clients = [
            await open_clients.enter_async_context(
                await start_client(robot.server.address, ["timestamp"], hz)
            )
            for hz in (500.0, 125.0, 25.0)
        ]
        for client, period_s, packets in zip(clients, (0.002, 0.008, 0.04), (200, 50, 10), strict=True):
            times = [(await client.read_package())["timestamp"] for _ in range(packets)]
            steps = [(b - a) / period_s for a, b in pairwise(times)]
            assert min(steps) == pytest.approx(1.0)
            assert all(step == pytest.approx(round(step)) for step in steps)


async def test_input_recipes_count_from_one_and_registers_have_one_owner() -> None:
    async with fake_ur() as robot:
        host = robot.server.address
        async with await RawRtde.connect(host) as owner, await RawRtde.connect(host) as other:
            assert await owner.negotiate_version()
            assert await other.negotiate_version()
            assert await owner.set_up_inputs(["input_int_register_20"]) == (1, ["INT32"])
            assert await owner.set_up_inputs(["input_int_register_20", "input_double_register_20"]) == (
                2,
                ["INT32", "DOUBLE"],
            )
            assert await other.set_up_inputs(["input_int_register_20", "input_int_register_21"]) == (
                0,
                ["IN_USE", "INT32"],
            )
            assert await other.set_up_inputs(["input_int_register_21"]) == (1, ["INT32"])
            assert await owner.set_up_inputs(["no_such_thing"]) == (0, ["NOT_FOUND"])
            owner.send("U", struct.pack(">Bid", 2, -7, 2.5))
            names = ["input_int_register_20", "input_double_register_20"]
            watch = await start_client(host, names)
            assert (await watch.wait_for("input_int_register_20", -7))["input_double_register_20"] == 2.5
        async with watch:
            while robot.true_state()["connections"]["30004"] > 1:
                await watch.read_package()
            assert (await watch.read_package())[
                "input_int_register_20"
            ] == -7  # kept, though its writer has left
            async with await RawRtde.connect(host) as heir:
                assert await heir.negotiate_version()
                assert await heir.set_up_inputs(["input_int_register_20"]) == (1, ["INT32"])


async def test_data_of_the_wrong_size_change_nothing_and_cut_nothing() -> None:
    async with (
        fake_ur() as robot,
        await start_client(robot.server.address, ["input_int_register_3"]) as client,
    ):
        assert await client.set_up_inputs(["input_int_register_3"]) == (1, ["INT32"])
        for nonsense in (b"", b"\1", struct.pack(">Bd", 1, 9.0), struct.pack(">Bi", 9, 9)):
            client.send("U", nonsense)
        assert len(await client.send_and_receive("v")) == 16
        assert (await client.read_package())["input_int_register_3"] == 0


async def test_start_needs_a_recipe_and_pause_ends_the_stream() -> None:
    async with fake_ur() as robot, await RawRtde.connect(robot.server.address) as client:
        assert await client.negotiate_version()
        assert not await client.start_stream()
        assert await client.set_up_outputs(["timestamp", "nonsense"]) == (0, ["DOUBLE", "NOT_FOUND"])
        assert not await client.start_stream()
        await client.set_up_outputs(["timestamp"])
        assert await client.start_stream()
        await client.read_package()
        assert await client.send_and_receive("P") == b"\1"
        assert len(await client.send_and_receive("v")) == 16


async def test_an_unknown_package_is_answered_with_a_message() -> None:
    async with fake_ur() as robot, await RawRtde.connect(robot.server.address) as client:
        assert await client.negotiate_version()
        client.send("R", b"v1.software.version")
        kind, payload = await client.receive()
        assert kind == "M"
        assert payload[1 : 1 + payload[0]] == b"Unsupported package type 82"


async def test_a_slow_reader_loses_packets_and_delays_no_other() -> None:
    names = ["timestamp", *[f"output_double_register_{i}" for i in range(48)]]
    async with fake_ur() as robot:
        sleeper = await start_client(robot.server.address, names, 500.0)
        sleeper.writer.transport.pause_reading()
        async with sleeper, await start_client(robot.server.address, ["timestamp"], 500.0) as awake:
            times = [(await awake.read_package())["timestamp"] for _ in range(300)]
            assert times == sorted(times)
            assert times[-1] - times[0] >= 0.59


async def test_an_arm_at_slider_zero_stands_and_says_so() -> None:
    names = ["actual_q", "actual_qd", "target_qd", "actual_TCP_speed", "target_speed_fraction"]
    async with fake_ur() as robot, await start_client(robot.server.address, names) as client:
        slider, _ = await client.set_up_inputs(["speed_slider_mask", "speed_slider_fraction"])
        start = robot.true_state()["joints_rad"]
        await run_program(robot.server.address, f"movej({[q + 3.0 for q in start]}, a=5.0, v=0.5)")
        while (await client.read_package())["actual_qd"][0] < 0.4:
            pass
        client.send("U", struct.pack(">BId", slider, 1, 0.0))
        at_zero = await client.wait_for("target_speed_fraction", 0.0)
        await client.read_package()
        found = [await client.read_package() for _ in range(5)]
        assert {values["actual_q"] for values in found} == {found[0]["actual_q"]}
        assert found[0]["actual_q"][0] < start[0] + 2.9
        for values in (at_zero, *found):
            for name in ("actual_qd", "target_qd", "actual_TCP_speed"):
                assert not any(values[name]), name
        assert not robot.true_state()["moving"]
        client.send("U", struct.pack(">BId", slider, 1, 1.0))
        while (await client.read_package())["actual_qd"][0] < 0.4:  # the program goes on where it stood
            pass


async def test_speed_is_that_of_the_arm_at_half_slider_too() -> None:
    async with fake_ur() as robot:
        names = ["actual_q", "actual_qd", "timestamp", "target_speed_fraction"]
        async with await start_client(robot.server.address, names) as client:
            slider, _ = await client.set_up_inputs(["speed_slider_mask", "speed_slider_fraction"])
            client.send("U", struct.pack(">BId", slider, 1, 0.5))
            await client.wait_for("target_speed_fraction", 0.5)
            target = [q + 0.3 for q in robot.true_state()["joints_rad"]]
            await run_program(robot.server.address, f"movej({target}, a=50.0, v=0.4)")
            speeds = set()
            while (values := await client.read_package())["actual_q"] != tuple(target):
                speeds.add(round(values["actual_qd"][0], 9))
        assert max(speeds) == pytest.approx(0.2)


async def test_a_program_stopped_at_slider_zero_leaves_the_arm_where_it_stands() -> None:
    async with fake_ur() as robot:
        names = ["actual_q", "actual_qd", "runtime_state", "target_speed_fraction"]
        async with await start_client(robot.server.address, names) as client:
            slider, _ = await client.set_up_inputs(["speed_slider_mask", "speed_slider_fraction"])
            start = robot.true_state()["joints_rad"]
            await run_program(robot.server.address, f"movej({[q + 3.0 for q in start]}, a=5.0, v=0.5)")
            while (await client.read_package())["actual_qd"][0] < 0.4:
                pass
            client.send("U", struct.pack(">BId", slider, 1, 0.0))
            await client.wait_for("target_speed_fraction", 0.0)
            stood = (await client.read_package())["actual_q"]
            await robot.inject_fault("program_stop", {})
            await client.wait_for("runtime_state", 1)
            found = [await client.read_package() for _ in range(20)]
            assert {values["actual_q"] for values in found} == {stood}


async def run_program(host: str, line: str) -> None:
    """Upload a program of one line."""
    _, writer = await asyncio.open_connection(host, 30003)
    writer.write(f"def go():\n\t{line}\nend\n".encode())
    writer.close()
    await writer.wait_closed()
