"""Optimal choice of blocks of rows: which k of C candidate measurements tell most about p parameters.

Plain linear algebra: a candidate is a block of m whitened rows of a design matrix. All blocks are kept as one
array (p, m, C), components first and the candidate last, so that every step runs along memory for all
candidates at once.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array

_MOST_ROUNDS = 30
_WORTHWHILE = 1e-9  # relative gain of an exchange; below, it is rounding
_LEAST_WEIGHT = 1e-12
_LEAST_LEFT = 1e-5  # of the information in a direction, for a block to be removed by a rank-m change
_BOUND_GAP = 2e-3  # of the criterion, where the search for the bound may stop


@dataclass(frozen=True, eq=False)
class DesignTask:
    """The candidates of a choice, and its criterion.

    Columns are best scaled by the expected sizes of the parameters, so that metres and radians meet on one
    scale; a parameter that no block can see must be carried by ``information``.
    """

    columns: Array  # (p, m, C): whitened rows of all candidates, transposed
    information: Array  # (p, p), positive definite: priors, and what is measured already
    interest: Array | None = None  # (p, r): minimise trace(interest' Sigma interest); None: maximise det

    def __post_init__(self) -> None:
        p = len(self.columns)
        shapes = self.columns.ndim == 3 and self.information.shape == (p, p)
        if not shapes or (self.interest is not None and self.interest.shape[0] != p):
            raise CalibrationError("blocks (p, m, C), information (p, p) and interest (p, r) do not fit")
        if not (np.isfinite(self.columns).all() and np.isfinite(self.information).all()):
            raise CalibrationError("the rows of a design must be finite")

    @property
    def candidate_count(self) -> int:
        """The number of candidates."""
        return int(self.columns.shape[2])

    def information_of(self, chosen: NDArray[np.intp]) -> Array:
        """Return the information (p, p) with these candidates measured."""
        rows = self.columns[:, :, chosen].reshape(len(self.columns), -1)
        total: Array = self.information + rows @ rows.T
        return total

    def criterion_value(self, information: Array) -> float:
        """Return the criterion, larger is better: log det, or minus the trace."""
        factor = _cholesky_factor(information)
        if self.interest is None:
            return 2.0 * float(np.log(np.diag(factor)).sum())
        return -float(np.sum(np.linalg.solve(factor, self.interest) ** 2))


@dataclass(frozen=True, eq=False)
class DesignChoice:
    """Chosen candidates in the order in which each tells most, and the criterion they reach."""

    indices: tuple[int, ...]
    value: float


def choose_blocks(task: DesignTask, k: int, *, starts: int = 3, seed: int = 1) -> DesignChoice:
    r"""Choose k different candidates by block exchange from several starts.

    From a greedy choice, and from random ones, one block after another is taken out and replaced by the best
    of all candidates, until no single exchange improves anything. Removing or adding a block of m rows is a
    rank-m change of the covariance, and of its products with every candidate.

    Parameters
    ----------
    task : DesignTask
        Candidates and criterion.
    k : int
        How many to choose; all of them if there are no more.
    starts : int
        1 is greedy and exchange only [1].
    seed : int
        Of the random starts.

    References
    ----------
    V. V. Fedorov, Theory of optimal experiments, 1972: exchange. R. D. Cook and C. J. Nachtsheim, A
    comparison of algorithms for constructing exact D-optimal designs, Technometrics 22 (1980): place by place.
    """
    if k < 1 or starts < 1:
        raise CalibrationError("a design chooses at least one candidate, from at least one start")
    if k >= task.candidate_count:
        return _order_choice(task, np.arange(task.candidate_count))
    generator = np.random.default_rng(seed)
    best: NDArray[np.intp] | None = None
    best_value = -np.inf
    for start in range(starts):
        first = (
            _choose_greedily(task, k)
            if start == 0
            else generator.choice(task.candidate_count, k, replace=False)
        )
        chosen = _exchange_blocks(task, first)
        value = task.criterion_value(task.information_of(chosen))
        if value > best_value:
            best, best_value = chosen, value
    if best is None:
        raise DegenerateDataError("no choice of candidates has a finite criterion")
    return _order_choice(task, best)


def upper_bound(task: DesignTask, k: int, *, iterations: int = 400) -> float:
    r"""Return a value that no choice of k different candidates can exceed.

    The choice is relaxed to weights 0 <= w_c <= 1 with sum k. The criterion is concave in the weights, so its
    tangent at any w bounds it: ``f(w) + sum of the k largest g_c - sum w_c g_c`` with the gradient g. A
    multiplicative algorithm moves w to where the bound is tight; the least bound on the way is returned.

    References
    ----------
    S. D. Silvey, D. M. Titterington and B. Torsney, An algorithm for optimal designs on a finite design
    space, Communications in Statistics A 7 (1978).
    """
    weights = np.full(task.candidate_count, min(k, task.candidate_count) / task.candidate_count)
    flat = task.columns.reshape(len(task.columns), -1)
    power = 1.0 if task.interest is None else 0.5
    bound = np.inf
    for _ in range(iterations):
        repeated = np.tile(weights, task.columns.shape[1])
        information = task.information + (flat * repeated) @ flat.T
        gradient = _criterion_gradient(task, information)
        value = task.criterion_value(information)
        top = float(np.sort(gradient)[-k:].sum())
        gap = top - float(weights @ gradient)
        bound = min(bound, value + gap)
        if gap < _BOUND_GAP * (1.0 if task.interest is None else abs(value)):
            break
        weights = _cap_weights(weights * np.maximum(gradient, 1e-300) ** power, k)
    return bound


def design_efficiency(task: DesignTask, choice: DesignChoice, *, rank: int) -> float:
    """Return how good a choice is against the bound, at most 1: ratio of det^(1/rank), or of traces."""
    bound = upper_bound(task, len(choice.indices))
    if task.interest is None:
        return min(1.0, float(np.exp((choice.value - bound) / rank)))
    return min(1.0, bound / choice.value)


@dataclass(frozen=True, eq=False)
class _DesignState:
    """The covariance of a choice, and its products with every candidate's block."""

    covariance: Array  # (p, p)
    gram: Array  # (m, m, C): B Sigma B'
    reach: Array | None  # (r, m, C): interest' Sigma B'

    @classmethod
    def from_information(cls, task: DesignTask, information: Array) -> "_DesignState":
        p, m, count = task.columns.shape
        half = np.linalg.inv(_cholesky_factor(information))
        rows = (half @ task.columns.reshape(p, -1)).reshape(p, m, count)
        gram = np.empty((m, m, count))
        for a in range(m):
            for b in range(a + 1):
                gram[a, b] = gram[b, a] = np.einsum("pc,pc->c", rows[:, a], rows[:, b])
        reach = None
        if task.interest is not None:
            reach = ((half @ task.interest).T @ rows.reshape(p, -1)).reshape(-1, m, count)
        return cls(half.T @ half, gram, reach)

    def change_block(self, task: DesignTask, block: int, sign: int) -> "_DesignState":
        """Return the standing with a block added (+1) or removed (-1)."""
        p, m, count = task.columns.shape
        rows = task.columns[:, :, block].T
        spread = rows @ self.covariance
        inner = _cholesky_factor(np.eye(m) + sign * (spread @ rows.T))
        root = np.linalg.solve(inner, spread)
        products = (root @ task.columns.reshape(p, -1)).reshape(m, m, count)
        gram = np.empty_like(self.gram)
        for a in range(m):
            for b in range(a + 1):
                change = np.einsum("kc,kc->c", products[:, a], products[:, b])
                gram[a, b] = gram[b, a] = self.gram[a, b] - sign * change
        reach = self.reach
        if reach is not None and task.interest is not None:
            turned = sign * (task.interest.T @ root.T)
            reach = reach - (turned @ products.reshape(m, -1)).reshape(reach.shape)
        return _DesignState(self.covariance - sign * (root.T @ root), gram, reach)

    def candidate_gains(self) -> Array:
        """Return by how much adding each candidate would improve the criterion (C,).

        The rows of a block are taken one after another, each given the rows before it: one step of Gaussian
        elimination per row, for all candidates at once.
        """
        gram = self.gram.copy()
        reach = None if self.reach is None else self.reach.copy()
        gain = np.zeros(gram.shape[2])
        for a in range(len(gram)):
            pivot = 1.0 + gram[a, a]
            if reach is None:
                gain += np.log(pivot)
            else:
                gain += np.einsum("rc,rc->c", reach[:, a], reach[:, a]) / pivot
            for b in range(a + 1, len(gram)):
                factor = gram[b, a] / pivot
                gram[b, a + 1 :] -= factor * gram[a, a + 1 :]
                if reach is not None:
                    reach[:, b] -= factor * reach[:, a]
        return gain


def _choose_greedily(task: DesignTask, k: int) -> NDArray[np.intp]:
    standing = _DesignState.from_information(task, task.information)
    chosen: list[int] = []
    for _ in range(k):
        gains = standing.candidate_gains()
        gains[chosen] = -np.inf
        chosen.append(int(np.argmax(gains)))
        standing = standing.change_block(task, chosen[-1], +1)
    return np.array(chosen, dtype=np.intp)


def _exchange_blocks(task: DesignTask, first: NDArray[np.intp]) -> NDArray[np.intp]:
    chosen = first.copy()
    unchanged = 0
    for step in range(_MOST_ROUNDS * len(chosen)):
        place = step % len(chosen)
        if place == 0:  # afresh once a round: thousands of rank-m changes would add up their rounding
            standing = _DesignState.from_information(task, task.information_of(chosen))
        without = _remove_block(task, standing, chosen, place)
        gains = without.candidate_gains()
        own = gains[chosen[place]]
        gains[chosen] = -np.inf
        candidate = int(np.argmax(gains))
        if gains[candidate] > own + _WORTHWHILE * max(abs(own), 1e-300):
            chosen[place] = candidate
            standing, unchanged = without.change_block(task, candidate, +1), 0
        else:
            unchanged += 1
        if unchanged == len(chosen):
            break
    return chosen


def _remove_block(
    task: DesignTask, standing: _DesignState, chosen: NDArray[np.intp], place: int
) -> _DesignState:
    """Return the standing without one of the chosen; afresh where its removal would cancel all digits."""
    rows = task.columns[:, :, chosen[place]]
    remaining = 1.0 - float(np.linalg.eigvalsh(rows.T @ standing.covariance @ rows)[-1])
    if remaining < _LEAST_LEFT:
        return _DesignState.from_information(task, task.information_of(np.delete(chosen, place)))
    return standing.change_block(task, int(chosen[place]), -1)


def _order_choice(task: DesignTask, chosen: NDArray[np.intp]) -> DesignChoice:
    """Put the chosen in the order in which each tells most, given those before it."""
    few = DesignTask(np.ascontiguousarray(task.columns[:, :, chosen]), task.information, task.interest)
    order = chosen[_choose_greedily(few, len(chosen))]
    return DesignChoice(tuple(int(i) for i in order), task.criterion_value(task.information_of(order)))


def _criterion_gradient(task: DesignTask, information: Array) -> Array:
    """Return d criterion / d weight of every candidate (C,)."""
    half = np.linalg.inv(_cholesky_factor(information))
    flat = task.columns.reshape(len(task.columns), -1)
    product = (half if task.interest is None else (half @ task.interest).T @ half) @ flat
    by_candidate: Array = np.einsum("pj,pj->j", product, product).reshape(task.columns.shape[1:]).sum(axis=0)
    return by_candidate


def _cap_weights(weights: Array, k: int) -> Array:
    """Scale weights to the sum k with none above 1."""
    capped = np.zeros(len(weights), dtype=bool)
    result = weights
    for _ in range(len(weights)):
        free = ~capped
        remaining = k - float(capped.sum())
        result = np.where(capped, 1.0, weights * (remaining / max(float(weights[free].sum()), _LEAST_WEIGHT)))
        over = free & (result > 1.0)
        if not over.any():
            break
        capped |= over
    return result


def _cholesky_factor(matrix: Array) -> Array:
    try:
        return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise DegenerateDataError(
            "the information of the design is singular.",
            remedy="Give every parameter a prior, or leave out those that nothing can see.",
        ) from error
