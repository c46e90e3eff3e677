"""The KUKA driver against its simulator beyond the contract, and the simulator against a client of others."""

import asyncio
import math
import re
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from py_openshowvar import openshowvar

from cellcal.calibration.documents.plain_numbers import parse_number
from cellcal.calibration.geometry import Pose
from cellcal.drivers.errors import (
    DeviceError,
    MotionStoppedError,
    RefusedError,
    WireProtocolError,
    WrongDeviceError,
)
from cellcal.drivers.interfaces import AlarmKind, Readiness
from cellcal.drivers.kuka.variables.motion_server import speed_percent
from cellcal.drivers.kuka.variables.state import (
    ControllerState,
    condition_of,
    read_position_data,
    read_state,
)
from cellcal.drivers.kuka.variables.values import (
    read_axes,
    read_flag,
    read_members,
    read_pose,
    write_axes,
    write_pose,
)
from cellcal.drivers.kuka.variables.variable_link import VariableLink
from cellcal.procedures.motion.active_frames import frame_changes
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.driver_cases import wait_until
from tests.wire.robot_cases import ROBOTS, open_at_home

ROOT = Path(__file__).parents[2]
CASE = ROBOTS["kuka_variables"]


@pytest.fixture
async def kuka(cell: CellConfig, fake_client: FakeCellClient) -> AsyncIterator[Any]:
    """The KUKA, healthy and at home."""
    async with open_at_home(CASE, cell, fake_client) as robot:
        yield robot
        await CASE.heal(fake_client, robot)


async def truth_of(fake_client: FakeCellClient) -> dict[str, Any]:
    return dict((await fake_client.read_truth())["robots"][CASE.name])


@pytest.mark.parametrize(
    "text",
    [
        "{E6AXIS: A1 10.0, A2 -90.0, A3 90.0, A4 0.0, A5 1.5E+01, A6 -7, E1 0.0}",
        "{A6 -7,A5 15,A4 0,A3 90.0,A2 -90,A1 1.0e1}",
        "{AXIS:A1 10.0,  A2 -90.0, A3 90.0, A4 0, A5 15., A6 -7.0 }",
    ],
)
def test_axes_are_read_by_name_in_any_order_and_form(text: str) -> None:
    expected = [math.radians(angle) for angle in (10.0, -90.0, 90.0, 0.0, 15.0, -7.0)]
    assert read_axes(text) == pytest.approx(expected)


@pytest.mark.parametrize(
    "text",
    [
        *("", "{}", "{E6AXIS: A1 10.0, A2 -90.0}", "{A1 nan, A2 1}", "1e999"),
        "{E6AXIS: A1 10,523, A2 -90,1, A3 90,5, A4 0,0, A5 15,25, A6 -7,5}",  # a Windows program of another country
        "{E6AXIS: A1 10.0, A1 50.0, A2 0.0, A3 0.0, A4 0.0, A5 0.0, A6 0.0}",
    ],
)
def test_what_is_no_posture_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"missing|numbers|finite|decimal commas|twice"):
        read_axes(text)


@pytest.mark.parametrize("text", ["inf", "nan", "1,5", "#AUT", "1_0", "\uff11\uff12", "1e999", "9" * 65])
def test_what_is_no_finite_number_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"is not"):
        parse_number(text)


def test_a_flag_is_true_or_false() -> None:
    assert read_flag(" TRUE ")
    assert not read_flag("false")
    with pytest.raises(ValueError, match="neither"):
        read_flag("1")


class OneValueLink(VariableLink):
    """A controller in which one variable has another value than it should have."""

    def __init__(self, variable: str, value: str) -> None:
        super().__init__("kuka", "127.0.0.1", 1, deadline_s=1.0)
        joints = ", ".join(f"A{axis} 1.0" for axis in range(1, 7))
        self._values = {"$AXIS_ACT": f"{{{joints}}}", "$MODE_OP": "#T1", variable: value}

    async def read_variable(self, variable: str) -> str:
        default = "0.0" if variable.startswith("$MAMES") else "TRUE"
        return self._values.get(variable, default)


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("$AXIS_ACT", "{A1 NaN, A2 0, A3 0, A4 0, A5 0, A6 0}"),
        ("$MAMES[3]", "1e400"),
        ("$MAMES[3]", "\x1b[2J"),
        ("$AXIS_CAL[6]", "1"),
        ("$MODE_OP", "#T1\nrobot: ready"),
        ("$MODE_OP", "#" + "T" * 60_000),
    ],
)
async def test_what_is_no_value_of_its_kind_is_neither_recorded_nor_shown(variable: str, value: str) -> None:
    link = OneValueLink(variable, value)
    read = read_state if variable == "$MODE_OP" else read_position_data
    with pytest.raises(WireProtocolError, match="cannot be read") as caught:
        await read(link)
    assert len(str(caught.value)) < 300
    assert str(caught.value).isprintable()


def test_a_pose_survives_the_controllers_text() -> None:
    pose = Pose((0.1, -0.25, 1.5), (0.5, 0.5, -0.5, 0.5))
    found = read_pose(write_pose(pose).replace("}", ", S 2, T 35}"))
    assert found.position_m == pytest.approx(pose.position_m, abs=1e-9)
    assert np.allclose(found.rotation_matrix(), pose.rotation_matrix(), rtol=0, atol=1e-7)
    assert read_axes(write_axes((0.1, 0.2, 0.3, 0.4, 0.5, 0.6))) == pytest.approx(
        (0.1, 0.2, 0.3, 0.4, 0.5, 0.6), abs=1e-7
    )


def test_turns_are_about_z_y_x() -> None:
    turned = read_pose("{FRAME: X 0, Y 0, Z 0, A 90.0, B 0.0, C 0.0}")
    assert turned.rotation_matrix()[0][1] == pytest.approx(-1.0)
    assert read_members("{M 3.5, CM {X 1, Y 2, Z 3}}")["M"] == 3.5


@pytest.mark.parametrize(
    ("state", "readiness"),
    [
        (ControllerState("#AUT", True, True, False, ()), Readiness.READY),
        (ControllerState("#EX", True, True, False, ()), Readiness.READY),
        (ControllerState("#T1", True, True, False, ()), Readiness.NOT_READY),
        (ControllerState("#AUT", False, True, False, ()), Readiness.STOPPED),
        (ControllerState("#AUT", True, False, False, ()), Readiness.STOPPED),
        (ControllerState("#AUT", True, True, True, ()), Readiness.STOPPED),
        (ControllerState("#T1", False, False, True, (2,)), Readiness.POSITION_LOST),
    ],
)
def test_a_state_says_who_must_act(state: ControllerState, readiness: Readiness) -> None:
    condition = condition_of(state)
    assert condition.readiness is readiness
    assert bool(condition.remedy) is (readiness is not Readiness.READY)
    if readiness is Readiness.POSITION_LOST:
        assert condition.alarms[0].kind is AlarmKind.TURNS
        assert "A3" in condition.message


def test_a_speed_below_one_per_cent_is_refused_not_raised() -> None:
    assert speed_percent("kuka", 0.199, 10.0) == 1
    assert speed_percent("kuka", 50.0, 10.0) == 100
    with pytest.raises(RefusedError, match=r"5\.73 deg/s"):
        speed_percent("kuka", 0.09, 10.0)


async def test_a_foreign_client_reads_and_writes_the_simulated_controller(
    kuka: Any, cell: CellConfig, fake_client: FakeCellClient
) -> None:
    address = cell.robot_named(CASE.name).address

    def session() -> tuple[Any, ...]:
        client = openshowvar(address, 7000)
        found = [client.read(name, debug=False) for name in ("$AXIS_ACT", "$MODE_OP", "$BASE", "$STOPMESS")]
        missing = client.read("NO_SUCH_VARIABLE", debug=False)
        client.write("CC_AXIS", "{E6AXIS: A1 -70.0, A2 -68, A3 74, A4 15, A5 49, A6 20}", debug=False)
        client.write("CC_VEL", "30", debug=False)
        client.write("CC_STOP", "FALSE", debug=False)
        acknowledged = int(client.read("CC_ACK", debug=False))
        client.write("CC_REQ", str(acknowledged + 1), debug=False)
        for beat in range(1, 2000):
            client.write("CC_HB", str(beat), debug=False)
            if int(client.read("CC_ACK", debug=False)) == acknowledged + 1:
                break
        client.close()
        return *found, missing

    def read_guard() -> bytes:
        client = openshowvar(address, 7000)
        try:
            return bytes(client.read("$USER_SAF", debug=False))
        finally:
            client.close()

    axes, mode, base, stopped, missing = await asyncio.to_thread(session)
    assert read_axes(axes.decode()) == pytest.approx(CASE.home_rad, abs=1e-6)
    assert (mode, stopped, missing) == (b"#AUT", b"FALSE", None)
    assert read_pose(base.decode()).position_m == (0.0, 0.0, 0.0)
    assert math.degrees((await truth_of(fake_client))["joints_rad"][0]) == pytest.approx(-70.0, abs=1e-6)
    assert await asyncio.to_thread(read_guard) == b"TRUE"
    await fake_client.inject_fault("open_gate", device=CASE.name)
    assert await asyncio.to_thread(read_guard) == b"FALSE"  # texts of messages are no variables


async def test_both_servers_are_distinguished_and_an_empty_value_is_a_failure(
    kuka: Any, fake_client: FakeCellClient
) -> None:
    assert (await kuka.identify()).firmware.startswith("C3 Bridge")
    with pytest.raises(RefusedError, match="NO_SUCH"):
        await kuka._link.read_variable("NO_SUCH")
    await fake_client.inject_fault("old_server", device=CASE.name)
    assert (await kuka.identify()).firmware == "KUKAVARPROXY"
    with pytest.raises(RefusedError, match="NO_SUCH"):
        await kuka._link.read_variable("NO_SUCH")
    assert (await kuka.read_joints()).joints_rad


async def test_late_and_split_answers_do_no_harm_and_a_short_one_is_named(
    kuka: Any, fake_client: FakeCellClient
) -> None:
    expected = (await kuka.read_joints()).joints_rad
    for fault in ("stale", "split"):
        await fake_client.inject_fault(fault, device=CASE.name)
        assert (await kuka.read_joints()).joints_rad == expected
        await fake_client.send_command("clear")
    await fake_client.inject_fault("short", device=CASE.name, count=1)
    with pytest.raises(WireProtocolError):
        await kuka.read_joints()
    assert (await kuka.read_joints()).joints_rad == expected


async def test_a_server_that_hung_up_on_a_silent_client_is_asked_again(
    kuka: Any, fake_client: FakeCellClient
) -> None:
    expected = (await kuka.read_joints()).joints_rad
    await fake_client.inject_fault("hang_up", device=CASE.name)
    await wait_until(lambda: _has_heard_the_end(kuka))
    assert (await kuka.read_joints()).joints_rad == expected


async def test_another_controller_at_the_same_address_is_refused_on_every_new_connection(
    kuka: Any, cell: CellConfig, fake_client: FakeCellClient
) -> None:
    await fake_client.inject_fault("exchanged", device=CASE.name, serial="other")
    await wait_until(lambda: _has_heard_the_end(kuka))
    for _ in range(2):
        with pytest.raises(WrongDeviceError, match="'other'"):
            await kuka.read_joints()
    await fake_client.inject_fault("exchanged", device=CASE.name, serial=cell.robot_named(CASE.name).serial)
    assert (await kuka.read_joints()).joints_rad


async def test_places_are_seen_from_the_robots_base_however_it_is_mounted(
    kuka: Any, fake_client: FakeCellClient
) -> None:
    flange, taught = await kuka.flange_pose(), Pose((0.4, 0.1, 0.2), (0.5, 0.5, 0.5, 0.5))
    before = await kuka.write_user_frame(3, taught)
    await fake_client.inject_fault(
        "mounted", device=CASE.name, xyzabc=[300.0, -50.0, 2500.0, 0.0, 0.0, 180.0]
    )
    assert (await kuka.flange_pose()).position_m == pytest.approx(flange.position_m, abs=1e-8)
    assert (await kuka.read_user_frame(3)).position_m != pytest.approx(before.position_m, abs=1.0)
    assert (await kuka.write_user_frame(3, taught)).position_m == pytest.approx(taught.position_m, abs=1e-8)
    assert (await kuka.read_user_frame(3)).position_m == pytest.approx(taught.position_m, abs=1e-8)
    await fake_client.inject_fault("external_tool", device=CASE.name)
    with pytest.raises(RefusedError, match="IPO_MODE"):
        await kuka.flange_pose()


async def _has_heard_the_end(kuka: Any) -> bool:
    return bool(kuka._link._streams is None or kuka._link._streams[0].at_eof())


async def test_a_program_that_is_stopped_ends_the_move(kuka: Any, fake_client: FakeCellClient) -> None:
    move = asyncio.create_task(kuka.move_joints(CASE.away_rad, speed_rad_s=CASE.slow_rad_s))
    await wait_until(lambda: _moves(fake_client))
    await fake_client.inject_fault("program_stop", device=CASE.name)
    with pytest.raises(MotionStoppedError, match="CELLCAL"):
        await move
    with pytest.raises(DeviceError, match="does not run"):
        await kuka.move_joints(CASE.home_rad, speed_rad_s=0.5)


async def test_lost_mastering_is_seen_and_nothing_moves(kuka: Any, fake_client: FakeCellClient) -> None:
    await fake_client.inject_fault("mastering_lost", device=CASE.name, axes=["A4"])
    condition = await kuka.read_condition()
    assert condition.readiness is Readiness.POSITION_LOST
    assert condition.alarms[0].axis == 3
    before = (await truth_of(fake_client))["joints_rad"]
    with pytest.raises(RefusedError, match="not mastered"):
        await kuka.move_joints(CASE.away_rad, speed_rad_s=0.5)
    assert (await truth_of(fake_client))["joints_rad"] == before


async def _moves(fake_client: FakeCellClient) -> bool:
    return bool((await truth_of(fake_client))["moving"])


def test_the_program_that_ships_uses_the_variables_of_the_driver() -> None:
    folder = ROOT / "deploy" / "controller_setup" / "kuka"
    declared = set(
        re.findall(r"^GLOBAL \w+ (CC_\w+)", (folder / "CELLCAL_GLOBALS.DAT").read_text(), re.MULTILINE)
    )
    parts = "".join((folder / name).read_text() for name in ("CELLCAL.SRC", "CELLCAL_SPS.SRC"))
    words = set(re.findall(r"\bCC_[A-Z_]+\b", re.sub(r";.*", "", parts))) - {
        "CC_SERVE",
        "CC_BRAKE",
        "CC_CHECK",
    }
    assert words == declared
    source = (ROOT / "drivers" / "kuka" / "variables" / "motion_server.py").read_text()
    assert set(re.findall(r'"(CC_\w+)"', source)) <= declared
    lines = [line.strip() for line in parts.splitlines()]
    assert sum(line.startswith("DEF ") for line in lines) == lines.count("END")
    assert sum(line.startswith("IF ") for line in lines) == lines.count("ENDIF")
    held = [f"CC_AXIS.E{axis}=$AXIS_ACT.E{axis}" for axis in range(1, 7)]  # rails and positioners stand
    start = lines.index(held[0])
    assert lines[start : start + 7] == [*held, "CC_STATE=2"]
    assert (
        lines.index("BAS(#TOOL,CC_TOOL)") == next(k for k, line in enumerate(lines) if "INITMOV," in line) + 2
    )
    names = {word.upper() for line in lines for word in re.findall(r"^DECL \w+ (\w+)", line)}
    assert not names & {"AXIS", "POS", "FRAME", "E6AXIS", "E6POS", "LOAD"}  # types of the controller's own


async def test_a_rail_that_moves_between_two_looks_is_seen(kuka: Any, fake_client: FakeCellClient) -> None:
    before = await kuka.active_frames()
    assert [axis.name for axis in before.external_axes] == [f"E{axis}" for axis in range(1, 7)]
    await fake_client.inject_fault("external_moved", device=CASE.name, axis=1, value=812.5)
    after = await kuka.active_frames()
    assert [text for text, _ in frame_changes(before, after)] == [
        f"the external axis E1 stands at 812.500, and not at {before.external_axes[0].shown:.3f}"
    ]
    await kuka.move_joints(CASE.home_rad, speed_rad_s=0.5)
    assert (await truth_of(fake_client))["external"][0] == pytest.approx(812.5, abs=1e-3)
    await fake_client.inject_fault("external_moved", device=CASE.name, axis=1, value=0.0)


async def test_a_target_beyond_the_limits_of_the_controller_is_refused_by_its_axis(
    kuka: Any, fake_client: FakeCellClient
) -> None:
    with pytest.raises(RefusedError, match="A1 is beyond the software limit"):
        await kuka.move_joints((9.0, *CASE.home_rad[1:]), speed_rad_s=1.0)
    assert not (await truth_of(fake_client))["moving"]
    await kuka.move_joints(CASE.home_rad, speed_rad_s=1.0)  # without a person at the pendant


@pytest.mark.parametrize("event", ["program_stop", "program_cancel"])
async def test_start_after_a_stop_at_the_pendant_does_not_go_on_with_the_old_step(
    kuka: Any, fake_client: FakeCellClient, event: str
) -> None:
    move = asyncio.create_task(kuka.move_joints(CASE.away_rad, speed_rad_s=CASE.slow_rad_s))
    await wait_until(lambda: _moves(fake_client))
    await fake_client.inject_fault(event, device=CASE.name)
    with pytest.raises(MotionStoppedError, match="CELLCAL"):
        await move
    await wait_until(lambda: _stands(fake_client))  # the move ends while the arm still brakes
    stood = (await truth_of(fake_client))["joints_rad"]
    await fake_client.inject_fault("program_start" if event == "program_stop" else "mend", device=CASE.name)
    await wait_until(lambda: _has_state(fake_client, 3))
    await wait_until(lambda: _stands(fake_client))
    travelled = np.subtract((await truth_of(fake_client))["joints_rad"], stood)
    if event == "program_cancel":
        assert travelled == pytest.approx(0.0, abs=2e-3)
    # A START runs the step until the interrupt sees an edge, two cycles of the submit interpreter, in which this fast
    # world goes further than a robot: how far one goes is tested in `test_motion_sources`.
    assert np.abs(travelled).max() < 0.5 * np.abs(np.subtract(CASE.away_rad, stood)).max()
    await kuka.move_joints(CASE.home_rad, speed_rad_s=0.5)


async def _stands(fake_client: FakeCellClient) -> bool:
    return not (await truth_of(fake_client))["moving"]


async def _has_state(fake_client: FakeCellClient, state: int) -> bool:
    return bool((await truth_of(fake_client))["state"] == state)
