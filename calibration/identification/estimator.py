"""Maximum a posteriori estimation of an arm from observations: Gauss-Newton, in blocks of postures."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import prod
from threading import local
from typing import TypeAlias

import numpy as np

from cellcal.calibration.arm.joint_terms import JointTerm, term_values
from cellcal.calibration.arm.kinematics import (
    RobotModel,
    by_independent_columns,
    frames_of_placements,
    independent_columns,
)
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import Observations, Rows
from cellcal.calibration.identification.parameters import ArmState, ParameterLayout

_BLOCK = 2048  # postures at once: large enough for BLAS, small enough for the cache
_MOST_HELD = 10_000_000  # values of joint terms: 80 MB
_MAX_ITERATIONS = 40
_SETTLED = 1e-3  # of a posterior standard deviation: a smaller step is negligible
_CURVED = 1e-2  # of the smallest posterior deviation
_INVISIBLE_M = 1e-7  # a tenth of a micrometre: no arm and no tracker shows it
_NEAR_M = 3e-4  # its square is invisible: one step of all rows does the rest
_MAX_DAMPING = 1e8
_ROUNDING = 1e-6
_COARSE = 150  # rows are enough to come near
_THINNEST = 32

Block: TypeAlias = tuple[int, Rows | slice]  # mounting and its rows


@dataclass(frozen=True, eq=False)
class ArmFit:
    """An estimate with its uncertainty, before anything is said about how good it is."""

    state: ArmState
    layout: ParameterLayout
    covariance: Array  # (p, p), in the units of the parameters, for the sigmas as given
    deviations: Array  # (p,): how far each parameter is from its prior mean; zero for places
    cost: float
    iterations: int


@dataclass(frozen=True, eq=False)
class FitProblem:
    """Observations with everything about them that does not change while the parameters do."""

    observations: Observations
    arm: RobotModel  # nominal
    terms: tuple[JointTerm, ...]
    cached_values: Array | None  # (K, N) values of the joint terms; None: too many, made again block by block
    angles_rad: Array  # (n, N): what the joints add to the angles of the nominal arm
    blocks: tuple[Block, ...]
    root: Array | None = None  # (N,) of each row's weight; None weighs all rows alike

    @classmethod
    def from_observations(cls, state: ArmState, observations: Observations) -> "FitProblem":
        """Prepare the observations for states with the same nominal arm and joint terms."""
        cached_values = None
        if len(state.terms) * len(observations) <= _MOST_HELD:
            cached_values = term_values(state.nominal, observations.joints_rad, state.terms)
        angles = state.nominal.joint_coupling @ observations.joints_rad.T
        return cls(
            observations,
            state.nominal,
            state.terms,
            cached_values,
            angles,
            tuple(_iterate_blocks(observations)),
        )

    def term_values_of(self, rows: Rows | slice) -> Array:
        """Return the values of the joint terms in some rows (K, n)."""
        if self.cached_values is not None:
            return self.cached_values[:, rows]
        return term_values(self.arm, self.observations.joints_rad[rows], self.terms)

    def select_rows(self, rows: Rows) -> "FitProblem":
        """Return the same for some of the rows."""
        taken = self.observations.select_rows(rows)
        root = None if self.root is None else self.root[rows]
        cached_values = self.term_values_of(rows) if len(self.terms) * len(taken) <= _MOST_HELD else None
        angles = self.angles_rad[:, rows]
        return FitProblem(
            taken, self.arm, self.terms, cached_values, angles, tuple(_iterate_blocks(taken)), root
        )

    def channel_scales(self, rows: Rows | slice) -> Array:
        """Return what makes the channels of rows count alike: root of the weight over sigma (channels or 1, N)."""
        scales = self.observations.inverse_sigmas(rows)
        return scales if self.root is None else scales * self.root[rows]


def whitened_residuals(state: ArmState, problem: FitProblem) -> Array:
    """Return measured minus predicted of every row, in sigmas, (channels, N)."""
    observations = problem.observations
    residuals = np.empty((observations.channels, len(observations)))
    for mounting, rows in problem.blocks:
        values = problem.term_values_of(rows)
        rotations, origins = _chain_frames(
            state, _chain_placements(state, mounting), problem.angles_rad[:, rows], values
        )
        tip = origins[-1], rotations[-1]
        residuals[:, rows] = observations.compute_residuals(tip, state.device_of(mounting), rows)
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
        few = problem.select_rows(np.arange(0, count, min(count // _COARSE, _THINNEST)))
        state = _iterate_steps(_NormalEquations(layout, few), state, enough_m=_NEAR_M).state
    return _iterate_steps(_NormalEquations(layout, problem), state)


def _iterate_steps(
    equations: "_NormalEquations", state: ArmState, *, enough_m: float = _INVISIBLE_M
) -> ArmFit:
    layout = equations.layout
    information, gradient, cost = equations.evaluate_at(state)
    damping = 0.0
    iterations = 0
    inverse = inverse_information(information)
    while iterations < _MAX_ITERATIONS and damping <= _MAX_DAMPING:
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
    covariance = inverse * np.outer(layout.prior_sigmas, layout.prior_sigmas)
    return ArmFit(state, layout, covariance, layout.prior_deviations(state), cost, iterations)


def is_settled(step: Array, spread: Array, prior: Array, enough_m: float = _INVISIBLE_M) -> bool:
    """Tell whether all that a step leaves out is invisible; step and posterior deviations in prior deviations.

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
    for mounting, rows in problem.blocks:
        chain = _MountingChain.at_mounting(layout, state, mounting)
        system = _whitened_system(state, chain, problem, (mounting, rows))
        every[:, :, rows] = np.tensordot(chain.tangent, system[:-1], axes=1)
        white_residuals[:, rows] = system[-1]
    return every, white_residuals


def _iterate_blocks(observations: Observations) -> Iterator[Block]:
    for mounting in range(int(observations.mounting.max(initial=0)) + 1):
        rows = np.flatnonzero(observations.mounting == mounting)
        for start in range(0, len(rows), _BLOCK):
            yield mounting, _as_slice(rows[start : start + _BLOCK])


def _as_slice(rows: Rows) -> Rows | slice:
    """Return rows that follow each other as a slice, which is looked at and not copied."""
    first, last = int(rows[0]), int(rows[-1])
    return slice(first, last + 1) if last - first + 1 == len(rows) else rows


class _Workspace(local):
    """Arrays that are written again block after block, kept by each thread between fits.

    Touching memory that is new from the system costs more than the arithmetic on it. What is taken under a name
    is good until the next one takes it.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, Array] = {}

    def get_array(self, name: str, *shape: int) -> Array:
        """Return an array of this shape, with anything in it."""
        size = prod(shape)
        if name not in self._arrays or self._arrays[name].size < size:
            self._arrays[name] = np.empty(size)
        return self._arrays[name][:size].reshape(shape)


_WORKSPACE = _Workspace()


@dataclass(frozen=True, eq=False)
class _MountingChain:
    """The arm between one mounting of the device and the target, at one state."""

    placements: Array  # (n + 1, 4, 4)
    turns: Array  # (K, P): what each joint term's joint does, by independent columns
    tangent: Array  # (p, P + K + D): what each parameter does, by columns of the system

    @classmethod
    def at_mounting(cls, layout: ParameterLayout, state: ArmState, mounting: int) -> "_MountingChain":
        placements = _chain_placements(state, mounting)
        combine = by_independent_columns(placements)
        if layout.kind != "pose":
            combine = combine[:, :-3]
        joints = np.array([term.joint for term in state.terms], dtype=np.intp)
        tangent = layout.tangent_rows(state, mounting)
        arm, rest = tangent[:, : len(combine)], tangent[:, len(combine) :]
        return cls(placements, combine[6 * joints + 5], np.concatenate([arm @ combine, rest], axis=1))


def _chain_placements(state: ArmState, mounting: int) -> Array:
    """Return those of `ArmState.seen_from`, without a model around them."""
    placements = state.arm_model.placements.copy()
    placements[0] = state.device_of(mounting).device_base @ placements[0]
    placements[-1] = placements[-1] @ state.target_of(mounting)
    return placements


def _chain_frames(
    state: ArmState, placements: Array, joints_rad: Array, values: Array
) -> tuple[Array, Array]:
    angles = joints_rad + state.arm_model.theta0_rad[:, None]
    for term, coefficient, value in zip(state.terms, state.coefficients, values, strict=True):
        angles[term.joint] += coefficient * value
    out = _WORKSPACE.get_array("frames", len(placements), 4, 3, angles.shape[1])
    return frames_of_placements(placements, angles, out=out)


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
        for mounting in range(state.mounting_count):
            chain = _MountingChain.at_mounting(layout, state, mounting)
            products = self._mounting_products(state, chain, mounting)
            tangent = chain.tangent * layout.prior_sigmas[:, None]
            information += tangent @ products[:-1, :-1] @ tangent.T
            gradient += tangent @ products[:-1, -1]
            cost += float(products[-1, -1])
        if not np.isfinite(cost):
            raise CalibrationError(
                "the estimate left the range of numbers.", remedy="Check robot model, units and columns."
            )
        return information, gradient, cost

    def _mounting_products(self, state: ArmState, chain: _MountingChain, mounting: int) -> Array:
        """Return the products of all columns and the residuals with each other, over a mounting's rows."""
        size = chain.tangent.shape[1] + 1
        products = np.zeros((size, size))
        for block in self.problem.blocks:
            if block[0] != mounting:
                continue
            system = _whitened_system(state, chain, self.problem, block)
            flat = system.reshape(size, -1)
            products += flat @ flat.T
        return products


def _whitened_system(state: ArmState, chain: _MountingChain, problem: FitProblem, block: Block) -> Array:
    """Return the whitened columns of a block and, in the last row, its residuals (P + K + D + 1, channels, N)."""
    observations, (mounting, rows) = problem.observations, block
    device, count = state.device_of(mounting), chain.turns.shape[1]
    values = problem.term_values_of(rows)
    rotations, origins = _chain_frames(state, chain.placements, problem.angles_rad[:, rows], values)
    tip, rows_taken = (origins[-1], rotations[-1]), origins.shape[-1]
    system = _WORKSPACE.get_array("system", chain.tangent.shape[1] + 1, observations.channels, rows_taken)
    scales, columns = problem.channel_scales(rows), system[:count]
    if observations.channels == 3:  # the tip's motion is the answer, in place
        independent_columns(rotations, origins, out=columns, scale=scales[0])
    else:
        linear = independent_columns(
            rotations, origins, out=_WORKSPACE.get_array("linear", count, 3, rows_taken)
        )
        angular = _angular_columns(rotations) if observations.needs_rotation else None
        np.multiply(observations.project_motions(linear, angular, tip, device), scales, out=columns)
    if state.terms:
        turned = chain.turns @ columns.reshape(count, -1)
        moved = turned.reshape(-1, *system.shape[1:]) * values[:, None]
        system[count : count + len(moved)] = moved
    system[count + len(state.terms) : -1] = observations.own_columns(tip, device) * scales
    system[-1] = observations.compute_residuals(tip, device, rows)
    if problem.root is not None:
        system[-1] *= problem.root[rows]
    return system


def _angular_columns(rotations: Array) -> Array:
    """Return (4 n + 6, 3, N): how the motions of `independent_columns` turn the tip."""
    n, count = len(rotations) - 1, rotations.shape[-1]
    columns = np.zeros((4 * n + 6, 3, count))
    columns[: 4 * n].reshape(n, 4, 3, count)[:, 2:] = rotations[:-1].swapaxes(1, 2)[:, :2]
    columns[-3:] = rotations[-1].swapaxes(0, 1)
    return columns


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
