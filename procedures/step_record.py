"""One step as the journal records it: its inputs, its result, and where its move ends."""

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, get_type_hints

from pydantic import TypeAdapter
from pydantic_core import to_jsonable_python

from cellcal.drivers.interfaces import Joints
from cellcal.procedures.cell import Cell
from cellcal.procedures.instruction_page import InstructionPage, PagedInstruction
from cellcal.procedures.run_history import EventKind, StepEffect


@dataclass(frozen=True, slots=True)
class StepTask:
    """One step as the journal sees it."""

    name: str
    effect: StepEffect
    kind: EventKind
    inputs: Any
    codec: TypeAdapter[Any]
    act: Callable[[Cell], Awaitable[Any]]
    solves: bool = False
    page: InstructionPage | None = None
    goal_rad: Joints | None = None

    @property
    def activity_name(self) -> str:
        """The activity that a screen shows: read, move, write, solve."""
        return "solve" if self.solves else "read" if self.effect is StepEffect.NONE else self.effect.value


def journalled_inputs(args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> Any:
    """Return a step's inputs as the journal keeps them: how a screen shows an instruction is none of them."""

    def plain_value(value: Any) -> Any:
        return value.plain_instruction if isinstance(value, PagedInstruction) else value

    return to_jsonable_python(
        [[*map(plain_value, args)], {name: plain_value(value) for name, value in kwargs.items()}]
    )


def goal_of(way: Any = None, *_: Any) -> Joints | None:
    """Return where a move ends by its first input: a pose, or a way whose last corner is one; else None."""
    end = way[-1] if isinstance(way, tuple) and way and isinstance(way[-1], tuple) else way
    return end if isinstance(end, tuple) and all(isinstance(angle, float) for angle in end) else None


@cache
def result_codec(work: Callable[..., Any]) -> TypeAdapter[Any]:
    """Return what converts the results of a step to JSON and back, by its return annotation."""
    hints = get_type_hints(work)
    if "return" not in hints:
        raise TypeError(f"{work} needs a return annotation: its result is journalled")
    return TypeAdapter(hints["return"])
