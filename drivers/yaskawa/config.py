"""[[robot]] driver = "yaskawa" in cell.toml. The model is the factory."""

import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, field_validator

from cellcal.drivers.interfaces import RobotCapabilities
from cellcal.drivers.wire.device_connection import connection_to
from cellcal.drivers.wire.motor_turns import MotorTurns
from cellcal.drivers.wire.stepwise_config import StepwiseRobotConfig

if TYPE_CHECKING:
    from cellcal.drivers.yaskawa.robot import YaskawaOptions, YaskawaRobot

_Scale = Annotated[float, Field(allow_inf_nan=False)]


class YaskawaConfig(StepwiseRobotConfig):
    """How to reach a Yaskawa controller with the High Speed Ethernet Server, and how its arm may move."""

    driver: Literal["yaskawa"]
    port: int = Field(default=10040, ge=1, le=65535)
    file_port: int = Field(default=10041, ge=1, le=65535)
    controller_type: str = Field(
        min_length=1, max_length=16
    )  # as the controller names its robot, for the check
    serial: str = Field(min_length=1)  # of the type plate: the controller does not tell it
    pulses_per_degree: Annotated[tuple[_Scale, ...], Field(min_length=6, max_length=6)]  # S L U R B T, signed
    fastest_axis_deg_s: float = Field(gt=0, le=2000)  # of the data sheet: speeds are told as a share of it
    motor_turns_per_joint_turn: MotorTurns = None  # gear ratios of the data sheet; a position cure needs them

    @field_validator("pulses_per_degree")
    @classmethod
    def _check_scale(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if any(not 10.0 <= abs(value) <= 1e6 for value in values):
            raise ValueError(
                "each number is the pulses of one degree of the axis, from RC.PRM or one taught pair; 10 to 1000000"
            )
        return values

    @property
    def capabilities(self) -> RobotCapabilities:
        """The robot's capabilities, known before it is reached."""
        from cellcal.drivers.yaskawa.robot import CAPABILITIES  # noqa: PLC0415  a cell file is read without it

        return CAPABILITIES

    @asynccontextmanager
    async def open(self) -> AsyncIterator["YaskawaRobot"]:
        """Connect, check the type of the robot, and close the sockets at the end."""
        from cellcal.drivers.yaskawa.hses_frames import FILE_DIVISION, ROBOT_DIVISION  # noqa: PLC0415  as above
        from cellcal.drivers.yaskawa.hses_link import HsesLink  # noqa: PLC0415  as above
        from cellcal.drivers.yaskawa.robot import YaskawaRobot  # noqa: PLC0415  as above

        within_s = self.telegram_deadline_s
        link = HsesLink(self.name, self.address, self.port, ROBOT_DIVISION, deadline_s=within_s)
        files = HsesLink(self.name, self.address, self.file_port, FILE_DIVISION, deadline_s=within_s)
        robot = YaskawaRobot(link, files, self._make_options())
        async with connection_to(robot):
            yield robot

    def _make_options(self) -> "YaskawaOptions":
        from cellcal.drivers.yaskawa.motion import PulseScale  # noqa: PLC0415  a cell file is read without it
        from cellcal.drivers.yaskawa.robot import YaskawaOptions  # noqa: PLC0415  as above
        from cellcal.drivers.yaskawa.state import AXES  # noqa: PLC0415  as above

        motion = self.stepwise_options(AXES)
        return YaskawaOptions(
            self.controller_type,
            self.serial,
            PulseScale(self.pulses_per_degree),
            math.radians(self.fastest_axis_deg_s),
            motion,
        )
