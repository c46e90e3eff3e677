"""A draw-wire on a healthy robot: where its anchor and hook are, how the arm differs from the nominal one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.errors import CalibrationError, DegenerateDataError
from calibration.geometry import Array
from calibration.kinematics import RobotModel
from calibration.uncertainty import chi_square_limit
from calibration.wire_model import WirePrior, WireSeen, WireTerms, disturbance_covariance, wire_terms

__all__ = ["WirePredictor", "WirePrior", "WireReference", "fit_wire_reference", "parameter_sigmas"]

_MAX_ITERATIONS = 12
_SETTLED = 1e-4  # of a parameter's deviation
_BELIEF_WORTH = 10.0  # captures that the prior deviations count for, against the record's own scatter


@dataclass(frozen=True, slots=True)
class WireReference:
    """What the healthy robot's wire lengths say, kept whole: recovery needs the correlations.

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
    worst_capture: int  # the capture that its fellows predict worst …
    worst_deviation: float  # … and by how many deviations
    joints_rad: tuple[tuple[float, ...], ...]
    lengths_m: tuple[float, ...]
    sigma_m: tuple[float, ...]

    def parameters(self) -> Array:
        """Return the parameter vector in the order of the covariance."""
        first = (*self.anchor_in_base_m, *self.hook_in_flange_m, self.zero_m, self.scale)
        return np.array([*first, *self.geometry_errors])

    def variance_factor(self) -> float:
        """Return by how much the record found variances larger than believed, drawn towards 1."""
        return (self.chi_square + _BELIEF_WORTH) / (self.degrees_of_freedom + _BELIEF_WORTH)

    def consistent(self) -> bool:
        """Tell whether the record fits its model at 99.9 % and no capture stands out at 4.5 deviations."""
        return self.chi_square <= chi_square_limit(self.degrees_of_freedom) and self.worst_deviation < 4.5


def parameter_sigmas(model: RobotModel, prior: WirePrior) -> Array:
    """Return the prior deviations of all parameters, in the order of ``WireReference``."""
    length, angle = prior.sigma_length_m, prior.sigma_angle_rad
    frames = [prior.sigma_anchor_m] * 3 + [prior.sigma_hook_m] * 3 + [prior.sigma_zero_m, prior.sigma_scale]
    if model.dh is None:
        return np.array(frames + ([length] * 3 + [angle] * 3) * (model.axes + 1))
    return np.array(frames + [angle, length, length, angle, angle] * model.axes)


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
    seen, sigma_x = WireSeen.of(joints, sigmas), parameter_sigmas(model, prior)
    nominal: Array = np.zeros(len(sigma_x))
    nominal[:8] = [*prior.anchor_in_base_m, *prior.hook_in_flange_m, prior.zero_m, 1.0]
    x = nominal.copy()
    for _ in range(_MAX_ITERATIONS):
        terms = wire_terms(model, x, seen)
        by_x = terms.by_parameter
        weight = np.linalg.inv(disturbance_covariance(prior, terms, terms) + np.diag(terms.noise(prior)))
        covariance = np.asarray(
            np.linalg.inv(by_x.T @ weight @ by_x + np.diag(sigma_x**-2.0)), dtype=np.float64
        )
        step = covariance @ (by_x.T @ weight @ (lengths - terms.lengths) - (x - nominal) / sigma_x**2)
        x = x + step
        if float(np.max(np.abs(step) / sigma_x)) < _SETTLED:
            break
    terms = wire_terms(model, x, seen)
    return _reference(terms, (nominal, x, covariance), lengths, (prior, sigma_x))


def _check_record(model: RobotModel, joints: Array, lengths: Array, sigmas: Array) -> None:
    if joints.ndim != 2 or joints.shape != (len(lengths), model.axes):
        raise CalibrationError(f"{len(lengths)} lengths need ({len(lengths)}, {model.axes}) joint angles")
    if not (np.isfinite(joints).all() and np.isfinite(lengths).all() and np.isfinite(sigmas).all()):
        raise CalibrationError("a record must be finite")
    if (sigmas <= 0).any():
        raise CalibrationError("the sensor's deviation must be above zero")
    if len(lengths) < model.axes + 2:
        raise DegenerateDataError(
            f"{len(lengths)} captures cannot describe a wire on {model.axes} joints",
            remedy="Take at least 24 captures over the whole reach.",
        )


def _reference(
    terms: WireTerms, fit: tuple[Array, Array, Array], lengths: Array, beliefs: tuple[WirePrior, Array]
) -> WireReference:
    (nominal, x, covariance), (prior, sigma_x) = fit, beliefs
    residuals, by_x = lengths - terms.lengths, terms.by_parameter
    # Before the fit the lengths scatter by ``total`` around the nominal prediction: chi square and the
    # deviation of each capture from what all others predict follow from this one matrix.
    total = (
        disturbance_covariance(prior, terms, terms)
        + np.diag(terms.noise(prior))
        + (by_x * sigma_x**2) @ by_x.T
    )
    precision = np.linalg.inv(total)
    innovation = residuals + by_x @ (x - nominal)
    deviations = np.abs(precision @ innovation) / np.sqrt(np.diag(precision))
    worst = int(np.argmax(deviations))
    return WireReference(
        anchor_in_base_m=_triple(x[:3]),
        hook_in_flange_m=_triple(x[3:6]),
        zero_m=float(x[6]),
        scale=float(x[7]),
        geometry_errors=_floats(x[8:]),
        covariance=tuple(_floats(row) for row in covariance),
        residual_rms_m=float(np.sqrt(np.mean(residuals**2))),
        chi_square=float(innovation @ precision @ innovation),
        degrees_of_freedom=len(lengths),
        n=len(lengths),
        worst_capture=worst,
        worst_deviation=float(deviations[worst]),
        joints_rad=tuple(_floats(row) for row in terms.seen.joints_rad),
        lengths_m=_floats(lengths),
        sigma_m=_floats(terms.seen.sigma_m),
    )


def _floats(values: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def _triple(values: Array) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


class WirePredictor:
    """What lengths to expect of the healthy robot at other joints, and how surely.

    The expectation is the fitted model plus what the record's residuals say about the disturbance nearby; the
    covariance carries the whole posterior of the record, the disturbances that are not shared with it, and
    the noise of the new captures (universal kriging). All of it is scaled by how well the record fitted.
    """

    def __init__(self, model: RobotModel, reference: WireReference, prior: WirePrior) -> None:
        self._model, self._prior = model, prior
        self._parameters = reference.parameters()
        self._posterior = np.array(reference.covariance)
        self._factor = reference.variance_factor()
        if len(self._parameters) != len(parameter_sigmas(model, prior)):
            raise CalibrationError(f"the reference was not fitted with the model {model.name}")
        seen = WireSeen.of(np.array(reference.joints_rad), np.array(reference.sigma_m))
        self._record = self.terms(seen)
        scatter = disturbance_covariance(prior, self._record, self._record) + np.diag(
            self._record.noise(prior)
        )
        self._weight = np.linalg.inv(scatter)
        self._weighted_residuals = self._weight @ (np.array(reference.lengths_m) - self._record.lengths)
        self.sigma_m = float(np.median(reference.sigma_m))  # of a typical capture

    def terms(self, seen: WireSeen) -> WireTerms:
        """Return the fitted model's lengths and derivatives."""
        return wire_terms(self._model, self._parameters, seen)

    def expect(self, terms: WireTerms) -> tuple[Array, Array]:
        """Return expected lengths (N,) [m] and their covariance (N, N) [m^2], the captures' noise in it."""
        prior, by_x = self._prior, terms.by_parameter
        shared = disturbance_covariance(prior, terms, self._record)
        gain = shared @ self._weight
        free = by_x - gain @ self._record.by_parameter
        hung_in_again = by_x[:, 3:7] * prior.sigma_session_m
        covariance = disturbance_covariance(prior, terms, terms) - gain @ shared.T
        covariance += free @ self._posterior @ free.T + hung_in_again @ hung_in_again.T
        covariance += np.diag(terms.noise(prior))
        scatter = self._factor * (covariance + covariance.T) / 2.0
        return terms.lengths + shared @ self._weighted_residuals, scatter
