"""Maximum a posteriori estimation of an arm from observations: Gauss-Newton, in blocks of postures."""

from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.arm_columns import (
    ArmChains,
    devices_of_span,
    span_frames,
    whitened_system,
)
from cellcal.calibration.identification.fit_problem import FitProblem, places_in_span
from cellcal.calibration.identification.parameters import ArmState, ParameterLayout

_MAX_ITERATIONS = 40
_WINDOW = 8  # evaluations over which progress is looked at
_SETTLED = 1e-3  # of a posterior standard deviation: a smaller step is negligible
_CURVED = 1e-2  # of the smallest posterior deviation
_INVISIBLE_M = 1e-7  # a tenth of a micrometre: no arm and no tracker shows it
_NEAR_M = 3e-4  # its square is invisible: one step of all rows does the rest
_MAX_DAMPING = 1e8
_ROUNDING = 1e-6
_COARSE = 150  # rows are enough to come near
_THINNEST = 32


@dataclass(frozen=True, eq=False)
class ArmFit:
    """An estimate with its uncertainty, before anything is said about how good it is."""

    state: ArmState
    layout: ParameterLayout
    covariance: Array  # (p, p), in the units of the parameters, for the sigmas as given
    deviations: Array  # (p,): how far each parameter is from its prior mean; zero for places
    cost: float
    iterations: int


def whitened_residuals(state: ArmState, problem: FitProblem) -> Array:
    """Return measured minus predicted of every row, in sigmas, (channels, N)."""
    observations = problem.observations
    residuals = np.empty((observations.channels, len(observations)))
    chains = ArmChains(state)
    for span in problem.spans_at(state):
        rotations, origins = span_frames(chains, problem, span)
        for device, rows, here in devices_of_span(state, problem, span):
            tip = origins[-1][..., here], rotations[-1][..., here]
            residuals[:, rows] = observations.compute_residuals(tip, device, rows)
    return residuals


def errors_m(state: ArmState, problem: FitProblem) -> Array:
    """Return the size of the position or length error of every row (N,) [m]."""
    return problem.observations.errors_m(whitened_residuals(state, problem))


def estimate_arm(
    layout: ParameterLayout,
    state: ArmState,
    problem: FitProblem,
    weights: Array | None = None,
    *,
    from_afar: bool = False,
    least_progress: float = 0.0,
) -> ArmFit:
    r"""Minimise ``sum w r^2 + sum (x / prior)^2`` from a start, by damped Gauss-Newton.

    Parameters
    ----------
    layout : Layout
        The unknowns and their priors.
    state : ArmState
        Start; its joint terms must be those of the layout.
    problem : Problem
        Observations.
    weights : (N,) or None
        Weight of each row's squared residual [1].
    from_afar : bool
        The start is rough: walk most of the way with a few hundred of the rows, the last step with all.
    least_progress : float
        End also where eight evaluations lower the cost by less than this share of it [1]. For rows that no arm of
        this model fits: their deviations are no measure of what is left, and small steps would not end.

    Returns
    -------
    Fit
        Estimate and posterior covariance for the sigmas and weights given.

    Raises
    ------
    CalibrationError
        Nothing finite comes out.

    Notes
    -----
    Steps are taken in units of prior deviations, so that metres and radians meet on one scale. The iteration
    ends when what the next step could change, its own part or the curvature that it leaves out, is far below
    the posterior deviations.

    References
    ----------
    J. Nocedal, S. J. Wright, Numerical Optimization, 2006, chapter 10: damped Gauss-Newton.
    """
    if weights is not None:
        problem = replace(problem, root=np.sqrt(weights))
    count = len(problem.observations)
    if from_afar and count > 2 * _COARSE:
        state = approach_minimum(layout, state, problem).state
    return _iterate_steps(_NormalEquations(layout, problem), state, least_progress=least_progress)


def approach_minimum(layout: ParameterLayout, state: ArmState, problem: FitProblem) -> ArmFit:
    """Come near the minimum with a few hundred of the rows; the cost returned is of these rows."""
    count = len(problem.observations)
    few = problem.select_rows(np.arange(0, count, max(min(count // _COARSE, _THINNEST), 1)))
    return _iterate_steps(_NormalEquations(layout, few), state, enough_m=_NEAR_M)


def _iterate_steps(
    equations: "_NormalEquations",
    state: ArmState,
    *,
    enough_m: float = _INVISIBLE_M,
    least_progress: float = 0.0,
) -> ArmFit:
    layout = equations.layout
    information, gradient, cost = equations.evaluate_at(state)
    damping = 0.0
    iterations = 0
    inverse = inverse_information(information)
    costs = [cost]
    while iterations < _MAX_ITERATIONS and damping <= _MAX_DAMPING:
        if iterations >= _WINDOW and costs[-_WINDOW - 1] - cost < least_progress * cost:
            break
        iterations += 1
        damped = (
            inverse_information(information + damping * np.diag(np.diag(information))) if damping else inverse
        )
        step, spread = damped @ gradient, np.sqrt(np.diag(damped))
        candidate = layout.apply_step(state, step * layout.prior_sigmas)
        if is_settled(step, spread, layout.prior_sigmas, enough_m):
            state, cost = candidate, cost - float(gradient @ step)
            break
        there = equations.evaluate_at(candidate)
        if there[2] <= cost * (1 + 1e-12):
            state, (information, gradient, cost) = candidate, there
            inverse = inverse_information(information)
            damping = 0.0 if damping < 1e-3 else damping / 10
        else:
            damping = max(1e-3, damping * 10)
        costs.append(cost)
    covariance = inverse * np.outer(layout.prior_sigmas, layout.prior_sigmas)
    return ArmFit(state, layout, covariance, layout.prior_deviations(state), cost, iterations)


def is_settled(step: Array, spread: Array, prior: Array, enough_m: float = _INVISIBLE_M) -> bool:
    """Return whether all that a step leaves out is invisible; step and posterior deviations in prior deviations.

    That is so when the step itself is, or what is quadratic in it (an arm is a metre long).
    """
    if float(np.max(np.abs(step) / spread)) < _SETTLED:
        return True
    curved_m = float(np.max(np.abs(step * prior))) ** 2
    return curved_m < max(_CURVED * float(np.min(spread * prior)), enough_m)


def place_columns(layout: ParameterLayout, state: ArmState, problem: FitProblem) -> tuple[Array, Array]:
    """Return the whitened columns of all unknowns (p, channels, N) and the residuals (channels, N)."""
    observations = problem.observations
    every = np.zeros((len(layout), observations.channels, len(observations)))
    white_residuals = np.empty((observations.channels, len(observations)))
    chains = ArmChains(state)
    tangents = [chains.tangent_of(layout, mounting) for mounting in range(state.mounting_count)]
    for span in problem.spans_at(state):
        system = whitened_system(chains, problem, span)
        for (mounting, rows), here in zip(span, places_in_span(span), strict=True):
            every[:, :, rows] = np.tensordot(tangents[mounting], system[:-1, :, here], axes=1)
            white_residuals[:, rows] = system[-1, :, here]
    return every, white_residuals


@dataclass(frozen=True, eq=False)
class _NormalEquations:
    """Normal equations of a problem at any state."""

    layout: ParameterLayout
    problem: FitProblem

    def evaluate_at(self, state: ArmState) -> tuple[Array, Array, float]:
        """Return information and gradient in prior deviations, and twice the negative log posterior."""
        layout = self.layout
        deviations = layout.prior_deviations(state) / layout.prior_sigmas
        information, gradient = np.eye(len(layout)), -deviations
        cost = float(deviations @ deviations)
        chains = ArmChains(state)
        for mounting, products in enumerate(self._products(chains)):
            tangent = chains.tangent_of(layout, mounting) * layout.prior_sigmas[:, None]
            information += tangent @ products[:-1, :-1] @ tangent.T
            gradient += tangent @ products[:-1, -1]
            cost += float(products[-1, -1])
        if not np.isfinite(cost):
            raise CalibrationError(
                "the estimate left the range of numbers.", remedy="Check robot model, units and columns."
            )
        return information, gradient, cost

    def _products(self, chains: ArmChains) -> list[Array]:
        """Return the products of all columns and the residuals with each other, over each mounting's rows."""
        every: list[Array | float] = [0.0] * chains.state.mounting_count
        for span in self.problem.spans_at(chains.state):
            system = whitened_system(chains, self.problem, span)
            for (mounting, _), here in zip(span, places_in_span(span), strict=True):
                flat = system[:, :, here].reshape(len(system), -1)
                every[mounting] = every[mounting] + flat @ flat.T
        size = chains.column_count(self.problem) + 1
        return [np.zeros((size, size)) if isinstance(found, float) else found for found in every]


def inverse_information(information: Array) -> Array:
    """Return the inverse of information in prior deviations, whose eigenvalues are one or more.

    With few rows and small residuals they span more digits than there are; then the smallest are cut to what the
    prior alone makes of them.
    """
    scale = 1.0 / np.sqrt(np.diag(information))
    try:
        inverse: Array = np.linalg.inv(information * scale[:, None] * scale) * scale[:, None] * scale
    except np.linalg.LinAlgError:
        return _bounded_inverse(information)
    variances = np.diag(inverse)
    plausible = (variances > 0).all() and (variances <= 1.0 + _ROUNDING).all()
    return inverse if plausible else _bounded_inverse(information)


def _bounded_inverse(information: Array) -> Array:
    values, vectors = np.linalg.eigh(information)
    safe: Array = (vectors / np.maximum(values, 1.0)) @ vectors.T
    return safe


__all__ = [
    "ArmFit",
    "FitProblem",
    "approach_minimum",
    "errors_m",
    "estimate_arm",
    "inverse_information",
    "is_settled",
    "place_columns",
    "whitened_residuals",
]
