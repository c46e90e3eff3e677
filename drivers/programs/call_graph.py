"""What routines set, seen from those that call them and those that they call: one pass over all calls."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import TypeAlias

Marks: TypeAlias = tuple[tuple[str, int], ...]  # what is set, and by which routine; two tell of several

_MOST = 2


def reached_settings(
    calls: Sequence[Collection[int]], own: Sequence[Iterable[str]]
) -> tuple[list[Marks], list[Marks]]:
    """Return for every routine what it and those that it calls set, and what is set around it.

    Around it are the routines that call it, at any depth, and all that those call. At most two different values
    are kept of each: more tell nothing more, and a chain of calls would cost its square.
    """
    groups = _group_cycles(calls)
    group_of = {routine: number for number, group in enumerate(groups) for routine in group}
    below: list[Marks] = []
    for group in groups:  # whom a group calls stands before it
        marks = {(value, routine) for routine in group for value in own[routine]}
        for called in {group_of[other] for routine in group for other in calls[routine]}:
            if called < len(below):
                marks.update(below[called])
        below.append(_least_marks(marks))
    above: list[Marks] = [()] * len(groups)
    for number in range(len(groups) - 1, -1, -1):
        others = {group_of[other] for routine in groups[number] for other in calls[routine]}
        if number in others:  # its routines call each other
            above[number] = _least_marks({*above[number], *below[number]})
        for called in others - {number}:
            above[called] = _least_marks({*above[called], *above[number], *below[number]})
    count = range(len(calls))
    return [below[group_of[one]] for one in count], [above[group_of[one]] for one in count]


def find_recursive_routines(calls: Sequence[Collection[int]]) -> list[bool]:
    """Return of each routine whether it, or one that it calls, calls it."""
    found = [routine in called for routine, called in enumerate(calls)]
    for group in _group_cycles(calls):
        if len(group) > 1:
            for routine in group:
                found[routine] = True
    return found


def called_outside(routines: Mapping[str, tuple[Set[str], Set[str]]]) -> dict[str, frozenset[str]]:
    """Return by routine what it, or one that it calls, calls outside; from the calls inside and outside."""
    numbers = {name: number for number, name in enumerate(routines)}
    calls = [[numbers[each] for each in sorted(inside) if each in numbers] for inside, _ in routines.values()]
    outside = [each for _, each in routines.values()]
    return {
        name: frozenset().union(*(outside[each] for each in find_reached(calls, {number})))
        for name, number in numbers.items()
    }


def _least_marks(marks: Collection[tuple[str, int]]) -> Marks:
    """Return the least marks, each of another value."""
    found: list[tuple[str, int]] = []
    for mark in sorted(marks):
        if not found or found[-1][0] != mark[0]:
            found.append(mark)
            if len(found) == _MOST:
                break
    return tuple(found)


def _group_cycles(calls: Sequence[Collection[int]]) -> list[list[int]]:
    """Return routines that call each other in a circle together, those called before those that call."""
    tarjan = _Tarjan(calls)
    for routine in range(len(calls)):
        if routine not in tarjan.order:
            tarjan.follow_routine(routine)
    return tarjan.groups


@dataclass
class _Tarjan:
    """Tarjan's way to find them, without recursion: calls are as deep as a file says."""

    calls: Sequence[Collection[int]]
    order: dict[int, int] = field(default_factory=dict)  # by routine: as how many-th it was met
    least: dict[int, int] = field(default_factory=dict)  # the first met that leads back to it
    waiting: dict[int, None] = field(default_factory=dict)  # met, and not yet in a group
    groups: list[list[int]] = field(default_factory=list)

    def follow_routine(self, first: int) -> None:
        """Group all that a routine leads to."""
        path = [(first, self._begin_routine(first))]
        while path:
            routine, rest = path[-1]
            for other in rest:
                if other not in self.order:
                    path.append((other, self._begin_routine(other)))
                    break
                if other in self.waiting:
                    self.least[routine] = min(self.least[routine], self.order[other])
            else:
                path.pop()
                if path:
                    above = path[-1][0]
                    self.least[above] = min(self.least[above], self.least[routine])
                self._end_routine(routine)

    def _begin_routine(self, routine: int) -> Iterator[int]:
        self.order[routine] = self.least[routine] = len(self.order)
        self.waiting[routine] = None
        return iter(self.calls[routine])

    def _end_routine(self, routine: int) -> None:
        if self.least[routine] != self.order[routine]:
            return
        group: list[int] = []
        while routine not in group[-1:]:
            group.append(self.waiting.popitem()[0])
        self.groups.append(group)


def with_interrupts(
    calls: Sequence[Collection[int]], here: Sequence[Collection[int]], shown: Sequence[Collection[int]]
) -> tuple[list[Collection[int]], list[Set[int]]]:
    """Return the calls with those of interrupts, and by routine the handlers that may run while it does.

    A routine declares handlers that run while it or one that it calls does, ``here``, and ``shown`` ones that run
    while its callers do, too.
    """
    callers: list[set[int]] = [set() for _ in calls]
    for routine, called in enumerate(calls):
        for other in called:
            callers[other].add(routine)
    running: list[Set[int]] = [set() for _ in calls]
    for routine in range(len(calls)):
        for handlers in filter(None, (here[routine], shown[routine])):
            roots = {routine} if handlers is here[routine] else find_reached(callers, {routine})
            for each in find_reached(calls, roots):
                running[each] |= set(handlers)
    return [[*called, *more] for called, more in zip(calls, running, strict=True)], running


def find_reached(
    calls: Sequence[Collection[int]] | Mapping[int, Collection[int]], roots: Set[int]
) -> Set[int]:
    """Return the roots and all that they lead to."""
    found, waiting = set(roots), list(roots)
    while waiting:
        more = set(calls[waiting.pop()]) - found
        found |= more
        waiting += more
    return found


def reached_missing(calls: Mapping[str, Set[str]], program_names: Set[str]) -> dict[str, str]:
    """Return by routine the name of one that was not given and that it, or one that it calls, calls."""
    callers: dict[str, list[str]] = {}
    for name, called in calls.items():
        for each in called & program_names:
            callers.setdefault(each, []).append(name)
    found = {name: min(missing) for name, called in calls.items() if (missing := called - program_names)}
    waiting = list(found)
    while waiting:
        reached = waiting.pop()
        for caller in callers.get(reached, ()):
            if caller not in found:
                found[caller] = found[reached]
                waiting.append(caller)
    return found
