"""How a screen shows an instruction: the kind of its page, and data that are drawn beside the words.

The words are what a step was asked for; they stand in the journal. The page is not: a run that is resumed may be
shown otherwise than before, and an operator without a screen reads the words alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from pydantic_core import to_jsonable_python

from cellcal.drivers.interfaces import Instruction

StepKind = Literal["ask", "enter", "teach", "capture", "approve", "motion", "review", "sign"]


@dataclass(frozen=True, slots=True)
class InstructionPage:
    """A kind of page and what it draws: JSON values, in SI units."""

    kind: StepKind = "ask"
    data: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PagedInstruction(Instruction):
    """An instruction with its page."""

    page: InstructionPage = field(default_factory=InstructionPage)

    @property
    def plain_instruction(self) -> Instruction:
        """The instruction alone."""
        return Instruction(self.key, self.text)


def with_page(instruction: Instruction, kind: StepKind, **data: Any) -> PagedInstruction:
    """Return an instruction on a page of a kind; what the page had already stays."""
    return PagedInstruction(
        instruction.key,
        instruction.text,
        InstructionPage(kind, {**page_of(instruction).data, **to_jsonable_python(data)}),
    )


def page_of(instruction: Instruction) -> InstructionPage:
    """Return how an instruction is shown; words alone are a question."""
    return instruction.page if isinstance(instruction, PagedInstruction) else InstructionPage()
