"""Fits that bad rows cannot bend: Cauchy start, rejection by median deviation, least squares at the end."""

from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads a part of it when that is first used
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import ArmFit, FitProblem, estimate_arm, whitened_residuals
from cellcal.calibration.identification.leverage import (
    channel_groups,
    effective_unknowns,
    redundant_shares,
    standardised_residuals,
)
from cellcal.calibration.identification.observations import PoseObservations, Rows
from cellcal.calibration.identification.parameters import ArmState, ParameterLayout

_CAUCHY = 2.5  # deviations at which a row's weight is one half
_MAX_ROUNDS = 12
_WEIGHTS_SETTLED = 0.02
_SCALES_SETTLED = 0.01
_LEAST_REJECTION = 4.0
_FALSE_ALARMS = 0.05  # good rows rejected per fit, if errors were Gaussian
_SMALLEST_M = 1e-7  # a series without errors is no reason to believe in none
_SMALLEST_RAD = 1e-8
_MEDIAN_EFFICIENCY = {1: 0.37, 3: 0.53, 6: 0.58}  # of a variance from the median of chi squares, by channels
_NEIGHBOURS = 7  # rows, with the one in question
_BEYOND_COMPANY = 5.0


@dataclass(frozen=True, eq=False)
class RobustFit:
    """A least-squares fit of the rows that were kept, with sigmas scaled to what the residuals show."""

    fit: ArmFit
    problem: FitProblem  # all rows, sigmas scaled
    rejected: Rows
    deviations: Array  # (N,): size of each row's residual in deviations of the good rows
    threshold: float
    scale: Array  # per channel group: found deviation / stated sigma
    degrees_of_freedom: float


def fit_robustly(layout: ParameterLayout, start: ArmState, problem: FitProblem) -> RobustFit:
    """Fit, find the rows that do not belong, and fit the rest by plain least squares.

    Parameters
    ----------
    layout : Layout
        Unknowns and priors.
    start : ArmState
        Start of the iteration.
    problem : Problem
        Observations; their sigmas weigh rows against each other and need not be right in size.

    Returns
    -------
    RobustFit
        The covariance belongs to sigmas scaled by the reduced chi square of the kept rows.

    Notes
    -----
    A row is rejected beyond ``max(4, t)`` deviations of what its residual may be, where t would reject 0.05 good
    Gaussian rows in all, given how well so few residuals tell their deviation; unless its neighbours are off in
    the same way. The deviation is taken from the median, so up to half of the rows may be bad.

    References
    ----------
    P. W. Holland, R. E. Welsch, Robust regression using iteratively reweighted least-squares, Comm. Statistics
    A6 (1977) 813: Cauchy weights.
    """
    if not len(layout):
        return _without_fit(layout, start, problem)
    fit = estimate_arm(layout, start, problem, from_afar=True)
    return _settle_weights(fit, problem, np.ones(len(problem.observations)))


def _cauchy_weights(deviations: Array) -> Array:
    weights: Array = 1.0 / (1.0 + deviations**2 / _CAUCHY**2)
    return weights


def _settle_weights(fit: ArmFit, problem: FitProblem, weights: Array) -> RobustFit:
    """Repeat fit and weights until they agree; then reject rows."""
    problem, standardised = _rescale_problem(fit, problem, weights)
    for _ in range(_MAX_ROUNDS):
        fresh = _cauchy_weights(np.linalg.norm(standardised, axis=0))
        settled = float(np.abs(fresh - weights).max()) < _WEIGHTS_SETTLED
        weights = fresh
        if settled:
            break
        fit = estimate_arm(fit.layout, fit.state, problem, weights)
        problem, standardised = _rescale_problem(fit, problem, weights)
    return _reject_and_refit(fit, problem, standardised)


def _without_fit(layout: ParameterLayout, state: ArmState, problem: FitProblem) -> RobustFit:
    """Return a fit of nothing: everything is held where it was known."""
    fit = ArmFit(state, layout, np.zeros((0, 0)), np.zeros(0), 0.0, 0)
    problem, standardised = _rescale_problem(fit, problem, np.ones(len(problem.observations)))
    observations = problem.observations
    freedom = float(observations.channels * len(observations))
    limit = rejection_limit(observations.channels, len(observations), freedom)
    out = np.flatnonzero(find_outliers(standardised, limit))
    groups = len(channel_groups(observations.channels))
    return RobustFit(fit, problem, out, np.linalg.norm(standardised, axis=0), limit, np.ones(groups), freedom)


def _reject_and_refit(fit: ArmFit, problem: FitProblem, standardised: Array) -> RobustFit:
    observations, layout = problem.observations, fit.layout
    redundant = max(observations.channels * len(observations) - effective_unknowns(fit), 1.0)
    limit = rejection_limit(observations.channels, len(observations), redundant)
    is_kept = np.ones(len(observations), dtype=bool)
    for _ in range(_MAX_ROUNDS):
        fresh = ~find_outliers(standardised, limit)
        settled = bool((fresh == is_kept).all())
        if settled and not fresh.all():
            break
        is_kept = fresh
        fit = estimate_arm(layout, fit.state, problem, is_kept.astype(float))
        problem, standardised = _rescale_problem(fit, problem, is_kept.astype(float))
        if settled:
            break
    fit, problem, scale, freedom = _scaled_by_chi_square(fit, problem, is_kept)
    return RobustFit(
        fit, problem, np.flatnonzero(~is_kept), np.linalg.norm(standardised, axis=0), limit, scale, freedom
    )


def rejection_limit(channels: int, rows: int, freedom: float = np.inf) -> float:
    """Return the number of deviations beyond which a row is not believed.

    The deviation itself comes from a median of residuals with so many degrees of freedom; from few, good rows reach
    farther: Fisher's F takes the place of chi square.
    """
    alarm = min(0.5, _FALSE_ALARMS / max(rows, 1))
    limit = np.sqrt(scipy.special.chdtri(channels, alarm))
    if np.isfinite(freedom):
        effective_rows = max(_MEDIAN_EFFICIENCY[channels] * freedom, 1.0)
        limit = np.sqrt(channels * scipy.special.fdtri(channels, effective_rows, 1.0 - alarm))
    return max(_LEAST_REJECTION, float(limit))


def find_outliers(residuals: Array, limit: float) -> NDArray[np.bool_]:
    """Return which rows (channels, N) are beyond the limit, and not in the company of their neighbours.

    A row that is as far off as the rows around it is no blunder but a drift, which a fit should see.
    Far beyond the limit no company helps.
    """
    size = np.linalg.norm(residuals, axis=0)
    if residuals.shape[1] <= _NEIGHBOURS:
        return np.asarray(size > limit)
    half = _NEIGHBOURS // 2
    padded = np.pad(residuals, ((0, 0), (half, half)), mode="reflect")
    around = sliding_window_view(padded, _NEIGHBOURS, axis=1)
    others = np.delete(around, half, axis=2)
    alone = np.linalg.norm(residuals - np.median(others, axis=2), axis=0)
    out: NDArray[np.bool_] = ((size > limit) & (alone > limit)) | (size > _BEYOND_COMPANY * limit)
    return out


def _rescale_problem(fit: ArmFit, problem: FitProblem, weights: Array) -> tuple[FitProblem, Array]:
    """Return the problem with sigmas as the median residual shows them, and the residuals in such deviations."""
    standardised = standardised_residuals(fit, problem, weights)
    groups = channel_groups(len(standardised))
    factors = np.array(
        [
            np.sqrt(
                np.median((standardised[g] ** 2).sum(axis=0))
                / scipy.special.chdtri(len(standardised[g]), 0.5)
            )
            for g in groups
        ]
    )
    factors = _limit_factors(problem, factors)
    for group, factor in zip(groups, factors, strict=True):
        standardised[group] /= factor
    return _with_factors(problem, factors), standardised


def _limit_factors(problem: FitProblem, factors: Array) -> Array:
    observations = problem.observations
    smallest = [_SMALLEST_M / float(np.median(observations.sigma_m))]
    if isinstance(observations, PoseObservations):
        smallest.append(_SMALLEST_RAD / float(np.median(observations.sigma_rad)))
    return np.maximum(factors, smallest)


def _with_factors(problem: FitProblem, factors: Array) -> FitProblem:
    return replace(problem, observations=problem.observations.scale_sigma(*(float(f) for f in factors)))


def _scaled_by_chi_square(
    fit: ArmFit, problem: FitProblem, is_kept: NDArray[np.bool_]
) -> tuple[ArmFit, FitProblem, Array, float]:
    """Return the fit with the scale that the kept rows show, and the freedom of the scale that is known least.

    Places and attitudes have scales of their own, on which it depends what each of them has to tell: a few rounds
    settle that.
    """
    groups, weights = channel_groups(problem.observations.channels), is_kept.astype(float)
    total = np.ones(len(groups))
    for _ in range(_MAX_ROUNDS):
        residuals = whitened_residuals(fit.state, problem)[:, is_kept]
        shares = redundant_shares(fit, problem.select_rows(np.flatnonzero(is_kept)))
        readings = np.array([residuals[group].size for group in groups])
        freedom = np.maximum(readings * shares, 1.0)
        squares = np.array([float((residuals[group] ** 2).sum()) for group in groups])
        factors = _limit_factors(problem, np.sqrt(squares / freedom))
        problem, total = _with_factors(problem, factors), total * factors
        fit = estimate_arm(fit.layout, fit.state, problem, weights)
        if len(groups) == 1 or float(np.abs(factors - 1.0).max()) < _SCALES_SETTLED:
            break
    return fit, problem, total, float(freedom.min())
