"""The person at the cell: what is asked and what is answered."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable


@dataclass(frozen=True, slots=True)
class Instruction:
    """Something a person must do or look at. ``key`` is stable, for scripts and translations."""

    key: str
    text: str


@dataclass(frozen=True, slots=True)
class Question:
    """A number or a text that only a person knows."""

    key: str
    text: str
    unit: str = ""
    count: int = 1  # of numbers, where it has a unit


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer, and the person who gave it."""

    who: str
    value: str = "yes"


class Operator(Protocol):
    """The technician."""

    async def confirm(self, instruction: Instruction) -> Answer:
        """Return when the person says yes; raise DeclinedError-like RefusedError on no."""
        ...

    async def ask_question(self, question: Question) -> Answer: ...


@runtime_checkable
class GuidesPerson(Protocol):
    """Operators that show how what they ask for goes on, until it is answered."""

    def show_guidance(self, text: str, values: Mapping[str, Any]) -> None:
        """Show it in words; ``values`` are for a picture, in SI units."""
        ...
