"""The motors of a robot whose encoders cannot be read, as the joints that its controller shows tell them.

A motor turn that the controller lost shows in these joints as it does in counts: by a whole number of motor turns.
"""

from collections.abc import Sequence

import numpy as np

from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.mastering.position_record import drive_of_ratios
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import Counts, MasteringData, Readiness, Robot
from cellcal.procedures.robot_condition import read_reached_condition


class ShownMotors:
    """MasteringStore whose counts are shown joints, and JogsAxes by joint moves of one axis. It writes nothing."""

    def __init__(self, robot: Robot, motor_turns_per_joint_turn: Sequence[float]) -> None:
        self._robot, self._drive = robot, drive_of_ratios(motor_turns_per_joint_turn)
        self._zeros = (0,) * len(motor_turns_per_joint_turn)

    async def encoder_counts(self) -> Counts:
        """Return the joints that the controller shows, in shares of motor turns."""
        joints = (await self._robot.read_joints()).joints_rad
        return tuple(int(count) for count in self._drive.to_counts(np.array(joints), np.array(self._zeros)))

    async def drive_train(self) -> DriveTrain:
        return self._drive

    async def encoder_epoch(self) -> int:
        """Return 1 while an axis has lost its position, else 0: a loss after the cure ends what is measured."""
        return int((await read_reached_condition(self._robot)).readiness is Readiness.POSITION_LOST)

    async def read_mastering(self) -> MasteringData:
        lost = (await read_reached_condition(self._robot)).readiness is Readiness.POSITION_LOST
        return MasteringData(self._zeros, mastered=not lost)

    async def write_mastering(self, counts_at_zero: Counts) -> MasteringData:
        raise self._refused_error()

    async def restore_mastering(self, data: MasteringData) -> MasteringData:
        raise self._refused_error()

    async def reset_position_alarms(self) -> None:
        raise self._refused_error()

    async def jog_axis(self, axis: int, delta_rad: float, *, speed_rad_s: float) -> None:
        """Turn one joint by a joint move of the controller, which takes all its axes as good."""
        here = (await self._robot.read_joints()).joints_rad
        there = tuple(joint + delta_rad * (k == axis) for k, joint in enumerate(here))
        await self._robot.move_joints(there, speed_rad_s=speed_rad_s)

    def _refused_error(self) -> RefusedError:
        return RefusedError(
            self._robot.name,
            "no wire writes the mastering of this controller",
            remedy="A person does it at the pendant: run position_cure.",
        )
