"""Steps in which the technician brings the arm somewhere and we read where it stands."""

import asyncio
from dataclasses import dataclass

from cellcal.calibration.geometry import Pose
from cellcal.drivers.interfaces import Instruction, JointReading, Joints
from cellcal.procedures.cell import Cell
from cellcal.procedures.instruction_page import PagedInstruction, with_page
from cellcal.procedures.motion.active_frames import check_same_frames
from cellcal.procedures.motion.robot_readiness import check_position_kept
from cellcal.procedures.questions import ask_confirmation
from cellcal.procedures.run import ProcedureError

STILL_RAD = 1e-4
STILL_TRIES = 20
STILL_PAUSE_S = 0.1


class StillMovingError(ProcedureError):
    """A pose was asked for and the arm does not stand still."""

    code = "procedure.still_moving"


@dataclass(frozen=True, slots=True)
class TaughtPose:
    """The flange's pose, the joints, and who said it was right."""

    base_flange: Pose
    joints_rad: Joints
    who: str


async def teach_pose(cell: Cell, instruction: Instruction) -> TaughtPose:
    """Have a person place the arm; return where it stands still.

    Raises
    ------
    PositionLostAgainError
        The robot does not know where it stands, or lost it since the run began.
    """
    await check_position_kept(cell)
    answer = await ask_confirmation(
        cell, instruction if isinstance(instruction, PagedInstruction) else with_page(instruction, "teach")
    )
    for _ in range(STILL_TRIES):
        before = await cell.robot.read_joints()
        base_flange = await cell.robot.flange_pose()
        after = await cell.robot.read_joints()
        if is_still(before, after):
            await check_position_kept(cell)
            await check_same_frames(cell)
            return TaughtPose(base_flange, after.joints_rad, answer.who)
        await asyncio.sleep(STILL_PAUSE_S)
    raise StillMovingError("the arm is still moving", remedy="Let it come to rest, then confirm again.")


def is_still(before: JointReading, after: JointReading) -> bool:
    """Whether two readings show a resting arm."""
    moved = max(abs(a - b) for a, b in zip(before.joints_rad, after.joints_rad, strict=True))
    return not before.moving and not after.moving and moved <= STILL_RAD
