"""A robot that a TP program moves: no axis moves without mastering, and mastering is not written."""

import itertools
import math

import numpy as np

from cellcal.calibration.geometry import Pose
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.mastering.shown_joints import find_conventions
from cellcal.drivers.errors import WireProtocolError
from cellcal.drivers.interfaces import (
    ActiveFrames,
    Condition,
    Counts,
    Identity,
    JointReading,
    Joints,
    MasteringData,
    RobotCapabilities,
)
from cellcal.drivers.modbus_robot.robot import ModbusRobot

_AGREEMENT_RAD = math.radians(0.02)  # the pendant's angle has hundredths of a degree


class TpRobot:
    """The abilities of a real controller with CELLCAL; each is that of `ModbusRobot`."""

    def __init__(self, robot: ModbusRobot) -> None:
        self._robot = robot

    @property
    def name(self) -> str:
        return self._robot.name

    @property
    def capabilities(self) -> RobotCapabilities:
        return self._robot.capabilities

    async def identify(self) -> Identity:
        return await self._robot.identify()

    async def read_condition(self) -> Condition:
        return await self._robot.read_condition()

    async def read_joints(self) -> JointReading:
        return await self._robot.read_joints()

    async def flange_pose(self) -> Pose:
        return await self._robot.flange_pose()

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        await self._robot.move_joints(target_rad, speed_rad_s=speed_rad_s)

    async def stop(self) -> None:
        await self._robot.stop()

    async def read_mastering(self) -> MasteringData:
        return await self._robot.read_mastering()

    async def read_tool_frame(self, number: int) -> Pose:
        return await self._robot.read_tool_frame(number)

    async def write_tool_frame(self, number: int, flange_tool: Pose) -> Pose:
        return await self._robot.write_tool_frame(number, flange_tool)

    async def read_user_frame(self, number: int) -> Pose:
        return await self._robot.read_user_frame(number)

    async def write_user_frame(self, number: int, base_user: Pose) -> Pose:
        return await self._robot.write_user_frame(number, base_user)

    async def active_frames(self) -> ActiveFrames:
        return await self._robot.active_frames()

    async def controller_mode(self) -> str:
        return await self._robot.controller_mode()

    async def speed_override(self) -> float:
        return await self._robot.speed_override()

    async def encoder_counts(self) -> Counts:
        return await self._robot.encoder_counts()

    async def encoder_epoch(self) -> int:
        return await self._robot.encoder_epoch()

    async def drive_train(self) -> DriveTrain:
        """Return how counts turn the joints that the pendant shows; the interaction matrix tells those of the links.

        Raises
        ------
        WireProtocolError
            Counts and shown joints agree under no convention.
        """
        links = await self._robot.drive_train()
        zero = (await self._robot.read_mastering()).counts_at_zero
        counts = await self._robot.encoder_counts()
        shown = (await self._robot.read_joints()).joints_rad
        moved = [count - at_zero for count, at_zero in zip(counts, zero, strict=True)]
        signs = sorted(itertools.product((1, -1), repeat=len(shown)), key=lambda row: row.count(-1))
        matrix = np.array(links.radians_per_count)
        found = find_conventions(matrix, signs, moved, shown, _AGREEMENT_RAD)
        if not found.matching:
            raise WireProtocolError(
                self.name,
                "counts and shown joints agree under no sign of the interaction matrix.",
                remedy="Compare $INTERACTION, $MASTER_COUN and the pendant's angles; the arm must stand.",
            )
        rows = found.matching[0].to_shown_matrix(matrix)
        return DriveTrain(tuple(tuple(row) for row in rows.tolist()), links.counts_per_turn)
