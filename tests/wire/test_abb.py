"""The ABB driver against its simulator beyond the contract, and the simulator against a client of others."""

import asyncio
import re
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from abb_robot_client.rws import RWS

from cellcal.drivers.abb.robot_web_services.rapid_values import (
    read_numbers,
    read_tool,
    write_joint_target,
)
from cellcal.drivers.abb.robot_web_services.state import ControllerState, condition_of
from cellcal.drivers.errors import DeviceError, MotionStoppedError, RefusedError, WireProtocolError
from cellcal.drivers.interfaces import AlarmKind, Readiness
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.driver_cases import wait_until
from tests.wire.robot_cases import ROBOTS, open_at_home

ROOT = Path(__file__).parents[2]
CASE = ROBOTS["abb_web_services"]


@pytest.fixture
async def abb(cell: CellConfig, fake_client: FakeCellClient) -> AsyncIterator[Any]:
    """The ABB, healthy and at home."""
    async with open_at_home(CASE, cell, fake_client) as robot:
        yield robot
        await CASE.heal(fake_client, robot)


async def truth_of(fake_client: FakeCellClient) -> dict[str, Any]:
    return dict((await fake_client.read_truth())["robots"][CASE.name])


def test_a_tool_is_read_as_the_controller_writes_it() -> None:
    carries, pose, mass = read_tool(
        "[TRUE,[[31.4,0,229.14],[0.707107,0,0.707107,0]],[2.5,[0,0,100],[1,0,0,0],0,0,0]]"
    )
    assert carries
    assert mass == 2.5
    assert pose.position_m == pytest.approx((0.0314, 0.0, 0.22914))
    assert np.allclose(pose.rotation_matrix() @ [0, 0, 1], [1, 0, 0], atol=1e-6)


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "TRUE", "[TRUE,[[0,0,0],[1,0,0,0]]]", "[TRUE,[[0,0,0],[0,0,0,0]],[1,[0,0,0]]]", "[x,[1,2]]",
    ],
)  # fmt: skip
def test_what_is_no_tool_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"tooldata|numbers|quaternion"):
        read_tool(text)


def test_a_target_is_written_with_its_external_axes_out_of_use() -> None:
    numbers = read_numbers(write_joint_target((0.1, -0.2, 0.3, -0.4, 0.5, -0.6)))
    assert np.allclose(np.radians(numbers[:6]), (0.1, -0.2, 0.3, -0.4, 0.5, -0.6), atol=1e-8)
    assert numbers[6:] == [9e9] * 6


@pytest.mark.parametrize(
    ("state", "readiness"),
    [
        (ControllerState("AUTO", "motoron", {}), Readiness.READY),
        (ControllerState("MANR", "motoron", {}), Readiness.NOT_READY),
        (ControllerState("AUTO", "motoroff", {}), Readiness.STOPPED),
        (ControllerState("AUTO", "emergencystop", {}), Readiness.STOPPED),
        (ControllerState("MANR", "motoroff", {2: "NotAMSSynchronized"}), Readiness.POSITION_LOST),
    ],
)
def test_a_state_says_who_must_act(state: ControllerState, readiness: Readiness) -> None:
    condition = condition_of(state)
    assert condition.readiness is readiness
    assert bool(condition.remedy) is (readiness is not Readiness.READY)
    if readiness is Readiness.POSITION_LOST:
        assert condition.alarms[0].kind is AlarmKind.TURNS
        assert condition.alarms[0].axis == 2


async def test_a_foreign_client_reads_and_writes_the_simulated_controller(
    abb: Any, cell: CellConfig, fake_client: FakeCellClient
) -> None:
    await fake_client.inject_fault("counters_lost", device=CASE.name, axes=["3"])
    config = cell.robot_named(CASE.name)

    def session() -> tuple[Any, ...]:
        client = RWS(f"http://{config.address}:{config.port}")
        client.set_rapid_variable("CellcalServer/nTime", "0.75", "T_ROB1")
        found = (
            client.get_jointtarget(), client.get_robtarget(), client.get_operation_mode(),
            client.get_controller_state(), client.get_speedratio(), client.get_execution_state(),
            client.read_event_log(), client.get_rapid_variable("CellcalServer/nTime", "T_ROB1"),
        )  # fmt: skip
        client.logout()
        return found

    joints, pose, mode, motors, speed, execution, log, written = await asyncio.to_thread(session)
    shown_rad = (await truth_of(fake_client))[
        "controller_joints_rad"
    ]  # the lost axis is shown some turns off
    assert np.allclose(np.radians(joints.robax), shown_rad, atol=1e-6)
    assert np.flatnonzero(np.abs(np.subtract(shown_rad, CASE.home_rad)) > 1e-3).tolist() == [2]
    assert np.allclose(np.array(pose.trans) * 1e-3, (await abb.flange_pose()).position_m, atol=1e-6)
    assert (mode, motors, speed) == ("AUTO", "motoron", 100.0)
    assert execution.ctrlexecstate == "stopped"  # no program runs with a lost counter
    assert log[0].code == 20032
    assert float(written) == 0.75


async def test_a_foreign_client_moves_the_simulated_controller(
    abb: Any, cell: CellConfig, fake_client: FakeCellClient
) -> None:
    config = cell.robot_named(CASE.name)
    target = [-70.0, 12.0, 8.0, 15.0, 20.0, -30.0]

    def session() -> tuple[str, str]:
        client = RWS(f"http://{config.address}:{config.port}")
        request = str(int(client.get_rapid_variable_num("CellcalServer/nAck")) + 1)
        client.set_rapid_variable(
            "CellcalServer/jTarget", f"[{target},{[9e9] * 6}]".replace(" ", ""), "T_ROB1"
        )
        client.set_rapid_variable("CellcalServer/nReq", request, "T_ROB1")
        for beat in range(2000):
            client.set_rapid_variable_num("CellcalServer/nHeart", beat)
            if client.get_rapid_variable("CellcalServer/nAck", "T_ROB1") == request:
                break
        tool = client.get_rapid_variable("CellcalServer/tMounted", "T_ROB1")
        client.logout()
        return tool, request

    tool, _ = await asyncio.to_thread(session)
    assert np.degrees((await truth_of(fake_client))["joints_rad"]) == pytest.approx(target, abs=1e-4)
    flange_tool = (await abb.active_frames()).flange_tool
    assert read_tool(tool)[1].position_m == pytest.approx(flange_tool.position_m)


async def test_a_lost_revolution_counter_is_named_by_axis_and_nothing_moves(
    abb: Any, fake_client: FakeCellClient
) -> None:
    await fake_client.inject_fault("counters_lost", device=CASE.name, axes=["2", "5"])
    condition = await abb.read_condition()
    assert condition.readiness is Readiness.POSITION_LOST
    assert [alarm.axis for alarm in condition.alarms] == [1, 4, None]
    assert condition.alarms[-1].text.startswith("Rev. counter not updated, ")  # the event of the log
    before = (await truth_of(fake_client))["joints_rad"]
    with pytest.raises(RefusedError, match="not synchronised"):
        await abb.move_joints(CASE.away_rad, speed_rad_s=0.5)
    assert (await truth_of(fake_client))["joints_rad"] == before


@pytest.mark.parametrize("fault", ["garbage", "page"])
async def test_an_answer_that_is_none_is_named_and_the_next_one_counts(
    abb: Any, fake_client: FakeCellClient, fault: str
) -> None:
    await fake_client.inject_fault(fault, device=CASE.name, count=1)
    with pytest.raises(WireProtocolError, match="no JSON"):
        await abb.controller_mode()
    assert await abb.controller_mode() == "AUTO"


async def test_a_wrong_password_is_said(cell: CellConfig) -> None:
    config = cell.robot_named(CASE.name).model_copy(update={"password": "wrong"})
    with pytest.raises(RefusedError, match="password"):
        async with config.open():
            pytest.fail("a stranger was let in")


async def test_a_program_that_is_stopped_ends_the_move(abb: Any, fake_client: FakeCellClient) -> None:
    move = asyncio.create_task(abb.move_joints(CASE.away_rad, speed_rad_s=CASE.slow_rad_s))
    await wait_until(lambda: _moves(fake_client))
    await fake_client.inject_fault("program_stop", device=CASE.name)
    with pytest.raises(MotionStoppedError, match="CellcalServer"):
        await move
    with pytest.raises(DeviceError, match="does not run"):
        await abb.move_joints(CASE.home_rad, speed_rad_s=0.5)


def test_the_module_that_ships_declares_what_the_driver_uses() -> None:
    text = (ROOT / "deploy" / "controller_setup" / "abb" / "CellcalServer.mod").read_text()
    code = re.sub(r"!.*", "", text)
    declared = set(re.findall(r"PERS \w+ (\w+) :=", code))
    source = (ROOT / "drivers" / "abb" / "robot_web_services" / "motion_server.py").read_text()
    assert set(re.findall(r'"(n[A-Z]\w+)"', source)) | {"jTarget", "nTime", "tMounted"} == declared
    for opening, closing in (
        ("PROC ", "ENDPROC"),
        ("TRAP ", "ENDTRAP"),
        ("WHILE ", "ENDWHILE"),
        ("IF ", "ENDIF"),
    ):
        lines = [line.strip() for line in code.splitlines()]
        assert sum(line.startswith(opening) for line in lines) == lines.count(closing), opening
    assert "tMounted := CTool();" in code.partition("PROC main()")[2].partition("ENDPROC")[0]
    assert re.findall(r"MoveAbsJ .*, (\w+) \\WObj", code) == ["tMounted"]  # tool0 weighs a gramme


async def _moves(fake_client: FakeCellClient) -> bool:
    return bool((await truth_of(fake_client))["moving"])


async def test_no_answer_that_came_twice_is_taken_for_the_next_one(
    abb: Any, fake_client: FakeCellClient
) -> None:
    refused = 0
    for k in range(12):
        joints = [0.1 + 0.01 * k] * 6
        await fake_client.inject_fault("hand_moves", device=CASE.name, joints=joints)
        try:
            assert (await abb.read_joints()).joints_rad == pytest.approx(joints, abs=1e-6)
            await fake_client.inject_fault("doubled", device=CASE.name, count=1)
            shown = (await abb.flange_pose()).to_matrix()
        except WireProtocolError:
            refused += 1
            continue
        assert np.allclose(shown, (await truth_of(fake_client))["base_flange"], atol=1e-6)
    assert refused
    assert (await abb.read_condition()).readiness is Readiness.READY


async def test_calibration_offsets_are_shown_and_change_with_a_fine_calibration(
    abb: Any, fake_client: FakeCellClient
) -> None:
    async def offsets() -> list[float]:
        shown = [each for each in await abb.position_data() if each.name == "cal_offset"]
        assert all(each.is_zero and each.unit == "rad" for each in shown)
        return [float(each.value) for each in shown]

    before = await offsets()
    assert len(before) == 6
    await fake_client.inject_fault("fine_calibrate", device=CASE.name, axis="2")
    changed = [now != then for now, then in zip(await offsets(), before, strict=True)]
    assert changed == [False, True, False, False, False, False]


async def test_a_track_stands_while_the_arm_moves_and_is_seen_where_it_was_moved(
    abb: Any, fake_client: FakeCellClient
) -> None:
    before = await abb.active_frames()
    assert before.external_axes == ()
    await fake_client.inject_fault("external_moved", device=CASE.name, axis="a", value=1500.25)
    await abb.move_joints(CASE.away_rad, speed_rad_s=1.0)
    assert (await truth_of(fake_client))["external"][0] == pytest.approx(1500.25, abs=1e-3)
    seen = (await abb.active_frames()).external_axes
    assert [(axis.name, round(axis.shown, 2)) for axis in seen] == [("eax_a", 1500.25)]
    await fake_client.inject_fault("external_moved", device=CASE.name, axis="a", value=9e9)


async def test_start_after_an_emergency_stop_does_not_go_on_with_the_old_step(
    abb: Any, fake_client: FakeCellClient
) -> None:
    move = asyncio.create_task(abb.move_joints(CASE.away_rad, speed_rad_s=CASE.slow_rad_s))
    await wait_until(lambda: _moves(fake_client))
    await fake_client.inject_fault("emergency_stop", device=CASE.name)
    with pytest.raises(MotionStoppedError):
        await move
    stood = (await truth_of(fake_client))["joints_rad"]
    await fake_client.inject_fault("auto_mode", device=CASE.name)
    await wait_until(lambda: _has_state(fake_client, 3))
    assert (await truth_of(fake_client))["joints_rad"] == pytest.approx(stood, abs=8e-3)
    await abb.move_joints(CASE.home_rad, speed_rad_s=0.5)


async def _has_state(fake_client: FakeCellClient, state: int) -> bool:
    return bool((await truth_of(fake_client))["state"] == state)
