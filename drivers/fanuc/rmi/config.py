"""[[robot]] driver = "fanuc_rmi" in cell.toml. The model is the factory."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Literal

from pydantic import BaseModel, ConfigDict, Field

from cellcal.drivers.interfaces import RobotCapabilities

if TYPE_CHECKING:
    from cellcal.drivers.fanuc.rmi.robot import FanucRmiRobot

_TELEGRAM_SHARE = 0.5  # of the deadline: a failed telegram leaves time for a stop and for saying so


class FanucRmiConfig(BaseModel):
    """How to reach a FANUC controller with the Remote Motion Interface, and how its arm may move."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    driver: Literal["fanuc_rmi"]
    name: str = Field(min_length=1, max_length=64)
    address: str = Field(min_length=1)
    port: int = Field(default=16001, ge=1, le=65535)
    model: str = Field(min_length=1)  # name of the nominal robot model
    serial: str = Field(min_length=1)  # of the type plate: this link does not tell it
    deadline_s: float = Field(default=2.0, gt=0, le=60)
    speed_limit_rad_s: float = Field(gt=0, le=3.0)
    step_s: float = Field(default=0.5, gt=0, le=5.0)  # so long the arm may go on when the link is lost
    settle_s: float = Field(default=0.5, ge=0, le=60)
    stuck_s: float = Field(default=3.0, gt=0, le=60)
    tolerance_rad: float = Field(default=5e-4, gt=0, le=0.01)

    @property
    def capabilities(self) -> RobotCapabilities:
        """What this robot can do, known before it is reached."""
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
        from cellcal.drivers.wire.stepwise_motion import StepwiseOptions  # noqa: PLC0415  as above

        link = RmiLink(self.name, self.address, self.port, deadline_s=_TELEGRAM_SHARE * self.deadline_s)
        motion = StepwiseOptions.from_settings(AXES, self)
        options = RmiOptions(self.serial, self.model, motion)
        robot = FanucRmiRobot(link, options)
        try:
            await robot.connect()
            yield robot
        finally:
            await robot.close()
