"""One draw-wire mounted at several places: where its exits and hooks are, fitted together with the arm's errors.

A fixture alignment moves the wire's exit from one alignment point to the next; an end-effector calibration moves
its hook. All lengths share the wire's zero, scale and exit lip, the arm's geometry and its sag, so one fit of all
of them knows more than one trilateration after another, and knows what they share.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.arm.joint_terms import gravity_terms, term_values
from calibration.arm.kinematics import RobotModel
from calibration.errors import CalibrationError, DegenerateDataError
from calibration.geometry import Array
from calibration.uncertainty import chi_square_limit
from calibration.wires.arm import flank_values, free_geometry
from calibration.wires.lip import Leaving
from calibration.wires.model import WirePrior, WireSeen, WireTerms, disturbance_covariance, wire_terms

Triple = tuple[float, float, float]
Joints = tuple[float, ...]

_MAX_ITERATIONS = 15
_SETTLED = 1e-4  # of a parameter's deviation
_LOG_FACTOR_SIGMA, _MOST_LOG_FACTOR, _FACTOR_STEPS = 0.5, 1.0, 21  # belief in the size of the disturbances
_WIRE = 5  # parameters of the wire: zero, scale, lip, slow linearity
_STANDS_OUT = 4.5  # deviations


@dataclass(frozen=True, slots=True)
class Place:
    """An exit (base frame) or a hook (flange frame) as far as a tape measure or a drawing tells."""

    at_m: Triple
    sigma_m: float  # of one coordinate

    def __post_init__(self) -> None:
        if not np.isfinite([*self.at_m, self.sigma_m]).all() or self.sigma_m <= 0:
            raise CalibrationError("a place needs finite coordinates and a deviation above zero")


@dataclass(frozen=True, slots=True)
class WireBelief:
    """What is known of wire and arm before measuring; ``wire`` gives zero, scale, geometry and disturbances.

    With the sag of the joints among the parameters, what is left of flexing is small: the defaults of ``tight``.
    """

    wire: WirePrior
    exits: tuple[Place, ...]
    hooks: tuple[Place, ...]
    exit_radius_m: float = 0.0015  # of the lip over which the wire bends
    sigma_exit_radius_m: float = 0.0003
    range_m: float = 3.0  # of the wire
    sigma_slow_m: float = 5e-5  # of its linearity, as far as that is one wave over the whole range
    sigma_sag_rad_m: float = 1e-3  # of a joint per metre of a link's lever
    sigma_flank_rad: float = 1e-4  # half the backlash of a joint whose tooth flank gravity chooses
    sigma_mouth_rad: float = 0.05  # of the mouth's direction, turned to a place by eye …
    sigma_unseen_mouth_rad: float = 0.5  # … or nobody said where to: about the mean of all hooks at that exit

    def wire_values(self) -> tuple[float, ...]:
        """Return what is believed of scale [1], lip and slow linearity [m]: they stay with the wire."""
        return (1.0, self.exit_radius_m, 0.0, 0.0)

    def wire_sigmas(self) -> tuple[float, ...]:
        """Return the deviations of ``wire_values``."""
        return (self.wire.sigma_scale, self.sigma_exit_radius_m, self.sigma_slow_m, self.sigma_slow_m)

    @classmethod
    def tight(
        cls, wire: WirePrior, exits: tuple[Place, ...], hooks: tuple[Place, ...], sigma_scale: float
    ) -> "WireBelief":
        """Return the belief for a wire whose scale is certified, with sag told apart from other disturbances."""
        disturbed = replace(
            wire,
            sigma_scale=sigma_scale,
            sigma_unmodelled_m=4e-5,
            sigma_linearity_m=6e-5,
            sigma_flex_rad=4e-5,
            sigma_ripple_rad=5e-5,
        )
        return cls(disturbed, exits, hooks)


@dataclass(frozen=True, slots=True)
class Mounting:
    """Lengths taken with the wire in one place: which exit, which hook, and where the wire's mouth looks."""

    exit: int
    hook: int
    joints_rad: tuple[Joints, ...]
    lengths_m: tuple[float, ...]
    sigma_m: tuple[float, ...]
    mouth_at_m: Triple | None = None  # a point straight in front of the exit, base frame; None: the mean hook
    another_day: bool = False  # hung in again: hook and zero may differ by the session's deviation


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

    def consistent(self) -> bool:
        """Tell whether the lengths fit their model at 99.9 % and none stands out."""
        return self.chi_square <= chi_square_limit(self.n) and self.worst_deviation < _STANDS_OUT

    def exit_covariance(self, exits: Sequence[int]) -> Array:
        """Return (3 k, 3 k) of these exits [m^2]."""
        return _block(np.array(self.covariance), exits)

    def exit_and_wire_covariance(self, exits: Sequence[int]) -> Array:
        """Return (3 k + 4, 3 k + 4) of these exits [m^2], then of the scale [1], lip and slow linearity [m]."""
        covariance, last = np.array(self.covariance), 3 * (len(self.exits_m) + len(self.hooks_m))
        index = [*(3 * e + axis for e in exits for axis in range(3)), *range(last + 1, last + _WIRE)]
        together: Array = covariance[np.ix_(index, index)]
        return together

    def hook_covariance(self, hooks: Sequence[int]) -> Array:
        """Return (3 k, 3 k) of these hooks [m^2]."""
        return _block(np.array(self.covariance), [len(self.exits_m) + h for h in hooks])


def fit_network(model: RobotModel, belief: WireBelief, mountings: Sequence[Mounting]) -> WireNetwork:
    r"""Fit all exits, hooks, the wire and the arm's errors to lengths from several mountings.

    ``y = z + s |a_e - T(q + sag(q), g) h_k| + r (phi - sin phi) + d + e``: zero z, scale s, exit a, hook h,
    geometry errors g, exit lip r with the angle phi between the wire and the mouth's direction, disturbances d of
    ``disturbance_covariance`` and sensor noise e. Maximum a posteriori by Gauss-Newton.

    Parameters
    ----------
    model : RobotModel
        Nominal model.
    belief : WireBelief
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
    return _result(*_fitted(model, belief, mountings))


def misses(model: RobotModel, belief: WireBelief, mountings: Sequence[Mounting]) -> Array:
    """Return what every length misses the same fit by, measured minus computed, one mounting after the other [m].

    A length whose deviation is a metre weighs nothing in the fit, and its miss is told all the same.
    """
    _, solved, lengths, _ = _fitted(model, belief, mountings)
    return np.asarray(lengths - solved.terms.lengths, dtype=np.float64)


class Network:
    """The linear algebra that a fit and a design share: parameters, priors, lengths and their covariance."""

    def __init__(self, model: RobotModel, belief: WireBelief, mountings: Sequence[Mounting]) -> None:
        self.model, self.belief, self.mountings = model, belief, mountings
        self.free = free_geometry(model)
        self.sag = gravity_terms(model)
        joints = [np.array(m.joints_rad, dtype=float).reshape(-1, model.axes) for m in mountings]
        sigmas = [np.array(m.sigma_m, dtype=float) for m in mountings]
        self.rows = np.cumsum([0, *map(len, joints)])
        self._mouths = self._looks()
        self.seen = WireSeen.of(np.concatenate(joints), np.concatenate(sigmas))
        loaded, flanks = flank_values(model, self.seen.joints_rad)
        moved = np.array([*(term.joint for term in self.sag), *loaded], dtype=np.intp)
        self._sagging = np.linalg.inv(model.joint_coupling).T[moved]
        self._sag_values = np.vstack([term_values(model, self.seen.joints_rad, self.sag), flanks])
        wire, places = belief.wire, (*belief.exits, *belief.hooks)
        self.first = 3 * len(places)  # zero, scale, lip, slow linearity; then geometry, sag, flanks
        angle, length = wire.sigma_angle_rad, wire.sigma_length_m
        sizes = (
            np.tile([angle, length, length, angle, angle], model.axes)
            if model.dh is not None
            else np.tile([length] * 3 + [angle] * 3, model.axes + 1)
        )
        self.nominal = np.concatenate(
            [
                *[np.array(p.at_m) for p in places],
                [wire.zero_m, *belief.wire_values()],
                np.zeros(int(self.free.sum()) + len(moved)),
            ]
        )
        self.sigma = np.concatenate(
            [
                *[np.full(3, p.sigma_m) for p in places],
                [wire.sigma_zero_m, *belief.wire_sigmas()],
                sizes[self.free],
                np.full(len(self.sag), belief.sigma_sag_rad_m),
                np.full(len(loaded), belief.sigma_flank_rad),
            ]
        )

    def _looks(self) -> list[tuple[int, Triple | None, NDArray[np.intp]]]:
        """Return every way a mouth looks: its exit, the place in front of it, and the rows of all its mountings."""
        ways: dict[tuple[int, Triple | None], list[NDArray[np.intp]]] = {}
        for m, mounting in enumerate(self.mountings):
            rows = np.arange(self.rows[m], self.rows[m + 1], dtype=np.intp)
            ways.setdefault((mounting.exit, mounting.mouth_at_m), []).append(rows)
        return [(exit_, mouth, np.concatenate(rows)) for (exit_, mouth), rows in ways.items()]

    def terms(self, x: Array) -> WireTerms:
        """Return lengths (N,), and derivatives by joint (N, n) and by parameter (N, p)."""
        lengths, by_joint = np.empty(self.rows[-1]), np.empty((self.rows[-1], self.model.axes))
        by_x = np.zeros((self.rows[-1], len(x)))
        geometry = np.zeros(len(self.free))
        geometry[self.free] = x[self.first + _WIRE : self.first + _WIRE + int(self.free.sum())]
        for m, mounting in enumerate(self.mountings):
            rows = slice(self.rows[m], self.rows[m + 1])
            lengths[rows], by_joint[rows] = self._mounted(x, geometry, mounting, rows, by_x)
        for exit_, mouth, seen in self._mouths:
            at = slice(3 * exit_, 3 * exit_ + 3)
            bend = Leaving.of(-by_x[seen, at], lengths[seen], x[at], mouth).bend()
            by_x[seen, self.first + 2] = bend
            lengths[seen] += bend * x[self.first + 2]
        return WireTerms(self.seen, lengths, by_joint, by_x)

    def _mounted(
        self, x: Array, geometry: Array, mounting: Mounting, rows: slice, by_x: Array
    ) -> tuple[Array, Array]:
        """Return lengths and derivatives by joint of one mounting; fill its rows of ``by_x``."""
        first, seen = self.first, WireSeen.of(self.seen.joints_rad[rows], self.seen.sigma_m[rows])
        exit_at = slice(3 * mounting.exit, 3 * mounting.exit + 3)
        hook = len(self.belief.exits) + mounting.hook
        hook_at = slice(3 * hook, 3 * hook + 3)
        inner = np.concatenate([x[exit_at], x[hook_at], x[first : first + 2], geometry])
        terms = wire_terms(self.model, inner, seen)
        by_inner = terms.by_parameter
        by_x[rows, exit_at], by_x[rows, hook_at] = by_inner[:, :3], by_inner[:, 3:6]
        by_x[rows, first : first + 2] = by_inner[:, 6:8]
        turns = 2.0 * np.pi * terms.lengths / self.belief.range_m
        by_x[rows, first + 3 : first + _WIRE] = np.column_stack([np.sin(turns), np.cos(turns)])
        end = first + _WIRE + int(self.free.sum())
        by_x[rows, first + _WIRE : end] = by_inner[:, 8:][:, self.free]
        by_x[rows, end:] = np.einsum("nj,kj,kn->nk", terms.by_joint, self._sagging, self._sag_values[:, rows])
        bent = (
            by_x[rows, first + 3 : first + _WIRE] @ x[first + 3 : first + _WIRE] + by_x[rows, end:] @ x[end:]
        )
        return terms.lengths + bent, terms.by_joint

    def scatter(self, terms: WireTerms, factor: float = 1.0) -> Array:
        """Return (N, N) [m^2]: noise, disturbances and what differs from day to day."""
        return self.disturbance(terms, factor) + self._noise(terms)

    def disturbance(self, terms: WireTerms, factor: float = 1.0) -> Array:
        """Return (N, N) [m^2]: what no parameter describes, larger by a factor than believed."""
        return disturbance_covariance(self.belief.wire.scaled(factor), terms, terms)

    def _noise(self, terms: WireTerms) -> Array:
        noise = np.diag(terms.noise(self.belief.wire))
        for m, mounting in enumerate(self.mountings):
            rows = slice(self.rows[m], self.rows[m + 1])
            if mounting.another_day:
                hook = 3 * (len(self.belief.exits) + mounting.hook)
                hung = terms.by_parameter[rows][:, [hook, hook + 1, hook + 2, self.first]]
                noise[rows, rows] += hung @ hung.T * self.belief.wire.sigma_session_m**2
        for exit_, mouth, seen in self._mouths:
            exit_m, towards = (
                np.array(self.belief.exits[exit_].at_m),
                -terms.by_parameter[seen, 3 * exit_ :][:, :3],
            )
            wire = Leaving.of(towards, terms.lengths[seen], exit_m, mouth)
            sigma = self.belief.sigma_unseen_mouth_rad if mouth is None else self.belief.sigma_mouth_rad
            turned = sigma * self.belief.exit_radius_m * wire.by_mouth()
            noise[np.ix_(seen, seen)] += turned @ turned.T
        return np.asarray(noise, dtype=np.float64)


@dataclass(frozen=True, eq=False, slots=True)
class _Solved:
    """A maximum a posteriori estimate, and what the lengths are from the nominal ones, linearised."""

    x: Array
    covariance: Array
    terms: WireTerms
    innovation: Array


def _fitted(
    model: RobotModel, belief: WireBelief, mountings: Sequence[Mounting]
) -> tuple[Network, _Solved, Array, float]:
    """Return the fit with the lengths it is of, and how much larger the disturbances are than believed."""
    _check(model, belief, mountings)
    network = Network(model, belief, mountings)
    lengths = np.concatenate([m.lengths_m for m in mountings])
    solved = _solve(network, lengths, 1.0)
    factor = _disturbance_factor(network, solved)
    return network, _solve(network, lengths, factor, solved.x), lengths, factor


def _solve(network: Network, lengths: Array, factor: float, start: Array | None = None) -> _Solved:
    nominal, sigma = network.nominal, network.sigma
    x = nominal.copy() if start is None else start
    for _ in range(_MAX_ITERATIONS):
        terms = network.terms(x)
        by_x = terms.by_parameter * sigma
        weighted = np.linalg.solve(network.scatter(terms, factor), by_x)
        information = by_x.T @ weighted + np.eye(len(x))
        pull = weighted.T @ (lengths - terms.lengths) - (x - nominal) / sigma
        step = np.linalg.solve(information, pull)
        x = x + sigma * step
        if float(np.abs(step).max()) < _SETTLED:
            break
    terms = network.terms(x)
    covariance = np.linalg.inv(information) * np.outer(sigma, sigma)
    innovation = lengths - terms.lengths + terms.by_parameter @ (x - nominal)
    return _Solved(x, np.asarray(covariance, dtype=np.float64), terms, innovation)


def _disturbance_factor(network: Network, solved: _Solved) -> float:
    """Return by what factor the disturbances are most likely larger than believed (marginal likelihood)."""
    weighted = solved.terms.by_parameter * network.sigma
    disturbance = network.disturbance(solved.terms)
    known = weighted @ weighted.T + network.scatter(solved.terms) - disturbance
    factors = np.exp(np.linspace(-_MOST_LOG_FACTOR, _MOST_LOG_FACTOR, _FACTOR_STEPS))
    misfits = []
    for factor in factors:
        lower = np.linalg.cholesky(known + factor**2 * disturbance)
        white = np.linalg.solve(lower, solved.innovation)
        misfits.append(float(white @ white) + 2.0 * float(np.log(np.diag(lower)).sum()))
    surprise = (np.log(factors) / _LOG_FACTOR_SIGMA) ** 2
    return float(factors[np.argmin(np.array(misfits) + surprise)])


def _result(network: Network, solved: _Solved, lengths: Array, factor: float) -> WireNetwork:
    weighted = solved.terms.by_parameter * network.sigma
    precision = np.linalg.inv(network.scatter(solved.terms, factor) + weighted @ weighted.T)
    deviations = np.abs(precision @ solved.innovation) / np.sqrt(np.diag(precision))
    worst = int(np.argmax(deviations))
    mounting = int(np.searchsorted(network.rows, worst, side="right")) - 1
    first, places = network.first, solved.x[: network.first].reshape(-1, 3)
    exits = len(network.belief.exits)
    residuals = lengths - solved.terms.lengths
    return WireNetwork(
        exits_m=tuple(_triple(p) for p in places[:exits]),
        hooks_m=tuple(_triple(p) for p in places[exits:]),
        covariance=tuple(
            tuple(float(v) for v in row) for row in solved.covariance[: first + _WIRE, : first + _WIRE]
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


def _check(model: RobotModel, belief: WireBelief, mountings: Sequence[Mounting]) -> None:
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
        if any(len(joints) != model.axes for joints in mounting.joints_rad):
            raise CalibrationError(f"mounting {m}: every length needs {model.axes} joint angles")
        if not (0 <= mounting.exit < len(belief.exits) and 0 <= mounting.hook < len(belief.hooks)):
            raise CalibrationError(f"mounting {m} names an exit or a hook that nobody described")
        _check_numbers(mounting, m)


def _check_numbers(mounting: Mounting, number: int) -> None:
    values = [*mounting.lengths_m, *mounting.sigma_m, *(q for joints in mounting.joints_rad for q in joints)]
    if not np.isfinite([*values, *(mounting.mouth_at_m or ())]).all():
        raise CalibrationError(f"mounting {number}: joints, lengths and deviations must be finite")
    if min(mounting.sigma_m) <= 0:
        raise CalibrationError(f"mounting {number}: the sensor's deviation must be above zero")


def _block(covariance: Array, places: Sequence[int]) -> Array:
    index = [3 * p + axis for p in places for axis in range(3)]
    block: Array = covariance[np.ix_(index, index)]
    return block


def _triple(values: Array) -> Triple:
    x, y, z = (float(v) for v in values)
    return (x, y, z)
