"""Maximum a posteriori estimation of a cell: normal equations of all series, damped Gauss-Newton."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.cells.state import CellLayout, CellState
from cellcal.calibration.cells.system import CellProblem, SeriesRows, series_chains, white_system
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import inverse_information, is_settled
from cellcal.calibration.identification.leverage import channel_groups

_MAX_ITERATIONS = 60
_MAX_DAMPING = 1e8

Weights = Sequence[Array] | None  # of every series' rows


@dataclass(frozen=True, eq=False)
class CellFit:
    """An estimate with its uncertainty, before anything is said about how good it is."""

    state: CellState
    layout: CellLayout
    covariance: Array  # (p, p), in the units of the parameters, for the sigmas as given
    deviations: Array  # (p,): how far each parameter is from its prior mean; zero without a prior
    cost: float
    learnt: tuple[
        Array, ...
    ]  # of each series and channel group, how many unknowns it determines; priors do the rest
    iterations: int


def estimate_cell(
    layout: CellLayout, state: CellState, problem: CellProblem, weights: Weights = None
) -> CellFit:
    r"""Minimise ``sum w r^2 + sum (x / prior)^2`` over all series from a start, by damped Gauss-Newton.

    With S series, row columns A_s by twists of their own chain, and the constant matrix T_s that turns unknowns of
    the cell into those twists, the normal equations are ``sum_s T_s A_s A_s' T_s'`` plus each prior once.

    Parameters
    ----------
    layout : CellLayout
        The unknowns and their priors.
    state : CellState
        Start; its joint terms must be those of the layout.
    problem : CellProblem
        Observations.
    weights : sequence of (N,) or None
        Weight of every row's squared residual [1].

    Returns
    -------
    CellFit
        Estimate and posterior covariance for the sigmas and weights given.

    Raises
    ------
    CalibrationError
        Nothing finite comes out.
    """
    roots = None if weights is None else [np.sqrt(some) for some in weights]
    shares, gradient, cost = _normal_equations(layout, state, problem, roots)
    inverse = inverse_information(np.sum(shares, axis=0))
    damping, iterations = 0.0, 0
    while len(layout) and iterations < _MAX_ITERATIONS and damping <= _MAX_DAMPING:
        iterations += 1
        information = np.sum(shares, axis=0)
        damped = inverse
        if damping:
            damped = inverse_information(information + damping * np.diag(np.diag(information)))
        step = damped @ gradient
        candidate = layout.apply_step(state, step * layout.prior_sigmas)
        if is_settled(step, np.sqrt(np.diag(damped)), layout.prior_sigmas):
            state, cost = candidate, cost - float(gradient @ step)
            break
        there = _normal_equations(layout, candidate, problem, roots)
        if there[2] <= cost * (1 + 1e-12):
            state, (shares, gradient, cost) = candidate, there
            inverse = inverse_information(np.sum(shares, axis=0))
            damping = 0.0 if damping < 1e-3 else damping / 10
        else:
            damping = max(1e-3, damping * 10)
    learnt = iter([float(np.sum(share * inverse)) for share in shares[1:]])
    by_series = [channel_groups(series.observations.channels) for series in problem.series]
    learnt_by_series = tuple(np.array([next(learnt) for _ in groups]) for groups in by_series)
    covariance = inverse * np.outer(layout.prior_sigmas, layout.prior_sigmas)
    return CellFit(
        state, layout, covariance, layout.prior_deviations(state), cost, learnt_by_series, iterations
    )


def _normal_equations(
    layout: CellLayout, state: CellState, problem: CellProblem, roots: Weights
) -> tuple[list[Array], Array, float]:
    """Return the information of priors and of each series' channel groups (p, p), gradient, and twice the cost."""
    information, gradient, cost = layout.prior_equations(state)
    shares = [information]
    for number, series in enumerate(problem.series):
        root = None if roots is None else roots[number]
        for share, pull, misfit in _series_equations(layout, state, series, root):
            shares.append(share)
            gradient, cost = gradient + pull, cost + misfit
    if not np.isfinite(cost):
        raise CalibrationError(
            "the estimate left the range of numbers.", remedy="Check robot models, units and rough places."
        )
    return shares, gradient, cost


def _series_equations(
    layout: CellLayout, state: CellState, series: SeriesRows, root: Array | None
) -> Iterator[tuple[Array, Array, float]]:
    """Yield information, gradient and cost of every channel group of a series."""
    by_mounting = series_chains(layout, state, series)
    groups = channel_groups(series.observations.channels)
    products = [[np.zeros((c.tangent.shape[1] + 1,) * 2) for c in by_mounting] for _ in groups]
    for mounting, rows in series.iterate_blocks():
        block = white_system(series, by_mounting[mounting], rows)
        if root is not None:
            block *= root[rows]
        for sums, group in zip(products, groups, strict=True):
            flat = block[:, group].reshape(len(block), -1)
            sums[mounting] += flat @ flat.T
    for sums in products:
        information, gradient, cost = np.zeros((len(layout),) * 2), np.zeros(len(layout)), 0.0
        for chain, product in zip(by_mounting, sums, strict=True):
            tangent = chain.tangent * layout.prior_sigmas[:, None]
            information += tangent @ product[:-1, :-1] @ tangent.T
            gradient += tangent @ product[:-1, -1]
            cost += float(product[-1, -1])
        yield information, gradient, cost
