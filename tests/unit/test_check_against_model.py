"""`cellcal check` compares the model of a robot that a person has in manual mode, too: units, signs, another arm."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Pose
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import Condition, Identity, JointReading, Readiness, RobotCapabilities
from cellcal.service.runs.cell_check import OTHER_MODEL, _report_robot

MODEL = "abb_irb1600_6_12"
JOINTS = (0.4, -0.3, 0.2, 0.5, 0.7, -0.9)


class ShownRobot:
    """A robot whose joints are shown in another unit than they are by a factor."""

    name, capabilities = "abb", RobotCapabilities(axes=6)

    def __init__(self, readiness: Readiness, factor: float) -> None:
        self.readiness, self.factor, self.refuses = readiness, factor, False

    async def identify(self) -> Identity:
        return Identity("ABB", "IRB", "1600-1", "6.15")

    async def read_condition(self) -> Condition:
        return Condition(self.readiness, "the controller is in MANR, not in AUTO.", "Turn the mode switch.")

    async def read_joints(self) -> JointReading:
        return JointReading(tuple(q * self.factor for q in JOINTS), moving=False, taken_at_s=0.0)

    async def flange_pose(self) -> Pose:
        if self.refuses:
            raise RefusedError(self.name, "the active tool stands beside the robot.")
        return Pose.from_matrix(load_model(MODEL).base_flange(np.array([JOINTS]))[0])


@pytest.mark.parametrize("readiness", [Readiness.READY, Readiness.NOT_READY, Readiness.STOPPED])
async def test_joints_in_another_unit_are_found_whatever_the_mode_switch_says(readiness: Readiness) -> None:
    config: Any = SimpleNamespace(model=MODEL)
    right: Any = ShownRobot(readiness, 1.0)
    assert (await _report_robot(right, config)).state is readiness
    wrong: Any = ShownRobot(readiness, np.pi / 180.0)  # radians that were taken for degrees
    report = await _report_robot(wrong, config)
    assert report.state == OTHER_MODEL
    assert "from where a abb_irb1600_6_12 has it" in report.message


async def test_a_robot_that_shows_no_pose_now_stays_what_it_is() -> None:
    config: Any = SimpleNamespace(model=MODEL)
    robot: Any = ShownRobot(Readiness.NOT_READY, 1.0)
    robot.refuses = True
    assert (await _report_robot(robot, config)).state is Readiness.NOT_READY


async def test_the_joints_of_a_lost_position_are_compared_with_nothing() -> None:
    robot: Any = ShownRobot(Readiness.POSITION_LOST, 0.5)
    report = await _report_robot(robot, SimpleNamespace(model=MODEL))  # type: ignore[arg-type]
    assert report.state is Readiness.POSITION_LOST
