"""Judging a model by rows that it has not seen, a whole group of neighbours at a time."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # loads a part of it when that is first used

from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.message import make_message

_SAME_RAD = 1e-3  # of a wrist that was not moved
_FEWEST_RUNS = 8
_FEWEST_ROWS_PER_RUN = 3.0
_SINGLE_ROWS = 40  # up to here each row is its own group
_BLOCKS = 40
_FEWEST_POSTURES = 5
_REPEATED = 0.6  # of the rows: above, most postures are new
_MOST_CELLS = 100_000  # beyond, only joints that round to the same numbers count as equal
_MOST_NEIGHBOURS = 300  # along a line: with more a tree is quicker, which takes half a second to load
_CONFIDENCE = 0.99  # four levels and some breaks are tried: each must be surer than 95 %


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Sizes of errors over some rows [m]."""

    n: int
    rmse_m: float
    mean_m: float
    p95_m: float
    max_m: float

    @classmethod
    def from_sizes(cls, sizes_m: Array) -> "ErrorSummary":
        """Summarise sizes (N,) [m]; without rows, everything is zero."""
        if not len(sizes_m):
            return cls(0, 0.0, 0.0, 0.0, 0.0)
        return cls(
            len(sizes_m),
            float(np.sqrt(np.mean(sizes_m**2))),
            float(np.mean(sizes_m)),
            float(np.percentile(sizes_m, 95)),
            float(np.max(sizes_m)),
        )


@dataclass(frozen=True, eq=False)
class Grouping:
    """Rows that are alike because they were measured next to each other share a group."""

    groups: Rows  # (N,)
    kind: str  # for people

    @property
    def group_count(self) -> int:
        """The number of groups."""
        return int(self.groups.max(initial=-1)) + 1

    def of_rows(self, rows: Rows) -> "Grouping":
        """Return the groups of some rows, numbered anew."""
        return Grouping(np.unique(self.groups[rows], return_inverse=True)[1].reshape(-1), self.kind)


def group_rows(joints_rad: Array, given_groups: Rows | None = None) -> Grouping:
    """Return groups: those given, runs of constant wrist, single rows if few, or blocks of neighbours.

    Rows that come back to a posture go with those that were there before: a posture that was fitted is no test.
    If most rows come back, each posture is a group.
    """
    count = len(joints_rad)
    if given_groups is not None:
        return Grouping(
            np.unique(given_groups, return_inverse=True)[1].reshape(-1), "groups named in the file"
        )
    postures = same_postures(joints_rad)
    distinct = int(postures.max(initial=0)) + 1
    if _FEWEST_POSTURES <= distinct <= _REPEATED * count:
        return Grouping(postures, "postures that were measured again and again")
    neighbours = _group_neighbours(joints_rad)
    first = np.unique(postures, return_index=True)[1]
    together = neighbours.groups[first][postures]
    return Grouping(np.unique(together, return_inverse=True)[1].reshape(-1), neighbours.kind)


def same_postures(joints_rad: Array, tolerance_rad: float = _SAME_RAD) -> Rows:
    """Return the number of the posture of every row (N,): rows with equal joints share it, however far apart."""
    cells, row, cell = np.unique(
        np.round(joints_rad / tolerance_rad), axis=0, return_index=True, return_inverse=True
    )
    leader = np.arange(len(cells))
    if len(cells) <= _MOST_CELLS:
        one, other = _near_cells(cells).T
        leader[one] = -1
        first = np.searchsorted(one, np.arange(len(cells) + 1))
        for each in np.argsort(row):  # cells by first row
            if leader[each] < 0:
                near = other[first[each] : first[each + 1]]
                leader[near[leader[near] < 0]] = leader[each] = each
    return np.unique(leader[cell.reshape(-1)], return_inverse=True)[1].reshape(-1)


def _near_cells(cells: Array) -> Rows:
    """Return the pairs (M, 2), both ways and sorted, of cells that differ by at most one in every coordinate.

    Along a line that is skew to all axes few cells are near each other by chance, so that these are compared.
    """
    skew = np.sqrt(2.0) ** np.arange(cells.shape[1])
    along = cells @ skew
    order = np.argsort(along)
    sorted_cells, along = cells[order], along[order]
    ahead = np.searchsorted(along, along + (skew.sum() + 0.5)) - np.arange(len(cells))  # so many, and itself
    if ahead.max(initial=0) > _MOST_NEIGHBOURS:
        pairs = scipy.spatial.cKDTree(cells).query_pairs(1.0, p=np.inf, output_type="ndarray")
    else:
        found = [np.zeros((0, 2), dtype=np.intp)]
        for step in range(1, int(ahead.max(initial=0))):
            at = np.flatnonzero(ahead > step)
            at = at[(np.abs(sorted_cells[at] - sorted_cells[at + step]) <= 1.0).all(axis=1)]
            found.append(order[np.column_stack([at, at + step])])
        pairs = np.concatenate(found)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    sorted_pairs: Rows = both[np.lexsort(both.T[::-1])]
    return sorted_pairs


def _group_neighbours(joints_rad: Array) -> Grouping:
    count = len(joints_rad)
    wrist = joints_rad[:, joints_rad.shape[1] // 2 :]
    starts = np.abs(np.diff(wrist, axis=0)).max(axis=1, initial=0.0) > _SAME_RAD
    runs = np.concatenate([[0], np.cumsum(starts)]).astype(np.intp)
    number = int(runs[-1]) + 1
    if number >= _FEWEST_RUNS and count / number >= _FEWEST_ROWS_PER_RUN:
        return Grouping(runs, "runs of constant wrist")
    if count <= _SINGLE_ROWS:
        return Grouping(np.arange(count), "single rows")
    return Grouping(np.arange(count) * _BLOCKS // count, "blocks of consecutive rows")


def assign_folds(grouping: Grouping, folds: int, seed: int) -> Rows:
    """Return the fold of every row: of as many groups in a row as there are folds, each goes to another fold.

    So every fold is spread over the whole series. The largest group goes to the fold that has fewest rows;
    which of equals is drawn.
    """
    sizes = np.bincount(grouping.groups)
    folds = min(folds, grouping.group_count)
    random = np.random.default_rng(seed)
    filled = np.zeros(folds, dtype=np.intp)
    fold_of_group = np.zeros(grouping.group_count, dtype=np.intp)
    for first in range(0, grouping.group_count, folds):
        some = random.permutation(np.arange(first, min(first + folds, grouping.group_count)))
        some = some[np.argsort(-sizes[some], kind="stable")]
        drawn = random.permutation(folds)
        chosen = drawn[np.argsort(filled[drawn], kind="stable")][: len(some)]
        fold_of_group[some] = chosen
        filled[chosen] += sizes[some]
    fold_of_row: Rows = fold_of_group[grouping.groups]
    return fold_of_row


def held_out_errors(folds: Rows, errors_without: Callable[[Rows, Rows], Array]) -> Array:
    """Return every row's error by a fit that did not see its fold: ``errors_without(training, held_out)``."""
    errors = np.zeros(len(folds))
    for fold in range(int(folds.max()) + 1):
        held_rows = np.flatnonzero(folds == fold)
        errors[held_rows] = errors_without(np.flatnonzero(folds != fold), held_rows)
    return errors


def rmse_uncertainty(sizes_m: Array, groups: Rows) -> tuple[float, float, float]:
    """Return the RMSE of errors (N,), its standard uncertainty [m] and degrees of freedom, by leaving groups out.

    Rows of one group share what drifts, so the group is what may be left out (the jackknife).

    Raises
    ------
    DegenerateDataError
        Fewer than two groups: the error on a further group cannot be estimated.
    """
    labels = np.unique(groups, return_inverse=True)[1].reshape(-1)
    counts, squares = np.bincount(labels), np.bincount(labels, sizes_m**2)
    number = len(counts)
    if number < 2:
        raise DegenerateDataError(
            "one group of rows tells no uncertainty.",
            remedy="Hold out more rows, or name groups in the file.",
        )
    without = np.sqrt((squares.sum() - squares) / (counts.sum() - counts))
    spread = float(np.sqrt((number - 1) / number * ((without - without.mean()) ** 2).sum()))
    return float(np.sqrt(np.mean(sizes_m**2))), spread, float(number - 1)


@dataclass(frozen=True, slots=True)
class ModelComparison:
    """Whether a wider model predicts unseen rows better than a narrower one, and how sure that is."""

    better: bool
    reason: str


def compare_models(
    narrow: tuple[str, Array], wide: tuple[str, Array], groups: Rows, *, least_gain: float = 0.01
) -> ModelComparison:
    """Compare held-out errors (N,) of two models, group by group.

    The wider one wins if its RMSE is lower by at least ``least_gain`` and the mean relative gain of the groups is
    positive with 99 % confidence (Student): a gain that a few groups make alone is none.
    """
    (narrow_name, first), (wide_name, second) = narrow, wide
    before, after = float(np.sqrt(np.mean(first**2))), float(np.sqrt(np.mean(second**2)))
    sure = _is_surely_positive(_relative_gains(first, second, groups))
    large = after < before * (1 - least_gain)
    change = make_message(
        "{wide}: {after_mm:.3f} mm ({narrow}: {before_mm:.3f})",
        wide=wide_name,
        after_mm=after * 1e3,
        narrow=narrow_name,
        before_mm=before * 1e3,
    )
    if large and sure:
        return ModelComparison(True, make_message("{change}: better", change=change))
    if large:
        return ModelComparison(
            False, make_message("{change}: no more than groups differ by chance", change=change)
        )
    return ModelComparison(False, make_message("{change}: not better", change=change))


def _relative_gains(first: Array, second: Array, groups: Rows) -> Array:
    """Return (a - b) / (a + b) of every group's mean squares: between -1 and 1, so that no group outshouts all."""
    sizes = np.bincount(groups)
    there = sizes > 0
    a, b = (np.bincount(groups, errors**2)[there] / sizes[there] for errors in (first, second))
    gains: Array = (a - b) / np.maximum(a + b, 1e-300)
    return gains


def _is_surely_positive(gains: Array) -> bool:
    count = len(gains)
    if count < 2:
        return False
    spread = float(gains.std(ddof=1)) / np.sqrt(count)
    return bool(gains.mean() > scipy.special.stdtrit(count - 1, _CONFIDENCE) * spread)
