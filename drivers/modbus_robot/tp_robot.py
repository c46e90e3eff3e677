"""A robot that a TP program moves: no axis moves without mastering, and mastering is not written."""

from cellcal.calibration.geometry import Pose
from cellcal.calibration.mastering.counts import DriveTrain
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

    async def encoder_counts(self) -> Counts:
        return await self._robot.encoder_counts()

    async def drive_train(self) -> DriveTrain:
        return await self._robot.drive_train()

    async def encoder_epoch(self) -> int:
        return await self._robot.encoder_epoch()

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
