"""[[robot]] driver = "modbus_robot" in cell.toml. The model is the factory."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from cellcal.drivers.interfaces import RobotCapabilities
from cellcal.drivers.modbus_robot.profile import load_profile, profile_names
from cellcal.drivers.wire.device_connection import connection_to

if TYPE_CHECKING:
    from cellcal.drivers.modbus_robot.robot import ModbusRobot
    from cellcal.drivers.modbus_robot.tp_robot import TpRobot

_TELEGRAM_SHARE = 0.3  # of the deadline: a failed telegram leaves time for a stop and for saying so


class ModbusRobotConfig(BaseModel):
    """How to reach a controller behind Modbus TCP, and how fast its robot may move."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    driver: Literal["modbus_robot"]
    name: str = Field(min_length=1, max_length=64)
    profile: str
    address: str = Field(min_length=1)
    port: int = Field(default=502, ge=1, le=65535)
    model: str = Field(min_length=1)  # name of the nominal robot model
    serial: str = Field(min_length=1)
    second_group: bool = False  # a positioner or rail: its axes are compared between captures, too
    deadline_s: float = Field(default=2.0, gt=0, le=60)
    speed_limit_rad_s: float = Field(gt=0, le=3.0)
    settle_s: float = Field(default=1.0, ge=0, le=60)
    motion_margin_s: float = Field(default=10.0, gt=0, le=600)

    @field_validator("profile")
    @classmethod
    def _check_profile(cls, name: str) -> str:
        if name not in profile_names():
            raise ValueError(f"there is no profile {name!r}; known: {', '.join(profile_names())}")
        return name

    @model_validator(mode="after")
    def _check_second_group(self) -> "ModbusRobotConfig":
        if self.second_group and not load_profile(self.profile).has_second_group:
            raise ValueError(f"second_group: profile {self.profile!r} tells of no second motion group")
        return self

    @property
    def capabilities(self) -> RobotCapabilities:
        """The robot's capabilities, known before it is reached."""
        from cellcal.drivers.modbus_robot.robot import capabilities_of  # noqa: PLC0415  a cell file is read without the library

        return capabilities_of(load_profile(self.profile))

    @property
    def pendant_language(self) -> str:
        """The key of the pendant's language among the program writers of the registry."""
        return self.profile

    @asynccontextmanager
    async def open(self) -> AsyncIterator["ModbusRobot | TpRobot"]:
        """Connect, check the serial number, and hang up at the end."""
        from cellcal.drivers.modbus_robot.cell_program import CellProgram  # noqa: PLC0415  as above
        from cellcal.drivers.modbus_robot.register_client import RegisterClient, SerialCheck  # noqa: PLC0415  a cell file is read without the library
        from cellcal.drivers.modbus_robot.robot import ModbusMotionOptions, ModbusRobot  # noqa: PLC0415  as above
        from cellcal.drivers.modbus_robot.tp_robot import TpRobot  # noqa: PLC0415  as above
        from cellcal.drivers.wire.modbus import ModbusLink  # noqa: PLC0415  as above

        profile = load_profile(self.profile)
        link = ModbusLink(
            self.name,
            self.address,
            self.port,
            deadline_s=_TELEGRAM_SHARE * self.deadline_s,
            check_server=SerialCheck(profile, self.serial),
        )
        panel = RegisterClient(link, profile)
        options = ModbusMotionOptions(
            self.deadline_s,
            self.speed_limit_rad_s,
            self.settle_s,
            self.motion_margin_s,
            self.second_group,
        )
        robot = ModbusRobot(panel, CellProgram(panel, deadline_s=self.deadline_s), options)
        async with connection_to(robot):
            yield robot if profile.abilities.writes_mastering else TpRobot(robot)
