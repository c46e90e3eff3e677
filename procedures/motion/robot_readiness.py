"""Whether a robot may be moved at this moment: ready, still, fresh, with its encoders and frames as they were."""

import asyncio

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import MotionStoppedError, RefusedError
from cellcal.drivers.interfaces import JointReading, Readiness
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion.active_frames import check_same_frames
from cellcal.procedures.motors import PositionLostAgainError
from cellcal.procedures.robot_condition import read_reached_condition
from cellcal.procedures.run import ProcedureError

STALE_S = 1.0


class MotionRefusedError(ProcedureError):
    """A move was not commanded. Nothing has moved."""

    code = "procedure.motion_refused"


async def read_ready_robot(cell: Cell, *allowed: Readiness) -> JointReading:
    """Return a fresh reading of a robot that may be moved; a lost robot's joints mean nothing."""
    _check_permit(cell)
    condition = await read_reached_condition(cell.robot)
    if condition.readiness not in allowed:
        name, words, remedy = cell.robot.name, condition.message, condition.remedy
        if condition.readiness is Readiness.STOPPED:
            raise MotionStoppedError(name, words, remedy=remedy)
        raise RefusedError(name, words or "the robot is not ready to move", remedy=remedy)
    await _check_same_encoders(cell)
    await check_same_frames(cell)
    if Readiness.POSITION_LOST in allowed:
        return JointReading((), moving=False, taken_at_s=loop_time())
    reading = await cell.robot.read_joints()
    if reading.moving or loop_time() - reading.taken_at_s > STALE_S:
        what = "moves already" if reading.moving else "shows a state that is too old"
        raise MotionRefusedError(
            make_message("the robot {what}: no move is commanded on top of it", what=what),
            remedy="Look at the robot and find out who moves it, then resume.",
        )
    return reading


async def check_still_allowed(cell: Cell) -> None:
    """Look right before a command at what may have changed while a person was asked or a corner was gone."""
    _check_permit(cell)
    await _check_same_encoders(cell)
    await check_same_frames(cell)


async def check_position_kept(cell: Cell) -> None:
    """Check that the joints which the controller shows are to be believed, before and after a person has the arm.

    Raises
    ------
    PositionLostAgainError
        The controller says that an axis has lost its position, or its encoders have begun anew during this run.
    """
    condition = await read_reached_condition(cell.robot)
    if condition.readiness is Readiness.POSITION_LOST:
        raise PositionLostAgainError(
            make_message("the robot has lost its position: {what}", what=condition.message),
            remedy=condition.remedy,
        )
    await _check_same_encoders(cell)


async def _check_same_encoders(cell: Cell) -> None:
    if cell.mastering is None:
        return
    epoch, memory = await cell.mastering.encoder_epoch(), cell.motion
    if memory.epoch is None:
        memory.epoch = epoch
    elif epoch != memory.epoch:
        raise PositionLostAgainError(
            make_message(
                "the robot lost its position during this run (encoder epoch {epoch}, now {found})",
                epoch=memory.epoch,
                found=epoch,
            ),
            remedy="Start the recovery anew; the points measured before cannot be combined with later ones.",
        )


def _check_permit(cell: Cell) -> None:
    if cell.permit is not None:
        cell.permit.check_held()


def loop_time() -> float:
    """Return the time of the event loop, by which readings are dated [s]."""
    return asyncio.get_running_loop().time()
