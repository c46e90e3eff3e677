"""A person's consent to motion: to a way that no shapes were known for, to a higher override, after a shift."""

import math
from collections.abc import Sequence

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Counts, Instruction, Joints, Readiness
from cellcal.procedures.axis_texts import axis_name
from cellcal.procedures.cell import Cell, MotionApproval
from cellcal.procedures.motion.robot_readiness import (
    MotionRefusedError,
    loop_time,
    read_ready_robot,
)
from cellcal.procedures.questions import ask_confirmation

SAME_OVERRIDE = 0.005  # pendants show whole per cent
AGREED_S = 8 * 3600.0  # a shift: an older consent to motion no longer counts


async def ensure_approved(
    cell: Cell, here_rad: Joints | None, way_rad: Sequence[Joints], speed_rad_s: float
) -> None:
    """Have a person agree to each single move, unless a plan was approved or the shapes of the cell are known.

    What was agreed to a shift ago is asked again, whatever it was: a run may have waited over night.
    """
    await _ensure_recent(cell, here_rad)
    await _check_override(cell, here_rad)
    if cell.surroundings.is_known or cell.motion.approved:
        return
    deltas = "" if here_rad is None else _turns_text(cell, here_rad, way_rad[-1])
    words = make_message(
        "No obstacles known: the path was not checked against what stands in the cell. The robot "
        "will turn{deltas} at up to {speed_rad_s:.1f} deg/s. Look at its way. May it move?",
        deltas=deltas,
        speed_rad_s=math.degrees(speed_rad_s),
    )
    await _ask_agreement(cell, Instruction("approve_move", words), here_rad)


async def _ensure_recent(cell: Cell, here_rad: Joints | None) -> None:
    memory = cell.motion
    if memory.agreed_at_s is None:
        memory.agreed_at_s = loop_time()  # this entry's first move; the cell file allows it
    if loop_time() - memory.agreed_at_s <= AGREED_S:
        return
    words = "This run was allowed to move the robot more than 8 hours ago. Look at the robot. May it move?"
    await _ask_agreement(cell, Instruction("may_still_move", words), here_rad)
    memory.note_approval(loop_time())


async def _check_override(cell: Cell, here_rad: Joints | None) -> None:
    """Have a person agree to an override above the one that the arm was watched at; below, no question is asked."""
    if cell.override is None:
        return
    memory = cell.motion
    while (now := await cell.override.speed_override()) > (
        before := _watched_override(memory, now)
    ) + SAME_OVERRIDE:
        words = make_message(
            "The speed override stands at {now_percent:.0f} %, and was {before_percent:.0f} % at "
            "most while this run moved the robot. Nothing recorded is lost. Look at the robot. May "
            "it move that fast?",
            now_percent=now * 100,
            before_percent=before * 100,
        )
        await _ask_agreement(cell, Instruction("may_move_faster", words), here_rad)
        memory.override = now


def _watched_override(memory: MotionApproval, now: float) -> float:
    """Return the highest override agreed to: that of this entry's first move, until more is agreed to."""
    if memory.override is None:
        memory.override = now
    return memory.override


async def _ask_agreement(cell: Cell, instruction: Instruction, here_rad: Joints | None) -> None:
    """Have a person agree to motion, and see that the robot stands as it did when it was asked."""
    stood = await _read_counts(cell) if here_rad is None else None
    await ask_confirmation(cell, instruction)
    await _check_unmoved(cell, here_rad, stood)


async def _check_unmoved(cell: Cell, here_rad: Joints | None, stood: Counts | None) -> None:
    """Look again: an answer may take minutes, and the way was checked from where the arm stood before.

    A robot that does not know where it is shows by its motors' counts whether it was turned.
    """
    if here_rad is not None:
        now = await read_ready_robot(cell, Readiness.READY)
        turned_rad = np.array(now.joints_rad) - here_rad
    else:
        await read_ready_robot(cell, Readiness.READY, Readiness.POSITION_LOST)
        turned_rad = await _turned_rad(cell, stood)
    if np.abs(turned_rad).max() > cell.limits.joint_tolerance_rad:
        raise MotionRefusedError(
            "the robot was moved while a person was asked whether it may move",
            remedy="Nothing was commanded. Resume: the way is then checked from where the robot stands.",
        )


async def _read_counts(cell: Cell) -> Counts | None:
    return None if cell.mastering is None else await cell.mastering.encoder_counts()


async def _turned_rad(cell: Cell, stood: Counts | None) -> Array:
    """Return by how much the joints were turned since the counts; zero where the robot tells no counts."""
    if cell.mastering is None or stood is None:
        return np.zeros(1)
    drive, now = await cell.mastering.drive_train(), await cell.mastering.encoder_counts()
    return drive.to_joints(np.array(now), np.array(stood))


def _turns_text(cell: Cell, here_rad: Joints, there_rad: Joints) -> str:
    turns = [math.degrees(b - a) for a, b in zip(here_rad, there_rad, strict=True)]
    turn_texts = ", ".join(
        f"{axis_name(cell, k)} {turn:+.1f}" for k, turn in enumerate(turns) if abs(turn) >= 0.05
    )
    return f" {turn_texts} deg" if turn_texts else ""
