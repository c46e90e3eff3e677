"""Rails and positioners that move between two captures are seen over every link whose document tells them."""

import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from cellcal.drivers.errors import RefusedError, WireProtocolError
from cellcal.drivers.fanuc.rmi.rmi_state import read_second_group
from cellcal.drivers.modbus_robot.config import ModbusRobotConfig
from cellcal.drivers.wire.trace import FrameTrace
from cellcal.procedures.motion.active_frames import changes_text, frame_changes
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.cell_tables import cell_head, fake_table, robot_table
from tests.wire.driver_cases import open_retrying
from tests.wire.fake_devices_process import run_fakes
from tests.wire.opc_ua_server import SERIAL, config_of, fake_server
from tests.wire.robot_cases import ROBOTS, open_at_home
from tests.wire.tp_cell import TP_CASE, TP_CELL

SECOND_GROUP_CELL = (
    cell_head("two groups")
    + robot_table(name="rmi", driver="fanuc_rmi", model="fanuc_m6ib", serial="F-230816", second_group=True)
    + fake_table()
)

CONFIG = {
    "driver": "modbus_robot", "name": "arm", "address": "127.0.0.1", "model": "fanuc_m6ib", "serial": "F-1",
    "speed_limit_rad_s": 0.3, "second_group": True,
}  # fmt: skip


async def changes_after(robot: Any, fake_client: FakeCellClient, **moved: Any) -> str:
    """Return what a capture says after an axis beside the arm has moved, and nothing else."""
    before = await robot.active_frames()
    assert frame_changes(before, await robot.active_frames()) == ()
    await fake_client.inject_fault("external_moved", **moved)
    return changes_text(frame_changes(before, await robot.active_frames()))


@pytest.mark.parametrize("axis", [1, 3])
async def test_a_fanuc_over_the_motion_interface_tells_its_extended_axes(
    cell: CellConfig, fake_client: FakeCellClient, axis: int
) -> None:
    case = ROBOTS["fanuc_rmi"]
    async with open_at_home(case, cell, fake_client) as robot:
        told = await changes_after(robot, fake_client, device=case.name, axis=axis, value=812.5)
        assert told == f"the external axis E{axis} stands at 812.500, and not at 0.000"
        robot._link.trace = FrameTrace("one look")
        await robot.active_frames()
        sent = [json.loads(frame.data) for frame in robot._link.trace.list_frames() if frame.direction == ">"]
        assert [packet["Command"] for packet in sent] == [
            "FRC_ReadCartesianPosition", "FRC_ReadUToolData", "FRC_GetStatus"
        ]  # fmt: skip
        await fake_client.inject_fault("external_moved", device=case.name, axis=axis, value=0.0)


async def test_a_fanuc_tells_a_second_group_where_the_cell_file_has_one(tmp_path: Path) -> None:
    with run_fakes(tmp_path, SECOND_GROUP_CELL) as (path, fake_client):
        async with open_retrying(read_cell_file(path).robot_named("rmi")) as robot:
            with pytest.raises(RefusedError):  # the cell file claims a group that the controller has not
                await robot.active_frames()
            await fake_client.inject_fault("external_moved", group=2, axis=1, value=0.0)
            told = await changes_after(robot, fake_client, group=2, axis=2, value=-45.0)
            assert told == "the external axis group 2 J2 stands at -45.000, and not at 0.000"


class OneGroupLink:
    """A controller that does not know groups: it tells those of the arm whatever it is asked for."""

    device = "rmi"

    def __init__(self) -> None:
        self.trace = self

    def last_received(self) -> str:
        return ""

    async def send_command(self, name: str, **fields: Any) -> dict[str, Any]:
        del name, fields
        return {"JointAngle": {f"J{axis}": 10.0 * axis for axis in range(1, 7)}}


async def test_joints_of_the_arm_are_never_taken_for_those_of_a_second_group() -> None:
    link: Any = OneGroupLink()
    with pytest.raises(WireProtocolError, match="another motion group"):
        await read_second_group(link)


async def test_a_fanuc_with_its_listings_tells_its_extended_axes(tmp_path: Path) -> None:
    with run_fakes(tmp_path, TP_CELL) as (path, fake_client):
        async with open_retrying(read_cell_file(path).robot_named("fanuc")) as robot:
            await TP_CASE.heal(fake_client, robot)
            told = await changes_after(robot, fake_client, axis=2, value=-1444.07)
            assert told == "the external axis E2 stands at -1444.070, and not at 0.000"


async def test_a_fanuc_with_its_listings_tells_a_second_group_where_it_is_assigned(tmp_path: Path) -> None:
    text = TP_CELL.replace('profile = "fanuc_tp"', 'profile = "fanuc_tp"\nsecond_group = true')
    with run_fakes(tmp_path, text) as (path, fake_client):
        async with open_retrying(read_cell_file(path).robot_named("fanuc")) as robot:
            await TP_CASE.heal(fake_client, robot)
            with pytest.raises(
                RefusedError, match="motion group 2"
            ) as refused:  # nothing is assigned: all zero
                await robot.active_frames()
            assert "assignment 21" in refused.value.remedy
            await fake_client.inject_fault("external_moved", group=2, axis=1, value=0.0)
            told = await changes_after(robot, fake_client, group=2, axis=9, value=-45.0)
            assert told == "the external axis group 2 J9 stands at -45.000, and not at 0.000"


def test_a_profile_without_a_second_group_claims_none() -> None:
    with pytest.raises(ValidationError, match="second_group"):
        ModbusRobotConfig.model_validate(CONFIG | {"profile": "fanuc_hmi"})
    assert ModbusRobotConfig.model_validate(CONFIG | {"profile": "fanuc_tp"}).second_group


async def test_a_yaskawa_tells_its_base_axes_and_stations(
    cell: CellConfig, fake_client: FakeCellClient
) -> None:
    async with open_retrying(cell.robot_named("motoman")) as robot:
        assert (await robot.active_frames()).external_axes == ()
    await fake_client.inject_fault("external_moved", device="motoman", group="B1", pulses=0)
    await fake_client.inject_fault("external_moved", device="motoman", group="S2", pulses=0)
    async with open_retrying(cell.robot_named("motoman")) as robot:
        wanders = await changes_after(robot, fake_client, device="motoman", group="B1", pulses=3)
        assert wanders == ""
        told = await changes_after(robot, fake_client, device="motoman", group="S2", axis=6, pulses=4000)
        assert told == "the external axis S2 axis 6 stands at 4000.000, and not at 0.000"


async def test_opc_ua_tells_machines_beside_the_arm_and_further_axes_of_it() -> None:
    settings = {
        "devices": ["Arm", "Table", "Arm2"],
        "machines": ["Table"],
        "axis_names": [*(f"Axis_{axis}" for axis in range(1, 7)), "Rail"],
        "units": ["deg"] * 6 + ["mm"],
    }
    async with fake_server(settings) as fake:
        arm = config_of(fake, motion_device="Arm", serial=SERIAL, axes=settings["axis_names"][:6])
        async with arm.open() as robot:
            before = await robot.active_frames()
            assert {axis.name for axis in before.external_axes} == {
                "Arm/Rail", *(f"Table/{name}" for name in settings["axis_names"])
            }  # fmt: skip
            for name in ("Arm/Axes/Rail", "Table/Axes/Axis_2"):
                node = f"{name}/ParameterSet/ActualPosition"
                await fake.inject_fault("other_value", {"node": node, "value": 250.5})
                told = changes_text(frame_changes(before, await robot.active_frames()))
                assert (
                    told
                    == f"the external axis {name.replace('/Axes', '')} stands at 250.500, and not at 0.000"
                )
                fake.clear_faults()
