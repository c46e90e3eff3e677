"""Joints that come by EGM and RSI beside the robot's own link: compared, guarded, and never answered."""

import asyncio
import logging
import socket
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from abb_robot_client.egm import EGM
from pydantic import ValidationError

from cellcal.drivers.errors import UnreachableError, WireProtocolError
from cellcal.drivers.interfaces import ComparesJoints
from cellcal.drivers.wire.joint_stream import JointStream, StreamPacket
from cellcal.drivers.wire.joint_stream_settings import JointStreamSettings
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.runs.cell_check import check_cell
from tests.machine_speed import stretched_s
from tests.wire.driver_cases import open_retrying, wait_until
from tests.wire.fake_devices_process import run_fakes
from tests.wire.stream_cell import STREAM_CELL

BRANDS = ("abb", "kuka")
LINKS = {"abb": "EGM", "kuka": "RSI"}
EXCHANGES = 50


@pytest.fixture(scope="module")
def stream_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, FakeCellClient]]:
    with run_fakes(tmp_path_factory.mktemp("streams"), STREAM_CELL) as cell:
        yield cell


@pytest.fixture
def stream_cell(stream_process: tuple[Path, FakeCellClient]) -> CellConfig:
    return read_cell_file(stream_process[0])


@pytest.fixture
async def fakes(stream_process: tuple[Path, FakeCellClient]) -> AsyncIterator[FakeCellClient]:
    client = stream_process[1]
    yield client
    await client.send_command("clear")
    for name in BRANDS:
        await client.inject_fault("mend", device=name)


@pytest.fixture(params=BRANDS)
async def robot(
    request: pytest.FixtureRequest, stream_cell: CellConfig, fakes: FakeCellClient
) -> AsyncIterator[Any]:
    """A robot whose stream is heard."""
    async with open_retrying(stream_cell.robot_named(request.param)) as robot:
        await until_streaming(robot)
        yield robot


def stream_of(robot: Any) -> JointStream:
    found = robot._compared.stream
    assert isinstance(found, JointStream)
    return found


async def is_streaming(robot: Any) -> bool:
    reading = await robot.read_joints()
    return not reading.moving and reading.raw.startswith(LINKS[robot.name])


async def until_streaming(robot: Any) -> None:
    async def streams() -> bool:
        return await is_streaming(robot)

    await wait_until(streams)


async def truth_of(fakes: FakeCellClient, robot: Any) -> dict[str, Any]:
    return dict((await fakes.read_truth())["robots"][robot.name])


async def until_dropped(robot: Any, why: str, count: int = 5) -> None:
    async def has_dropped() -> bool:
        return stream_of(robot).dropped[why] >= count

    await wait_until(has_dropped)


async def test_joints_come_by_the_stream_agree_and_nothing_is_sent_back(
    robot: Any, fakes: FakeCellClient
) -> None:
    answers = (await truth_of(fakes, robot))["stream_answers"]  # of another client
    for _ in range(20):
        reading = await robot.read_joints()
        assert not reading.moving
        assert (reading.device_time_s is not None) is (robot.name == "abb")  # RSI tells no time
        assert np.allclose(reading.joints_rad, (await truth_of(fakes, robot))["joints_rad"], atol=1e-6)
    assert (await truth_of(fakes, robot))["stream_answers"] == answers
    assert stream_of(robot).rate_hz() > 5.0  # 250 on a machine that is not busy


async def test_what_comes_is_said_in_the_check_of_the_cell(
    stream_cell: CellConfig, fakes: FakeCellClient
) -> None:
    async def says_rates() -> bool:
        report = await check_cell(stream_cell)
        texts = {device.name: device.message for device in report.devices}
        return all(
            f"{LINKS[name]}: " in texts[name] and "readings a second, within 0.0" in texts[name]
            for name in BRANDS
        )

    await wait_until(says_rates)


async def test_the_check_shows_the_axes_as_the_pendant_names_them(
    stream_cell: CellConfig, fakes: FakeCellClient
) -> None:
    truth = (await fakes.read_truth())["robots"]
    report = await check_cell(stream_cell)
    for device in report.devices:
        names = stream_cell.robot_named(device.name).capabilities.all_axis_names()
        assert tuple(joint.name for joint in device.joints) == names
        joints_rad = truth[device.name]["joints_rad"]
        assert [joint.value for joint in device.joints] == pytest.approx(np.degrees(joints_rad), abs=1e-3)
        assert {joint.unit for joint in device.joints} == {"deg"}


async def test_a_robot_that_is_reached_and_refuses_a_look_is_not_ready(
    stream_cell: CellConfig, fakes: FakeCellClient
) -> None:
    await fakes.inject_fault("external_tool", device="kuka")
    try:
        found = {device.name: device for device in (await check_cell(stream_cell)).devices}["kuka"]
    finally:
        await fakes.inject_fault("mend", device="kuka")
    assert (found.state, found.serial) == ("not_ready", "864231")
    assert "$IPO_MODE" in found.message
    assert found.remedy
    assert len(found.joints) == 6


async def _is_seen_moving(robot: Any, goal_rad: tuple[float, ...]) -> bool:
    move = asyncio.create_task(robot.move_joints(goal_rad, speed_rad_s=0.5))
    moving = False
    while not move.done():
        moving |= not (await stream_of(robot).read()).is_still  # type: ignore[union-attr]
    await move
    return moving


async def test_a_motion_is_seen_while_it_goes_on_and_its_end_too(robot: Any, fakes: FakeCellClient) -> None:
    assert isinstance(robot, ComparesJoints)
    start = (await robot.read_joints()).joints_rad
    away = (start[0] + 0.5, *start[1:])
    while not await _is_seen_moving(robot, away):  # a busy machine may miss a motion of 33 ms
        await robot.move_joints(start, speed_rad_s=0.5)
    await until_streaming(robot)
    assert np.allclose((await robot.read_joints()).joints_rad, away, atol=1e-5)
    await robot.move_joints(start, speed_rad_s=0.5)


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ("stream_stranger", "foreign sender"),
        ("stream_spoiled", "unreadable"),
        ("stream_doubled", "out of sequence"),
        ("stream_swapped", "out of sequence"),
    ],
)
async def test_what_is_foreign_spoiled_or_doubled_never_count(
    robot: Any, fakes: FakeCellClient, fault: str, why: str
) -> None:
    expected = (await truth_of(fakes, robot))["joints_rad"]
    await fakes.inject_fault(fault, device=robot.name)
    await until_dropped(robot, why)
    for _ in range(5):
        assert np.allclose((await robot.read_joints()).joints_rad, expected, atol=1e-5)
    await fakes.send_command("clear")
    await until_streaming(robot)


async def test_each_kind_of_dropped_datagram_is_logged_at_most_once_a_second(
    robot: Any, fakes: FakeCellClient, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        await fakes.inject_fault("stream_stranger", device=robot.name)
        await until_dropped(robot, "foreign sender", 40)
        took_s = loop.time() - began_s
    reports = [record for record in caplog.records if "foreign sender" in record.getMessage()]
    assert 1 <= len(reports) <= 1 + took_s
    assert "127.0.0.3" in reports[0].getMessage()


async def test_joints_of_another_arm_are_an_error_and_the_check_says_so(
    robot: Any, stream_cell: CellConfig, fakes: FakeCellClient
) -> None:
    await fakes.inject_fault("stream_other_arm", device=robot.name)

    found: list[WireProtocolError] = []

    async def differs() -> bool:
        try:
            await robot.read_joints()
        except WireProtocolError as error:
            found.append(error)
        return bool(found)

    await wait_until(differs)
    assert f"{LINKS[robot.name]} shows axis 1" in found[0].message
    assert "same controller" in found[0].remedy
    stream_of(robot).close()  # the check listens there itself

    async def is_reported() -> bool:
        report = await check_cell(stream_cell)
        return any(
            device.name == robot.name and "shows axis 1" in device.message and not device.is_ready
            for device in report.devices
        )

    await wait_until(is_reported)


async def test_without_a_stream_the_robot_is_read_as_ever_and_the_log_says_it_once(
    robot: Any, fakes: FakeCellClient, caplog: pytest.LogCaptureFixture
) -> None:
    await fakes.inject_fault("stream_silent", device=robot.name)

    async def is_silent() -> bool:
        return not (await robot.read_joints()).raw.startswith(LINKS[robot.name])

    with caplog.at_level(logging.WARNING):
        await wait_until(is_silent)
        for _ in range(3):
            reading = await robot.read_joints()
            assert np.allclose(reading.joints_rad, (await truth_of(fakes, robot))["joints_rad"], atol=1e-6)
    assert (
        len([record for record in caplog.records if "comes: the joints are read" in record.getMessage()]) == 1
    )
    assert f"No {LINKS[robot.name]} comes" in await robot.joint_sources()
    await fakes.send_command("clear")
    await until_streaming(robot)


async def test_a_program_that_is_started_anew_is_heard_again_from_its_new_port(
    robot: Any, fakes: FakeCellClient
) -> None:
    port = stream_of(robot)._port
    await fakes.inject_fault("stream_restart", device=robot.name)

    async def is_heard() -> bool:
        return stream_of(robot)._port not in (None, port)

    await wait_until(is_heard)
    await until_streaming(robot)
    assert stream_of(robot).dropped["foreign sender"] > 0  # until the old port had been silent for a while


async def test_a_second_client_may_read_and_stop_the_robot_although_the_port_is_taken(
    robot: Any, stream_cell: CellConfig, fakes: FakeCellClient
) -> None:
    async with open_retrying(stream_cell.robot_named(robot.name)) as second:
        reading = await second.read_joints()
        assert not reading.raw.startswith(LINKS[robot.name])
        assert np.allclose(reading.joints_rad, (await truth_of(fakes, robot))["joints_rad"], atol=1e-6)
        await second.stop()
        with pytest.raises(UnreachableError, match=f"{LINKS[robot.name]} cannot be received at 127"):
            await second.joint_sources()
    assert await is_streaming(robot)


def settings(**changes: Any) -> JointStreamSettings:
    return JointStreamSettings(**{"listen": "127.0.0.1", "port": 6510, **changes})


@pytest.mark.parametrize(
    "changes",
    [
        {"listen": "0.0.0.0"},
        {"listen": "224.0.0.1"},
        {"listen": "robot.example"},
        {"listen": "::"},
        {"sender": "robot"},
        {"port": 0},
        {"still_deg": 0.0},
        {"agree_deg": float("inf")},
        {"answer": True},
    ],
)
def test_a_stream_is_bound_to_one_address_and_its_limits_are_numbers(changes: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        settings(**changes)


def test_the_sender_is_the_robot_or_named() -> None:
    assert settings().sender_of("192.168.125.1") == "192.168.125.1"
    assert settings(sender="192.168.1.7").sender_of("robot.local") == "192.168.1.7"
    with pytest.raises(ValueError, match="sender"):
        settings().sender_of("robot.local")


def stream_with(packets: list[StreamPacket], **changes: Any) -> JointStream:
    """Return a stream that takes packets from a list, as its datagrams come."""
    rest = iter(packets)
    return JointStream("arm", "EGM", settings(**changes), "127.0.0.1", lambda _: next(rest))


def take(
    monkeypatch: pytest.MonkeyPatch, stream: JointStream, at_s: list[float], port: int = 5
) -> JointStream:
    """Let datagrams come at these moments of the host's clock."""
    for now_s in at_s:
        monkeypatch.setattr("cellcal.drivers.wire.joint_stream.time.monotonic", lambda now_s=now_s: now_s)
        stream.datagram_received(b"", ("127.0.0.1", port))
    return stream


def test_one_axis_that_creeps_is_no_standing_arm_and_a_gap_is_no_window(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def is_standing(joints: list[float], step_s: float) -> bool:
        times = [step_s * k for k in range(len(joints))]
        packets = [StreamPacket(k, times[k], (0.0, angle)) for k, angle in enumerate(joints)]
        stream = take(monkeypatch, stream_with(packets, silent_s=5.0), times)
        return stream.stood_since(times[-1]).is_still

    limit = settings().still_rad
    assert is_standing([0.0] * 60, 0.004)
    assert is_standing([limit * 0.9 * (k % 2) for k in range(60)], 0.004)
    assert not is_standing([limit / 45.0 * k for k in range(60)], 0.004)
    assert not is_standing([0.0] * 40, 0.004)  # the window is not full yet
    assert not is_standing([0.0] * 6, 0.15)  # one packet in a while says nothing of the time between


def test_what_was_long_under_way_never_counts_and_clocks_may_drift(monkeypatch: pytest.MonkeyPatch) -> None:
    sent = [0.01 * k for k in range(2000)]
    packets = [StreamPacket(k, sent_s, (0.0,)) for k, sent_s in enumerate(sent)]
    delayed = take(
        monkeypatch, stream_with(packets), [7.0 + s + (0.2 if s > 1.0 else 0.0) for s in sent[:120]]
    )
    assert delayed.dropped == {"late": 19}
    drifting = take(monkeypatch, stream_with(packets), [7.0 + 1.0005 * s for s in sent])
    assert not drifting.dropped
    timeless = [StreamPacket(k, None, (0.0,)) for k in range(120)]
    assert not take(monkeypatch, stream_with(timeless), [0.02 * k for k in range(120)]).dropped


def test_another_port_counts_only_after_a_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    packets = [StreamPacket(k, None, (0.0,)) for k in (50, 51, 1, 2, 3)]
    stream = take(monkeypatch, stream_with(packets, silent_s=0.5), [0.0, 0.1])
    take(monkeypatch, stream, [0.2, 0.3], port=6)
    assert stream.dropped == {"foreign sender": 2}
    take(monkeypatch, stream, [0.7, 0.8], port=6)
    assert stream.dropped == {"foreign sender": 2}
    take(monkeypatch, stream, [0.9], port=5)
    assert stream.dropped == {"foreign sender": 3}


async def test_a_client_of_others_exchanges_packets_with_the_simulated_controller(
    stream_cell: CellConfig, fakes: FakeCellClient
) -> None:
    config = stream_cell.robot_named("abb")
    before = (await fakes.read_truth())["robots"]["abb"]

    class OneAddressEgm(EGM):
        """The client bound to one address: by itself it listens on all."""

        def __init__(self, address: tuple[str, int]) -> None:
            self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self.socket.bind(address)
            self.send_sequence_number, self.egm_addr, self.count = 0, None, 0

    def exchange() -> list[Any]:
        client = OneAddressEgm((config.egm.listen, config.egm.port))
        try:
            states = []
            while len(states) < EXCHANGES:
                arrived, state = client.receive_from_robot(stretched_s(10.0))
                assert arrived
                states.append(state)
                assert client.send_to_robot(state.joint_angles + 5.0)
            return states
        finally:
            client.close()

    states = await asyncio.to_thread(exchange)
    sequence = [state.robot_message.header.seqno for state in states]
    assert sequence == sorted(set(sequence))
    for state in states:
        assert np.allclose(np.radians(state.joint_angles), before["joints_rad"], atol=1e-9)
        assert (state.motors_on, state.rapid_running) == (True, True)

    async def has_answers() -> bool:
        now = (await fakes.read_truth())["robots"]["abb"]
        assert now["joints_rad"] == before["joints_rad"]  # a position stream is not guided
        return bool(now["stream_answers"] == before["stream_answers"] + EXCHANGES)

    await wait_until(has_answers)
