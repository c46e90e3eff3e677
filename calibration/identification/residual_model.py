"""What an identified arm leaves over, as a smooth function of the joints: a Gaussian process, with its own doubt.

Far from the rows that it has seen it says zero, and its uncertainty grows to the size of what it models: the
parametric arm is used alone there.
"""

from dataclasses import dataclass

import numpy as np
import scipy  # loads a part of it when that is first used

from cellcal.calibration.arm.joint_terms import term_values
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import LengthObservations, Observations
from cellcal.calibration.identification.parameters import ArmState
from cellcal.calibration.identification.robust import RobustFit

_MOST_ROWS = 1200  # are remembered: the cost grows with their cube
_ROWS_TO_TUNE = 200
_RANGES_RAD = (0.2, 6.0)  # over which the residual of a joint may change
_FIRST = ((0.4, 1.0), (1.5, 1.0), (3.0, 4.0))  # ranges and noise to start from: the likelihood has many tops
_NOISE = (0.05, 20.0)  # variance of noise over that of the process
_EFFORT = {"maxiter": 40}
_FEWEST = 20
_BLOCK = 4096
_JITTER = 1e-9


@dataclass(frozen=True, eq=False)
class ResidualModel:
    """A Gaussian process over the joints for the residual position in the robot's base frame [m]."""

    joints_rad: Array  # (M, n) of the rows remembered
    ranges_rad: Array  # (n,)
    variance_m2: float
    noise: float  # variance over that of the process
    factor: Array  # (M, M) lower Cholesky factor
    weights: Array  # (M, 3)

    def predict_residual(self, joints_rad: Array) -> tuple[Array, Array]:
        """Return the expected residual (N, 3) [m] and its standard deviation a coordinate (N,) [m]."""
        mean, sigma = np.empty((len(joints_rad), 3)), np.empty(len(joints_rad))
        for first in range(0, len(joints_rad), _BLOCK):
            rows = slice(first, first + _BLOCK)
            near = _kernel_matrix(joints_rad[rows], self.joints_rad, self.ranges_rad)
            mean[rows] = near @ self.weights
            whitened = scipy.linalg.solve_triangular(self.factor, near.T, lower=True)
            sigma[rows] = np.sqrt(self.variance_m2 * np.maximum(1.0 - (whitened**2).sum(axis=0), 0.0))
        return mean, sigma


def residual_in_base(state: ArmState, observations: Observations) -> Array:
    """Return measured minus predicted positions (N, 3) in the robot's base frame [m].

    Raises
    ------
    CalibrationError
        Lengths: they tell one direction only.
    """
    if isinstance(observations, LengthObservations):
        raise CalibrationError(
            "a residual model needs positions: a length tells one direction only.",
            remedy="Leave out `--residual-model`, or measure points or poses.",
            code="usage",
        )
    residuals_m = np.empty((len(observations), 3))
    values = term_values(state.nominal, observations.joints_rad, state.terms)
    for mounting, device in enumerate(state.devices):
        rows = np.flatnonzero(observations.mounting == mounting)
        joints = state.moved_joints(observations.joints_rad[rows], values[:, rows])
        predicted = state.seen_from(mounting).base_flange(joints)[:, :3, 3]
        residuals_m[rows] = (observations.positions_m[rows] - predicted) @ device.device_base[:3, :3]
    return residuals_m


def residual_of(robust: RobustFit, observations: Observations, seed: int) -> ResidualModel:
    """Fit a residual model to the rows that a fit kept."""
    is_kept = np.ones(len(observations), dtype=bool)
    is_kept[robust.rejected] = False
    residuals_m = residual_in_base(robust.fit.state, observations)
    return fit_residual(observations.joints_rad[is_kept], residuals_m[is_kept], seed=seed)


def errors_with(residual: ResidualModel, state: ArmState, observations: Observations) -> Array:
    """Return the sizes of errors (N,) [m] that are left if the residual model corrects the arm."""
    remaining_m = (
        residual_in_base(state, observations) - residual.predict_residual(observations.joints_rad)[0]
    )
    sizes: Array = np.linalg.norm(remaining_m, axis=1)
    return sizes


def fit_residual(joints_rad: Array, residual_m: Array, *, seed: int = 0) -> ResidualModel:
    r"""Fit ``k(q, q') = s^2 exp(-sum (q_i - q_i')^2 / (2 l_i^2))`` by the likelihood of some of the rows.

    Parameters
    ----------
    joints_rad : (N, n)
        Postures [rad].
    residual_m : (N, 3)
        In the base frame [m]; rejected rows do not belong here.
    seed : int
        Of the rows that are drawn where there are more than are needed.

    Raises
    ------
    CalibrationError
        Fewer than 20 rows.

    Notes
    -----
    The three coordinates share one kernel. Angles that differ by a turn are not the same: cables and gears
    know the difference.

    References
    ----------
    C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning, 2006, 2.2 and 5.4.1.
    """
    if len(joints_rad) < _FEWEST:
        raise CalibrationError(
            f"{len(joints_rad)} rows are too few for a residual model.", remedy=f"Measure at least {_FEWEST}."
        )
    order = np.random.default_rng(seed).permutation(len(joints_rad))
    some, few = order[:_MOST_ROWS], order[:_ROWS_TO_TUNE]
    ranges, noise = _tune_kernel(joints_rad[few], residual_m[few])
    joints, residuals = joints_rad[some], residual_m[some]
    kernel = _kernel_matrix(joints, joints, ranges) + (noise + _JITTER) * np.eye(len(joints))
    factor = np.asarray(np.linalg.cholesky(kernel), dtype=np.float64)
    weights = scipy.linalg.cho_solve((factor, True), residuals)
    variance = float((residuals * weights).sum() / residuals.size)
    return ResidualModel(joints, ranges, variance, noise, factor, weights)


def _tune_kernel(joints_rad: Array, residual_m: Array) -> tuple[Array, float]:
    from scipy.optimize import minimize  # noqa: PLC0415  slow to load, and few ask for this model

    n = joints_rad.shape[1]
    bounds = [*([tuple(np.log(_RANGES_RAD))] * n), tuple(np.log(_NOISE))]
    count = len(joints_rad)
    apart = ((joints_rad[:, None] - joints_rad[None]) ** 2).reshape(-1, n)
    scaled = residual_m / max(float(np.sqrt(np.mean(residual_m**2))), 1e-12)

    def likelihood_cost(logs: Array) -> tuple[float, Array]:
        """Return the negative log likelihood, with the process variance at its best, and its gradient."""
        ranges, noise = np.exp(logs[:n]), float(np.exp(logs[n]))
        kernel = np.exp(-0.5 * apart @ ranges**-2.0).reshape(count, count)
        factor = scipy.linalg.cho_factor(kernel + (noise + _JITTER) * np.eye(len(kernel)), lower=True)
        weights = scipy.linalg.cho_solve(factor, scaled)
        variance = float((scaled * weights).sum() / scaled.size)
        inverse = scipy.linalg.cho_solve(factor, np.eye(len(kernel)))
        slope = 1.5 * inverse - 0.5 * weights @ weights.T / variance
        by_kernel = (slope * kernel).ravel()
        gradient = np.array([*(by_kernel @ apart / ranges**2), noise * np.trace(slope)])
        value = 0.5 * scaled.size * np.log(variance) + 3.0 * float(np.log(np.diag(factor[0])).sum())
        return value, gradient

    starts = [np.log([*([far] * n), noise]) for far, noise in _FIRST]
    ends = [
        minimize(likelihood_cost, s, jac=True, bounds=bounds, method="L-BFGS-B", options=_EFFORT)
        for s in starts
    ]
    found = min(ends, key=lambda end: float(end.fun))
    return np.exp(found.x[:n]), float(np.exp(found.x[n]))


def _kernel_matrix(first_rad: Array, second_rad: Array, ranges_rad: Array) -> Array:
    a, b = first_rad / ranges_rad, second_rad / ranges_rad
    square = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1)[None] - 2.0 * a @ b.T
    kernel: Array = np.exp(-0.5 * np.maximum(square, 0.0))
    return kernel
