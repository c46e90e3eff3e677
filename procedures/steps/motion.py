"""Steps that move the robot to planned joints. Every joint comes to rest turning in the positive sense.

One side for all captures keeps the gears on one tooth flank, so that backlash does not enter the comparison
of a record with a recovery. Nothing here commands a robot: `procedures.motion.motion_gate` does, or a person.
"""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.motion.position_uncertainty import PositionUncertainty
from cellcal.drivers.interfaces import Counts, Joints
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion import motion_gate
from cellcal.procedures.motion.approach import OVERSHOOT_RAD, from_above, from_below
from cellcal.procedures.motion.motion_gate import JogMove, MotionCare, refuse_off_target
from cellcal.procedures.motion.speed_limit import SpeedLimit
from cellcal.procedures.motors import motor_store

AXIS_TOLERANCE_RAD = 2e-3
ALREADY_TURNED = 0.5  # of a motor's way past its index
HAND_ROUNDS = 3  # over all axes, where a person moves one that had to stand


@dataclass(frozen=True, slots=True)
class Arrival:
    """The place where the arm came to rest, in the controller's counts and joints."""

    counts: Counts
    joints_rad: Joints


@dataclass(frozen=True, slots=True)
class CountsToJoints:
    """The relation of counts read now and joints of the healthy robot: the drive, and provisional turns."""

    drive: DriveTrain
    counts_at_zero: Counts
    turns: tuple[int, ...]

    def joints_at(self, counts: Counts) -> Joints:
        """Return the joints that these counts most likely mean [rad]."""
        true = [
            count + k * n for count, k, n in zip(counts, self.turns, self.drive.counts_per_turn, strict=True)
        ]
        return tuple(float(q) for q in self.drive.to_joints(np.array(true), np.array(self.counts_at_zero)))


async def go_to(
    cell: Cell, target_rad: Joints, speed_rad_s: float, doubt: PositionUncertainty | None = None
) -> Arrival:
    """Move a mastered robot, the wire hooked in, to joints; come to rest there from below."""
    await follow_way(cell, (target_rad,), speed_rad_s, wired=True, doubt=doubt)
    return await _read_arrival(cell)


async def go_along(cell: Cell, way_rad: tuple[Joints, ...], speed_rad_s: float) -> Arrival:
    """Move a mastered robot, the wire hooked in, along the corners of a way; come to rest at the last from below."""
    await follow_way(cell, way_rad, speed_rad_s, wired=True)
    return await _read_arrival(cell)


async def go_to_from_above(
    cell: Cell, target_rad: Joints, speed_rad_s: float, doubt: PositionUncertainty | None = None
) -> Arrival:
    """Move a mastered robot, the wire hooked in, to joints; come to rest there from the other side."""
    here = (await cell.robot.read_joints()).joints_rad
    way = from_above(here, target_rad)
    await motion_gate.move_along(cell, way, speed_rad_s, care=MotionCare.WIRED, doubt=doubt)
    found = (await cell.robot.read_joints()).joints_rad
    refuse_off_target(
        cell, found, target_rad, motion_gate.tolerance_rad(cell, cell.limits.joint_tolerance_rad)
    )
    return await _read_arrival(cell)


async def follow_way(
    cell: Cell,
    way_rad: tuple[Joints, ...],
    speed_rad_s: float,
    *,
    wired: bool = False,
    pace: SpeedLimit | None = None,
    doubt: PositionUncertainty | None = None,
) -> Joints:
    """Move along the corners of a way; come to rest at the last one from below, no leg faster than its ``pace``.

    ``wired`` tells that the draw-wire hangs where the cell file says, and has to keep its length and distances.
    """
    target = way_rad[-1]
    before = way_rad[-2] if len(way_rad) > 1 else (await cell.robot.read_joints()).joints_rad
    corners = (*way_rad[:-1], *from_below(before, target))
    care = MotionCare.WIRED if wired else MotionCare.FREE
    await motion_gate.move_along(cell, corners, speed_rad_s, care=care, pace=pace, doubt=doubt)
    found = (await cell.robot.read_joints()).joints_rad
    refuse_off_target(cell, found, target, motion_gate.tolerance_rad(cell, cell.limits.joint_tolerance_rad))
    return found


async def jog_to(
    cell: Cell,
    target_rad: Joints,
    mapping: CountsToJoints,
    pace: SpeedLimit,
    doubt: PositionUncertainty | None,
) -> Arrival:
    """Bring a robot that does not know its position to joints, one axis after the other, J1 first.

    Each turn is as fast as its own ``pace`` lets it be: a wrist need not wait for what a stretched arm asks for.
    """
    if cell.is_jogged_by_hand:
        return await _jog_by_hand_to(cell, target_rad, mapping, pace, doubt)
    store = motor_store(cell)
    tolerance = motion_gate.tolerance_rad(cell, AXIS_TOLERANCE_RAD)

    async def turn_joint(axis: int, delta_rad: float, here_rad: Joints) -> None:
        there = tuple(q + delta_rad * (k == axis) for k, q in enumerate(here_rad))
        (speed,) = pace.leg_speeds(here_rad, [there])
        await motion_gate.jog_axis(cell, JogMove(axis, delta_rad, speed, here_rad, doubt))

    for axis, target in enumerate(target_rad):
        here = mapping.joints_at(await store.encoder_counts())
        delta = target - here[axis]
        if abs(delta) <= tolerance / 20:
            continue
        if delta < 0:
            await turn_joint(axis, delta - OVERSHOOT_RAD, here)
            here = mapping.joints_at(await store.encoder_counts())
            delta = target - here[axis]
        await turn_joint(axis, delta, here)
    arrival = await _read_arrival(cell)
    refuse_off_target(cell, mapping.joints_at(arrival.counts), target_rad, tolerance)
    return arrival


async def _jog_by_hand_to(
    cell: Cell,
    target_rad: Joints,
    mapping: CountsToJoints,
    pace: SpeedLimit,
    doubt: PositionUncertainty | None,
) -> Arrival:
    """Have a person bring the axes near joints, J1 first; again where one was moved that had to stand.

    A capture counts where it is taken: an axis that is near enough is not asked for.
    """
    store, near = motor_store(cell), motion_gate.HAND_JOG_TOLERANCE_RAD
    for _ in range(HAND_ROUNDS):
        for axis, target in enumerate(target_rad):
            here = mapping.joints_at(await store.encoder_counts())
            delta = target - here[axis]
            if abs(delta) <= near:
                continue
            back = OVERSHOOT_RAD if delta < 0 else 0.0
            there = tuple(q + (delta - back) * (k == axis) for k, q in enumerate(here))
            (speed,) = pace.leg_speeds(here, [there])
            jog = JogMove(axis, delta - back, speed, here, doubt, back_rad=back, tolerance_rad=near)
            await motion_gate.jog_axis(cell, jog)
        arrival = await _read_arrival(cell)
        found = mapping.joints_at(arrival.counts)
        if np.abs(np.subtract(found, target_rad)).max() <= near:
            break
    refuse_off_target(cell, found, target_rad, near)
    return arrival


@dataclass(frozen=True, slots=True)
class IndexTurn:
    """A joint's turn past the index of its motor, of an arm that does not know where it stands."""

    axis: int
    delta_rad: float
    before: Counts  # when nothing had turned yet
    likely_rad: Joints  # where the arm then most likely stood
    doubt: PositionUncertainty


async def pass_index(cell: Cell, index_turn: IndexTurn, speed_rad_s: float) -> Arrival:
    """Turn one motor past its index, to rest from below; its single-turn reading is known again.

    The joint stays where the turn brought it: the way back would tell nothing. Done twice, the turn is not made
    twice. A count may jump by up to half a turn at the index; who stopped short of it keeps the alarm, and is turned
    again. A person has seen that the wire is free; of what is solid the arm keeps away for all that it may stand
    elsewhere.
    """
    axis, delta_rad, before = index_turn.axis, index_turn.delta_rad, index_turn.before
    store = motor_store(cell)
    drive, now = await store.drive_train(), await store.encoder_counts()
    turned = drive.to_joints(np.array(now), np.array(before))
    turned_rad = float(turned[axis])
    if turned_rad / delta_rad < ALREADY_TURNED:
        left_rad = delta_rad - turned_rad
        turns = [left_rad] if left_rad > 0 else [left_rad - OVERSHOOT_RAD, OVERSHOOT_RAD]
        back_rad = 0.0
        if cell.is_jogged_by_hand and left_rad < 0:
            turns, back_rad = turns[:1], OVERSHOOT_RAD
        here = np.array(index_turn.likely_rad) + turned
        began = tuple(float(q) for q in here)
        for turn in turns:
            at = tuple(float(q) for q in here)
            jog = JogMove(axis, turn, speed_rad_s, at, index_turn.doubt, MotionCare.FREE, began, back_rad)
            await motion_gate.jog_axis(cell, jog)
            here[axis] += turn
    return await _read_arrival(cell)


async def _read_arrival(cell: Cell) -> Arrival:
    return Arrival(await motor_store(cell).encoder_counts(), (await cell.robot.read_joints()).joints_rad)
