"""Routines that go on beside all others of a folder, or that an alarm may start at any time: what they set there."""

from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from cellcal.drivers.programs.call_graph import Marks, find_reached
from cellcal.drivers.programs.file_declarations import RoutineEffects

NOT_GIVEN = "~"  # what a program sets that was not given; behind all numbers and names
FindRoutines: TypeAlias = Callable[[str], Collection[int]]  # by a name: the numbers of those that it means


@dataclass
class RoutinesBeside:
    """By folder the routines that go on beside all others, by number, and those that start one not given."""

    calls: Sequence[Collection[int]]
    effects: Sequence[
        Sequence[Marks]
    ]  # by routine what it and those that it calls set: the tools, and the frames
    routines: Sequence[RoutineEffects]
    started: dict[str, set[int]] = field(default_factory=lambda: defaultdict(set))
    starting_missing: dict[str, set[int]] = field(default_factory=lambda: defaultdict(set))
    _marks: dict[tuple[str, int], dict[str, int]] = field(default_factory=dict)
    _places: dict[str, frozenset[str]] = field(default_factory=dict)

    def take_routine(self, number: int, folder: str, find: FindRoutines) -> None:
        """Take up what a routine starts."""
        for name in self.routines[number].beside:
            numbers = find(name)
            self.started[folder].update(numbers)
            if not numbers:
                self.starting_missing[folder].add(number)

    def marks_in(self, folder: str, which: int, own: frozenset[str]) -> list[tuple[str, int]]:
        """Return the tools (0) or frames (1) that they set in a folder, not a routine's own, and which one does."""
        if (folder, which) not in self._marks:
            below = self.effects[which]
            marks = {mark for number in self.started.get(folder, ()) for mark in below[number]}
            marks |= {(NOT_GIVEN, number) for number in self.starting_missing.get(folder, ())}
            self._marks[folder, which] = dict(sorted(marks, reverse=True))  # the first routine of each
        return sorted(mark for mark in self._marks[folder, which].items() if mark[0] not in own)

    def places_in(self, folder: str) -> frozenset[str]:
        """Return the global places that they, or routines that they call, compute in a folder."""
        if folder not in self._places:
            reached = find_reached(self.calls, self.started.get(folder, set()))
            places = (place for number in reached for place in self.routines[number].computes)
            self._places[folder] = frozenset(places)
        return self._places[folder]
