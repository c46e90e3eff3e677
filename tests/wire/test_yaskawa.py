"""The Yaskawa driver against its simulator beyond the contract, and both against what others wrote."""

import asyncio
import math
import struct
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from yrcom import MODEL_YRC1000, HsesClient, HsesFileClient, PulseMove

from cellcal.drivers.errors import DeviceError, DeviceTimeoutError, MotionStoppedError, RefusedError
from cellcal.drivers.interfaces import AlarmKind, Readiness
from cellcal.drivers.wire.stepwise_motion import step_targets
from cellcal.drivers.yaskawa.absolute_data import read_absolute_data
from cellcal.drivers.yaskawa.condition import condition_of
from cellcal.drivers.yaskawa.hses_frames import HsesRequest, read_answer
from cellcal.drivers.yaskawa.job_store import YaskawaJobStore
from cellcal.drivers.yaskawa.motion import PulseScale, speed_share
from cellcal.drivers.yaskawa.state import AlarmEntry, ControllerStatus, text_of
from cellcal.drivers.yaskawa.tool_file import read_tools
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.driver_cases import wait_until
from tests.wire.robot_cases import ROBOTS

READY = ControllerStatus(0xC2, 0x40)


@pytest.mark.parametrize(
    ("groups", "rows", "expected"),
    [
        ("1,63,0", ("1,5,1,-6,1,7,1,8", "1,9,1,10,0,0,0,0"), (5, -6, 7, 8, 9, 10)),
        ("3,63,63,0", ("1,5,1,-6,1,7,1,8", "1,9,0,10,1,11,1,12", "1,1,1,2,1,3,1,4"), (5, -6, 7, 8, 9, None)),
        ("7,127,127,1", ("1,5,1,6,1,7,1,8", "1,9,1,10,1,11,0,0", "1,0,1,1,1,2,1,3"), (5, 6, 7, 8, 9, 10, 11)),
        ("2,0,63", ("1,5,1,6,1,7,1,8", "1,9,1,10,0,0,0,0"), ()),
        ("1,63,0", ("1,5,1,6,1,7,1,8", "1,9,1"), ()),
        ("1,63,0", ("1,5,1,6,1,7,1,", "1,9,1,10,1,11,1,12", "1,1,1,2,1,3,1,4"), ()),  # of other axes
        ("1,63,0", (f"1,5,1,6,1,7,1,{'9' * 6000}", "1,9,1,10,0,0,0,0"), ()),
        (f"1,{'9' * 6000},0", ("1,5,1,6,1,7,1,8", "1,9,1,10,0,0,0,0"), ()),
        ("1,63,0", (), ()),
    ],
)
def test_absolute_data_are_those_of_the_axes_of_robot_1(groups: str, rows: tuple[str, ...], expected) -> None:
    for head in ((), ("///CRC 123",)):
        text = "\r\n".join(["//ABSO", *head, f"///RBPRM {groups},0,0", *rows, ""])
        assert read_absolute_data(text) == expected


async def test_a_home_position_made_anew_shows_in_the_position_data(
    motoman: Any, fake_client: FakeCellClient
) -> None:
    async def homes() -> list[int]:
        return [int(each.value) for each in await motoman.position_data() if each.name == "ABSO.DAT"]

    before, pulses = await homes(), await motoman.encoder_counts()
    await fake_client.inject_fault("make_home", device="motoman", axis="U")
    after = await homes()
    assert [now - then for now, then in zip(after, before, strict=True)] == [0, 0, pulses[2], 0, 0, 0]
    await fake_client.inject_fault("confirm_positions", device="motoman")


async def test_the_history_of_minor_alarms_is_read_by_a_client_of_others(
    motoman: Any, cell: CellConfig, fake_client: FakeCellClient
) -> None:
    _, marks, _ = astuple(await motoman.position_history(()))
    for fault, parameters in (
        ("alarm", {"code": 1300, "text": "SERVO CPU ERROR"}),
        ("battery_loss", {"axes": "U"}),
    ):
        await fake_client.inject_fault(fault, device="motoman", **parameters)
    await fake_client.inject_fault("confirm_positions", device="motoman")

    def read_history() -> list[dict[str, Any]]:
        with HsesClient(cell.robot_named("motoman").address) as client:
            client.model = MODEL_YRC1000
            return [client.read_alarm_history(number) for number in (1, 1001)]

    entries = await asyncio.to_thread(read_history)
    assert [entry["alarm_code"] for entry in entries] == [1300, 4107]
    history = await motoman.position_history(marks)
    assert [(alarm.code, alarm.axis, alarm.kind) for alarm in history.alarms] == [
        ("4107", 2, AlarmKind.TURNS)
    ]
    assert history.is_whole
    assert (await motoman.position_history(history.marks)).alarms == ()


def test_a_status_request_has_the_octets_of_the_makers_example() -> None:
    frame = HsesRequest(0x72, 1, 0, 0x01).to_frame(0)
    assert frame.hex() == "5945524320000000030100000000000039393939393939397200010000010000"


def test_an_answer_is_read_by_the_octets_of_the_makers_example() -> None:
    frame = bytes.fromhex("5945524320000800030101000000008039393939393939398100000000000000c400000040000000")
    answer = read_answer(frame, 1)
    assert answer.status == 0
    status = ControllerStatus(*struct.unpack("<II", answer.data))
    assert status.is_remote
    assert status.has_servo_power
    assert not status.is_running


@pytest.mark.parametrize(
    ("octets", "complaint"),
    [
        (b"YERC", "shorter than its header"),
        (b"\0" * 40, "not one of the High Speed Ethernet Server"),
        (
            bytes.fromhex("5945524320000900030101000000008039393939393939398100000000000000" + "00" * 8),
            "announced",
        ),
    ],
)
def test_octets_that_are_no_answer_are_refused(octets: bytes, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        read_answer(octets, 1)


def test_a_lost_position_comes_before_everything_else() -> None:
    teaching = ControllerStatus(0x20, 0x10)
    alarms = (AlarmEntry(4320, 0, "OVERLOAD(CONTINUE)", 1), AlarmEntry(4107, 4, "OUT OF RANGE(ABSO DATA)", 3))
    condition = condition_of(teaching, alarms)
    assert condition.readiness is Readiness.POSITION_LOST
    assert condition.alarms[1].kind is AlarmKind.TURNS
    assert condition.alarms[1].axis == 2
    assert "second home position" in condition.remedy


def test_the_data_of_an_alarm_are_axes_only_where_their_type_says_so() -> None:
    for data_type, axis in ((1, None), (2, None), (3, 1), (24, None)):
        condition = condition_of(READY, (AlarmEntry(4107, 2, "OUT OF RANGE(ABSO DATA)", data_type),))
        assert condition.readiness is Readiness.POSITION_LOST
        assert [alarm.axis for alarm in condition.alarms] == [axis]


def test_a_lost_position_is_known_by_its_number_where_the_pendant_speaks_another_language() -> None:
    japanese = text_of("範囲オーバ(位置データ)".encode("shift_jis"))
    condition = condition_of(READY, (AlarmEntry(4107, 4, japanese, 3),))
    assert condition.readiness is Readiness.POSITION_LOST
    assert condition.alarms[0].axis == 2
    assert condition_of(READY, (AlarmEntry(4320, 4, japanese, 3),)).readiness is Readiness.STOPPED


@pytest.mark.parametrize(
    ("status", "readiness"),
    [
        (READY, Readiness.READY),
        (ControllerStatus(0x22, 0x40), Readiness.NOT_READY),
        (ControllerStatus(0x42, 0x40), Readiness.NOT_READY),
        (ControllerStatus(0xC2, 0x00), Readiness.STOPPED),
        (ControllerStatus(0xC2, 0x42), Readiness.STOPPED),
    ],
)
def test_the_switches_say_who_must_act(status: ControllerStatus, readiness: Readiness) -> None:
    condition = condition_of(status, ())
    assert condition.readiness is readiness
    assert bool(condition.remedy) is (readiness is not Readiness.READY)


def test_a_low_battery_does_not_stop_the_robot() -> None:
    condition = condition_of(READY, (AlarmEntry(4311, 0, "ENCODER BATTERY WEAK", 1),))
    assert condition.readiness is Readiness.READY
    assert condition.alarms[0].kind is AlarmKind.BATTERY_LOW


def test_no_axis_exceeds_the_speed_and_the_share_is_never_zero() -> None:
    assert speed_share(0.5, math.radians(885.0)) == 323  # 3.2370 %, rounded down
    assert speed_share(1e-9, 10.0) == 1
    assert speed_share(50.0, 10.0) == 10000


def test_steps_lie_on_the_straight_line_and_end_at_the_target() -> None:
    start, target = np.zeros(6), np.array([0.5, -0.25, 0.0, 0.1, 0.0, -1.0])
    steps = step_targets(start, target, 0.3)
    assert len(steps) == 4
    assert np.array_equal(steps[-1], target)
    edges = np.diff(np.vstack([start, *steps]), axis=0)
    assert np.abs(edges).max() <= 0.3
    assert np.allclose(edges, target / 4)


def test_pulses_round_to_the_nearest_whole_one_and_beyond_the_range_are_refused() -> None:
    scale = PulseScale((1000.0, -1000.0, 1341.4, 1.5, 622.2, -622.2))
    joints = np.radians([10.0004, 10.0, -7.0, 1.0, 90.0, 0.5])
    assert scale.to_pulses(joints) == (10000, -10000, -9390, 2, 55998, -311)
    with pytest.raises(ValueError, match="range of pulses"):
        scale.to_pulses(np.full(6, 1e9))


def test_a_tool_file_is_read_as_a_real_controller_writes_it() -> None:
    text = (
        "//TOOL 0\r\n///CRC 1894208062\r\n///NAME STANDARD TOOL\r\n"
        "-88.687,0.981,463.147,0.0000,-45.0000,0.0000\r\n-4.000,0.000,118.000\r\n2.480\r\n"
        "0.000,0.000,0.000\r\n0.000,0,2\r\n//TOOL 1\r\n///NAME\r\nnan,0,0,0,0,0\r\n0,0,0\r\n0\r\n"
    )
    tools = read_tools(text)
    assert set(tools) == {0}
    assert tools[0].mass_kg == 2.48
    assert tools[0].flange_tool.position_m == pytest.approx((-0.088687, 0.000981, 0.463147))
    tilted = tools[0].flange_tool.rotation_matrix()
    assert tilted[0][2] == pytest.approx(-math.sin(math.radians(45.0)))


async def test_a_foreign_client_reads_what_our_driver_reads(
    motoman: Any, cell: CellConfig, fake_client: FakeCellClient
) -> None:
    config = cell.robot_named("motoman")
    await fake_client.inject_fault("alarm", device="motoman", code=4320)

    def ask() -> tuple[Any, ...]:
        with HsesClient(config.address) as client, HsesFileClient(config.address) as files:
            client.model = MODEL_YRC1000
            return (
                client.read_status(), client.read_position(1), client.read_axis_config(1),
                client.read_alarm(1), files.list_files("*.CND"), files.read_file("TOOL.CND"),
                files.read_file("ABSO.DAT"),
            )  # fmt: skip

    status, position, axes, alarm, names, content, homes = await asyncio.to_thread(ask)
    truth = (await fake_client.read_truth())["robots"]["motoman"]
    assert "S" in str(axes)
    assert str(truth["pulses"][0]) in str(position)
    assert list(await motoman.encoder_counts()) == truth["pulses"]
    assert "TOOL.CND" in names
    assert read_tools(content.decode())[1].mass_kg == truth["active"]["payload_kg"]
    assert status["alarm"]
    assert alarm["alarm_code"] == 4320
    assert alarm["alarm_name"].startswith("OVERLOAD")
    shown = [int(each.value) for each in await motoman.position_data() if each.name == "ABSO.DAT"]
    assert read_absolute_data(homes.decode()) == tuple(shown)
    assert len(shown) == 6


async def test_a_foreign_client_moves_and_holds_the_simulated_robot(
    motoman: Any, cell: CellConfig, fake_client: FakeCellClient
) -> None:
    config = cell.robot_named("motoman")
    before = await motoman.encoder_counts()
    target = [before[0] + 2000, *before[1:]]

    def move() -> None:
        with HsesClient(config.address) as client:
            client.move_pulse(PulseMove(robot_group=1, speed=500, robot_axes=target))

    await asyncio.to_thread(move)

    async def arrived() -> bool:
        return list(await motoman.encoder_counts()) == target

    await wait_until(arrived)


async def test_answers_that_are_late_doubled_or_lost_do_no_harm(
    motoman: Any, fake_client: FakeCellClient
) -> None:
    expected = await motoman.encoder_counts()
    for fault in ("late", "doubled", "foreign", "other_service"):
        await fake_client.inject_fault(fault, device="motoman", count=3)
        assert await motoman.encoder_counts() == expected
        await fake_client.send_command("clear")
    await fake_client.inject_fault("lossy", device="motoman")
    for _ in range(5):
        assert await motoman.encoder_counts() == expected


@pytest.mark.parametrize("faults", [(), ("unnumbered",)])
async def test_a_file_in_one_answer_is_read_with_and_without_a_block_number(
    motoman: Any, cell: CellConfig, fake_client: FakeCellClient, faults: tuple[str, ...]
) -> None:
    for fault in faults:
        await fake_client.inject_fault(fault, device="motoman")
    config = cell.robot_named("motoman")
    async with YaskawaJobStore("motoman", config.address, timeout_s=config.deadline_s) as store:
        assert "CELLCAL.JBI" not in await store.list_names()
        await store.write_file("CELLCAL.JBI", b"/JOB\r\n//NAME CELLCAL\r\n")
        assert await store.read_file("CELLCAL.JBI") == b"/JOB\r\n//NAME CELLCAL\r\n"
        await store.delete_file("CELLCAL.JBI")


async def test_an_arm_that_a_person_jogs_moves_although_no_status_says_so(
    motoman: Any, fake_client: FakeCellClient
) -> None:
    assert not (await motoman.read_joints()).moving
    await fake_client.inject_fault("jog_by_hand", device="motoman", axis="S", rad=0.5, speed_rad_s=0.02)
    assert (await motoman.read_joints()).moving
    await wait_until(lambda: _stands(fake_client))
    assert not (await motoman.read_joints()).moving


async def test_an_order_whose_answer_was_lost_is_not_given_twice(
    motoman: Any, fake_client: FakeCellClient
) -> None:
    await fake_client.inject_fault("lossy", device="motoman")
    with pytest.raises(DeviceTimeoutError):
        await _move_there_and_back(motoman)
    await fake_client.send_command("clear")

    async def stands() -> bool:
        return not (await fake_client.read_truth())["robots"]["motoman"]["moving"]

    await wait_until(stands)


async def test_a_refused_move_says_what_forbids_it(motoman: Any, fake_client: FakeCellClient) -> None:
    home = ROBOTS["yaskawa"].home_rad
    await fake_client.inject_fault("teach_mode", device="motoman")
    with pytest.raises(RefusedError, match="TEACH"):
        await motoman.move_joints(home, speed_rad_s=0.5)
    await fake_client.inject_fault("remote_mode", device="motoman")
    await fake_client.inject_fault("pendant_hold", device="motoman")
    with pytest.raises(MotionStoppedError, match="hold"):
        await motoman.move_joints(home, speed_rad_s=0.5)


async def test_a_dead_battery_is_a_lost_position_and_no_move_is_ordered(
    motoman: Any, fake_client: FakeCellClient
) -> None:
    await fake_client.inject_fault("battery_loss", device="motoman", axes=["U"])
    condition = await motoman.read_condition()
    assert condition.readiness is Readiness.POSITION_LOST
    assert condition.alarms[0].axis == 2
    before = (await fake_client.read_truth())["robots"]["motoman"]["joints_rad"]
    with pytest.raises(DeviceError, match="ABSO"):
        await motoman.move_joints(ROBOTS["yaskawa"].home_rad, speed_rad_s=0.5)
    assert (await fake_client.read_truth())["robots"]["motoman"]["joints_rad"] == before


async def test_a_lost_link_leaves_the_arm_within_one_step(
    motoman: Any, cell: CellConfig, fake_client: FakeCellClient
) -> None:
    case, config = ROBOTS["yaskawa"], cell.robot_named("motoman")
    move = asyncio.create_task(motoman.move_joints(case.away_rad, speed_rad_s=0.1))

    async def truth() -> dict[str, Any]:
        return dict((await fake_client.read_truth())["robots"]["motoman"])

    async def moves() -> bool:
        return bool((await truth())["moving"])

    await wait_until(moves)
    await fake_client.inject_fault("silent", device="motoman")
    at_loss = np.array((await truth())["joints_rad"])
    with pytest.raises(DeviceError):
        await move
    await wait_until(lambda: _stands(fake_client))
    travelled = np.abs(np.array((await truth())["joints_rad"]) - at_loss).max()
    assert travelled <= 0.1 * config.step_s + 1e-4


async def _move_there_and_back(motoman: Any) -> None:
    case = ROBOTS["yaskawa"]
    for _ in range(4):
        await motoman.move_joints(case.away_rad, speed_rad_s=0.5)
        await motoman.move_joints(case.home_rad, speed_rad_s=0.5)


async def _stands(fake_client: FakeCellClient) -> bool:
    return not (await fake_client.read_truth())["robots"]["motoman"]["moving"]


def test_a_cell_file_without_the_scale_is_refused(tmp_path: Path, cell: CellConfig) -> None:
    config = cell.robot_named("motoman")
    fields = config.model_dump()
    for wrong in ([1000.0] * 5, [1000.0] * 5 + [0.0], [1000.0] * 5 + [math.inf]):
        with pytest.raises(ValueError, match="pulses_per_degree"):
            type(config).model_validate({**fields, "pulses_per_degree": wrong})
