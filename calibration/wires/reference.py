"""A draw-wire on a healthy robot: where its anchor and hook are, how the arm differs from the nominal one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.uncertainty import chi_square_limit
from cellcal.calibration.wires.model import (
    WirePoses,
    WirePrior,
    WireTerms,
    disturbance_covariance,
    disturbance_of_sets,
    wire_terms,
)

__all__ = ["WirePredictor", "WirePrior", "WireReference", "fit_wire_reference", "parameter_sigmas"]

_MAX_ITERATIONS = 12
_SETTLED = 1e-4  # of a parameter's deviation
_LOG_FACTOR_SIGMA, _MOST_LOG_FACTOR, _FACTOR_STEPS = 0.5, 1.5, 31  # belief in the size of the disturbances


@dataclass(frozen=True, slots=True)
class WireReference:
    """The healthy robot's wire lengths as a reference, stored whole: recovery needs the correlations.

    The parameter order of ``covariance`` is: anchor x y z [m], hook x y z [m], zero [m], scale [1], then the
    geometry errors row by row: theta, d, a, alpha, beta of each DH row [rad, m], or, for a model without a DH
    table, the twist v x y z, w x y z of each placement [m, rad].
    """

    anchor_in_base_m: tuple[float, float, float]
    hook_in_flange_m: tuple[float, float, float]
    zero_m: float
    scale: float
    geometry_errors: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    residual_rms_m: float
    chi_square: float  # of residuals and prior together
    degrees_of_freedom: int
    n: int
    disturbance_factor: float  # how much larger the record found the disturbances than its prior says
    worst_capture: int  # the capture that its fellows predict worst …
    worst_deviation: float  # … and by how many deviations
    joints_rad: tuple[tuple[float, ...], ...]
    lengths_m: tuple[float, ...]
    sigma_m: tuple[float, ...]

    def parameter_vector(self) -> Array:
        """Return the parameter vector in the order of the covariance."""
        first = (*self.anchor_in_base_m, *self.hook_in_flange_m, self.zero_m, self.scale)
        return np.array([*first, *self.geometry_errors])

    def is_consistent(self) -> bool:
        """Return whether the record fits its model at 99.9 % and no capture stands out at 4.5 deviations."""
        return self.chi_square <= chi_square_limit(self.degrees_of_freedom) and self.worst_deviation < 4.5


def parameter_sigmas(model: RobotModel, prior: WirePrior) -> Array:
    """Return the prior deviations of all parameters, in the order of ``WireReference``."""
    length, angle = prior.sigma_length_m, prior.sigma_angle_rad
    frames = [prior.sigma_anchor_m] * 3 + [prior.sigma_hook_m] * 3 + [prior.sigma_zero_m, prior.sigma_scale]
    if model.dh is None:
        return np.array(frames + ([length] * 3 + [angle] * 3) * (model.axis_count + 1))
    return np.array(frames + [angle, length, length, angle, angle] * model.axis_count)


def fit_wire_reference(
    model: RobotModel,
    joints_rad: Array | Sequence[Sequence[float]],
    lengths_m: Array | Sequence[float],
    sigma_m: float | Array | Sequence[float],
    prior: WirePrior,
) -> WireReference:
    r"""Fit anchor, hook, zero, scale and geometry errors to wire lengths of a healthy robot.

    ``y_i = z + s |a - T(q_i, g) h| + d(q_i) + e_i`` with the disturbance d of ``disturbance_covariance``
    (flexing, gear ripple, linearity of the wire) and sensor noise e. The maximum a posteriori estimate is
    found by Gauss-Newton; every parameter has a prior in physical units, so that what the poses cannot tell
    stays at its nominal value with its full uncertainty.

    Parameters
    ----------
    model : RobotModel
        Nominal model.
    joints_rad : (N, n)
        Controller joints of the healthy robot [rad].
    lengths_m : (N,)
        Wire lengths [m].
    sigma_m : float or (N,)
        Standard deviation of the sensor's noise [m].
    prior : WirePrior
        Nominal places and deviations [m, rad].

    Returns
    -------
    WireReference
        Estimate, posterior covariance, residuals, and the capture that fits worst.

    Raises
    ------
    DegenerateDataError
        Fewer captures than joints plus two.
    CalibrationError
        Shapes that do not match, numbers that are not finite.

    Notes
    -----
    ``chi_square`` counts residuals and prior together; for a consistent record it follows chi square with N
    degrees of freedom.
    """
    joints, lengths = np.asarray(joints_rad, dtype=float), np.asarray(lengths_m, dtype=float)
    sigmas = np.broadcast_to(np.asarray(sigma_m, dtype=float), lengths.shape)
    _check_record(model, joints, lengths, sigmas)
    fit = _solve_record(model, WirePoses.from_record_side(joints, sigmas), lengths, prior)
    factor = _disturbance_factor(fit, prior)
    fitted = prior.scale_disturbances(factor)
    return _make_reference(_solve_record(model, fit.terms.poses, lengths, fitted), fitted, factor)


@dataclass(frozen=True, eq=False, slots=True)
class _ReferenceFit:
    """A solved record: terms at the estimate, measured minus modelled, and against the prior."""

    terms: WireTerms
    x: Array
    covariance: Array
    sigma_x: Array
    residuals: Array
    innovation: Array  # measured minus what the nominal parameters predict, linearised


def _solve_record(model: RobotModel, poses: WirePoses, lengths: Array, prior: WirePrior) -> _ReferenceFit:
    sigma_x = parameter_sigmas(model, prior)
    nominal: Array = np.zeros(len(sigma_x))
    nominal[:8] = [*prior.anchor_in_base_m, *prior.hook_in_flange_m, prior.zero_m, 1.0]
    x = nominal.copy()
    for _ in range(_MAX_ITERATIONS):
        terms = wire_terms(model, x, poses)
        by_x = terms.by_parameter
        weight = np.linalg.inv(_length_covariance(prior, terms))
        information = by_x.T @ weight @ by_x + np.diag(sigma_x**-2.0)
        step = np.linalg.solve(
            information, by_x.T @ weight @ (lengths - terms.lengths) - (x - nominal) / sigma_x**2
        )
        x = x + step
        if float(np.max(np.abs(step) / sigma_x)) < _SETTLED:
            break
    terms = wire_terms(model, x, poses)
    residuals = lengths - terms.lengths
    innovation = residuals + terms.by_parameter @ (x - nominal)
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return _ReferenceFit(terms, x, covariance, sigma_x, residuals, innovation)


def _length_covariance(prior: WirePrior, terms: WireTerms) -> Array:
    scatter: Array = disturbance_covariance(prior, terms, terms) + np.diag(terms.noise_variance(prior))
    return scatter


def _disturbance_factor(fit: _ReferenceFit, prior: WirePrior) -> float:
    """Return by what factor the disturbances are most likely larger than believed (marginal likelihood)."""
    weighted = fit.terms.by_parameter * fit.sigma_x
    frame = weighted @ weighted.T + np.diag(fit.terms.noise_variance(prior))
    disturbance = disturbance_covariance(prior, fit.terms, fit.terms)
    factors = np.exp(np.linspace(-_MOST_LOG_FACTOR, _MOST_LOG_FACTOR, _FACTOR_STEPS))
    totals = frame + factors[:, None, None] ** 2 * disturbance
    squares = np.linalg.solve(totals, np.broadcast_to(fit.innovation[:, None], (*totals.shape[:2], 1)))[
        ..., 0
    ]
    misfit = squares @ fit.innovation + np.linalg.slogdet(totals)[1]
    prior_misfit = (np.log(factors) / _LOG_FACTOR_SIGMA) ** 2
    return float(factors[np.argmin(misfit + prior_misfit)])


def _check_record(model: RobotModel, joints: Array, lengths: Array, sigmas: Array) -> None:
    if joints.ndim != 2 or joints.shape != (len(lengths), model.axis_count):
        raise CalibrationError(
            f"{len(lengths)} lengths need ({len(lengths)}, {model.axis_count}) joint angles"
        )
    if not (np.isfinite(joints).all() and np.isfinite(lengths).all() and np.isfinite(sigmas).all()):
        raise CalibrationError("a record must be finite")
    if (sigmas <= 0).any():
        raise CalibrationError("the sensor's deviation must be above zero")
    if len(lengths) < model.axis_count + 2:
        raise DegenerateDataError(
            f"{len(lengths)} captures cannot describe a wire on {model.axis_count} joints",
            remedy="Take at least 24 captures over the whole reach.",
        )


def _make_reference(fit: _ReferenceFit, prior: WirePrior, factor: float) -> WireReference:
    terms, x = fit.terms, fit.x
    # Before the fit the lengths scatter by this much around the nominal prediction: chi square, and the
    # deviation of each capture from what all others predict, follow from this one matrix.
    weighted = terms.by_parameter * fit.sigma_x
    precision = np.linalg.inv(_length_covariance(prior, terms) + weighted @ weighted.T)
    deviations = np.abs(precision @ fit.innovation) / np.sqrt(np.diag(precision))
    worst = int(np.argmax(deviations))
    count = len(fit.residuals)
    return WireReference(
        anchor_in_base_m=_to_triple(x[:3]),
        hook_in_flange_m=_to_triple(x[3:6]),
        zero_m=float(x[6]),
        scale=float(x[7]),
        geometry_errors=_to_floats(x[8:]),
        covariance=tuple(_to_floats(row) for row in fit.covariance),
        residual_rms_m=float(np.sqrt(np.mean(fit.residuals**2))),
        chi_square=float(fit.innovation @ precision @ fit.innovation),
        degrees_of_freedom=count,
        n=count,
        disturbance_factor=factor,
        worst_capture=worst,
        worst_deviation=float(deviations[worst]),
        joints_rad=tuple(_to_floats(row) for row in terms.poses.joints_rad),
        lengths_m=_to_floats(terms.lengths + fit.residuals),
        sigma_m=_to_floats(terms.poses.sigma_m),
    )


def _to_floats(values: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def _to_triple(values: Array) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


class WirePredictor:
    """Predicts lengths of the healthy robot at other joints, with their covariance.

    The expectation is the fitted model plus what the record's residuals say about the disturbance nearby; the
    covariance carries the whole posterior of the record, the disturbances that are not shared with it, and
    the noise of the new captures (universal kriging). The disturbances
    are as large as the record found them.
    """

    def __init__(self, model: RobotModel, reference: WireReference, prior: WirePrior) -> None:
        self._model, self._prior = model, prior.scale_disturbances(reference.disturbance_factor)
        self._parameters = reference.parameter_vector()
        self._posterior = np.array(reference.covariance)
        if len(self._parameters) != len(parameter_sigmas(model, prior)):
            raise CalibrationError(f"the reference was not fitted with the model {model.label}")
        poses = WirePoses.from_record_side(np.array(reference.joints_rad), np.array(reference.sigma_m))
        self._record = self.wire_terms(poses)
        self._weight = np.linalg.inv(_length_covariance(self._prior, self._record))
        self._weighted_residuals = self._weight @ (np.array(reference.lengths_m) - self._record.lengths)
        self.sigma_m = float(np.median(reference.sigma_m))  # of a typical capture

    def wire_terms(self, poses: WirePoses) -> WireTerms:
        """Return the fitted model's lengths and derivatives."""
        return wire_terms(self._model, self._parameters, poses)

    def expected_lengths(self, terms: WireTerms) -> tuple[Array, Array]:
        """Return expected lengths (N,) [m] and their covariance (N, N) [m^2], the captures' noise in it."""
        prior, by_x = self._prior, terms.by_parameter
        shared = disturbance_covariance(prior, terms, self._record)
        gain = shared @ self._weight
        free = by_x - gain @ self._record.by_parameter
        hung_in_again = by_x[:, 3:7] * prior.sigma_session_m
        covariance = disturbance_covariance(prior, terms, terms) - gain @ shared.T
        covariance += free @ self._posterior @ free.T + hung_in_again @ hung_in_again.T
        covariance += np.diag(terms.noise_variance(prior))
        return terms.lengths + shared @ self._weighted_residuals, (covariance + covariance.T) / 2.0

    def scatter_of_sets(self, terms: WireTerms, size: int) -> Array:
        """Return (B, K, K) [m^2]: covariances of ``expected_lengths`` inside B sets of K = ``size`` captures.

        What captures of different sets share is not computed: many sets are compared in little time.
        """
        prior, by_x = self._prior, terms.by_parameter
        shared = disturbance_covariance(prior, terms, self._record)
        gain = shared @ self._weight
        free = by_x - gain @ self._record.by_parameter
        hung_in_again = by_x[:, 3:7] * prior.sigma_session_m
        sets: Array = disturbance_of_sets(prior, terms, size) - _group_products(gain, shared, size)
        sets += _group_products(free @ self._posterior, free, size) + _group_products(
            hung_in_again, hung_in_again, size
        )
        each = np.arange(size)
        sets[:, each, each] += terms.noise_variance(prior).reshape(-1, size)
        symmetric: Array = (sets + np.swapaxes(sets, 1, 2)) / 2.0
        return symmetric


def _group_products(first_factor: Array, right: Array, size: int) -> Array:
    """Return (B, K, K): the blocks of left @ right' for B groups of K = ``size`` rows."""
    blocks: Array = first_factor.reshape(-1, size, first_factor.shape[1]) @ np.swapaxes(
        right.reshape(-1, size, right.shape[1]), 1, 2
    )
    return blocks
