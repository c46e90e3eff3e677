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

    started: dict[str, set[int]] = field(default_factory=lambda: defaultdict(set))
    starting_missing: dict[str, set[int]] = field(default_factory=lambda: defaultdict(set))

    def take_routine(self, number: int, folder: str, routine: RoutineEffects, find: FindRoutines) -> None:
        """Take up what a routine starts."""
        for name in routine.beside:
            numbers = find(name)
            self.started[folder].update(numbers)
            if not numbers:
                self.starting_missing[folder].add(number)

    def marks_in(self, folder: str, below: Sequence[Marks], own: frozenset[str]) -> list[tuple[str, int]]:
        """Return what they set in a folder, and which routine does, of what is not among a routine's own."""
        marks = {mark for number in self.started.get(folder, ()) for mark in below[number]}
        marks |= {(NOT_GIVEN, number) for number in self.starting_missing.get(folder, ())}
        return sorted(mark for mark in marks if mark[0] not in own)

    def places_in(
        self, folder: str, calls: Sequence[Collection[int]], routines: Sequence[RoutineEffects]
    ) -> frozenset[str]:
        """Return the global places that they, or routines that they call, compute in a folder."""
        reached = find_reached(calls, self.started.get(folder, set()))
        return frozenset(place for number in reached for place in routines[number].computes)
