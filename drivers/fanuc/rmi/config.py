"""[[robot]] driver = "fanuc_rmi" in cell.toml. The model is the factory."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from cellcal.drivers.interfaces import RobotCapabilities
from cellcal.drivers.wire.device_connection import connection_to
from cellcal.drivers.wire.stepwise_config import StepwiseRobotConfig

if TYPE_CHECKING:
    from cellcal.drivers.fanuc.rmi.robot import FanucRmiRobot


class FanucRmiConfig(StepwiseRobotConfig):
    """How to reach a FANUC controller with the Remote Motion Interface, and how its arm may move."""

    driver: Literal["fanuc_rmi"]
    port: int = Field(default=16001, ge=1, le=65535)
    serial: str = Field(min_length=1)  # of the type plate: this link does not tell it
    second_group: bool = False  # a positioner or rail: its axes are compared between captures, too
    stuck_s: float = Field(default=3.0, gt=0, le=60)

    @property
    def capabilities(self) -> RobotCapabilities:
        """The robot's capabilities, known before it is reached."""
        from cellcal.drivers.fanuc.rmi.robot import CAPABILITIES  # noqa: PLC0415  a cell file is read without it

        return CAPABILITIES

    @property
    def pendant_language(self) -> str:
        """The key of the pendant's language among the program writers of the registry."""
        return "fanuc_hmi"

    @asynccontextmanager
    async def open(self) -> AsyncIterator["FanucRmiRobot"]:
        """Connect, and hang up at the end."""
        from cellcal.drivers.fanuc.rmi.rmi_link import RmiLink  # noqa: PLC0415  a cell file is read without it
        from cellcal.drivers.fanuc.rmi.rmi_state import AXES  # noqa: PLC0415  as above
        from cellcal.drivers.fanuc.rmi.robot import FanucRmiRobot, RmiOptions  # noqa: PLC0415  as above

        link = RmiLink(self.name, self.address, self.port, deadline_s=self.telegram_deadline_s)
        motion = self.stepwise_options(AXES)
        options = RmiOptions(self.serial, self.model, motion, self.second_group)
        robot = FanucRmiRobot(link, options)
        async with connection_to(robot):
            yield robot
