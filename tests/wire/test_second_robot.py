"""A controller with two robots: the driver reads the first one, and says so."""

from typing import Any

import pytest

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.driver_cases import open_retrying


@pytest.mark.parametrize(
    ("name", "unit", "open_serial"), [("abb", "ROB_1", ""), ("motoman", "R1", "Y-230815")]
)
async def test_another_robot_on_the_same_controller_is_told(
    cell: CellConfig, fake_client: FakeCellClient, name: str, unit: str, open_serial: str
) -> None:
    robot: Any
    async with open_retrying(cell.robot_named(name)) as robot:
        doubts = await robot.identity_doubts()
        assert open_serial in doubts
        assert bool(doubts) is bool(open_serial)  # a serial number that is not told proves nothing
        assert unit not in doubts.split()
        await fake_client.inject_fault("second_robot", device=name)
        assert unit in await robot.identity_doubts()
        await fake_client.inject_fault("second_robot", device=name, there=False)


async def test_what_rmi_shows_of_the_robot_is_the_cell_file(cell: CellConfig) -> None:
    robot: Any
    async with open_retrying(cell.robot_named("rmi")) as robot:
        doubts = await robot.identity_doubts()
    assert "fanuc_m6ib" in doubts
    assert "F-230816" in doubts
    assert "label" in doubts
