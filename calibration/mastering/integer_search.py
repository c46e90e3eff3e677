"""Integer least squares: the whole numbers nearest to a correlated real estimate, and how sure they are."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy  # loads a part of it when that is first used

from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array

_LOVASZ = 0.99  # how nearly a swap must shorten the basis; below 1 so that the reduction ends
_MAX_NODES = 20_000  # a reduced basis of six needs about fifty

_Node: TypeAlias = tuple[float, tuple[float, ...]]  # squared distance so far; entries, from a row to the last


@dataclass(frozen=True, slots=True)
class IntegerFix:
    """The best and second-best integers, their squared distances, and the chance that the best is right."""

    best: tuple[int, ...]
    second: tuple[int, ...]
    best_distance: float
    second_distance: float
    success_probability: float

    @property
    def distance_ratio(self) -> float:
        """Return second distance over best; large means that no other vector comes near."""
        return self.second_distance / max(self.best_distance, 1e-12)


def search_integers(estimate: Array, covariance: Array) -> IntegerFix:
    r"""Find the integer vectors nearest to a real estimate in the metric of its covariance.

    Minimise ``(z - a)' Q^-1 (z - a)`` over integer z. With ``Q^-1 = R' R`` this is the closest point of the
    lattice R; its basis is reduced first (unimodular Z, ``B = R Z``), which decorrelates the unknowns, so
    that the depth-first search ends after a few nodes and successive rounding is nearly as good.

    Parameters
    ----------
    estimate : Array, (n,)
        Real estimate a [periods].
    covariance : Array, (n, n)
        Covariance Q of the estimate, positive definite [periods^2].

    Returns
    -------
    IntegerFix
        Best, second best, squared distances, and the success probability of ``success_probability``.

    Raises
    ------
    DegenerateDataError
        The covariance is not positive definite.

    Notes
    -----
    The distances are exact; the probability assumes Gaussian errors with this covariance.

    References
    ----------
    P. J. G. Teunissen, The least-squares ambiguity decorrelation adjustment, J. Geodesy 70 (1995) 65.
    C. P. Schnorr, M. Euchner, Lattice basis reduction, Math. Programming 66 (1994) 181.
    """
    estimate = np.asarray(estimate, dtype=float)
    if estimate.size == 0:
        return IntegerFix((), (), 0.0, float("inf"), 1.0)
    transform, triangle = _decorrelate_covariance(covariance)
    unimodular_inverse = np.rint(np.linalg.inv(transform))
    points, distances = _two_nearest(triangle, unimodular_inverse @ estimate)
    integers = [tuple(int(v) for v in np.rint(transform @ point)) for point in points]
    return IntegerFix(integers[0], integers[1], distances[0], distances[1], _bootstrap_probability(triangle))


def success_probability(covariance: Array) -> float:
    r"""Return a lower bound on the probability that ``search_integers`` finds the true integers.

    ``P_s >= prod_i [2 Phi(1 / (2 sigma_i|I)) - 1]`` with the conditional deviations of the decorrelated
    unknowns (successive rounding). It needs no measurement, only the geometry of the poses.

    References
    ----------
    P. J. G. Teunissen, An optimality property of the integer least-squares estimator, J. Geodesy 73
    (1999) 587.
    """
    return _bootstrap_probability(_decorrelate_covariance(covariance)[1]) if len(covariance) else 1.0


def _bootstrap_probability(triangle: Array) -> float:
    return float(np.prod(2.0 * scipy.special.ndtr(np.abs(np.diag(triangle)) / 2.0) - 1.0))


def _decorrelate_covariance(covariance: Array) -> tuple[Array, Array]:
    """Return unimodular Z and upper triangular B with ``(R Z)'(R Z) = B'B = Z' Q^-1 Z`` and B reduced."""
    covariance = np.asarray(covariance, dtype=float)
    try:
        factor = np.linalg.inv(np.linalg.cholesky((covariance + covariance.T) / 2.0))
    except np.linalg.LinAlgError as error:
        raise DegenerateDataError("the covariance of the turns is not positive definite") from error
    size = len(covariance)
    transform = np.eye(size)
    triangle = np.asarray(np.linalg.qr(factor, mode="r"))
    column = 1
    while column < size:
        _reduce_column(triangle, transform, column)
        if _should_swap(triangle, column):
            triangle[:, [column - 1, column]] = triangle[:, [column, column - 1]]
            transform[:, [column - 1, column]] = transform[:, [column, column - 1]]
            triangle = np.asarray(np.linalg.qr(triangle, mode="r"))
            column = max(column - 1, 1)
        else:
            column += 1
    return transform, triangle


def _reduce_column(triangle: Array, transform: Array, column: int) -> None:
    for row in range(column - 1, -1, -1):
        times = np.rint(triangle[row, column] / triangle[row, row])
        if times:
            triangle[:, column] -= times * triangle[:, row]
            transform[:, column] -= times * transform[:, row]


def _should_swap(triangle: Array, column: int) -> bool:
    before, across, after = (
        triangle[column - 1, column - 1],
        triangle[column - 1, column],
        triangle[column, column],
    )
    return bool(_LOVASZ * before * before > across * across + after * after)


def _two_nearest(triangle: Array, target: Array) -> tuple[list[Array], list[float]]:
    """Return the two closest points of the lattice: depth first, nearest child first, the radius shrinks."""
    size = len(target)
    found = _first_two(triangle, target)
    stack: list[_Node] = [(0.0, ())]
    for _ in range(_MAX_NODES):
        if not stack:
            break
        distance, tail = stack.pop()
        if distance > found[1][0]:
            continue
        if len(tail) < size:
            stack.extend(_child_nodes(triangle, target, (distance, tail), found[1][0]))
        elif tail not in (found[0][1], found[1][1]):
            found = sorted([*found, (distance, tail)])[:2]
    return [np.array(tail) for _, tail in found], [distance for distance, _ in found]


def _first_two(triangle: Array, target: Array) -> list[_Node]:
    """Return two points to start from: successive rounding, and its first entry rounded the other way."""
    entries = np.array(target, dtype=float)
    for row in range(len(target) - 1, -1, -1):
        entries[row] = np.rint(_conditional_centre(triangle, target, row, entries[row + 1 :]))
    other = entries.copy()
    other[0] += 1.0 if _conditional_centre(triangle, target, 0, entries[1:]) >= entries[0] else -1.0
    points = [
        (float(np.sum((triangle @ (p - target)) ** 2)), tuple(float(v) for v in p)) for p in (entries, other)
    ]
    return sorted(points)


def _child_nodes(triangle: Array, target: Array, node: _Node, limit: float) -> list[_Node]:
    """Return the entries of the next row that stay inside the radius, nearest last."""
    distance, tail = node
    row = len(target) - 1 - len(tail)
    diagonal = triangle[row, row]
    centre = _conditional_centre(triangle, target, row, np.array(tail))
    reach = max(limit - distance, 0.0) ** 0.5 / abs(diagonal) + 1e-9
    entries = np.arange(np.ceil(centre - reach), np.floor(centre + reach) + 1.0)
    costs = distance + (diagonal * (entries - centre)) ** 2
    return [(float(costs[i]), (float(entries[i]), *tail)) for i in np.argsort(-costs)]


def _conditional_centre(triangle: Array, target: Array, row: int, tail: Array) -> float:
    """Return the real value of entry ``row`` that is best once the entries after it are fixed."""
    return float(target[row] + triangle[row, row + 1 :] @ (target[row + 1 :] - tail) / triangle[row, row])
