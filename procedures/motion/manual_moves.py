"""Moves that a person makes, or lets a program make, and that are only looked at: levels L0 and L1."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.interfaces import Instruction, Joints
from cellcal.procedures.axis_texts import axis_name, joints_text
from cellcal.procedures.cell import Cell, MotionLevel
from cellcal.procedures.instruction_page import PagedInstruction, with_page
from cellcal.procedures.questions import ask_confirmation
from cellcal.procedures.run import ProcedureError

TRIES = 6
STILL_RAD = 1e-3


class NotThereError(ProcedureError):
    """The arm was not brought to where it was asked to be."""

    code = "procedure.not_there"


async def move_by_hand(
    cell: Cell, way_rad: Sequence[Joints], speed_rad_s: float, tolerance_rad: float, *, wired: bool = False
) -> None:
    """Ask for the arm at the last corner until it stands there; where it really stands is read by who measures.

    Raises
    ------
    DeclinedError
        The technician said no.
    NotThereError
        It was asked for again and again, and the arm stands elsewhere.
    """
    target, progress_text = way_rad[-1], ""
    for _ in range(TRIES):
        text = progress_text + _move_text(cell, way_rad, speed_rad_s)
        axis_by_axis = {} if _runs_program(cell) else _jogged(way_rad, speed_rad_s)
        instruction = manual_move_page(
            Instruction("move_by_hand", text), target, tolerance_rad, wired=wired, **axis_by_axis
        )
        await ask_confirmation(cell, instruction)
        before, after = await cell.robot.read_joints(), await cell.robot.read_joints()
        errors = np.subtract(after.joints_rad, target)
        worst = int(np.argmax(np.abs(errors)))
        moves = after.moving or np.abs(np.subtract(after.joints_rad, before.joints_rad)).max() > STILL_RAD
        if not moves and abs(errors[worst]) <= tolerance_rad:
            return
        progress_text = (
            "The robot still moves. "
            if moves
            else make_message(
                "Not there yet: {axis} is {error_deg:+.2f} deg off. ",
                axis=axis_name(cell, worst),
                error_deg=math.degrees(errors[worst]),
            )
        )
        way_rad = (target,)
    raise NotThereError(
        make_message("{progress_text}The arm was not brought to its target.", progress_text=progress_text),
        remedy="Find out what keeps it away, then resume.",
    )


def _move_text(cell: Cell, way_rad: Sequence[Joints], speed_rad_s: float) -> str:
    pace = make_message("{speed_rad_s:.1f} deg/s", speed_rad_s=math.degrees(speed_rad_s))
    if cell.level is MotionLevel.PROGRAM and cell.programs is not None:
        name = cell.programs.write_program(tuple(tuple(corner) for corner in way_rad), speed_rad_s)
        return make_message(
            "Load the program {name} on the pendant, compare its joints with {joints_text}, and run "
            "it in T1, at most {pace}.",
            name=name,
            joints_text=joints_text(cell, way_rad[-1], 2),
            pace=pace,
        )
    to = joints_text(cell, way_rad[-1], 2)
    if len(way_rad) > 1:
        over = join_messages("; ", [joints_text(cell, corner, 2) for corner in way_rad[:-1]])
        return make_message(
            "With the pendant, in T1 and at most {pace} per joint, bring the robot by way of {over}; "
            "to {to}.",
            pace=pace,
            over=over,
            to=to,
        )
    return make_message(
        "With the pendant, in T1 and at most {pace} per joint, bring the robot to {to}.",
        pace=pace,
        to=to,
    )


def _runs_program(cell: Cell) -> bool:
    return cell.level is MotionLevel.PROGRAM and cell.programs is not None


def _jogged(way_rad: Sequence[Joints], speed_rad_s: float) -> dict[str, Any]:
    """Return what a page shows axis by axis beside the goal: the corners on the way, and the pace."""
    return {"by_way_rad": [list(corner) for corner in way_rad[:-1]], "pace_rad_s": speed_rad_s}


def manual_move_page(
    instruction: Instruction, target_rad: Joints, tolerance_rad: float, *, wired: bool, **jogged: Any
) -> PagedInstruction:
    """Return a move that a person makes on its page; with a wire the next thing is a capture of its length."""
    target = {"joints_rad": list(target_rad), "tolerance_rad": tolerance_rad, **jogged}
    plan = {"poses": [{"name": "", "joints_rad": list(target_rad), "way_rad": []}]}
    return with_page(instruction, "capture" if wired else "teach", target=target, plan=plan)
