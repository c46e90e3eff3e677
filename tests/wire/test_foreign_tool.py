"""The tool is switched on the pendant: seen over the wire, and nothing is moved or measured with it."""

from typing import Any

import pytest

from cellcal.drivers.operator.scripted import ScriptedOperator
from cellcal.procedures.motion.active_frames import FramesChangedError
from cellcal.procedures.motion.motion_gate import move_along
from cellcal.procedures.steps.length import capture_length
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.runs.open_cell import open_cell
from tests.wire.driver_cases import Fault
from tests.wire.robot_cases import ROBOTS, RobotCase

ASIDE_RAD = 0.05
BACK: dict[str, Fault] = {  # how a technician selects again what was active
    "fanuc": ("tool_switched", {"number": 1}),
    "ur": ("tool_switched", {"tcp": [0.0] * 6, "payload_kg": 0.0}),
}
SAYS = {
    "fanuc": ("tool 2 is active, and not tool 1", "Select tool 1 on the pendant again, then resume."),
    "ur": (r"z 100.000 mm .*, and not at x 0.000, y 0.000, z 0.000 mm", "Set the active tool to x 0.000"),
}


async def _expect_refused(work: Any, name: str) -> None:
    with pytest.raises(FramesChangedError, match=SAYS[name][0]) as refused:
        await work
    assert refused.value.remedy.startswith(SAYS[name][1])


@pytest.mark.parametrize(
    "robot_case", [ROBOTS["modbus_robot"], ROBOTS["universal_robots"]], ids=["fanuc", "ur"]
)
async def test_a_foreign_tool_moves_nothing_until_the_old_one_is_selected_again(
    robot: Any, robot_case: RobotCase, cell: CellConfig, fake_client: FakeCellClient
) -> None:
    await robot.close()
    aside = (robot_case.home_rad[0] + ASIDE_RAD, *robot_case.home_rad[1:])
    async with open_cell(cell, ScriptedOperator({}), robot_case.name) as open_cell_devices:
        await move_along(open_cell_devices, [robot_case.home_rad], 0.3)
        await capture_length(open_cell_devices, "before", 2)
        await fake_client.inject_fault("tool_switched", device=robot_case.name)
        stood = (await fake_client.read_truth())["robots"][robot_case.name]["joints_rad"]
        await _expect_refused(move_along(open_cell_devices, [aside], 0.3), robot_case.name)
        await _expect_refused(capture_length(open_cell_devices, "with a foreign tool", 2), robot_case.name)
        assert (await fake_client.read_truth())["robots"][robot_case.name]["joints_rad"] == pytest.approx(
            stood, abs=1e-9
        )
        name, parameters = BACK[robot_case.name]
        await fake_client.inject_fault(name, device=robot_case.name, **parameters)
        await move_along(open_cell_devices, [aside], 0.3)
        await capture_length(open_cell_devices, "after", 2)
        assert (await open_cell_devices.robot.read_joints()).joints_rad == pytest.approx(aside, abs=2e-3)
