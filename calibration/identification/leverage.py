"""What a residual of a fit may be: rows that bend the fit look better than they are, rows left out of it worse."""

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import ArmFit, FitProblem, place_columns, whitened_residuals

MOST_MEAN_LEVERAGE = (
    0.05  # unknowns a reading: with fewer, what single rows do to the fit is not worth the work
)
_SHOWING = 200  # rows
_LEAST_SHARE = 0.05  # of a row's variance that is taken to be left in its residual


def channel_groups(channels: int) -> tuple[slice, ...]:
    """Return the channels that share one unit: positions or lengths, and attitudes."""
    return (slice(0, 3), slice(3, 6)) if channels == 6 else (slice(0, channels),)


def effective_unknowns(fit: ArmFit) -> float:
    """Return how many unknowns the rows, rather than the priors, determine."""
    return len(fit.layout) - float((np.diag(fit.covariance) / fit.layout.prior_sigmas**2).sum())


def standardised_residuals(fit: ArmFit, problem: FitProblem, weights: Array) -> Array:
    r"""Return the residuals of all rows, each in deviations of what it may be.

    Parameters
    ----------
    fit : Fit
        Of this problem.
    problem : Problem
        Observations.
    weights : (N,)
        With which the rows were fitted; zero for those left out.

    Returns
    -------
    (channels, N)
        With unit covariance within each group of channels, if the sigmas are right.

    Notes
    -----
    With columns x of a row and covariance C of the fit, ``H = x' C x`` and the residual has the covariance
    ``I - H`` if the row was fitted, ``I + H`` if not, and about ``I + (1 - 2 w) H`` between. Where unknowns are
    few against readings, all residuals are raised by the mean instead.
    """
    mean_leverage = effective_unknowns(fit) / (problem.observations.channels * len(problem.observations))
    if mean_leverage < MOST_MEAN_LEVERAGE:
        raised: Array = whitened_residuals(fit.state, problem) / np.sqrt(1.0 - mean_leverage)
        return raised
    columns, residuals = place_columns(fit.layout, fit.state, problem)
    return standardise_residuals(residuals, columns, fit.covariance, weights)


def standardise_residuals(residuals: Array, columns: Array, covariance: Array, weights: Array) -> Array:
    """Return residuals (channels, N) as `standardised_residuals`, given the columns (p, channels, N) of a fit."""
    residuals = residuals.copy()
    for group in channel_groups(len(residuals)):
        rows = columns[:, group].transpose(2, 1, 0)  # (N, c, p)
        hat = (rows @ covariance) @ rows.swapaxes(1, 2) * (1.0 - 2.0 * weights)[:, None, None]
        variances, axes = np.linalg.eigh(np.eye(hat.shape[1]) + hat)
        turned = axes.swapaxes(1, 2) @ residuals[group].T[:, :, None]
        turned /= np.sqrt(np.maximum(variances, _LEAST_SHARE))[:, :, None]
        residuals[group] = (axes @ turned)[:, :, 0].T
    return residuals


def redundant_shares(fit: ArmFit, problem: FitProblem) -> Array:
    """Return which part of each channel group's readings is redundant: not needed for the unknowns.

    References
    ----------
    W. Foerstner, Reliability and discernability of extended Gauss-Markov models, DGK A98 (1983) 79: redundancy.
    """
    observations = problem.observations
    groups, unknowns = channel_groups(observations.channels), effective_unknowns(fit)
    if len(groups) == 1:
        return np.array([1.0 - unknowns / (observations.channels * len(observations))])
    # Places and attitudes tell different unknowns, and not equally many; some rows show in which proportion.
    some = problem.select_rows(np.arange(0, len(observations), -(-len(observations) // _SHOWING)))
    columns, _ = place_columns(fit.layout, fit.state, some)
    shares = np.array(
        [
            np.vdot(np.tensordot(fit.covariance, columns[:, group], axes=1), columns[:, group])
            for group in groups
        ]
    )
    sizes = np.array([len(observations) * (group.stop - group.start) for group in groups])
    redundant: Array = 1.0 - unknowns * shares / shares.sum() / sizes
    return redundant
