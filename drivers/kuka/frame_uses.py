"""What the routines of a KRL program set ``$TOOL`` and ``$BASE`` to, and where that surely holds."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

UNKNOWN = "?"
BARRED = {
    "several": "the program sets another tool or base for it at different places",
    "computed": "its tool or base is set while the program runs",
    "called": "a routine that its program calls sets another tool or base",
    "caller": "a routine that calls its program sets the tool or base",
    "later": "its program sets the tool or base below it, or in a branch",
}

Branches: TypeAlias = tuple[int, ...]  # the ifs, cases and loops that a place is inside, by where they begin


@dataclass
class FrameUse:
    """What a routine sets ``$TOOL`` or ``$BASE`` to, and where first."""

    values: set[str] = field(default_factory=set)
    first: dict[Branches, int] = field(default_factory=dict)  # where first in which branches

    def take(self, place: int, value: str, branches: "Branches") -> None:
        """Note a value."""
        self.first.setdefault(branches, place)
        self.values.add(value)

    def at(self, place: int, branches: "Branches") -> str | None:
        """Return what is set at a place: known only where the routine sets one thing, and surely before."""
        if len(self.values) != 1 or not self._surely_before(place, branches):
            return None
        (value,) = self.values
        return None if value == UNKNOWN else value

    def barred(self, called: set[str], callers: set[str], place: int, branches: "Branches") -> str:
        """Return why nobody can tell what holds, with what other routines set; "" where nothing is in the way."""
        if called - self.values:
            return BARRED["called"]
        if UNKNOWN in self.values:
            return BARRED["computed"]
        if len(self.values) > 1:
            return BARRED["several"]
        if self.values and not self._surely_before(place, branches):
            return BARRED["later"]
        return BARRED["caller"] if callers and not self.values else ""

    def _surely_before(self, place: int, branches: "Branches") -> bool:
        return any(self.first.get(branches[:depth], place + 1) <= place for depth in range(len(branches) + 1))


@dataclass
class Routine:
    """One DEF ... END."""

    number: int
    name: str = ""
    shown: bool = False  # other files may call it
    declared: set[str] = field(default_factory=set)  # names that hide those of other files
    calls: set[str] = field(default_factory=set)
    tool: FrameUse = field(default_factory=FrameUse)
    base: FrameUse = field(default_factory=FrameUse)


def tool_of(routine: Routine) -> FrameUse:
    """Return what a routine sets ``$TOOL`` to."""
    return routine.tool


def base_of(routine: Routine) -> FrameUse:
    """Return what a routine sets ``$BASE`` to."""
    return routine.base


def callers_of(routine: Routine, callers: Mapping[str, list[Routine]]) -> list[Routine]:
    """Return the routines of this file that call one, and those that call them."""
    found: dict[int, Routine] = {}
    open_ = [routine]
    while open_:
        for one in callers.get(open_.pop().name, ()):
            if one.number not in found:
                found[one.number] = one
                open_.append(one)
    return list(found.values())
