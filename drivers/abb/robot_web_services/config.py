"""[[robot]] driver = "abb_web_services" in cell.toml. The model is the factory."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, model_validator

from cellcal.drivers.interfaces import RobotCapabilities
from cellcal.drivers.wire.device_connection import connection_to
from cellcal.drivers.wire.joint_stream_settings import JointStreamSettings
from cellcal.drivers.wire.motor_turns import MotorTurns
from cellcal.drivers.wire.stepwise_config import StepwiseRobotConfig

if TYPE_CHECKING:
    from cellcal.drivers.abb.robot_web_services.robot import AbbRobot

_EGM_PORT = 6510  # by convention


class GuidedMotionSettings(JointStreamSettings):
    """``[robot.egm]``: position stream of Externally Guided Motion (option 689-1), received and never answered."""

    port: int = Field(default=_EGM_PORT, ge=1, le=65535)


class AbbWebServicesConfig(StepwiseRobotConfig):
    """How to reach an ABB controller with RobotWare 6 or 7, and how its arm may move."""

    driver: Literal["abb_web_services"]
    port: int | None = Field(default=None, ge=1, le=65535)  # None: 80 and 443, as the generation asks for
    certificate: Path | None = None  # of a controller with TLS, in PEM form; None: not compared
    user: str = Field(default="Default User", min_length=1, max_length=64)
    password: str = Field(default="robotics", max_length=64)  # both are the maker's defaults
    serial: str = Field(min_length=1)  # of the controller (ctrl-id); compared at every connect
    deadline_s: float = Field(default=3.0, gt=0, le=60)
    motor_turns_per_joint_turn: MotorTurns = None  # gear ratios of the data sheet; a position cure needs them

    egm: GuidedMotionSettings | None = None

    @model_validator(mode="after")
    def _check_sender(self) -> Self:
        if self.egm is not None:
            self.egm.sender_of(self.address)
        return self

    @property
    def capabilities(self) -> RobotCapabilities:
        """The robot's capabilities, known before it is reached."""
        from cellcal.drivers.abb.robot_web_services.robot import CAPABILITIES  # noqa: PLC0415  a cell file is read without it

        return CAPABILITIES

    @asynccontextmanager
    async def open(self) -> AsyncIterator["AbbRobot"]:
        """Open a session, compare the serial number, and give the session back at the end."""
        from cellcal.drivers.abb.guided_motion.packets import read_robot_packet  # noqa: PLC0415  as above
        from cellcal.drivers.abb.robot_web_services.generation import ServiceAddress  # noqa: PLC0415  as above
        from cellcal.drivers.abb.robot_web_services.rapid_values import AXES  # noqa: PLC0415  as above
        from cellcal.drivers.abb.robot_web_services.robot import AbbOptions, AbbRobot  # noqa: PLC0415  as above
        from cellcal.drivers.abb.robot_web_services.web_link import WebLink  # noqa: PLC0415  as above
        from cellcal.drivers.wire.joint_stream import JointStream  # noqa: PLC0415  as above

        link = WebLink(
            ServiceAddress(self.name, self.address, self.port, self.certificate),
            (self.user, self.password),
            deadline_s=self.telegram_deadline_s,
        )
        motion = self.stepwise_options(AXES)
        stream = None
        if self.egm is not None:
            sender = self.egm.sender_of(self.address)
            stream = JointStream(self.name, "EGM", self.egm, sender, read_robot_packet)
        robot = AbbRobot(link, AbbOptions(self.serial, motion), stream)
        async with connection_to(robot):
            yield robot
