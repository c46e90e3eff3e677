"""What the routines of a KRL program set ``$TOOL`` and ``$BASE`` to, and where that surely holds."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from operator import itemgetter
from typing import TypeAlias

from cellcal.drivers.programs.barred import (
    CALLED,
    CALLER,
    COMPUTED,
    EXTERNAL_BASE,
    LATER,
    SEVERAL,
    SOURCE_OF_TARGET,
)
from cellcal.drivers.programs.call_graph import Marks, reached_settings, with_interrupts
from cellcal.drivers.programs.routine_calls import RoutineParameter
from cellcal.drivers.programs.text_flow import TextFlow

UNKNOWN = "?"
WRITTEN_OUT = "$"  # before the numbers of one that stands in the text
TURNED_BY_AXIS = "!"  # a base that an external axis turns, by data of the controller
TURNED = "^"  # before the number of a base that EK() lets an external axis turn
RESET = "~"  # what the controller begins with: BAS(#INITMOV,0) sets it, behind what the routine sets
BARRED = {
    "several": SEVERAL,
    "computed": COMPUTED,
    "source": SOURCE_OF_TARGET,
    "external": EXTERNAL_BASE,
    "called": CALLED,
    "caller": CALLER,
    "later": LATER,
}

Branches: TypeAlias = tuple[int, ...]  # the ifs, cases and loops that a place is inside, by where they begin


@dataclass
class RoutineJumps:
    """The jumps of a routine and where they land: what is set between may be jumped over."""

    first: int | None = None  # GOTO or EXIT
    jump_targets: list[int] = field(
        default_factory=list
    )  # labels, and ends of loops, in the order of the text
    flow: TextFlow = field(default_factory=TextFlow)  # its loops and labels

    def may_miss(self, place: int, until: int) -> bool:
        """Return whether a way leads to a place without what stands at another above it."""
        if self.first is None or place < self.first:
            return False
        return bisect_right(self.jump_targets, place) < bisect_right(self.jump_targets, until)


@dataclass
class FrameUse:
    """The values to which a routine sets ``$TOOL`` or ``$BASE``, and where first."""

    values: set[str] = field(default_factory=set)
    order: list[tuple[int, str, Branches]] = field(default_factory=list)  # where each is set, and to what
    first: dict[Branches, int] = field(default_factory=dict)  # where first in which branches
    below: Marks = ()  # what the routine and those that it calls set, when all is read
    above: Marks = ()  # what is set around it
    reset_below: bool = False  # a routine that it calls resets it
    set_by_called: bool = False  # a routine of its file that it calls sets one

    def take_value(self, place: int, value: str, branches: "Branches") -> None:
        """Note a value."""
        self.first.setdefault(branches, place)
        self.values.add(value)
        self.order.append((place, value, branches))

    def value_in_force(self, *, said_before: bool) -> str | None:
        """Return what holds where it is set before or not: known only where the routine sets one thing."""
        if len(self.values) != 1 or not said_before:
            return None
        (value,) = self.values
        return None if value in (UNKNOWN, TURNED_BY_AXIS) else value

    def barred_reason(self, *, said_before: bool) -> str:
        """Return why the active frames cannot be determined, with what other routines set; "" where they can."""
        if any(value not in self.values for value, _ in self.below) or (self.values and self.reset_below):
            return BARRED["called"]
        if TURNED_BY_AXIS in self.values:
            return BARRED["external"]
        if UNKNOWN in self.values:
            return BARRED["computed"]
        if len(self.values) > 1:
            return BARRED["several"]
        if self.values and not said_before:
            return BARRED["later"]
        return BARRED["caller"] if self.above and not self.values else ""

    def surely_before(self, place: int, branches: "Branches", jumps: RoutineJumps) -> bool:
        """Return whether one is set above a place, in the branches that the place is inside."""
        if not self.first:
            return False
        firsts = (self.first.get(branches[:depth], place + 1) for depth in range(len(branches) + 1))
        return any(first <= place and not jumps.may_miss(first, place) for first in firsts)


@dataclass
class KrlRoutine:
    """One DEF ... END."""

    number: int
    name: str = ""
    shown: bool = False  # other files may call it
    declared: set[str] = field(default_factory=set)  # names that hide those of other files
    calls: set[str] = field(default_factory=set)
    handlers: set[str] = field(default_factory=set)  # routines of the interrupts that it declares
    shown_handlers: set[str] = field(default_factory=set)  # of those that stay for its callers, too
    interrupted: bool = False  # one that sets a tool or base, or a setting, may run while it does
    data_taken: set[str] = field(default_factory=set)  # frame data of its inline forms
    parameters: tuple[RoutineParameter, ...] = ()
    assigned: set[str] = field(default_factory=set)  # names that get a value, or a component
    tool: FrameUse = field(default_factory=FrameUse)
    base: FrameUse = field(default_factory=FrameUse)
    jumps: RoutineJumps = field(default_factory=RoutineJumps)
    resets: bool = False  # it sets both to what the controller begins with
    reset_from: int | None = None  # where it first does so outside of branches
    reset_at: list[int] = field(default_factory=list)  # where it does so, in the order of the text
    calls_at: list[int] = field(default_factory=list)  # where it calls others, in the order of the text
    triggers: bool = False  # it lets others run during its motions
    external_tool: bool = False  # it sets that the tool stands in the cell
    held_tool: bool = False  # it surely sets that the robot holds the tool before it moves or calls others
    moves: bool = False  # it has a motion

    def set_both_frames(self, place: int, value: str, branches: Branches) -> None:
        """Take a tool and a base that are set together."""
        self.tool.take_value(place, value, branches)
        self.base.take_value(place, value, branches)

    def is_at_beginning(self, branches: Branches) -> bool:
        """Return whether it surely comes to where it is read before it moves or calls another that does."""
        return not (self.moves or self.calls_at or branches) and self.jumps.first is None

    def passed_until_here(self) -> int:
        """Return a number that grows with each thing read after which another tool or base may hold."""
        flow = self.jumps.flow
        counted = len(self.tool.order) + len(self.base.order) + len(self.calls_at)
        return counted + len(flow.labels) + len(flow.blocks) + flow.blocks_ended

    def may_be_reset(self, use: FrameUse, place: int) -> bool:
        """Return whether nothing sets it between a reset and a place below, as the text goes."""
        at = bisect_right(self.reset_at, place) - 1
        if at < 0:
            return False
        reset = self.reset_at[at]
        return all(value == RESET or not reset < where < place for where, value, _ in use.order)

    def straight(self, use: FrameUse, place: int, branches: Branches) -> tuple[str | None, bool]:
        """Return what is set last on every way to a place, and whether other routines are called in between.

        None where that is not certain, or no number of a table and not written out.
        """
        at = bisect_right(use.order, place, key=itemgetter(0)) - 1
        if at < 0 or self.interrupted:
            return None, False
        where, value, inside = use.order[at]
        is_known = value.removeprefix(TURNED).isdigit() or value.startswith(WRITTEN_OUT)
        next_set = use.order[at + 1][0] if at + 1 < len(use.order) else inf
        if not (
            is_known
            and branches[: len(inside)] == inside
            and self.jumps.flow.surely_passes(where, place, next_set)
        ):
            return None, False
        called = self.triggers or self.jumps.flow.may_meet(self.calls_at, where, place)
        if called and (use.set_by_called or use.reset_below):
            return None, False
        return value, called


def spread_frames_to_called(routines: Sequence[KrlRoutine]) -> None:
    """Give every routine what is set by those of its file that it calls, and that call it."""
    by_name: dict[str, list[int]] = {}
    for routine in routines:
        if routine.name:
            by_name.setdefault(routine.name, []).append(routine.number)
    calls, here, shown = (
        [[number for name in sorted(names) for number in by_name.get(name, ())] for names in some]
        for some in (
            [one.calls for one in routines],
            [one.handlers for one in routines],
            [one.shown_handlers for one in routines],
        )
    )
    reached, running = with_interrupts(calls, here, shown)
    resets, _ = reached_settings(reached, [[RESET] if routine.resets else [] for routine in routines])
    for routine, called in zip(routines, reached, strict=True):
        routine.tool.reset_below = routine.base.reset_below = any(resets[number] for number in called)
    for uses in ([one.tool for one in routines], [one.base for one in routines]):
        below, above = reached_settings(reached, [use.values for use in uses])
        for use, its_below, its_above, called in zip(uses, below, above, reached, strict=True):
            use.below, use.above = its_below, its_above
            use.set_by_called = any(below[number] for number in called)
    for routine, more in zip(routines, running, strict=True):
        routine.interrupted |= any(routines[one].tool.below or routines[one].base.below for one in more)
