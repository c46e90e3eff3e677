"""Steps that move the robot to planned joints. Every joint comes to rest turning in the positive sense.

One side for all captures keeps the gears on one tooth flank, so that backlash does not enter the comparison
of a record with a recovery.
"""

from dataclasses import dataclass

import numpy as np

from calibration.mastering import DriveTrain
from drivers.interfaces import Counts, Joints
from procedures.cell import Cell
from procedures.run import ProcedureError
from procedures.steps.mastering import axis_jog, motor_store

OVERSHOOT_RAD = 0.0174533  # 1 deg
AXIS_TOLERANCE_RAD = 2e-3


class OffTargetError(ProcedureError):
    """A move ended somewhere else than planned."""

    code = "procedure.off_target"


@dataclass(frozen=True, slots=True)
class Arrival:
    """Where the arm came to rest, in the controller's counts and joints."""

    counts: Counts
    joints_rad: Joints


@dataclass(frozen=True, slots=True)
class CountsToJoints:
    """How counts read now become joints of the healthy robot: the drive, and provisional turns."""

    drive: DriveTrain
    counts_at_zero: Counts
    turns: tuple[int, ...]

    def joints(self, counts: Counts) -> Joints:
        """Return the joints that these counts most likely mean [rad]."""
        true = [
            count + k * n for count, k, n in zip(counts, self.turns, self.drive.counts_per_turn, strict=True)
        ]
        return tuple(float(q) for q in self.drive.joints(np.array(true), np.array(self.counts_at_zero)))


async def go_to(cell: Cell, target_rad: Joints, speed_rad_s: float) -> Arrival:
    """Move a mastered robot to joints, by way of a point below them where a joint would come from above."""
    speed = min(speed_rad_s, cell.limits.speed_rad_s)
    here = (await cell.robot.joints()).joints_rad
    below = tuple(t - OVERSHOOT_RAD if t < q else t for t, q in zip(target_rad, here, strict=True))
    if below != tuple(target_rad):
        await cell.robot.move_joints(below, speed_rad_s=speed)
    await cell.robot.move_joints(tuple(target_rad), speed_rad_s=speed)
    arrival = await _arrival(cell)
    _refuse_off_target(arrival.joints_rad, target_rad, cell.limits.joint_tolerance_rad)
    return arrival


async def jog_to(cell: Cell, target_rad: Joints, mapping: CountsToJoints, speed_rad_s: float) -> Arrival:
    """Bring a robot that does not know its position to joints, one axis after the other, J1 first."""
    jogs, store = axis_jog(cell), motor_store(cell)
    speed = min(speed_rad_s, cell.limits.jog_speed_rad_s)
    for axis, target in enumerate(target_rad):
        here = mapping.joints(await store.encoder_counts())[axis]
        delta = target - here
        if abs(delta) <= AXIS_TOLERANCE_RAD / 20:
            continue
        if delta < 0:
            await jogs.jog_axis(axis, delta - OVERSHOOT_RAD, speed_rad_s=speed)
            delta = target - mapping.joints(await store.encoder_counts())[axis]
        await jogs.jog_axis(axis, delta, speed_rad_s=speed)
    arrival = await _arrival(cell)
    _refuse_off_target(mapping.joints(arrival.counts), target_rad, AXIS_TOLERANCE_RAD)
    return arrival


async def pass_index(cell: Cell, axis: int, delta_rad: float, speed_rad_s: float) -> Arrival:
    """Turn one motor past its index and back, so that its single-turn reading is known again."""
    jogs = axis_jog(cell)
    speed = min(speed_rad_s, cell.limits.jog_speed_rad_s)
    await jogs.jog_axis(axis, delta_rad, speed_rad_s=speed)
    await jogs.jog_axis(axis, -delta_rad, speed_rad_s=speed)
    return await _arrival(cell)


async def _arrival(cell: Cell) -> Arrival:
    return Arrival(await motor_store(cell).encoder_counts(), (await cell.robot.joints()).joints_rad)


def _refuse_off_target(found: Joints, target: Joints, tolerance_rad: float) -> None:
    errors = [abs(f - t) for f, t in zip(found, target, strict=True)]
    worst = max(range(len(errors)), key=errors.__getitem__)
    if errors[worst] > tolerance_rad:
        raise OffTargetError(
            f"axis {worst + 1} ended {np.degrees(errors[worst]):.3f} deg from its target",
            remedy="Look whether something blocks the arm, then resume.",
        )
