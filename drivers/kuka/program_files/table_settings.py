"""Entries of ``TOOL_DATA`` and ``BASE_DATA`` that a program sets to numbers, and takes as its tool or base below.

``BASE_DATA[3] = {FRAME: …}`` and then ``$BASE = BASE_DATA[3]`` is ``$BASE = {FRAME: …}``, where each way from the one
to the other leaves the entry as it is.
"""

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from operator import attrgetter

from cellcal.drivers.kuka.program_files.frame_uses import UNKNOWN, Branches, FrameUse, KrlRoutine

_ANY = "*"  # in place of a number that is computed


@dataclass(frozen=True, slots=True)
class _Setting:
    place: int
    routine: int
    branches: Branches
    value: str  # the numbers, or that they are not known


@dataclass
class TableSettings:
    """The settings of a program, by "TOOL" or "BASE" and the entry's number."""

    _of_entry: dict[tuple[str, str], list[_Setting]] = field(default_factory=lambda: defaultdict(list))

    taken: dict[str, set[str]] = field(
        default_factory=lambda: defaultdict(set)
    )  # by entry, as "BASE 3": its numbers where they were put in its place
    _taught: dict[str, list[tuple[int, int, Branches]]] = field(default_factory=lambda: defaultdict(list))

    def note_setting(
        self, which: str, number: str, routine: KrlRoutine, place: int, branches: Branches, value: str
    ) -> None:
        """Note that an entry is set, to numbers or to what is not known."""
        self._of_entry[which, number].append(_Setting(place, routine.number, branches, value))

    def note_taught(self, data: str, routine: KrlRoutine, place: int, branches: Branches) -> None:
        """Note a move that takes its tool and base by the numbers in its point's frame data."""
        self._taught[data.upper()].append((routine.number, place, branches))

    def entries_set(self) -> set[str]:
        """Return the entries that the program sets, as "BASE 3"."""
        return {" ".join(entry) for entry in self._of_entry}

    def taught_values(self, routines: Sequence[KrlRoutine]) -> dict[str, str]:
        """Return by frame data and entry, as "FP1 BASE 3", the numbers at all moves that take them, where certain."""
        found: dict[str, str] = {}
        for (which, number), settings in self._of_entry.items():
            values = {one.value for one in settings}
            if (which, _ANY) in self._of_entry or (len(values) > 1 and _may_interrupt(routines)):
                continue
            for data, moves in self._taught.items():
                at_moves = {
                    _value_at(settings, routines[routine], place, branches, alike=len(values) == 1)
                    for routine, place, branches in moves
                }
                if len(at_moves) == 1 and UNKNOWN not in at_moves:
                    found[f"{data} {which} {number}"] = at_moves.pop()
        return found

    def settle_uses(self, routines: Sequence[KrlRoutine]) -> None:
        """Put the numbers in place of the entry that a routine takes, where these are certain."""
        if not self._of_entry:
            return
        interrupts = _may_interrupt(routines)
        for routine in routines:
            for which, use in (("TOOL", routine.tool), ("BASE", routine.base)):
                self._settle_use(which, use, routine, interrupts=interrupts)

    def _settle_use(self, which: str, use: FrameUse, routine: KrlRoutine, *, interrupts: bool) -> None:
        for at, (place, number, branches) in enumerate(use.order):
            if not number.isdigit() or (which, _ANY) in self._of_entry:
                continue
            settings = self._of_entry.get((which, number), [])
            if interrupts and len({one.value for one in settings}) > 1:
                continue
            value = _value_at(settings, routine, place, branches)
            if value != UNKNOWN:
                use.order[at] = place, value, branches
                self.taken[f"{which} {number}"].add(value)
        use.values = {value for _, value, _ in use.order}


def _may_interrupt(routines: Sequence[KrlRoutine]) -> bool:
    return any(one.handlers or one.shown_handlers for one in routines)


def _value_at(
    settings: Sequence[_Setting], routine: KrlRoutine, place: int, branches: Branches, *, alike: bool = False
) -> str:
    """Return what an entry surely has at a place of a routine; ``alike`` where no call sets it to anything else."""
    own = [one for one in settings if one.routine == routine.number]
    at = bisect_left(own, place, key=attrgetter("place")) - 1
    if at < 0 or (routine.triggers and not alike):
        return UNKNOWN
    last, flow = own[at], routine.jumps.flow
    after = own[at + 1].place if at + 1 < len(own) else inf
    is_certain = (
        branches[: len(last.branches)] == last.branches
        and flow.surely_passes(last.place, place, after)
        and (alike or not flow.may_meet(routine.calls_at, last.place, place))
    )
    return last.value if is_certain else UNKNOWN
