"""Maximum a posteriori estimation of an arm from observations: Gauss-Newton, in blocks of postures."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from calibration.errors import CalibrationError
from calibration.geometry import Array
from calibration.joint_terms import term_values
from calibration.kinematics import chain_frames, placement_columns
from calibration.observations import Observations, Rows, TipFrames
from calibration.parameters import ArmState, Layout

_BLOCK = 2048  # postures at once: large enough for BLAS, small enough for the cache
_MAX_ITERATIONS = 40
_SETTLED = 1e-3  # of a posterior standard deviation: nobody can see the rest of the step
_CURVED = 1e-2  # of the smallest posterior deviation
_INVISIBLE_M = 2e-8
_MAX_DAMPING = 1e8
_ROUNDING = 1e-6
_COARSE = 150  # rows are enough to come near
_THINNEST = 16

Block: TypeAlias = tuple[int, Rows]  # mounting and its rows


@dataclass(frozen=True, eq=False)
class Fit:
    """An estimate with its uncertainty, before anything is said about how good it is."""

    state: ArmState
    layout: Layout
    covariance: Array  # (p, p), in the units of the parameters, for the sigmas as given
    deviations: Array  # (p,): how far each parameter is from its prior mean; zero for places
    cost: float
    iterations: int


@dataclass(frozen=True, eq=False)
class Problem:
    """Observations with everything about them that does not change while the parameters do."""

    observations: Observations
    values: Array  # (K, N) of the joint terms
    blocks: tuple[Block, ...]

    @classmethod
    def of(cls, state: ArmState, observations: Observations) -> "Problem":
        """Prepare the observations for states with the same nominal arm and joint terms."""
        values = term_values(state.nominal, observations.joints_rad, state.terms)
        return cls(observations, values, tuple(_blocks(observations)))

    def take(self, rows: Rows) -> "Problem":
        """Return the same for some of the rows."""
        taken = self.observations.take(rows)
        return Problem(taken, self.values[:, rows], tuple(_blocks(taken)))


def whitened_residuals(state: ArmState, problem: Problem) -> Array:
    """Return measured minus predicted of every row, in sigmas, (channels, N)."""
    observations = problem.observations
    residuals = np.empty((observations.channels, len(observations)))
    for mounting, rows in problem.blocks:
        _, _, tip = _frames(state, problem, mounting, rows)
        residuals[:, rows] = observations.residuals(tip, state.devices[mounting], rows)
    return residuals


def errors_m(state: ArmState, problem: Problem) -> Array:
    """Return the size of the position or length error of every row (N,) [m]."""
    return problem.observations.errors_m(whitened_residuals(state, problem))


def estimate(
    layout: Layout,
    state: ArmState,
    problem: Problem,
    weights: Array | None = None,
    *,
    from_afar: bool = False,
) -> Fit:
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
        The start is rough: walk most of the way with a few hundred of the rows.

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
    """
    root = None if weights is None else np.sqrt(weights)
    count = len(problem.observations)
    if from_afar and count > 2 * _COARSE:
        some = np.arange(0, count, min(count // _COARSE, _THINNEST))
        state = _iterate(layout, state, problem.take(some), None if root is None else root[some]).state
    return _iterate(layout, state, problem, root)


def _iterate(layout: Layout, state: ArmState, problem: Problem, root: Array | None) -> Fit:
    equations = _Equations(layout, problem, root)
    information, gradient, cost = equations.at(state)
    damping = 0.0
    iterations = 0
    while iterations < _MAX_ITERATIONS and damping <= _MAX_DAMPING:
        iterations += 1
        step, spread = _solve(information, gradient, damping)
        candidate = layout.step(state, step * layout.prior)
        if _settled(step, spread, layout.prior):
            state, cost = candidate, cost - float(gradient @ step)
            break
        there = equations.at(candidate)
        if there[2] <= cost * (1 + 1e-12):
            state, (information, gradient, cost) = candidate, there
            damping = 0.0 if damping < 1e-3 else damping / 10
        else:
            damping = max(1e-3, damping * 10)
    covariance = _inverse(information) * np.outer(layout.prior, layout.prior)
    return Fit(state, layout, covariance, layout.deviations(state), cost, iterations)


def _settled(step: Array, spread: Array, prior: Array) -> bool:
    """Tell whether the rest is invisible: the step itself, or what is quadratic in it (an arm is a metre long)."""
    if float(np.max(np.abs(step) / spread)) < _SETTLED:
        return True
    curved_m = float(np.max(np.abs(step * prior))) ** 2
    return curved_m < max(_CURVED * float(np.min(spread * prior)), _INVISIBLE_M)


def place_columns(layout: Layout, state: ArmState, problem: Problem) -> tuple[Array, Array]:
    """Return the whitened columns of all unknowns (p, channels, N) and the residuals (channels, N)."""
    observations = problem.observations
    every = np.zeros((len(layout), observations.channels, len(observations)))
    left = np.empty((observations.channels, len(observations)))
    for mounting, rows in problem.blocks:
        columns, residuals = _block(state, problem, mounting, rows, {})
        tangent = layout.tangent(state, mounting)
        every[:, :, rows] = np.einsum("pr,rmn->pmn", tangent, columns, optimize=True)
        left[:, rows] = residuals
    return every, left


def _blocks(observations: Observations) -> Iterator[Block]:
    for mounting in range(int(observations.mounting.max(initial=0)) + 1):
        rows = np.flatnonzero(observations.mounting == mounting)
        for start in range(0, len(rows), _BLOCK):
            yield mounting, rows[start : start + _BLOCK]


def _frames(state: ArmState, problem: Problem, mounting: int, rows: Rows) -> tuple[Array, Array, TipFrames]:
    joints = state.moved_joints(problem.observations.joints_rad[rows], problem.values[:, rows])
    rotations, origins = chain_frames(state.seen_from(mounting), joints)
    return rotations, origins, (origins[-1], rotations[-1])


@dataclass(frozen=True, eq=False)
class _Equations:
    """Normal equations of a problem at any state."""

    layout: Layout
    problem: Problem
    root: Array | None
    scratch: dict[int, Array] = field(default_factory=dict)

    def at(self, state: ArmState) -> tuple[Array, Array, float]:
        """Return information and gradient in prior deviations, and twice the negative log posterior."""
        layout = self.layout
        deviations = layout.deviations(state) / layout.prior
        information, gradient = np.eye(len(layout)), -deviations
        cost = float(deviations @ deviations)
        for mounting, rows in self.problem.blocks:
            columns, residuals = _block(state, self.problem, mounting, rows, self.scratch)
            if self.root is not None:
                columns *= self.root[rows]
                residuals = residuals * self.root[rows]
            flat, residual = columns.reshape(len(columns), -1), residuals.reshape(-1)
            tangent = layout.tangent(state, mounting) * layout.prior[:, None]
            information += tangent @ (flat @ flat.T) @ tangent.T
            gradient += tangent @ (flat @ residual)
            cost += float(residual @ residual)
        if not np.isfinite(cost):
            raise CalibrationError(
                "the estimate left the range of numbers.", remedy="Check robot model, units and columns."
            )
        return information, gradient, cost


def _block(
    state: ArmState, problem: Problem, mounting: int, rows: Rows, scratch: dict[int, Array]
) -> tuple[Array, Array]:
    """Return whitened columns (6 (n + 1) + K + D, channels, N) and residuals (channels, N) of a block.

    ``scratch`` keeps one array for each size of block: touching fresh memory costs more than the arithmetic.
    """
    observations, device = problem.observations, state.devices[mounting]
    rotations, origins, tip = _frames(state, problem, mounting, rows)
    place = placement_columns(rotations, origins, tip[0], out=scratch.get(len(rows)))
    scratch[len(rows)] = place
    linear = place.reshape(-1, 3, len(rows))
    angular = _angular_columns(rotations) if observations.needs_rotation else None
    columns = observations.project(linear, angular, tip, device)
    own = observations.own_columns(tip, device)
    if state.terms or len(own):
        joints = np.array([term.joint for term in state.terms], dtype=np.intp)
        moved = columns[6 * joints + 5] * problem.values[:, rows][:, None]
        columns = np.concatenate([columns, moved, own])
    columns *= observations.scales(rows)
    return columns, observations.residuals(tip, device, rows)


def _angular_columns(rotations: Array) -> Array:
    """Return (6 (n + 1), 3, N): how right twists of the placements turn the tip."""
    axes = rotations.swapaxes(1, 2)
    columns = np.zeros((len(rotations), 6, *axes.shape[2:]))
    columns[:, 3:] = axes
    return columns.reshape(-1, *axes.shape[2:])


def _solve(information: Array, gradient: Array, damping: float) -> tuple[Array, Array]:
    """Return the step and the posterior deviation of every unknown, both in prior deviations."""
    inverse = _inverse(information + damping * np.diag(np.diag(information)))
    return inverse @ gradient, np.sqrt(np.diag(inverse))


def _inverse(information: Array) -> Array:
    """Return the inverse of information in prior deviations, whose eigenvalues are one or more.

    With few rows and small residuals they span more digits than there are; then the smallest are cut to what the
    prior alone makes of them.
    """
    scale = 1.0 / np.sqrt(np.diag(information))
    try:
        inverse: Array = np.linalg.inv(information * scale[:, None] * scale) * scale[:, None] * scale
    except np.linalg.LinAlgError:
        return _cut_inverse(information)
    variances = np.diag(inverse)
    plausible = (variances > 0).all() and (variances <= 1.0 + _ROUNDING).all()
    return inverse if plausible else _cut_inverse(information)


def _cut_inverse(information: Array) -> Array:
    values, vectors = np.linalg.eigh(information)
    safe: Array = (vectors / np.maximum(values, 1.0)) @ vectors.T
    return safe
