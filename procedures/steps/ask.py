"""Steps that ask the technician."""

import asyncio

from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import Answer, Instruction, Question
from cellcal.procedures.cell import Cell
from cellcal.procedures.run import DeclinedError
from cellcal.procedures.steps.pages import seen_from_here


async def ask(cell: Cell, instruction: Instruction) -> Answer:
    """Have a person do or look at something and say yes."""
    try:
        return await cell.operator.confirm(seen_from_here(cell, instruction))
    except RefusedError as error:
        raise DeclinedError(
            f"declined: {instruction.text}", remedy="Resume the run when it can be done."
        ) from error


async def enter(cell: Cell, question: Question) -> Answer:
    """Ask for a number or a text that only a person knows."""
    try:
        return await cell.operator.enter(question)
    except RefusedError as error:
        raise DeclinedError(
            f"not answered: {question.text}", remedy="Resume the run when it is known."
        ) from error


async def accept(cell: Cell, instruction: Instruction, what_sha256: str) -> Answer:
    """Have a person accept exactly what is shown: its hash is journalled with the answer."""
    del what_sha256  # an input of the step: on replay it must be the same
    answer = await ask(cell, instruction)
    cell.motion.agree(_now())  # to a plan that was shown; any fault takes the approval back
    return answer


async def let_move(cell: Cell, instruction: Instruction) -> Answer:
    """Have a person look at the robot and agree to moves that are told in words, since no plan can be made."""
    answer = await ask(cell, instruction)
    cell.motion.agree(_now())
    return answer


def _now() -> float:
    return asyncio.get_running_loop().time()
