"""A controller with two robots: the driver reads the first one, and says so."""

from typing import Any

import pytest

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.driver_cases import open_retrying


@pytest.mark.parametrize(("name", "unit"), [("abb", "ROB_1"), ("motoman", "R1")])
async def test_another_robot_on_the_same_controller_is_told(
    cell: CellConfig, fake_client: FakeCellClient, name: str, unit: str
) -> None:
    robot: Any
    async with open_retrying(cell.robot_named(name)) as robot:
        assert await robot.identity_doubts() == ""
        await fake_client.inject_fault("second_robot", device=name)
        assert unit in await robot.identity_doubts()
        await fake_client.inject_fault("second_robot", device=name, there=False)
