"""Moves that a person makes, or lets a program make, and that are only looked at: levels L0 and L1."""

import math
from collections.abc import Sequence

import numpy as np

from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Instruction, Joints
from cellcal.procedures.cell import Cell, MotionLevel
from cellcal.procedures.instruction_page import PagedInstruction, with_page
from cellcal.procedures.motors import motor_store
from cellcal.procedures.questions import ask_confirmation
from cellcal.procedures.run import ProcedureError

TRIES = 4
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
        It was asked for four times, and the arm stands elsewhere.
    """
    target, progress_text = way_rad[-1], ""
    for _ in range(TRIES):
        text = progress_text + _move_text(cell, way_rad, speed_rad_s)
        instruction = manual_move_page(Instruction("move_by_hand", text), target, tolerance_rad, wired=wired)
        await ask_confirmation(cell, instruction)
        before, after = await cell.robot.read_joints(), await cell.robot.read_joints()
        errors = np.subtract(after.joints_rad, target)
        worst = int(np.argmax(np.abs(errors)))
        moves = after.moving or np.abs(np.subtract(after.joints_rad, before.joints_rad)).max() > STILL_RAD
        if not moves and abs(errors[worst]) <= tolerance_rad:
            return
        off = f"J{worst + 1} is {math.degrees(errors[worst]):+.2f} deg off"
        progress_text = (
            "The robot still moves. " if moves else make_message("Not there yet: {off}. ", off=off)
        )
        way_rad = (target,)
    raise NotThereError(
        make_message("{progress_text}The arm was not brought to its target.", progress_text=progress_text),
        remedy="Find out what keeps it away, then resume.",
    )


async def jog_by_hand(
    cell: Cell, axis: int, delta_rad: float, speed_rad_s: float, tolerance_rad: float
) -> None:
    """Ask for a turn of one joint alone, and look at the motors' counts; raises as ``move_by_hand``.

    A motor that has not found its index may count a part of a turn when it does: a turn is forgiven then.
    """
    store = motor_store(cell)
    drive, before = await store.drive_train(), np.array(await store.encoder_counts())
    seeking = any(alarm.axis in (axis, None) for alarm in (await cell.robot.read_condition()).alarms)
    allowed = tolerance_rad + (float(np.abs(drive.radians_per_turn()[axis]).sum()) if seeking else 0.0)
    open_rad, progress_text = delta_rad, ""
    for _ in range(TRIES):
        degrees, pace = math.degrees(open_rad), math.degrees(speed_rad_s)
        words = make_message(
            "With the pendant, turn J{axis} alone by {degrees:+.2f} deg, at most {pace:.1f} deg/s.",
            axis=axis + 1,
            degrees=degrees,
            pace=pace,
        )
        await ask_confirmation(
            cell,
            Instruction(
                "jog_by_hand",
                make_message(
                    "{progress_text}{words} Say yes when it stands.", progress_text=progress_text, words=words
                ),
            ),
        )
        moved = drive.to_joints(np.array(await store.encoder_counts()), before)[axis]
        open_rad = delta_rad - float(moved)
        if abs(open_rad) <= allowed:
            return
        progress_text = "Not there yet. "
    raise NotThereError(
        make_message(
            "J{axis} was not turned as asked: {open_deg:+.2f} deg are left.",
            axis=axis + 1,
            open_deg=math.degrees(open_rad),
        ),
        remedy="Find out what keeps it from turning, then resume.",
    )


def _move_text(cell: Cell, way_rad: Sequence[Joints], speed_rad_s: float) -> str:
    pace = make_message("{speed_rad_s:.1f} deg/s", speed_rad_s=math.degrees(speed_rad_s))
    if cell.level is MotionLevel.PROGRAM and cell.programs is not None:
        name = cell.programs.write_program(tuple(tuple(corner) for corner in way_rad), speed_rad_s)
        return make_message(
            "Load the program {name} on the pendant, compare its joints with {joints_text}, and run "
            "it in T1, at most {pace}. Say yes when it has ended.",
            name=name,
            joints_text=_joints_text(way_rad[-1]),
            pace=pace,
        )
    to = _joints_text(way_rad[-1])
    if len(way_rad) > 1:
        over = "; then ".join(map(_joints_text, way_rad[:-1]))
        return make_message(
            "With the pendant, in T1 and at most {pace} per joint, bring the robot by way of {over}; "
            "to {to}. Say yes when it stands there.",
            pace=pace,
            over=over,
            to=to,
        )
    return make_message(
        "With the pendant, in T1 and at most {pace} per joint, bring the robot to {to}. Say yes "
        "when it stands there.",
        pace=pace,
        to=to,
    )


def _joints_text(joints_rad: Joints) -> str:
    return ", ".join(f"J{k} {math.degrees(q):.2f}" for k, q in enumerate(joints_rad, 1)) + " deg"


def manual_move_page(
    instruction: Instruction, target_rad: Joints, tolerance_rad: float, *, wired: bool
) -> PagedInstruction:
    """Return a move that a person makes on its page; with a wire the next thing is a capture of its length."""
    target = {"joints_rad": list(target_rad), "tolerance_rad": tolerance_rad}
    plan = {"poses": [{"name": "", "joints_rad": list(target_rad), "way_rad": []}]}
    return with_page(instruction, "capture" if wired else "teach", target=target, plan=plan)
