"""Points that were taken in another order than the drawing's: found by trying the others."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message

_SUSPECT_M = 1e-3  # RMS that no touch leaves
_SUSPECT_SHARE = 3e-3  # of the spread
_BETTER = 20.0
_ALL_ORDERS = 7  # points; of more, two that changed places, runs from another end, and what distances tell
_MOST_MATCHED = 60  # points whose order is looked for by their distances
_ALIKE_SHARE = 0.25  # of the present misfit: how far the distances of a better order may differ
_AS_GOOD = 3.0  # times the misfit: an order that fits within this cannot be told from the one that was taken
_AS_GOOD_M = 1e-4  # … and where the misfit is smaller than touches repeat


@dataclass(frozen=True, eq=False)
class AlikeOrder:
    """Another order in which points fit as well as in their own: the pattern is symmetric."""

    order: tuple[int, ...]  # which target point stands where each one should, counted from 0
    target_source: Array  # (3, 3): the rotation that this order gives


def find_alike_orders(source: Array, target: Array) -> list[AlikeOrder]:
    """Return other orders of the targets that points (n, 3) [m] cannot tell from their own, the best fit first.

    A square's corners fit in eight orders: an exchange of names turns the frame, and no residual shows it.
    """
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    orders = np.array(list(_list_orders(len(a))))
    scores = _order_scores(a, b[orders])
    most_m = max(_AS_GOOD * float(_order_scores(a, b[None])[0]), _AS_GOOD_M)
    alike = [int(at) for at in np.argsort(scores) if scores[at] <= most_m]
    return [AlikeOrder(tuple(orders[at].tolist()), best_rotation(a, b[orders[at]])) for at in alike]


def best_rotation(source: Array, target: Array) -> Array:
    """Return the rotation (3, 3) that carries points (n, 3) onto others best, each about their mean."""
    left, _, right = np.linalg.svd((target - target.mean(axis=0)).T @ (source - source.mean(axis=0)))
    left[:, 2] *= np.linalg.det(left) * np.linalg.det(right)
    return np.asarray(left @ right)


def refuse_other_order(source: Array, target: Array, residuals: Array) -> None:
    """Refuse pairs of centred points (n, 3) that another order fits twenty times better.

    Raises
    ------
    CalibrationError
        With the order.
    """
    rms_m = _rms_of(residuals)
    spread = float(np.sqrt((target**2).sum(axis=1).mean()))
    if rms_m < max(_SUSPECT_M, _SUSPECT_SHARE * spread):
        return
    found = list(_list_orders(len(source)))
    if _ALL_ORDERS < len(source) <= _MOST_MATCHED:
        found += _orders_by_distances(source, target, _ALIKE_SHARE * rms_m)
    orders = np.array(found)
    if not len(orders):
        return
    scores = _order_scores(source, target[orders])
    best = int(np.argmin(scores))
    if scores[best] * _BETTER > rms_m:
        return
    order = ", ".join(str(at + 1) for at in orders[best])
    raise CalibrationError(
        make_message(
            "the points fit {rms_m:.0f} times better in another order: {order}.",
            rms_m=rms_m / max(float(scores[best]), 1e-09),
            order=order,
        ),
        remedy="See which point is which: the numbers say where each one of the drawing stands among those measured.",
    )


def _list_orders(count: int) -> Iterator[tuple[int, ...]]:
    plain = tuple(range(count))
    if count <= _ALL_ORDERS:
        yield from (order for order in permutations(plain) if order != plain)
        return
    for a, b in combinations(plain, 2):
        order = list(plain)
        order[a], order[b] = order[b], order[a]
        yield tuple(order)
    for turned in (plain, plain[::-1]):
        yield from (turned[at:] + turned[:at] for at in range(count) if turned[at:] + turned[:at] != plain)


def _orders_by_distances(source: Array, target: Array, alike_m: float) -> Iterator[tuple[int, ...]]:
    """Yield the orders in which the target's points lie nearest to the source's, laid on three of them.

    A triangle of source points is looked for among the target's by its sides; each that is found places all points.
    """
    corners = _widest_triangle(source)
    sides = np.linalg.norm(source[corners] - source[np.roll(corners, -1)], axis=1)
    apart = np.linalg.norm(target[:, None] - target[None], axis=2)
    fits = [np.abs(apart - side) < alike_m for side in sides]
    for first, second in np.argwhere(fits[0]).tolist():
        for third in np.flatnonzero(fits[1][second] & fits[2][:, first]).tolist():
            placed = _placed_on(source, source[corners], target[[first, second, third]])
            nearest = np.linalg.norm(placed[:, None] - target[None], axis=2).argmin(axis=1)
            if len(set(nearest.tolist())) == len(source):
                yield tuple(nearest.tolist())


def _widest_triangle(points: Array) -> Array:
    """Return three points that lie far apart and on no line."""
    first = int(np.argmax((points**2).sum(axis=1)))
    from_first = points - points[first]
    second = int(np.argmax((from_first**2).sum(axis=1)))
    third = int(np.argmax(np.linalg.norm(np.cross(from_first, from_first[second]), axis=1)))
    return np.array([first, second, third])


def _placed_on(points: Array, three: Array, onto: Array) -> Array:
    """Return points (n, 3) moved with the rigid motion that brings three of them onto three others."""
    centre, goal = three.mean(axis=0), onto.mean(axis=0)
    moved: Array = (points - centre) @ best_rotation(three, onto).T + goal
    return moved


def _order_scores(source: Array, targets: Array) -> Array:
    """Return the RMS of the best rigid fit to each order of the target (H, n, 3)."""
    left, _, right = np.linalg.svd(np.swapaxes(targets, 1, 2) @ source)
    left[..., 2] *= (np.linalg.det(left) * np.linalg.det(right))[:, None]
    moved = source @ np.swapaxes(left @ right, 1, 2)
    scores: Array = np.sqrt(((moved - targets) ** 2).sum(axis=2).mean(axis=1))
    return scores


def _rms_of(residuals: Array) -> float:
    return float(np.sqrt((residuals**2).sum(axis=1).mean()))
