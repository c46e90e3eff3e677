"""Steps that ask the technician."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import Answer, GuidesPerson, Instruction, Question
from cellcal.procedures.cell import Cell
from cellcal.procedures.instruction_page import PagedInstruction, with_page
from cellcal.procedures.run import DeclinedError


async def ask_confirmation(cell: Cell, instruction: Instruction) -> Answer:
    """Have a person do or look at something and say yes."""
    try:
        return await cell.operator.confirm(with_cell_state(cell, instruction))
    except RefusedError as error:
        raise DeclinedError(
            make_message("declined: {instruction_text}", instruction_text=instruction.text),
            remedy="Resume the run when it can be done.",
        ) from error


async def ask_while_watching(
    cell: Cell,
    instruction: Instruction,
    look: Callable[[GuidesPerson | None], Awaitable[None]],
    period_s: float,
) -> Answer:
    """Ask for a confirmation; call ``look`` after every period until it is given.

    ``look`` gets the screen that shows guidance, None where there is none. What it raises ends the question.
    """
    guides = cell.operator if isinstance(cell.operator, GuidesPerson) else None
    confirmation = asyncio.ensure_future(ask_confirmation(cell, instruction))
    try:
        while not confirmation.done():
            await asyncio.wait({confirmation}, timeout=period_s)
            if not confirmation.done():
                await look(guides)
        return await confirmation
    finally:
        if not confirmation.done():
            confirmation.cancel()
            await asyncio.gather(confirmation, return_exceptions=True)


async def ask_for_value(cell: Cell, question: Question) -> Answer:
    """Ask for a number or a text that only a person knows."""
    try:
        return await cell.operator.ask_question(question)
    except RefusedError as error:
        raise DeclinedError(
            make_message("not answered: {question_text}", question_text=question.text),
            remedy="Resume the run when it is known.",
        ) from error


async def ask_acceptance(cell: Cell, instruction: Instruction, what_sha256: str) -> Answer:
    """Have a person accept exactly what is shown: its hash is journalled with the answer."""
    del what_sha256  # an input of the step: on replay it must be the same
    answer = await ask_confirmation(cell, instruction)
    cell.motion.note_approval(_loop_time())  # to a plan that was shown; any fault takes the approval back
    return answer


async def ask_to_move(cell: Cell, instruction: Instruction) -> Answer:
    """Have a person look at the robot and agree to moves that are told in words, since no plan can be made."""
    answer = await ask_confirmation(cell, instruction)
    cell.motion.note_approval(_loop_time())
    return answer


def _loop_time() -> float:
    return asyncio.get_running_loop().time()


def with_cell_state(cell: Cell, instruction: Instruction) -> Instruction:
    """Return an instruction with what only the cell knows: what is selected on the controller, and planned tips."""
    if not isinstance(instruction, PagedInstruction):
        return instruction
    data: dict[str, Any] = {}
    if cell.motion.frames is not None:
        data["frames"] = cell.motion.frames
    plan = instruction.page.data.get("plan")
    if plan is not None and cell.model is not None:
        data["plan"] = {
            **plan,
            "poses": _with_tips(cell, cell.model, plan["poses"]),
            "level": cell.level.value,
        }
    return with_page(instruction, instruction.page.kind, **data)


def _with_tips(cell: Cell, model: RobotModel, poses: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    tip = cell.surroundings.tip_in_flange_m or (0.0, 0.0, 0.0)
    found = tips_at(
        model, np.array([pose["joints_rad"] for pose in poses]).reshape(-1, model.axis_count), tip
    )
    return [{**pose, "tip_in_base_m": place.tolist()} for pose, place in zip(poses, found, strict=True)]


def tips_at(model: RobotModel, joints_rad: Any, tip_in_flange_m: Sequence[float]) -> Any:
    """Return where the tip (N, 3) [m] is in the base at postures (N, n) [rad]."""
    flanges = model.base_flange(joints_rad)
    return flanges[:, :3, :3] @ np.array(tip_in_flange_m) + flanges[:, :3, 3]
