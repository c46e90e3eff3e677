"""[[robot]] driver = "universal_robots" in cell.toml. The model is the factory."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from cellcal.calibration.arm.mounting import MOUNTED
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import RobotCapabilities
from cellcal.drivers.universal_robots.motion import MotionTolerances
from cellcal.drivers.universal_robots.robot import CAPABILITIES, UniversalRobot, UrMotionOptions
from cellcal.drivers.universal_robots.robot_connection import RobotConnection, StreamTiming
from cellcal.drivers.universal_robots.session import SessionOptions

_MODELS = ("ur3e", "ur5e", "ur10e", "ur16e")  # e-Series: CB3 runs another software
_STALE_SHARE = 0.25  # of the deadline
_CONNECT_SHARE = 0.75


class UniversalRobotConfig(BaseModel):
    """How to reach a UR controller, and how its arm may move. Its ports are the maker's and fixed."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    driver: Literal["universal_robots"]
    name: str = Field(min_length=1, max_length=64)
    address: str = Field(min_length=1)
    model: str
    serial: str = Field(min_length=1)
    deadline_s: float = Field(default=2.0, ge=1.0, le=60)
    speed_limit_rad_s: float = Field(default=0.5, gt=0, le=3.0)
    acceleration_rad_s2: float = Field(default=1.0, gt=0, le=10)
    stop_deceleration_rad_s2: float = Field(default=2.0, gt=0, le=20)
    settle_tolerance_rad: float = Field(default=5e-4, gt=0, le=0.01)
    settle_speed_rad_s: float = Field(default=2e-3, gt=0, le=0.1)
    settle_s: float = Field(default=0.3, ge=0, le=2.0)
    state_rate_hz: float = Field(default=125.0, ge=10, le=500)
    watchdog_hz: float = Field(default=5.0, ge=1, le=10)  # below 5 the arm runs on for longer than 0.2 s
    release_after_s: float = Field(default=5.0, ge=0, le=600)

    @field_validator("model")
    @classmethod
    def _check_model(cls, name: str) -> str:
        if name.partition(MOUNTED)[0] not in _MODELS:
            raise ValueError(
                make_message(
                    "this driver does not know a {name!r}; it knows {models}",
                    name=name,
                    models=", ".join(_MODELS),
                )
            )
        return name

    @property
    def capabilities(self) -> RobotCapabilities:
        """What this robot can do, known before it is reached."""
        return CAPABILITIES

    @property
    def pendant_language(self) -> str:
        """The key of the pendant's language among the program writers of the registry."""
        return self.driver

    @asynccontextmanager
    async def open(self) -> AsyncIterator[UniversalRobot]:
        """Connect for reading, check model and serial number; give the robot back at the end."""
        robot = UniversalRobot(self._make_connection(), self._session_options(), self._motion_options())
        try:
            await robot.connect()
            yield robot
        finally:
            await robot.close()

    def _make_connection(self) -> RobotConnection:
        return RobotConnection(
            self.name,
            self.address,
            (self.model.partition(MOUNTED)[0], self.serial),  # a controller does not tell its mounting
            StreamTiming(self.state_rate_hz, _STALE_SHARE * self.deadline_s, self.deadline_s),
        )

    def _session_options(self) -> SessionOptions:
        return SessionOptions(
            self.address, self.watchdog_hz, _CONNECT_SHARE * self.deadline_s, self.release_after_s
        )

    def _motion_options(self) -> UrMotionOptions:
        return UrMotionOptions(
            self.deadline_s,
            self.speed_limit_rad_s,
            self.acceleration_rad_s2,
            self.stop_deceleration_rad_s2,
            MotionTolerances(self.settle_tolerance_rad, self.settle_speed_rad_s, self.settle_s),
        )
