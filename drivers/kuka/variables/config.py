"""[[robot]] driver = "kuka_variables" in cell.toml. The model is the factory."""

import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, model_validator

from cellcal.drivers.interfaces import RobotCapabilities
from cellcal.drivers.wire.device_connection import connection_to
from cellcal.drivers.wire.joint_stream_settings import JointStreamSettings
from cellcal.drivers.wire.motor_turns import MotorTurns
from cellcal.drivers.wire.stepwise_config import StepwiseRobotConfig

if TYPE_CHECKING:
    from cellcal.drivers.kuka.variables.robot import KukaRobot


class KukaVariablesConfig(StepwiseRobotConfig):
    """How to reach a KUKA controller through C3 Bridge or KUKAVARPROXY, and how its arm may move."""

    driver: Literal["kuka_variables"]
    port: int = Field(default=7000, ge=1, le=65535)
    serial: str = Field(min_length=1)  # $KR_SERIALNO; compared at every connect
    fastest_axis_deg_s: float = Field(gt=0, le=2000)  # of the data sheet: speeds are told as a share of it
    motor_turns_per_joint_turn: MotorTurns = None  # gear ratios of the data sheet; a position cure needs them

    rsi: JointStreamSettings | None = (
        None  # Robot Sensor Interface with ONLYSEND: received and never answered
    )

    @model_validator(mode="after")
    def _check_sender(self) -> Self:
        if self.rsi is not None:
            self.rsi.sender_of(self.address)
        return self

    @property
    def capabilities(self) -> RobotCapabilities:
        """The robot's capabilities, known before it is reached."""
        from cellcal.drivers.kuka.variables.robot import CAPABILITIES  # noqa: PLC0415  a cell file is read without it

        return CAPABILITIES

    @asynccontextmanager
    async def open(self) -> AsyncIterator["KukaRobot"]:
        """Connect, compare the serial number, and hang up at the end."""
        from cellcal.drivers.kuka.sensor_interface.packets import read_robot_packet  # noqa: PLC0415  as above
        from cellcal.drivers.kuka.variables.robot import KukaOptions, KukaRobot  # noqa: PLC0415  as above
        from cellcal.drivers.kuka.variables.values import AXES  # noqa: PLC0415  as above
        from cellcal.drivers.kuka.variables.variable_link import VariableLink  # noqa: PLC0415  as above
        from cellcal.drivers.wire.joint_stream import JointStream  # noqa: PLC0415  as above

        within_s = self.telegram_deadline_s
        link = VariableLink(self.name, self.address, self.port, deadline_s=within_s)
        motion = self.stepwise_options(AXES)
        options = KukaOptions(self.serial, math.radians(self.fastest_axis_deg_s), motion)
        stream = None
        if self.rsi is not None:
            sender = self.rsi.sender_of(self.address)
            stream = JointStream(self.name, "RSI", self.rsi, sender, read_robot_packet)
        robot = KukaRobot(link, options, stream)
        async with connection_to(robot):
            yield robot
