"""[[robot]] driver = "universal_robots" in cell.toml. The model is the factory."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from cellcal.calibration.arm.model_references import parse_reference
from cellcal.calibration.arm.robot_models import known_names
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import RobotCapabilities
from cellcal.drivers.universal_robots.arm_types import arm_types
from cellcal.drivers.universal_robots.motion import MotionTolerances
from cellcal.drivers.universal_robots.reading_robot import (
    READ_ONLY_CAPABILITIES,
    ReadingUniversalRobot,
    UrMotionOptions,
)
from cellcal.drivers.universal_robots.robot import CAPABILITIES, UniversalRobot
from cellcal.drivers.universal_robots.robot_connection import (
    ExpectedRobot,
    RobotConnection,
    StreamTiming,
)
from cellcal.drivers.universal_robots.session import SessionOptions
from cellcal.drivers.wire.device_connection import connection_to

_STALE_SHARE = 0.25  # of the deadline
_CONNECT_SHARE = 0.75


class UniversalRobotConfig(BaseModel):
    """How to reach a UR controller, and how its arm may move."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    driver: Literal["universal_robots"]
    name: str = Field(min_length=1, max_length=64)
    address: str = Field(min_length=1)
    model: str
    arm_type: str = Field(default="", validate_default=True)  # which arm it is, where the model is a file
    serial: str = Field(min_length=1)  # PolyScope X does not tell it
    calibration: str = Field(
        default="", pattern="^(calib_[0-9]+)?$"
    )  # name of the factory table; compared at connect
    robot_api_port: int = Field(default=80, ge=1, le=65535)  # PolyScope X; the maker's other ports are fixed
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
    def _check_model(cls, model: str, others: ValidationInfo) -> str:
        reference = parse_reference(model)
        if reference.is_file:
            return model
        if reference.where not in arm_types():
            raise ValueError(
                make_message(
                    "this driver does not know a {name!r}; it knows {models}",
                    name=reference.where,
                    models=", ".join(arm_types()),
                )
            )
        if reference.where not in known_names():
            raise ValueError(
                make_message(
                    "the catalogue holds no kinematics of a {name}: no public source has them. Write a model file "
                    "from the controller with `cellcal ur-model {address} --arm {name} --out {name}.toml`, then "
                    'write model = "{name}.toml" and arm_type = "{name}"',
                    name=reference.where,
                    address=others.data.get("address", ""),
                )
            )
        return model

    @field_validator("arm_type")
    @classmethod
    def _check_arm_type(cls, arm_type: str, others: ValidationInfo) -> str:
        if "model" not in others.data:
            return arm_type  # what is wrong with the model is said already
        reference = parse_reference(others.data["model"])
        if reference.is_file and arm_type not in arm_types():
            raise ValueError(
                make_message(
                    "where model is a file, arm_type names the arm, one of {models}",
                    models=", ".join(arm_types()),
                )
            )
        if not reference.is_file and arm_type not in ("", reference.where):
            raise ValueError(
                make_message(
                    "model says {model} and arm_type says {arm_type}",
                    model=reference.where,
                    arm_type=arm_type,
                )
            )
        return arm_type

    @property
    def arm(self) -> str:
        """Which arm of the maker it is, whatever model it is calibrated with."""
        return self.arm_type or parse_reference(self.model).where

    @property
    def profile(self) -> str:
        """Which rows of the evidence table are about it."""
        return "cb3" if arm_types()[self.arm].is_cb3 else "polyscope"

    @property
    def capabilities(self) -> RobotCapabilities:
        """The robot's capabilities, known before it is reached."""
        return READ_ONLY_CAPABILITIES if arm_types()[self.arm].is_cb3 else CAPABILITIES

    @property
    def pendant_language(self) -> str:
        """The key of the pendant's language among the program writers of the registry."""
        return self.driver

    @asynccontextmanager
    async def open(self) -> AsyncIterator[ReadingUniversalRobot]:
        """Connect for reading, check model and serial number; give the robot back at the end."""
        robot = self._make_robot()
        async with connection_to(robot):
            yield robot

    def _make_robot(self) -> ReadingUniversalRobot:
        if self.capabilities.moves_joints:
            return UniversalRobot(self._make_connection(), self._session_options(), self._motion_options())
        return ReadingUniversalRobot(self._make_connection(), self.address, self._motion_options())

    def _make_connection(self) -> RobotConnection:
        return RobotConnection(
            self.name,
            self.address,
            ExpectedRobot(self.arm, self.serial, self.calibration),
            StreamTiming(self.state_rate_hz, _STALE_SHARE * self.deadline_s, self.deadline_s),
            robot_api_port=self.robot_api_port,
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
