"""The fit of one draw-wire at several places: its most likely places, how sure they are, and what stands out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.uncertainty import chi_square_limit
from cellcal.calibration.wires.model import WireTerms
from cellcal.calibration.wires.network import (
    WIRE_PARAMETERS,
    Triple,
    WireEquations,
    WireMounting,
    WireNetworkPrior,
)

_MAX_ITERATIONS = 15
_SETTLED = 1e-4  # of a parameter's deviation
_LOG_FACTOR_SIGMA, _MOST_LOG_FACTOR, _FACTOR_STEPS = 0.5, 1.0, 21  # belief in the size of the disturbances
_STANDS_OUT = 4.5  # deviations


@dataclass(frozen=True, slots=True)
class WireNetwork:
    """Exits and hooks as found.

    ``covariance`` is of the exits x y z one after the other, then the hooks [m^2], then the wire's zero [m],
    scale [1], lip [m] and slow linearity [m, m].
    """

    exits_m: tuple[Triple, ...]
    hooks_m: tuple[Triple, ...]
    covariance: tuple[tuple[float, ...], ...]
    zero_m: float
    scale: float
    exit_radius_m: float
    slow_m: tuple[float, float]  # linearity as one wave over the whole range: its sine and cosine
    n: int
    residual_rms_m: float
    chi_square: float  # of residuals and prior together; n degrees of freedom
    disturbance_factor: float  # how much larger the data found the disturbances than believed
    worst_mounting: int  # the length that the others predict worst …
    worst_capture: int
    worst_deviation: float  # … and by how many deviations

    def is_consistent(self) -> bool:
        """Return whether the lengths fit their model at 99.9 % and none stands out."""
        return self.chi_square <= chi_square_limit(self.n) and self.worst_deviation < _STANDS_OUT

    def exit_covariance(self, exits: Sequence[int]) -> Array:
        """Return (3 k, 3 k) of these exits [m^2]."""
        return _covariance_block(np.array(self.covariance), exits)

    def exit_and_wire_covariance(self, exits: Sequence[int]) -> Array:
        """Return (3 k + 4, 3 k + 4) of these exits [m^2], then of the scale [1], lip and slow linearity [m]."""
        covariance, last = np.array(self.covariance), 3 * (len(self.exits_m) + len(self.hooks_m))
        index = [
            *(3 * e + axis for e in exits for axis in range(3)),
            *range(last + 1, last + WIRE_PARAMETERS),
        ]
        together: Array = covariance[np.ix_(index, index)]
        return together

    def hook_covariance(self, hooks: Sequence[int]) -> Array:
        """Return (3 k, 3 k) of these hooks [m^2]."""
        return _covariance_block(np.array(self.covariance), [len(self.exits_m) + h for h in hooks])


def fit_network(
    model: RobotModel, network_prior: WireNetworkPrior, mountings: Sequence[WireMounting]
) -> WireNetwork:
    r"""Fit all exits, hooks, the wire and the arm's errors to lengths from several mountings.

    ``y = z + s |a_e - T(q + sag(q), g) h_k| + r (phi - sin phi) + d + e``: zero z, scale s, exit a, hook h,
    geometry errors g, exit lip r with the angle phi between the wire and the mouth's direction, disturbances d of
    ``disturbance_covariance`` and sensor noise e. Maximum a posteriori by Gauss-Newton.

    Parameters
    ----------
    model : RobotModel
        Nominal model.
    network_prior : WireNetworkPrior
        Places with their deviations, and the priors of everything else.
    mountings : sequence of Mounting
        Lengths with the controller's joints [m, rad].

    Returns
    -------
    WireNetwork
        Places with their joint covariance, residuals, and the length that fits worst.

    Raises
    ------
    DegenerateDataError
        A mounting with fewer than three lengths.
    CalibrationError
        Shapes that do not match, numbers that are not finite.

    Notes
    -----
    The base frame is that of the arm's own first axis and zero, the flange frame that of its last joint: the
    geometry errors that only move these frames as a whole are held at zero (theta and d of the first row; theta,
    d, a and alpha of the last; beta where consecutive axes are not parallel).

    References
    ----------
    Derived in calibration/README.md, section 6. Lip: a wire bent by phi around radius r is r (phi - sin phi) longer.
    """
    return _make_result(*_fit_network(model, network_prior, mountings))


def length_misses(
    model: RobotModel, network_prior: WireNetworkPrior, mountings: Sequence[WireMounting]
) -> Array:
    """Return what every length misses the same fit by, measured minus computed, one mounting after the other [m].

    A length whose deviation is a metre weighs nothing in the fit, and its miss is told all the same.
    """
    _, solved, lengths, _ = _fit_network(model, network_prior, mountings)
    return np.asarray(lengths - solved.terms.lengths, dtype=np.float64)


@dataclass(frozen=True, eq=False, slots=True)
class _NetworkEstimate:
    """A maximum a posteriori estimate, and what the lengths are from the nominal ones, linearised."""

    x: Array
    covariance: Array
    terms: WireTerms
    innovation: Array


def _fit_network(
    model: RobotModel, network_prior: WireNetworkPrior, mountings: Sequence[WireMounting]
) -> tuple[WireEquations, _NetworkEstimate, Array, float]:
    """Return the fit with the lengths it is of, and how much larger the disturbances are than believed."""
    _check_mountings(model, network_prior, mountings)
    network = WireEquations(model, network_prior, mountings)
    lengths = np.concatenate([m.lengths_m for m in mountings])
    solved = _solve_network(network, lengths, 1.0)
    factor = _disturbance_factor(network, solved)
    return network, _solve_network(network, lengths, factor, solved.x), lengths, factor


def _solve_network(
    network: WireEquations, lengths: Array, factor: float, start: Array | None = None
) -> _NetworkEstimate:
    nominal, sigma = network.nominal, network.sigma
    x = nominal.copy() if start is None else start
    for _ in range(_MAX_ITERATIONS):
        terms = network.wire_terms(x)
        by_x = terms.by_parameter * sigma
        weighted = np.linalg.solve(network.length_covariance(terms, factor), by_x)
        information = by_x.T @ weighted + np.eye(len(x))
        pull = weighted.T @ (lengths - terms.lengths) - (x - nominal) / sigma
        step = np.linalg.solve(information, pull)
        x = x + sigma * step
        if float(np.abs(step).max()) < _SETTLED:
            break
    terms = network.wire_terms(x)
    covariance = np.linalg.inv(information) * np.outer(sigma, sigma)
    innovation = lengths - terms.lengths + terms.by_parameter @ (x - nominal)
    return _NetworkEstimate(x, np.asarray(covariance, dtype=np.float64), terms, innovation)


def _disturbance_factor(network: WireEquations, solved: _NetworkEstimate) -> float:
    """Return by what factor the disturbances are most likely larger than believed (marginal likelihood)."""
    weighted = solved.terms.by_parameter * network.sigma
    disturbance = network.disturbance_covariance(solved.terms)
    scatter = weighted @ weighted.T + network.length_covariance(solved.terms) - disturbance
    factors = np.exp(np.linspace(-_MOST_LOG_FACTOR, _MOST_LOG_FACTOR, _FACTOR_STEPS))
    misfits = []
    for factor in factors:
        lower = np.linalg.cholesky(scatter + factor**2 * disturbance)
        white = np.linalg.solve(lower, solved.innovation)
        misfits.append(float(white @ white) + 2.0 * float(np.log(np.diag(lower)).sum()))
    prior_misfit = (np.log(factors) / _LOG_FACTOR_SIGMA) ** 2
    return float(factors[np.argmin(np.array(misfits) + prior_misfit)])


def _make_result(
    network: WireEquations, solved: _NetworkEstimate, lengths: Array, factor: float
) -> WireNetwork:
    weighted = solved.terms.by_parameter * network.sigma
    precision = np.linalg.inv(network.length_covariance(solved.terms, factor) + weighted @ weighted.T)
    deviations = np.abs(precision @ solved.innovation) / np.sqrt(np.diag(precision))
    worst = int(np.argmax(deviations))
    mounting = int(np.searchsorted(network.rows, worst, side="right")) - 1
    first, places = network.first, solved.x[: network.first].reshape(-1, 3)
    exits = len(network.network_prior.exits)
    residuals = lengths - solved.terms.lengths
    return WireNetwork(
        exits_m=tuple(_to_triple(p) for p in places[:exits]),
        hooks_m=tuple(_to_triple(p) for p in places[exits:]),
        covariance=tuple(
            tuple(float(v) for v in row)
            for row in solved.covariance[: first + WIRE_PARAMETERS, : first + WIRE_PARAMETERS]
        ),
        zero_m=float(solved.x[first]),
        scale=float(solved.x[first + 1]),
        exit_radius_m=float(solved.x[first + 2]),
        slow_m=(float(solved.x[first + 3]), float(solved.x[first + 4])),
        n=len(lengths),
        residual_rms_m=float(np.sqrt(np.mean(residuals**2))),
        chi_square=float(solved.innovation @ precision @ solved.innovation),
        disturbance_factor=factor,
        worst_mounting=mounting,
        worst_capture=worst - int(network.rows[mounting]),
        worst_deviation=float(deviations[worst]),
    )


def _check_mountings(
    model: RobotModel, network_prior: WireNetworkPrior, mountings: Sequence[WireMounting]
) -> None:
    if not mountings:
        raise DegenerateDataError("no length was taken.", remedy="Mount the wire and capture some poses.")
    for m, mounting in enumerate(mountings, 1):
        count = len(mounting.lengths_m)
        if count < 3:
            raise DegenerateDataError(
                f"mounting {m} has {count} lengths: fewer than three fix no point.",
                remedy="Take more of them.",
            )
        if {len(mounting.joints_rad), len(mounting.sigma_m)} != {count}:
            raise CalibrationError(f"mounting {m}: every length needs its joints and its deviation")
        if any(len(joints) != model.axis_count for joints in mounting.joints_rad):
            raise CalibrationError(f"mounting {m}: every length needs {model.axis_count} joint angles")
        if not (
            0 <= mounting.exit < len(network_prior.exits) and 0 <= mounting.hook < len(network_prior.hooks)
        ):
            raise CalibrationError(f"mounting {m} names an exit or a hook that is not described")
        _check_numbers(mounting, m)


def _check_numbers(mounting: WireMounting, number: int) -> None:
    values = [*mounting.lengths_m, *mounting.sigma_m, *(q for joints in mounting.joints_rad for q in joints)]
    if not np.isfinite([*values, *(mounting.mouth_at_m or ())]).all():
        raise CalibrationError(f"mounting {number}: joints, lengths and deviations must be finite")
    if min(mounting.sigma_m) <= 0:
        raise CalibrationError(f"mounting {number}: the sensor's deviation must be above zero")


def _covariance_block(covariance: Array, places: Sequence[int]) -> Array:
    index = [3 * p + axis for p in places for axis in range(3)]
    block: Array = covariance[np.ix_(index, index)]
    return block


def _to_triple(values: Array) -> Triple:
    x, y, z = (float(v) for v in values)
    return (x, y, z)
