"""The order in which poses are visited, with detours over places that were visited before. Pure functions."""

import heapq
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.drivers.interfaces import Joints

K = TypeVar("K", int, Joints)
_NEAREST = 6  # places that a way to one pose is tried from at a time
_CORNER_RAD = 0.1  # what a corner counts: a way with few is easier to look over
SAME_WINDING_RAD = 0.1  # of two ways to one place: more apart, the wire lies otherwise

# From a place, with how far the wire is wound there, to a posture: how far it is wound then; None: no free way.
Arrive = Callable[[Array, Array, float], float | None]


def ways_through(start_rad: Joints, poses: Array, arrive: Arrive) -> list[list[Array]]:
    """Return a way to each pose that can be reached, the shortest way next; each is its corners, the pose last.

    Where no pose is free from where the robot stands, it goes back to a place that it has been to, by ways that
    are known to be free, cut short where a straight one is, and on from there. Poses that cannot be reached even so
    are left out.
    """
    tour, remaining, ways = (
        _DetourSearch(np.array(start_rad), arrive),
        dict(enumerate(poses)),
        list[list[Array]](),
    )
    while remaining:
        found = tour.next_of(remaining)
        if found is None:
            break
        at, index, wound = found
        ways.append(tour.go_to(at, remaining.pop(index), wound))
    return ways


class _DetourSearch:
    """The places the robot has been to, how far the wire was wound there, and the straight ways known to be free."""

    def __init__(self, start: Array, arrive: Arrive) -> None:
        self._places, self._wound_rad, self._here = [start], [0.0], 0
        self._free: dict[int, dict[int, float]] = {0: {}}
        self._arrive = arrive
        self._shut: set[tuple[int, int]] = set()  # from a place to a pose
        self._blocked_pairs: set[tuple[int, int]] = set()  # between two places

    def next_of(self, remaining: Mapping[int, Array]) -> tuple[int, int, float] | None:
        """Return from which place which pose is gone to by the shortest way, and how far the wire is wound then."""
        numbers = list(remaining)
        apart = np.abs(np.array(list(remaining.values()))[:, None] - np.array(self._places)[None]).max(axis=2)
        back = self._shortest_paths()[0]
        lengths = apart + np.array([back[at] for at in range(len(self._places))])
        while ways := sorted(
            (float(lengths[row, at]), at, row)
            for row in range(len(numbers))
            for at in self._starts_worth_trying(lengths[row], numbers[row])
        ):
            for _, at, row in ways:
                wound = self._arrive(self._places[at], remaining[numbers[row]], self._wound_rad[at])
                if wound is not None:
                    return at, numbers[row], wound
                self._shut.add((at, numbers[row]))
        return None

    def _starts_worth_trying(self, lengths: Array, number: int) -> list[int]:
        """Return from which places a pose may be tried, the shortest ways; where the robot is among them."""
        untried = [int(at) for at in np.argsort(lengths) if (int(at), number) not in self._shut]
        return sorted({*untried[:_NEAREST], *({self._here} & set(untried))})

    def go_to(self, at: int, pose: Array, wound_rad: float) -> list[Array]:
        """Go to a pose from a place; return the corners of the way from where the robot was."""
        corners = self._shorten_path(_trace_path(self._shortest_paths()[1], self._here, at))
        self._places.append(pose)
        self._wound_rad.append(wound_rad)
        self._here = len(self._places) - 1
        self._free[self._here] = {}
        self._join_places(at, self._here)
        return [self._places[k] for k in [*corners[1:], self._here]]

    def _shortest_paths(self) -> tuple[dict[int, float], dict[int, int]]:
        return _shortest_distances(self._free, self._here)

    def _shorten_path(self, path: list[int]) -> list[int]:
        """Leave out corners between which there is a free straight way that winds the wire alike."""
        corners = path[:1]
        while corners[-1] != path[-1]:
            k = path.index(corners[-1])
            later = range(len(path) - 1, k, -1)
            corners.append(path[next(j for j in later if j == k + 1 or self._is_straight(path[k], path[j]))])
        return corners

    def _is_straight(self, one: int, other: int) -> bool:
        if other in self._free[one]:
            return True
        if (one, other) in self._blocked_pairs:
            return False
        wound = self._arrive(self._places[one], self._places[other], self._wound_rad[one])
        if wound is None or abs(wound - self._wound_rad[other]) > SAME_WINDING_RAD:
            self._blocked_pairs |= {(one, other), (other, one)}
            return False
        self._join_places(one, other)
        return True

    def _join_places(self, one: int, other: int) -> None:
        apart = float(np.abs(self._places[one] - self._places[other]).max())
        self._free[one][other] = self._free[other][one] = apart


def known_way(
    start_rad: Joints, ways: Sequence[Sequence[Joints]], here: Joints, goal: Joints
) -> tuple[Joints, ...]:
    """Return the corners from one place of a travelled tour to another, over steps that the tour made.

    Both are places of the tour; the goal is the last corner.
    """
    free: dict[Joints, dict[Joints, float]] = {}
    before = start_rad
    for corner in (corner for way in ways for corner in way):
        apart = max(abs(a - b) for a, b in zip(before, corner, strict=True))
        free.setdefault(before, {})[corner] = apart
        free.setdefault(corner, {})[before] = apart
        before = corner
    return tuple(_trace_path(_shortest_distances(free, here)[1], here, goal)[1:]) or (goal,)


def _shortest_distances(free: Mapping[K, Mapping[K, float]], start: K) -> tuple[dict[K, float], dict[K, K]]:
    """Return how far each place is along free steps, and the place before it on that way (Dijkstra 1959)."""
    far, came, queue, count = {start: 0.0}, {start: start}, [(0.0, 0, start)], 0
    while queue:
        gone, _, at = heapq.heappop(queue)
        for other, apart in free[at].items():
            length = gone + apart + _CORNER_RAD
            if length < far.get(other, np.inf):
                far[other], came[other], count = length, at, count + 1
                heapq.heappush(queue, (length, count, other))
    return far, came


def _trace_path(came: Mapping[K, K], start: K, goal: K) -> list[K]:
    path = [goal]
    while path[-1] != start:
        path.append(came[path[-1]])
    return path[::-1]
