"""Steps that look what a cell has to find places again with, and ask which kit of places shall be recorded."""

from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Question
from cellcal.procedures.cell import Cell, MotionCaps
from cellcal.procedures.instruments import Instruments, instruments_of
from cellcal.procedures.motors import Motors
from cellcal.procedures.questions import ask_for_value
from cellcal.procedures.run import ProcedureError
from cellcal.procedures.steps.mastering import nominal_model, read_motors_alone

MOST_QUESTIONS = 3
_SHORTEST_TOOL_M = 0.02  # a shorter tool frame counts as not entered


class NoSuchKitError(ProcedureError):
    """A kit was named that this cell does not offer."""

    code = "procedure.no_such_kit"


@dataclass(frozen=True, slots=True)
class KitBench:
    """A healthy robot, and what its places could be found again with."""

    motors: Motors
    model: str
    limits: MotionCaps
    instruments: Instruments


@dataclass(frozen=True, slots=True)
class KitChoice:
    """The kit that a person chose, and the person."""

    kit: str
    who: str


async def read_kit_bench(cell: Cell) -> KitBench:
    """Read the motors, and what the cell file and the controller say about tips and instruments."""
    tool = None
    if cell.frames is not None:
        active = (await cell.frames.active_frames()).flange_tool
        if active is not None and sum(v * v for v in active.position_m) > _SHORTEST_TOOL_M**2:
            tool = active.position_m
    motors = await read_motors_alone(cell)
    return KitBench(motors, nominal_model(cell).name, cell.limits, instruments_of(cell, tool))


async def choose_kit(cell: Cell, text: str, names: tuple[str, ...]) -> KitChoice:
    """Have a person name one of the kits that are shown; no word is the first one.

    Raises
    ------
    NoSuchKitError
        Three answers named none of them.
    """
    question = text
    for _ in range(MOST_QUESTIONS):
        answer = await ask_for_value(cell, Question("choose_kit", question))
        kit_name = answer.value.strip().lower() or names[0]
        if kit_name in ("yes", "y"):
            kit_name = names[0]
        if kit_name in names:
            return KitChoice(kit_name, answer.who)
        question = make_message(
            "There is no kit {answer_value!r}; there are {names}.\n{text}",
            answer_value=answer.value,
            names=", ".join(names),
            text=text,
        )
    raise NoSuchKitError(
        make_message(
            "no kit was chosen: {answer_value!r} is none of {names}",
            answer_value=answer.value,
            names=", ".join(names),
        ),
        remedy="Resume the run and type one of the names.",
    )
