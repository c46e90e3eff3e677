"""Maximum a posteriori estimation of an arm from observations: Gauss-Newton, in blocks of postures."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import prod
from typing import TypeAlias

import numpy as np

from calibration.errors import CalibrationError
from calibration.geometry import Array
from calibration.joint_terms import term_values
from calibration.kinematics import along_next, independent_columns, turned_frames
from calibration.observations import Observations, Rows
from calibration.parameters import ArmState, Layout

_BLOCK = 2048  # postures at once: large enough for BLAS, small enough for the cache
_MAX_ITERATIONS = 40
_SETTLED = 1e-3  # of a posterior standard deviation: nobody can see the rest of the step
_CURVED = 1e-2  # of the smallest posterior deviation
_INVISIBLE_M = 1e-7  # a tenth of a micrometre: no arm and no tracker shows it
_NEAR_M = 3e-4  # its square is invisible: one step of all rows does the rest
_MAX_DAMPING = 1e8
_ROUNDING = 1e-6
_COARSE = 150  # rows are enough to come near
_THINNEST = 32

Block: TypeAlias = tuple[int, Rows | slice]  # mounting and its rows


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
    angles_rad: Array  # (n, N): what the joints add to the angles of the nominal arm
    blocks: tuple[Block, ...]

    @classmethod
    def of(cls, state: ArmState, observations: Observations) -> "Problem":
        """Prepare the observations for states with the same nominal arm and joint terms."""
        values = term_values(state.nominal, observations.joints_rad, state.terms)
        angles = state.nominal.joint_coupling @ observations.joints_rad.T
        return cls(observations, values, angles, tuple(_blocks(observations)))

    def take(self, rows: Rows) -> "Problem":
        """Return the same for some of the rows."""
        taken = self.observations.take(rows)
        return Problem(taken, self.values[:, rows], self.angles_rad[:, rows], tuple(_blocks(taken)))


def whitened_residuals(state: ArmState, problem: Problem) -> Array:
    """Return measured minus predicted of every row, in sigmas, (channels, N)."""
    observations = problem.observations
    residuals = np.empty((observations.channels, len(observations)))
    scratch = _Scratch()
    for mounting, rows in problem.blocks:
        rotations, origins = _frames(state, _placements(state, mounting), problem, rows, scratch)
        tip = origins[-1], rotations[-1]
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
        The start is rough: walk most of the way with a few hundred of the rows, the last step with all.

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
        few = problem.take(some)
        equations = _Equations(layout, few, None if root is None else root[some])
        state = _iterate(equations, state, enough_m=_NEAR_M).state
    return _iterate(_Equations(layout, problem, root), state)


def _iterate(equations: "_Equations", state: ArmState, *, enough_m: float = _INVISIBLE_M) -> Fit:
    layout = equations.layout
    information, gradient, cost = equations.at(state)
    damping = 0.0
    iterations = 0
    inverse = _inverse(information)
    while iterations < _MAX_ITERATIONS and damping <= _MAX_DAMPING:
        iterations += 1
        damped = _inverse(information + damping * np.diag(np.diag(information))) if damping else inverse
        step, spread = damped @ gradient, np.sqrt(np.diag(damped))
        candidate = layout.step(state, step * layout.prior)
        if settled(step, spread, layout.prior, enough_m):
            state, cost = candidate, cost - float(gradient @ step)
            break
        there = equations.at(candidate)
        if there[2] <= cost * (1 + 1e-12):
            state, (information, gradient, cost) = candidate, there
            inverse = _inverse(information)
            damping = 0.0 if damping < 1e-3 else damping / 10
        else:
            damping = max(1e-3, damping * 10)
    covariance = inverse * np.outer(layout.prior, layout.prior)
    return Fit(state, layout, covariance, layout.deviations(state), cost, iterations)


def settled(step: Array, spread: Array, prior: Array, enough_m: float = _INVISIBLE_M) -> bool:
    """Tell whether all that a step leaves out is invisible; step and posterior deviations in prior deviations.

    That is so when the step itself is, or what is quadratic in it (an arm is a metre long).
    """
    if float(np.max(np.abs(step) / spread)) < _SETTLED:
        return True
    curved_m = float(np.max(np.abs(step * prior))) ** 2
    return curved_m < max(_CURVED * float(np.min(spread * prior)), enough_m)


def place_columns(layout: Layout, state: ArmState, problem: Problem) -> tuple[Array, Array]:
    """Return the whitened columns of all unknowns (p, channels, N) and the residuals (channels, N)."""
    observations = problem.observations
    every = np.zeros((len(layout), observations.channels, len(observations)))
    left = np.empty((observations.channels, len(observations)))
    scratch = _Scratch()
    for mounting, rows in problem.blocks:
        chain = _Chain.of(layout, state, mounting)
        system = _system(state, chain, problem, (mounting, rows), scratch)
        every[:, :, rows] = np.tensordot(chain.tangent, system[:-1], axes=1)
        left[:, rows] = system[-1]
    return every, left


def _blocks(observations: Observations) -> Iterator[Block]:
    for mounting in range(int(observations.mounting.max(initial=0)) + 1):
        rows = np.flatnonzero(observations.mounting == mounting)
        for start in range(0, len(rows), _BLOCK):
            yield mounting, _together(rows[start : start + _BLOCK])


def _together(rows: Rows) -> Rows | slice:
    """Return rows that follow each other as a slice, which is looked at and not copied."""
    first, last = int(rows[0]), int(rows[-1])
    return slice(first, last + 1) if last - first + 1 == len(rows) else rows


class _Scratch:
    """Arrays that are written again block after block: touching fresh memory costs more than the arithmetic."""

    def __init__(self) -> None:
        self._kept: dict[str, Array] = {}

    def take(self, name: str, *shape: int) -> Array:
        """Return an array of this shape, with anything in it."""
        size = prod(shape)
        if name not in self._kept or self._kept[name].size < size:
            self._kept[name] = np.empty(size)
        return self._kept[name][:size].reshape(shape)


@dataclass(frozen=True, eq=False)
class _Chain:
    """The arm between one mounting of the device and the target, at one state."""

    placements: Array  # (n + 1, 4, 4)
    turns: Array  # (K, P): what each joint term's joint does, by independent columns
    tangent: Array  # (p, P + K + D): what each parameter does, by columns of the system

    @classmethod
    def of(cls, layout: Layout, state: ArmState, mounting: int) -> "_Chain":
        placements = _placements(state, mounting)
        combine = along_next(placements)
        if layout.kind != "pose":
            combine = combine[:, :-3]
        joints = np.array([term.joint for term in state.terms], dtype=np.intp)
        tangent = layout.tangent(state, mounting)
        arm, rest = tangent[:, : len(combine)], tangent[:, len(combine) :]
        return cls(placements, combine[6 * joints + 5], np.concatenate([arm @ combine, rest], axis=1))


def _placements(state: ArmState, mounting: int) -> Array:
    return state.seen_from(mounting).placements


def _frames(
    state: ArmState, placements: Array, problem: Problem, rows: Rows | slice, scratch: _Scratch
) -> tuple[Array, Array]:
    angles = problem.angles_rad[:, rows] + state.arm.theta0_rad[:, None]
    for term, coefficient, values in zip(state.terms, state.coefficients, problem.values, strict=True):
        angles[term.joint] += coefficient * values[rows]
    out = scratch.take("frames", len(placements), 4, 3, angles.shape[1])
    return turned_frames(placements, angles, out=out)


@dataclass(frozen=True, eq=False)
class _Equations:
    """Normal equations of a problem at any state."""

    layout: Layout
    problem: Problem
    root: Array | None
    scratch: _Scratch = field(default_factory=_Scratch)

    def at(self, state: ArmState) -> tuple[Array, Array, float]:
        """Return information and gradient in prior deviations, and twice the negative log posterior."""
        layout = self.layout
        deviations = layout.deviations(state) / layout.prior
        information, gradient = np.eye(len(layout)), -deviations
        cost = float(deviations @ deviations)
        for mounting in range(len(state.devices)):
            chain = _Chain.of(layout, state, mounting)
            products = self._products(state, chain, mounting)
            tangent = chain.tangent * layout.prior[:, None]
            information += tangent @ products[:-1, :-1] @ tangent.T
            gradient += tangent @ products[:-1, -1]
            cost += float(products[-1, -1])
        if not np.isfinite(cost):
            raise CalibrationError(
                "the estimate left the range of numbers.", remedy="Check robot model, units and columns."
            )
        return information, gradient, cost

    def _products(self, state: ArmState, chain: _Chain, mounting: int) -> Array:
        """Return the products of all columns and the residuals with each other, over a mounting's rows."""
        size = chain.tangent.shape[1] + 1
        products = np.zeros((size, size))
        for block in self.problem.blocks:
            if block[0] != mounting:
                continue
            system = _system(state, chain, self.problem, block, self.scratch)
            if self.root is not None:
                system *= self.root[block[1]]
            flat = system.reshape(size, -1)
            products += flat @ flat.T
        return products


def _system(state: ArmState, chain: _Chain, problem: Problem, block: Block, scratch: _Scratch) -> Array:
    """Return the whitened columns of a block and, in the last row, its residuals (P + K + D + 1, channels, N)."""
    observations, (mounting, rows) = problem.observations, block
    device, count = state.devices[mounting], chain.turns.shape[1]
    rotations, origins = _frames(state, chain.placements, problem, rows, scratch)
    tip, rows_taken = (origins[-1], rotations[-1]), origins.shape[-1]
    system = scratch.take("system", chain.tangent.shape[1] + 1, observations.channels, rows_taken)
    points = observations.channels == 3  # then the tip's motion is the answer, in place
    linear = system[:count] if points else scratch.take("linear", count, 3, rows_taken)
    independent_columns(rotations, origins, out=linear)
    if not points:
        angular = _angular_columns(rotations) if observations.needs_rotation else None
        system[:count] = observations.project(linear, angular, tip, device)
    if state.terms:
        turned = chain.turns @ system[:count].reshape(count, -1)
        moved = turned.reshape(-1, *system.shape[1:]) * problem.values[:, rows][:, None]
        system[count : count + len(moved)] = moved
    system[count + len(state.terms) : -1] = observations.own_columns(tip, device)
    system[:-1] *= observations.scales(rows)
    system[-1] = observations.residuals(tip, device, rows)
    return system


def _angular_columns(rotations: Array) -> Array:
    """Return (4 n + 6, 3, N): how the motions of `independent_columns` turn the tip."""
    n, count = len(rotations) - 1, rotations.shape[-1]
    columns = np.zeros((4 * n + 6, 3, count))
    columns[: 4 * n].reshape(n, 4, 3, count)[:, 2:] = rotations[:-1].swapaxes(1, 2)[:, :2]
    columns[-3:] = rotations[-1].swapaxes(0, 1)
    return columns


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
