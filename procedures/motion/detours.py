"""The order in which poses are visited, with detours over places that were visited before. Pure functions."""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from calibration.geometry import Array
from drivers.interfaces import Joints

K = TypeVar("K", int, Joints)
_NEAREST = 6  # visited places that a detour to one pose is tried from

# From a place, with how far the wire is wound there, to a posture: how far it is wound then; None: no free way.
Arrive = Callable[[Array, Array, float], float | None]


def ways_through(start_rad: Joints, poses: Array, arrive: Arrive) -> list[list[Array]]:
    """Return a way to each pose that can be reached, the nearest next; each way is its corners, the pose last.

    Where no pose is free from where the robot stands, it goes back to a place that it has been to, by ways that
    are known to be free, and on from there. Poses that cannot be reached even so are left out.
    """
    places = [_Place(np.array(start_rad), 0.0)]
    free: dict[int, set[int]] = {0: set()}
    left, here, ways = list(poses), 0, []
    while left:
        found = _next(places, here, left, arrive)
        if found is None:
            break
        at, index, wound = found
        places.append(_Place(left.pop(index), wound))
        new = len(places) - 1
        free[new] = {at}
        free[at].add(new)
        ways.append([places[k].joints for k in _path(free, here, new)[1:]])
        here = new
    return ways


@dataclass(frozen=True, eq=False)
class _Place:
    """A posture that the robot has been to, and how far the wire was wound there."""

    joints: Array
    wound_rad: float


def _next(
    places: list[_Place], here: int, left: list[Array], arrive: Arrive
) -> tuple[int, int, float] | None:
    """Return from which place which pose is gone to: from here the nearest one; else the shortest step elsewhere."""
    visited = np.array([place.joints for place in places])
    apart = np.abs(np.array(left)[:, None, :] - visited[None]).max(axis=2)
    steps = [(here, int(index)) for index in np.argsort(apart[:, here])]
    others = [
        (float(apart[index, at]), int(at), index)
        for index in range(len(left))
        for at in np.argsort(apart[index])[:_NEAREST]
        if at != here
    ]
    for at, index in [*steps, *((at, index) for _, at, index in sorted(others))]:
        wound = arrive(places[at].joints, left[index], places[at].wound_rad)
        if wound is not None:
            return at, index, wound
    return None


def _path(free: Mapping[K, set[K]], start: K, goal: K) -> list[K]:
    """Return the way with the fewest corners along steps that are known to be free."""
    came, queue = {start: start}, deque([start])
    while queue:
        at = queue.popleft()
        for other in sorted(free[at]):
            if other not in came:
                came[other] = at
                queue.append(other)
    path = [goal]
    while path[-1] != start:
        path.append(came[path[-1]])
    return path[::-1]


def known_way(
    start_rad: Joints, ways: Sequence[Sequence[Joints]], here: Joints, goal: Joints
) -> tuple[Joints, ...]:
    """Return the corners from one place of a travelled tour to another, over steps that the tour made.

    Both are places of the tour; the goal is the last corner.
    """
    free: dict[Joints, set[Joints]] = {}
    before = start_rad
    for corner in (corner for way in ways for corner in way):
        free.setdefault(before, set()).add(corner)
        free.setdefault(corner, set()).add(before)
        before = corner
    return tuple(_path(free, here, goal)[1:]) or (goal,)
