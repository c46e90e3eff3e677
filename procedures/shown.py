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
class Page:
    """A kind of page and what it draws: JSON values, in SI units."""

    kind: StepKind = "ask"
    data: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Shown(Instruction):
    """An instruction with its page."""

    page: Page = field(default_factory=Page)

    @property
    def words(self) -> Instruction:
        """The instruction alone."""
        return Instruction(self.key, self.text)


def on_page(asked: Instruction, kind: StepKind, **data: Any) -> Shown:
    """Return an instruction on a page of a kind; what the page had already stays."""
    return Shown(asked.key, asked.text, Page(kind, {**page_of(asked).data, **to_jsonable_python(data)}))


def page_of(asked: Instruction) -> Page:
    """Return how an instruction is shown; words alone are a question."""
    return asked.page if isinstance(asked, Shown) else Page()
