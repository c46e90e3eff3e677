"""Where in a series the measuring device was moved: change points of its place, found row by row."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import ArmFit
from cellcal.calibration.identification.frame_fits import SHORTEST_MOUNTING, FrameFits
from cellcal.calibration.identification.observations import Observations, Rows

_MOST_BREAKS = 8
_CAPPED_COST = 100.0
_CHANGE_COST = 50.0
_RIDGE = 1e-9
_WINDOW_EDGES = 30  # that are tried first for a place that was left again


@dataclass(frozen=True, slots=True)
class SeriesBreak:
    """The first row of a new mounting, and how strongly the rows ask for it."""

    row: int
    bic_gain: float  # difference of the Bayesian information criterion; above 10 is called very strong


def candidate_breaks(
    model: RobotModel, observations: Observations, *, most: int = _MOST_BREAKS, fits: FrameFits | None = None
) -> Iterator[tuple[SeriesBreak, ...]]:
    r"""Yield one break, then two, and so on: for each number the rows that ask most strongly.

    Each round adds the break with the largest gain of the Bayesian information criterion
    ``N ln(RSS) + p ln(N)`` and then moves all breaks to their best places. The gain is computed for all cuts
    at once from one linearisation: with gradient g and columns D of the rows after the cut,
    ``RSS falls by g' (D'D - D'J (J'J)^-1 J'D)^-1 g``.

    Parameters
    ----------
    model : RobotModel
        Nominal.
    observations : Observations
        In the order in which they were measured; their mounting is ignored.
    most : int
        Largest number of breaks.
    fits : FrameFits or None
        Of these observations, where others want the same fits.

    Yields
    ------
    tuple of SeriesBreak
        Sorted by row. Whether breaks are real is for cross-validation to say: neighbours share errors, and
        the criterion takes them for independent.

    References
    ----------
    G. Schwarz, Estimating the dimension of a model, Annals of Statistics 6 (1978) 461: the criterion.
    """
    fits = fits or FrameFits(model, observations)
    breaks: list[SeriesBreak] = []
    while len(breaks) < most and len(observations) >= 4 * SHORTEST_MOUNTING:
        rows = [found.row for found in breaks]
        try:
            cut = _best_cut(fits.linearise_breaks(rows), rows, None)
        except DegenerateDataError:
            return
        if cut is None or cut.bic_gain <= 0:
            return
        breaks = _settle_breaks(fits, [*breaks, cut])
        yield sort_breaks(*breaks)


def sort_breaks(*breaks: SeriesBreak) -> tuple[SeriesBreak, ...]:
    """Return breaks in the order of their rows."""
    return tuple(sorted(breaks, key=lambda found: found.row))


def find_small_break(fits: FrameFits, breaks: Sequence[SeriesBreak]) -> SeriesBreak | None:
    """Return the further break that the rows ask for once the geometry is fitted, or None.

    The errors of an arm that was never calibrated are larger than a small move of the device, and hide it from
    `candidate_breaks`.
    """
    rows = [found.row for found in breaks]
    if not fits.carry_geometry(rows):
        return None
    try:
        linear = fits.fit_geometry(rows)
        cut = _best_cut(linear, rows, None)
    except DegenerateDataError:
        return None
    if cut is None or cut.bic_gain <= max(0.0, *(_drift_gain(linear, rows, cut, power) for power in (1, 2))):
        return None
    return cut


def find_small_excursion(
    fits: FrameFits, breaks: Sequence[SeriesBreak]
) -> tuple[SeriesBreak, SeriesBreak] | None:
    """Return the two further breaks between which the device stood elsewhere for a while, or None.

    A move that is undone later gains little by either of its breaks alone, and `find_small_break` passes it.
    """
    rows = [found.row for found in breaks]
    if not fits.carry_geometry(rows):
        return None
    try:
        linear = fits.fit_geometry(rows)
    except DegenerateDataError:
        return None
    best: tuple[SeriesBreak, SeriesBreak] | None = None
    for mounting, span in enumerate(pairwise(sorted([0, len(fits.observations), *rows]))):
        found = _scan_windows(linear, mounting, span)
        if found is not None and (best is None or found[0].bic_gain > best[0].bic_gain):
            best = found
    if best is None or best[0].bic_gain <= max(0.0, _drift_gain(linear, rows, best[0], 2)):
        return None
    return best


def _scan_windows(
    linear: tuple[ArmFit, Array, Array], mounting: int, span: tuple[int, int]
) -> tuple[SeriesBreak, SeriesBreak] | None:
    """Return the breaks of the run of rows inside a mounting that asks most strongly for a place of its own."""
    first, last = span
    count = last - first
    if count < 3 * SHORTEST_MOUNTING:
        return None
    step = max(count // _WINDOW_EDGES, 1)
    coarse = np.arange(SHORTEST_MOUNTING, count - SHORTEST_MOUNTING + 1, step)
    sums, residuals = _window_sums(linear, mounting, span), linear[2]
    begins, ends, gains = _window_gains(sums, residuals, coarse, coarse)
    if not len(gains):
        return None
    at = int(np.argmax(gains))
    near = [
        np.arange(max(edge - step, SHORTEST_MOUNTING), min(edge + step, count - SHORTEST_MOUNTING) + 1)
        for edge in (int(begins[at]), int(ends[at]))
    ]
    begins, ends, gains = _window_gains(sums, residuals, *near)
    at = int(np.argmax(gains))
    gain = float(gains[at])
    return SeriesBreak(first + int(begins[at]), gain), SeriesBreak(first + int(ends[at]), gain)


def _window_sums(
    linear: tuple[ArmFit, Array, Array], mounting: int, span: tuple[int, int]
) -> tuple[Array, Array, Array, Array]:
    """Return sums over the rows from each cut to the end of a mounting, the last of them none."""
    fit, columns, residuals = linear
    size = 3 if fit.layout.kind == "length" else 6
    first, last = span
    place = columns[size * mounting : size * (mounting + 1), :, first:last]
    whole = columns[:, :, first:last]
    cross = np.zeros((last - first + 1, len(columns), size))
    gradient = np.zeros((last - first + 1, size))
    cross[:-1] = _tail_sums(np.einsum("pmn,dmn->npd", whole, place))
    gradient[:-1] = _tail_sums(np.einsum("dmn,mn->nd", place, residuals[:, first:last]))
    own = cross[:, size * mounting : size * (mounting + 1)]
    return cross, own, gradient, _inverse_normal(columns)


def _window_gains(
    sums: tuple[Array, Array, Array, Array], residuals: Array, begins: Rows, ends: Rows
) -> tuple[Rows, Rows, Array]:
    """Return the windows between these edges that are long enough, and what the criterion gains for each."""
    cross, own, gradient, inverse = sums
    size = gradient.shape[1]
    at_begin, at_end = np.nonzero(ends - begins[:, None] >= SHORTEST_MOUNTING)
    begin, end = begins[at_begin], ends[at_end]
    # The rows of a window are the difference of two sums: what these share is made once for each edge, not window.
    first, last = cross[begins].transpose(0, 2, 1), cross[ends].transpose(0, 2, 1)  # (…, d, p)
    bent = last @ inverse
    between = np.tensordot(first, bent, axes=(2, 2)).transpose(0, 2, 1, 3)[at_begin, at_end]
    of_begin = (first @ inverse) @ first.transpose(0, 2, 1)
    of_end = bent @ last.transpose(0, 2, 1)
    shared = of_begin[at_begin] + of_end[at_end] - between - between.transpose(0, 2, 1)
    schur = own[begin] - own[end] - shared
    schur = schur + _RIDGE * np.trace(schur, axis1=1, axis2=2)[:, None, None] * np.eye(size)
    pull = gradient[begin] - gradient[end]
    drop = np.einsum("nd,nd->n", pull, np.linalg.solve(schur, pull[..., None])[..., 0])
    return begin, end, _gain_of(drop, residuals, 2 * size + 1)  # cross-validation fits two places


def _drift_gain(
    linear: tuple[ArmFit, Array, Array], breaks: Sequence[int], cut: SeriesBreak, power: int
) -> float:
    """Return what the criterion gains where the device moves steadily through the span that the cut is in.

    With ``power`` 2 it may come back: it moves as a parabola of the rows.
    """
    fit, columns, residuals = linear
    edges = sorted([0, residuals.shape[1], *breaks])
    mounting = int(np.searchsorted(edges, cut.row, side="right")) - 1
    first, last = edges[mounting : mounting + 2]
    size = 3 if fit.layout.kind == "length" else 6
    place = columns[size * mounting : size * (mounting + 1), :, first:last]
    along = np.linspace(0.0, 1.0, last - first)
    ramp = np.concatenate([place * along**each for each in range(1, power + 1)])
    cross = np.einsum("pmn,dmn->pd", columns[:, :, first:last], ramp)
    gradient = np.einsum("dmn,mn->d", ramp, residuals[:, first:last])
    schur = np.einsum("dmn,emn->de", ramp, ramp) - cross.T @ _inverse_normal(columns) @ cross
    schur = schur + _RIDGE * np.trace(schur) * np.eye(len(ramp))
    drop = float(gradient @ np.linalg.solve(schur, gradient))
    return float(_gain_of(np.array([drop]), residuals, len(ramp))[0])


def _settle_breaks(fits: FrameFits, breaks: list[SeriesBreak]) -> list[SeriesBreak]:
    """Move each break to where it gains most while the others stay; the first search saw a worse model."""
    observations = fits.observations
    for index in range(len(breaks)):
        others = [found.row for found in breaks if found is not breaks[index]]
        around = _free_span(breaks[index].row, others, len(observations))
        moved = _best_cut(fits.linearise_breaks(others), others, around)
        if moved is not None:
            breaks = [*breaks[:index], moved, *breaks[index + 1 :]]
    return breaks


def _free_span(row: int, others: list[int], count: int) -> tuple[int, int]:
    edges = sorted([0, count, *others])
    after = int(np.searchsorted(edges, row, side="right"))
    return edges[after - 1], edges[after]


def _best_cut(
    linear: tuple[ArmFit, Array, Array], breaks: Sequence[int], within: tuple[int, int] | None
) -> SeriesBreak | None:
    fit, columns, residuals = linear
    best: SeriesBreak | None = None
    for mounting, span in enumerate(pairwise(sorted([0, residuals.shape[1], *breaks]))):
        if within is not None and span != within:
            continue
        found = _scan_span(fit, columns, residuals, mounting, span)
        if found is not None and (best is None or found.bic_gain > best.bic_gain):
            best = found
    return best


def _scan_span(
    fit: ArmFit, columns: Array, residuals: Array, mounting: int, span: tuple[int, int]
) -> SeriesBreak | None:
    size = 3 if fit.layout.kind == "length" else 6
    first, last = span
    if last - first < 2 * SHORTEST_MOUNTING:
        return None
    place = columns[size * mounting : size * (mounting + 1), :, first:last]
    whole = columns[:, :, first:last]
    # Sums over the rows from each cut to the end of the mounting.
    cross = _tail_sums(np.einsum("pmn,dmn->npd", whole, place))
    own = cross[:, size * mounting : size * (mounting + 1)]
    gradient = _tail_sums(np.einsum("dmn,mn->nd", place, residuals[:, first:last]))
    bent = np.einsum("pq,nqd->npd", _inverse_normal(columns), cross)
    schur = own - np.einsum("npd,npe->nde", cross, bent)
    schur = schur + _RIDGE * np.trace(schur, axis1=1, axis2=2)[:, None, None] * np.eye(size)
    cuts = slice(SHORTEST_MOUNTING, last - first - SHORTEST_MOUNTING + 1)
    drop = np.einsum(
        "nd,nd->n", gradient[cuts], np.linalg.solve(schur[cuts], gradient[cuts][..., None])[..., 0]
    )
    gain = _gain_of(drop, residuals, size)
    at = int(np.argmax(gain))
    return SeriesBreak(first + SHORTEST_MOUNTING + at, float(gain[at]))


def _gain_of(drop: Array, residuals: Array, size: int) -> Array:
    """Return by how much the criterion falls for each drop of the sum of squares, at the price of a place."""
    rss = float((residuals**2).sum())
    count = residuals.size
    remaining_rss = np.maximum(rss - drop, 1e-3 * rss)
    gain: Array = count * np.log(rss / remaining_rss) - (size + 1) * np.log(count)
    return gain


def _tail_sums(terms: Array) -> Array:
    sums: Array = np.cumsum(terms[::-1], axis=0)[::-1]
    return sums


def _inverse_normal(columns: Array) -> Array:
    flat = columns.reshape(len(columns), -1)
    normal = flat @ flat.T
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
    inverse: Array = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-10) / np.outer(scale, scale)
    return inverse


def change_between(before_m: Array, after_m: Array) -> int:
    """Return how many of some rows (N,) belong before a change, given their errors on either side of it [m]."""
    usual = max(float(np.median(np.minimum(before_m, after_m))), 1e-6)
    # Capped: one outlier must not decide.
    first, second = (np.minimum((errors / usual) ** 2, _CAPPED_COST) for errors in (before_m, after_m))
    cost = np.concatenate([[0.0], np.cumsum(first)]) + np.concatenate([[0.0], np.cumsum(second[::-1])])[::-1]
    return int(np.argmin(cost))


def assign_mountings(errors_m: Array, sigma_m: float) -> Rows:
    """Return the mounting of every row of another series, changing as seldom as the rows allow.

    Parameters
    ----------
    errors_m : (S, N)
        Error of every row under each of the known mountings [m].
    sigma_m : float
        Standard deviation of one row [m].

    Returns
    -------
    (N,)
        The sequence with the least sum of squared errors, capped at 10 deviations, plus 50 for each change.
    """
    cost = np.minimum((errors_m / sigma_m) ** 2, _CAPPED_COST)
    count, total = cost.shape[1], cost[:, 0].copy()
    came_from = np.zeros(cost.shape, dtype=np.intp)
    for row in range(1, count):
        cheapest = int(np.argmin(total))
        change = total[cheapest] + _CHANGE_COST < total
        came_from[:, row] = np.where(change, cheapest, np.arange(len(total)))
        total = np.minimum(total, total[cheapest] + _CHANGE_COST) + cost[:, row]
    path = np.empty(count, dtype=np.intp)
    path[-1] = int(np.argmin(total))
    for row in range(count - 1, 0, -1):
        path[row - 1] = came_from[path[row], row]
    return path
