"""The fake cell as a process and behind its control port."""

import asyncio
import json
import signal
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from cellcal.drivers.registry import GaugeConfig, ProbeConfig, RobotConfig, TrackerConfig
from cellcal.fake_devices.cell import WITHOUT_WIRE, FakeCell, find_factory
from cellcal.fake_devices.control_server import ControlServer
from cellcal.fake_devices.device import FaultRefusedError
from cellcal.fake_devices.link_faults import LinkFaults
from tests.driver_configs import models_of
from tests.machine_speed import stretched_s
from tests.wire.fake_cells import GAUGE, ROBOT, behind_control_server, cell_document, run_cell, wait_until

CELL = """
[cell]
name = "test"
[[robot]]
name = "fanuc"
driver = "modbus_robot"
address = "127.0.0.1"
port = {port}
model = "fanuc_m6ib"
serial = "F-104711"
[[gauge]]
name = "wire"
driver = "draw_wire"
host = "127.0.0.1"
port = 0
channel = "can0"
node_id = 7
serial = 4711
robot = "fanuc"
[fake]
seed = 3
time_factor = {factor}
control_port = 0
"""


async def ask_server(control_server: ControlServer, **question: Any) -> dict[str, Any]:
    return await control_server.answer_line(json.dumps(question).encode())


# the process


@asynccontextmanager
async def play_cell(
    folder: Path, *more: str, factor: float = 100.0, port: int = 0
) -> AsyncIterator[asyncio.subprocess.Process]:
    path = folder / "cell.toml"
    path.write_text(CELL.format(factor=factor, port=port))
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "cellcal.fake_devices", str(path), *more,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        yield process
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()


async def first_line(process: asyncio.subprocess.Process) -> dict[str, Any]:
    assert process.stdout is not None
    async with asyncio.timeout(stretched_s(30.0)):
        return dict(json.loads(await process.stdout.readline()))


async def wait_for_end(process: asyncio.subprocess.Process) -> int:
    async with asyncio.timeout(stretched_s(10.0)):
        return await process.wait()


async def test_it_says_when_it_is_ready_and_ends_on_sigterm(tmp_path: Path):
    async with play_cell(tmp_path) as process:
        ready = await first_line(process)
        assert ready["ready"] is True
        host, port = ready["control"]
        reader, writer = await asyncio.open_connection(host, port)
        for verb in ("faults", "truth"):
            writer.write(json.dumps({"do": verb}).encode() + b"\n")
            assert json.loads(await reader.readline())["ok"] is True
        process.send_signal(signal.SIGTERM)
        assert await wait_for_end(process) == 0
        writer.close()
        await writer.wait_closed()


async def test_it_does_not_outlive_its_parent_process(tmp_path: Path):
    async with play_cell(tmp_path, "--watch-stdin") as process:
        await first_line(process)
        assert process.stdin is not None
        process.stdin.close()
        assert await wait_for_end(process) == 0


async def test_a_taken_port_is_a_sentence_and_exit_code_2(tmp_path: Path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        async with play_cell(tmp_path, port=taken.getsockname()[1]) as process:
            assert await wait_for_end(process) == 2
            assert process.stderr is not None
            assert b"cannot start" in await process.stderr.read()


async def test_an_unknown_driver_is_a_sentence():
    with pytest.raises(ValueError, match="no fake for the driver 'toaster'"):
        FakeCell({"robot": [{"name": "x", "driver": "toaster"}]})


@pytest.mark.parametrize(
    "driver", ["", "world", "clock", "program_text", "fanuc_files", "../cell", "a.b", "1"]
)
async def test_what_builds_no_device_is_no_driver(driver: str):
    with pytest.raises(ValueError, match="no fake for the driver"):
        FakeCell({"robot": [{"name": "x", "driver": driver}]})


def test_every_driver_of_a_cell_file_has_a_fake():
    drivers = {
        get_args(model.model_fields["driver"].annotation)[0]
        for union in (RobotConfig, GaugeConfig, TrackerConfig, ProbeConfig)
        for model in models_of(union)
    }
    assert len(drivers) > 10
    assert all(find_factory(driver) for driver in drivers - WITHOUT_WIRE)


# the control port


async def test_the_truth_is_whole_and_finite():
    async with behind_control_server() as service_client:
        truth = await ask_server(service_client, do="truth")
        json.dumps(truth, allow_nan=False)
        robot, gauge = truth["robots"]["fanuc"], truth["gauges"]["wire"]
        assert truth["seed"] == 1
        assert robot["turns_lost"] == [0] * 6
        assert robot["counts_read"] == robot["true_counts"]
        assert robot["mastered"] is True
        assert robot["joints_rad"] == pytest.approx(robot["controller_joints_rad"], abs=1e-6)
        straight = np.linalg.norm(np.array(gauge["hook_in_base_m"]) - gauge["anchor_in_base_m"])
        assert gauge["length_m"] == pytest.approx(straight, abs=2e-3)
        assert gauge["reading_m"] == pytest.approx(gauge["length_m"], abs=1e-2)


async def test_a_healthy_robot_has_no_tcp_error_and_a_wrong_turn_has_one():
    async with behind_control_server() as service_client:
        healthy = await ask_server(service_client, do="tcp_error", robot="fanuc")
        assert healthy == {"ok": True, "mean": 0.0, "max": 0.0, "n": 50}
        zero = (await ask_server(service_client, do="truth"))["robots"]["fanuc"]["counts_at_zero"]
        zero[0] += 1 << 19
        turned = await ask_server(
            service_client, do="tcp_error", robot="fanuc", counts_at_zero=zero, poses=[[0.0] * 6]
        )
        hook = (await ask_server(service_client, do="truth"))["gauges"]["wire"]["hook_in_flange_m"]
        assert turned["max"] == pytest.approx(2 * np.pi / 121 * np.hypot(0.865 + hook[2], hook[1]), rel=0.02)


@pytest.mark.parametrize(
    "line",
    [
        b"not json\n",
        b"[1]\n",
        b"3\n",
        b"{}\n",
        b'{"do": "sing"}\n',
        b'{"do": "fault"}\n',
        b'{"do": "fault", "name": "rain"}\n',
        b'{"do": "fault", "name": "slow", "device": "wire"}\n',
        b'{"do": "fault", "name": "slow", "spice": 1}\n',
        b'{"do": "fault", "name": "battery_loss", "axes": ["J9"]}\n',
        b'{"do": "fault", "name": "wire_snap", "spice": 1}\n',
        b'{"do": "advance", "seconds": -1}\n',
        b'{"do": "advance"}\n',
        b'{"do": "tcp_error", "robot": "unnamed"}\n',
    ],
)
async def test_nonsense_is_refused_in_words(line):
    async with behind_control_server() as service_client:
        answer = await service_client.answer_line(line)
        assert set(answer) == {"error"}
        assert answer["error"]


@pytest.mark.parametrize("start", [b"POST / HTTP/1.1\r\nhost: x\r\n\r\n", b"\x16\x03\x01\n", b"[1]\n", b"\n"])
async def test_a_browser_page_cannot_use_the_control_server(start):
    async with behind_control_server() as service_client:
        reader, writer = await asyncio.open_connection(service_client.host, service_client.port)
        writer.write(start + b'{"do": "fault", "name": "battery_loss"}\n')
        assert await reader.read() == b""
        writer.close()


async def test_the_control_server_uses_lines_over_tcp():
    async with behind_control_server() as service_client:
        reader, writer = await asyncio.open_connection(service_client.host, service_client.port)
        writer.write(b'{"do": "faults"}\n{"do": "sing"}\n')
        faults = json.loads(await reader.readline())["faults"]
        assert {"battery_loss", "motor_exchange", "reference_loss", "crash", "silent"} <= set(faults["fanuc"])
        assert {"wire_slack", "wire_snap", "node_off", "emcy", "daemon_stop"} <= set(faults["wire"])
        assert "error" in json.loads(await reader.readline())
        writer.close()
        await writer.wait_closed()


async def test_a_fault_goes_to_the_device_that_has_it_or_is_named():
    async with behind_control_server() as service_client:
        assert await ask_server(service_client, do="fault", name="wire_snap") == {"ok": True}
        assert (await ask_server(service_client, do="truth"))["gauges"]["wire"]["snapped"] is True
        assert await ask_server(
            service_client, do="fault", name="link", kind="slow", device="fanuc", delay_s=0.1
        ) == {"ok": True}
        assert await ask_server(service_client, do="clear") == {"ok": True}


async def test_time_leaps_on_request():
    async with behind_control_server(time_factor=0.0) as service_client:
        assert (await ask_server(service_client, do="advance", seconds=100.0))["time_s"] == pytest.approx(
            100.0
        )
        assert (await ask_server(service_client, do="truth"))["time_s"] == pytest.approx(100.0)


async def test_a_power_cycle_ends_when_its_world_time_has_passed():
    async with run_cell(time_factor=0.0) as cell:
        robot = cell.robots[0]
        await robot.inject_fault("power_cycle", {"off_s": 30.0})
        cell.world.clock.advance(29.0)
        await asyncio.sleep(0.12)
        assert robot.true_state()["powered"] is False
        cell.world.clock.advance(2.0)
        await wait_until(lambda: robot.true_state()["powered"])


async def test_the_wire_follows_the_robot():
    async with run_cell(time_factor=2000.0) as cell:
        before = cell.gauges[0].true_state()["length_m"]
        await cell.robots[0].inject_fault("jog_by_hand", {"axis": "J1", "rad": 0.3})
        await wait_until(lambda: not cell.robots[0].true_state()["moving"])
        assert abs(cell.gauges[0].true_state()["length_m"] - before) > 0.05


async def test_one_seed_is_one_world():
    truths = []
    for _ in range(2):
        async with run_cell(seed=11, time_factor=0.0) as cell:
            truths.append(
                [cell.robots[0].true_state()["dh"], cell.gauges[0].true_state()["anchor_in_base_m"]]
            )
    async with run_cell(seed=12, time_factor=0.0) as cell:
        assert cell.robots[0].true_state()["dh"] != truths[0][0]
    assert truths[0] == truths[1]


async def test_devices_that_started_are_stopped_when_a_later_one_cannot():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        cell = FakeCell({**cell_document(), "gauge": [{**GAUGE, "port": taken.getsockname()[1]}]})
        with pytest.raises(OSError, match="in use"):
            await cell.__aenter__()
        assert cell.robots[0].true_state()["connections"] == 0
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection("127.0.0.1", cell.robots[0].true_state()["port"])


def test_two_robots_have_two_worlds_of_errors():
    cell = FakeCell({"robot": [ROBOT, {**ROBOT, "name": "second"}]})
    first, second = (robot.true_state() for robot in cell.robots)
    assert first["dh"] != second["dh"]
    assert first["factory_counts_at_zero"] != second["factory_counts_at_zero"]


def test_a_link_fault_ends_by_count_by_time_and_by_clearing():
    now = [0.0]
    faults = LinkFaults({"slow": {"delay_s": 1.0}, "silent": {}}, lambda: now[0])
    faults.switch_on("slow", {"count": 2})
    assert [faults.use_once("slow") is not None for _ in range(3)] == [True, True, False]
    faults.switch_on("silent", {"duration_s": 5.0})
    now[0] = 4.9
    assert faults.active_parameters("silent") is not None
    now[0] = 5.0
    assert faults.active_parameters("silent") is None
    faults.switch_on("slow", {"delay_s": 0.5})
    assert faults.active_parameters("slow") == {"delay_s": 0.5}
    faults.clear_all()
    assert faults.active_parameters("slow") is None
    with pytest.raises(FaultRefusedError, match="no fault is called"):
        faults.switch_on("rain", {})
