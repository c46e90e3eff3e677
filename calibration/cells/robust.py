"""Cell fits that bad rows cannot bend: `calibration.identification.robust`, scale and rejection by series."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads a part of it when that is first used
from numpy.typing import NDArray

from cellcal.calibration.cells.estimate import CellFit, estimate_cell
from cellcal.calibration.cells.state import CellLayout, CellState
from cellcal.calibration.cells.system import CellProblem, SeriesRows, series_residuals, whole_columns
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.group_effect import GroupEffect, expected_of, group_effect
from cellcal.calibration.identification.leverage import (
    MOST_MEAN_LEVERAGE,
    channel_groups,
    standardise_residuals,
)
from cellcal.calibration.identification.observations import PoseObservations, Rows
from cellcal.calibration.identification.robust import find_outliers, rejection_limit

_CAUCHY = 2.5  # deviations at which a row's weight is one half
_MAX_ROUNDS = 12
_WEIGHTS_SETTLED = 0.02
_SMALLEST_M = 1e-7
_SMALLEST_RAD = 1e-8
_SCALES_SETTLED = 0.01
_LEAST_FREEDOM = 1.0
_FEW_FREEDOM = 6.0  # redundant readings: from fewer, a scale is a guess


@dataclass(frozen=True, eq=False)
class SeriesResult:
    """The result of the fit for one series."""

    name: str
    rejected: Rows
    deviations: Array  # (N,): size of each row's residual in deviations of the good rows
    threshold: float
    scale: Array  # per channel group: found deviation / stated sigma
    degrees_of_freedom: float  # readings kept less unknowns that they determine
    scale_found: (
        bool  # by its own residuals; if not, the stated sigmas stand, unless the residuals are larger
    )


@dataclass(frozen=True, eq=False)
class RobustCellFit:
    """A least-squares fit of the rows that were kept, with sigmas scaled to what the residuals show."""

    fit: CellFit
    problem: CellProblem  # all rows, sigmas scaled
    series: tuple[SeriesResult, ...]

    @property
    def degrees_of_freedom(self) -> float:
        """Of the whole fit."""
        return sum(result.degrees_of_freedom for result in self.series)


def fit_cell_robustly(layout: CellLayout, start: CellState, problem: CellProblem) -> RobustCellFit:
    """Fit, find the rows that do not belong, and fit the rest by plain least squares.

    Parameters
    ----------
    layout : CellLayout
        Unknowns and priors.
    start : CellState
        Start of the iteration.
    problem : CellProblem
        Observations. Sigmas weigh rows of a series against each other; between series, the residuals of each tell.

    Returns
    -------
    RobustCellFit
        The covariance belongs to sigmas scaled by the reduced chi square of each series' kept rows.

    Notes
    -----
    With few redundant readings a series cannot tell its own scale. Its stated sigmas then stand, but for residuals
    that are larger: too small an uncertainty is worse than too large a one.
    """
    stated = problem
    weights = [np.ones(len(series)) for series in problem.series]
    fit = estimate_cell(layout, start, problem)
    problem, standardised = _rescale_problem(fit, stated, problem, weights)
    for _ in range(_MAX_ROUNDS):
        fresh = [1.0 / (1.0 + (np.linalg.norm(some, axis=0) / _CAUCHY) ** 2) for some in standardised]
        change = max(float(np.abs(a - b).max()) for a, b in zip(fresh, weights, strict=True))
        weights = fresh
        if change < _WEIGHTS_SETTLED:
            break
        fit = estimate_cell(layout, fit.state, problem, weights)
        problem, standardised = _rescale_problem(fit, stated, problem, weights)
    return _reject_and_refit(fit, stated, problem, standardised)


def widen_cell_fit(robust: RobustCellFit, groups: Sequence[Rows]) -> tuple[RobustCellFit, tuple[str, ...]]:
    """Return a fit with the covariance that alike rows of each series' groups allow, and what is said about it.

    The estimate stays: see `calibration.identification.group_effect`.
    """
    factors, notes, weights, freedom = [], [], [], []
    for series, result, labels in zip(robust.problem.series, robust.series, groups, strict=True):
        is_kept = np.ones(len(series), dtype=bool)
        is_kept[result.rejected] = False
        effect = _group_effect_of(robust.fit, series, np.flatnonzero(is_kept), labels[is_kept])
        factors.append(effect.widening)
        weights.append(is_kept.astype(float))
        least = min(result.degrees_of_freedom, effect.degrees_of_freedom or np.inf)
        freedom.append(replace(result, degrees_of_freedom=least))
        if effect.said:
            notes.append(f"{series.name}: {effect.said}")
    if max(factors) == 1.0:
        return robust, ()
    rows = zip(robust.problem.series, factors, strict=True)
    problem = CellProblem(tuple(series.scale_sigmas(np.full(2, factor)) for series, factor in rows))
    wide = estimate_cell(robust.fit.layout, robust.fit.state, problem, weights)
    fit = replace(robust.fit, covariance=wide.covariance)
    return replace(robust, fit=fit, series=tuple(freedom)), tuple(notes)


def _group_effect_of(fit: CellFit, series: SeriesRows, rows: Rows, groups: Rows) -> GroupEffect:
    labels = np.unique(groups, return_inverse=True)[1].reshape(-1)

    def columns_of(some: Rows) -> Array:
        return whole_columns(fit.layout, fit.state, series.select_rows(rows[some]))[0]

    row_residuals = series_residuals(series, fit.state)[:, rows]
    return group_effect(
        row_residuals, labels, expected_of(fit.covariance, columns_of, labels, len(row_residuals))
    )


def _reject_and_refit(
    fit: CellFit, stated: CellProblem, problem: CellProblem, standardised: list[Array]
) -> RobustCellFit:
    limits = [_series_limit(fit, series, number) for number, series in enumerate(problem.series)]
    is_kept = [np.ones(len(series), dtype=bool) for series in problem.series]
    for _ in range(_MAX_ROUNDS):
        fresh = [~find_outliers(some, limit) for some, limit in zip(standardised, limits, strict=True)]
        settled = all(bool((a == b).all()) for a, b in zip(fresh, is_kept, strict=True))
        if settled and not all(some.all() for some in fresh):
            break
        is_kept = fresh
        weights = [some.astype(float) for some in is_kept]
        fit = estimate_cell(fit.layout, fit.state, problem, weights)
        problem, standardised = _rescale_problem(fit, stated, problem, weights)
        if settled:
            break
    fit, problem, freedom = _scaled_by_chi_square(fit, stated, problem, is_kept)
    results = tuple(
        SeriesResult(
            series.name,
            np.flatnonzero(~is_kept[i]),
            np.linalg.norm(standardised[i], axis=0),
            limits[i],
            _scale_of(stated.series[i], series),
            freedom[i],
            freedom[i] >= _FEW_FREEDOM,
        )
        for i, series in enumerate(problem.series)
    )
    return RobustCellFit(fit, problem, results)


def _series_limit(fit: CellFit, series: SeriesRows, number: int) -> float:
    channels = series.observations.channels
    redundant = max(channels * len(series) - float(fit.learnt[number].sum()), 1.0)
    return rejection_limit(channels, len(series), redundant)


def _rescale_problem(
    fit: CellFit, stated: CellProblem, problem: CellProblem, weights: list[Array]
) -> tuple[CellProblem, list[Array]]:
    """Return the problem with sigmas as the median residuals show them, and residuals in such deviations."""
    series, every = [], []
    for number, (first, rows) in enumerate(zip(stated.series, problem.series, strict=True)):
        standardised = _standardised_residuals(fit, rows, number, weights[number])
        groups = channel_groups(len(standardised))
        medians = [
            np.median((standardised[g] ** 2).sum(axis=0)) / scipy.special.chdtri(len(standardised[g]), 0.5)
            for g in groups
        ]
        freedom = standardised.size - float(fit.learnt[number].sum())
        before = _scale_of(first, rows)
        scaled = _scale_sigmas(first, _limit_factors(np.sqrt(np.array(medians)) * before, freedom))
        for group, factor in zip(groups, _scale_of(first, scaled) / before, strict=True):
            standardised[group] /= factor
        series.append(scaled)
        every.append(standardised)
    return CellProblem(tuple(series)), every


def _standardised_residuals(fit: CellFit, series: SeriesRows, number: int, weights: Array) -> Array:
    """Return the residuals of a series (channels, N), each in deviations of what it may be."""
    whitened = series_residuals(series, fit.state)
    mean_leverage = float(fit.learnt[number].sum()) / whitened.size
    if mean_leverage < MOST_MEAN_LEVERAGE:
        raised: Array = whitened / np.sqrt(1.0 - mean_leverage)
        return raised
    columns, _ = whole_columns(fit.layout, fit.state, series)
    return standardise_residuals(whitened, columns, fit.covariance, weights)


def _scaled_by_chi_square(
    fit: CellFit, stated: CellProblem, problem: CellProblem, is_kept: list[NDArray[np.bool_]]
) -> tuple[CellFit, CellProblem, list[float]]:
    """Return the fit with the scales that the kept rows show, and the redundant readings of every series.

    How much a series has to tell depends on its scale against the others': a few rounds settle that.
    """
    weights = [some.astype(float) for some in is_kept]
    for _ in range(_MAX_ROUNDS):
        freedom, series, change = [], [], 0.0
        for number, (first, rows) in enumerate(zip(stated.series, problem.series, strict=True)):
            fit_residuals = series_residuals(rows, fit.state)[:, is_kept[number]]
            groups = channel_groups(len(fit_residuals))
            sizes = np.array([fit_residuals[group].size for group in groups])
            redundant = np.maximum(sizes - fit.learnt[number], _LEAST_FREEDOM)
            squares = np.array([float((fit_residuals[group] ** 2).sum()) for group in groups])
            before = _scale_of(first, rows)
            freedom.append(float(redundant.sum()))
            factors = _limit_factors(np.sqrt(squares / redundant) * before, freedom[-1])
            series.append(_scale_sigmas(first, factors))
            change = max(change, float(np.abs(_scale_of(first, series[-1]) / before - 1.0).max()))
        problem = CellProblem(tuple(series))
        fit = estimate_cell(fit.layout, fit.state, problem, weights)
        if len(series) == 1 and len(groups) == 1:
            break
        if change < _SCALES_SETTLED:
            break
    return fit, problem, freedom


def _limit_factors(factors: Array, freedom: float) -> Array:
    return factors if freedom >= _FEW_FREEDOM else np.maximum(factors, 1.0)


def _scale_sigmas(stated: SeriesRows, factors: Array) -> SeriesRows:
    """Return rows with the stated sigmas times factors.

    From the stated ones every time: products of ratios would round a scale of one to a little less.
    """
    observations = stated.observations
    smallest = [_SMALLEST_M / float(np.median(observations.sigma_m))]
    if isinstance(observations, PoseObservations):
        smallest.append(_SMALLEST_RAD / float(np.median(observations.sigma_rad)))
    return stated.scale_sigmas(np.maximum(factors, smallest))


def _scale_of(stated: SeriesRows, rows: SeriesRows) -> Array:
    first, then = stated.observations, rows.observations
    scale = [float(then.sigma_m[0] / first.sigma_m[0])]
    if isinstance(first, PoseObservations) and isinstance(then, PoseObservations):
        scale.append(float(then.sigma_rad[0] / first.sigma_rad[0]))
    return np.array(scale)
