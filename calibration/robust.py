"""Fits that bad rows cannot bend: Cauchy start, rejection by median deviation, least squares at the end."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import chdtri

from calibration.estimator import Fit, Problem, estimate, whitened_residuals
from calibration.geometry import Array
from calibration.observations import PoseObservations, Rows, with_sigma
from calibration.parameters import ArmState, Layout

_CAUCHY = 2.5  # deviations at which a row's weight is one half
_MAX_ROUNDS = 12
_WEIGHTS_SETTLED = 0.02
_LEAST_REJECTION = 4.0
_FALSE_ALARMS = 0.05  # good rows rejected per fit, if errors were Gaussian
_SMALLEST_M = 1e-7  # a series without errors is no reason to believe in none
_SMALLEST_RAD = 1e-8
_NEIGHBOURS = 7  # rows, with the one in question
_BEYOND_COMPANY = 5.0


@dataclass(frozen=True, eq=False)
class RobustFit:
    """A least-squares fit of the rows that were kept, with sigmas scaled to what the residuals show."""

    fit: Fit
    problem: Problem  # all rows, sigmas scaled
    rejected: Rows
    deviations: Array  # (N,): size of each row's residual in deviations of the good rows
    threshold: float
    scale: Array  # per channel group: found deviation / stated sigma
    degrees_of_freedom: float


def fit_robustly(layout: Layout, start: ArmState, problem: Problem) -> RobustFit:
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
    A row is rejected beyond ``max(4, t)`` deviations, where t would reject 0.05 good Gaussian rows in all,
    unless its neighbours are off in the same way. The deviation is taken from the median, so up to half
    of the rows may be bad.
    """
    fit = estimate(layout, start, problem, from_afar=True)
    problem = _rescaled(layout, fit, problem)
    weights = np.ones(len(problem.observations))
    for _ in range(_MAX_ROUNDS):
        size = _sizes(fit, problem)
        fresh = 1.0 / (1.0 + (size / _CAUCHY) ** 2)
        settled = float(np.abs(fresh - weights).max()) < _WEIGHTS_SETTLED
        weights = fresh
        if settled:
            break
        fit = estimate(layout, fit.state, problem, weights)
        problem = _rescaled(layout, fit, problem)
    return _reject_and_refit(layout, fit, problem)


def _reject_and_refit(layout: Layout, fit: Fit, problem: Problem) -> RobustFit:
    limit = rejection_limit(problem.observations.channels, len(problem.observations))
    kept = np.ones(len(problem.observations), dtype=bool)
    for _ in range(_MAX_ROUNDS):
        problem = _rescaled(layout, fit, problem)
        fresh = ~_standing_out(whitened_residuals(fit.state, problem), limit)
        if bool((fresh == kept).all()) and not fresh.all():
            break
        settled = bool((fresh == kept).all())
        kept = fresh
        fit = estimate(layout, fit.state, problem, kept.astype(float))
        if settled:
            break
    size = _sizes(fit, problem)
    fit, problem, scale, freedom = _scaled_by_chi_square(layout, fit, problem, kept)
    return RobustFit(fit, problem, np.flatnonzero(~kept), size, limit, scale, freedom)


def rejection_limit(channels: int, rows: int) -> float:
    """Return the number of deviations beyond which a row is not believed."""
    limit = float(np.sqrt(chdtri(channels, min(0.5, _FALSE_ALARMS / max(rows, 1)))))
    return max(_LEAST_REJECTION, limit)


def channel_groups(channels: int) -> tuple[slice, ...]:
    """Return the channels that share one unit: positions or lengths, and attitudes."""
    return (slice(0, 3), slice(3, 6)) if channels == 6 else (slice(0, channels),)


def _standing_out(residuals: Array, limit: float) -> NDArray[np.bool_]:
    """Tell which rows (channels, N) are beyond the limit, and not in the company of their neighbours.

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


def _sizes(fit: Fit, problem: Problem) -> Array:
    sizes: Array = np.linalg.norm(whitened_residuals(fit.state, problem), axis=0)
    return sizes


def _rescaled(layout: Layout, fit: Fit, problem: Problem) -> Problem:
    """Return the problem with sigmas as the median residual shows them."""
    residuals = whitened_residuals(fit.state, problem)
    count = residuals.size
    # Fitted rows look better than they are; a prior takes part of the unknowns away again.
    inflation = np.sqrt(count / max(count - _effective(layout, fit), 0.2 * count))
    factors = [
        inflation
        * np.sqrt(np.median((residuals[group] ** 2).sum(axis=0)) / chdtri(len(residuals[group]), 0.5))
        for group in channel_groups(len(residuals))
    ]
    return _with_factors(problem, np.array(factors))


def _median_square(residuals: Array) -> float:
    return float(np.median((residuals**2).sum(axis=0)))


def _effective(layout: Layout, fit: Fit) -> float:
    """Return how many unknowns the rows, rather than the priors, determine."""
    return len(layout) - float((np.diag(fit.covariance) / layout.prior**2).sum())


def _with_factors(problem: Problem, factors: Array) -> Problem:
    seen = problem.observations
    smallest = [_SMALLEST_M / float(np.median(seen.sigma_m))]
    if isinstance(seen, PoseObservations):
        smallest.append(_SMALLEST_RAD / float(np.median(seen.sigma_rad)))
    factors = np.maximum(factors, smallest)
    observations = with_sigma(problem.observations, *(float(f) for f in factors))
    return replace(problem, observations=observations)


def _scaled_by_chi_square(
    layout: Layout, fit: Fit, problem: Problem, kept: Array
) -> tuple[Fit, Problem, Array, float]:
    residuals = whitened_residuals(fit.state, problem)[:, kept]
    freedom = max(residuals.size - _effective(layout, fit), 1.0)
    share = freedom / residuals.size
    factors = np.array(
        [np.sqrt(np.mean(residuals[group] ** 2) / share) for group in channel_groups(len(residuals))]
    )
    problem = _with_factors(problem, factors)
    fit = estimate(layout, fit.state, problem, kept.astype(float))
    return fit, problem, factors, freedom
