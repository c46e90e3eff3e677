"""[[robot]] driver = "kuka_variables" in cell.toml. The model is the factory."""

import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from cellcal.drivers.interfaces import RobotCapabilities
from cellcal.drivers.wire.joint_stream_settings import JointStreamSettings
from cellcal.drivers.wire.motor_turns import MotorTurns

if TYPE_CHECKING:
    from cellcal.drivers.kuka.variables.robot import KukaRobot

_TELEGRAM_SHARE = 0.5  # of the deadline: a failed telegram leaves time for a stop and for saying so


class KukaVariablesConfig(BaseModel):
    """How to reach a KUKA controller through C3 Bridge or KUKAVARPROXY, and how its arm may move."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    driver: Literal["kuka_variables"]
    name: str = Field(min_length=1, max_length=64)
    address: str = Field(min_length=1)
    port: int = Field(default=7000, ge=1, le=65535)
    model: str = Field(min_length=1)  # name of the nominal robot model
    serial: str = Field(min_length=1)  # $KR_SERIALNO; compared at every connect
    fastest_axis_deg_s: float = Field(gt=0, le=2000)  # of the data sheet: speeds are told as a share of it
    deadline_s: float = Field(default=2.0, gt=0, le=60)
    speed_limit_rad_s: float = Field(gt=0, le=3.0)
    step_s: float = Field(default=0.5, gt=0, le=5.0)  # so long the arm may go on when the link is lost
    settle_s: float = Field(default=0.5, ge=0, le=60)
    stuck_s: float = Field(default=2.0, gt=0, le=60)
    tolerance_rad: float = Field(default=5e-4, gt=0, le=0.01)
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
        """What this robot can do, known before it is reached."""
        from cellcal.drivers.kuka.variables.robot import CAPABILITIES  # noqa: PLC0415  a cell file is read without it

        return CAPABILITIES

    @property
    def pendant_language(self) -> str:
        """The key of the pendant's language among the program writers of the registry."""
        return self.driver

    @asynccontextmanager
    async def open(self) -> AsyncIterator["KukaRobot"]:
        """Connect, compare the serial number, and hang up at the end."""
        from cellcal.drivers.kuka.sensor_interface.packets import read_robot_packet  # noqa: PLC0415  as above
        from cellcal.drivers.kuka.variables.robot import KukaOptions, KukaRobot  # noqa: PLC0415  as above
        from cellcal.drivers.kuka.variables.values import AXES  # noqa: PLC0415  as above
        from cellcal.drivers.kuka.variables.variable_link import VariableLink  # noqa: PLC0415  as above
        from cellcal.drivers.wire.joint_stream import JointStream  # noqa: PLC0415  as above
        from cellcal.drivers.wire.stepwise_motion import StepwiseOptions  # noqa: PLC0415  as above

        within_s = _TELEGRAM_SHARE * self.deadline_s
        link = VariableLink(self.name, self.address, self.port, deadline_s=within_s)
        motion = StepwiseOptions.from_settings(AXES, self)
        options = KukaOptions(self.serial, math.radians(self.fastest_axis_deg_s), motion)
        stream = None
        if self.rsi is not None:
            sender = self.rsi.sender_of(self.address)
            stream = JointStream(self.name, "RSI", self.rsi, sender, read_robot_packet)
        robot = KukaRobot(link, options, stream)
        try:
            await robot.connect()
            yield robot
        finally:
            await robot.close()
