"""One draw-wire mounted at several places: parameters, beliefs and lengths that its fit and a design share.

A fixture alignment moves the wire's exit from one alignment point to the next; an end-effector calibration moves
its hook. All lengths share the wire's zero, scale and exit lip, the arm's geometry and its sag, so one fit of all
of them knows more than one trilateration after another, and knows what they share.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.joint_terms import gravity_terms, term_values
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.wires.arm import flank_values, free_geometry
from cellcal.calibration.wires.lip import WireExit
from cellcal.calibration.wires.model import (
    WirePoses,
    WirePrior,
    WireTerms,
    disturbance_covariance,
    wire_terms,
)

Triple = tuple[float, float, float]
Joints = tuple[float, ...]

WIRE_PARAMETERS = 5  # zero, scale, lip, slow linearity


@dataclass(frozen=True, slots=True)
class WirePlace:
    """An exit (base frame) or a hook (flange frame) as far as a tape measure or a drawing tells."""

    at_m: Triple
    sigma_m: float  # of one coordinate

    def __post_init__(self) -> None:
        if not np.isfinite([*self.at_m, self.sigma_m]).all() or self.sigma_m <= 0:
            raise CalibrationError("a place needs finite coordinates and a deviation above zero")


@dataclass(frozen=True, slots=True)
class WireNetworkPrior:
    """Knowledge of wire and arm before measuring; ``wire`` gives zero, scale, geometry and disturbances.

    With the sag of the joints among the parameters, what is left of flexing is small: the defaults of
    ``with_certified_scale``.
    """

    wire: WirePrior
    exits: tuple[WirePlace, ...]
    hooks: tuple[WirePlace, ...]
    exit_radius_m: float = 0.0015  # of the lip over which the wire bends
    sigma_exit_radius_m: float = 0.0003
    range_m: float = 3.0  # of the wire
    sigma_slow_m: float = 5e-5  # of its linearity, as far as that is one wave over the whole range
    sigma_sag_rad_m: float = 1e-3  # of a joint per metre of a link's lever
    sigma_flank_rad: float = 1e-4  # half the backlash of a joint whose tooth flank gravity chooses
    sigma_mouth_rad: float = 0.05  # of the mouth's direction, turned to a place by eye …
    sigma_unseen_mouth_rad: float = (
        0.5  # … or its direction is not given: about the mean of all hooks at that exit
    )

    def wire_values(self) -> tuple[float, ...]:
        """Return what is believed of scale [1], lip and slow linearity [m]: they stay with the wire."""
        return (1.0, self.exit_radius_m, 0.0, 0.0)

    def wire_sigmas(self) -> tuple[float, ...]:
        """Return the deviations of ``wire_values``."""
        return (self.wire.sigma_scale, self.sigma_exit_radius_m, self.sigma_slow_m, self.sigma_slow_m)

    @classmethod
    def with_certified_scale(
        cls, wire: WirePrior, exits: tuple[WirePlace, ...], hooks: tuple[WirePlace, ...], sigma_scale: float
    ) -> "WireNetworkPrior":
        """Return the belief for a wire whose scale is certified, with sag told apart from other disturbances."""
        disturbed = replace(
            wire,
            sigma_scale=sigma_scale,
            sigma_unmodelled_m=4e-5,
            sigma_linearity_m=6e-5,
            sigma_exit_m=0.0,  # the radius of the exit's lip is a parameter here
            sigma_flex_rad=4e-5,
            sigma_ripple_rad=5e-5,
        )
        return cls(disturbed, exits, hooks)


@dataclass(frozen=True, slots=True)
class WireMounting:
    """Lengths taken with the wire in one place: which exit, which hook, and where the wire's mouth looks."""

    exit: int
    hook: int
    joints_rad: tuple[Joints, ...]
    lengths_m: tuple[float, ...]
    sigma_m: tuple[float, ...]
    mouth_at_m: Triple | None = None  # a point straight in front of the exit, base frame; None: the mean hook
    another_day: bool = False  # hung in again: hook and zero may differ by the session's deviation


class WireEquations:
    """The linear algebra that a fit and a design share: parameters, priors, lengths and their covariance."""

    def __init__(
        self, model: RobotModel, network_prior: WireNetworkPrior, mountings: Sequence[WireMounting]
    ) -> None:
        self.model, self.network_prior, self.mountings = model, network_prior, mountings
        self.free = free_geometry(model)
        self.sag = gravity_terms(model)
        joints = [np.array(m.joints_rad, dtype=float).reshape(-1, model.axis_count) for m in mountings]
        sigmas = [np.array(m.sigma_m, dtype=float) for m in mountings]
        self.rows = np.cumsum([0, *map(len, joints)])
        self._mouths = self._mouth_directions()
        self.poses = WirePoses.from_record_side(np.concatenate(joints), np.concatenate(sigmas))
        loaded, flanks = flank_values(model, self.poses.joints_rad)
        moved = np.array([*(term.joint for term in self.sag), *loaded], dtype=np.intp)
        self._sagging = np.linalg.inv(model.joint_coupling).T[moved]
        self._sag_values = np.vstack([term_values(model, self.poses.joints_rad, self.sag), flanks])
        wire, places = network_prior.wire, (*network_prior.exits, *network_prior.hooks)
        self.first = 3 * len(places)  # zero, scale, lip, slow linearity; then geometry, sag, flanks
        angle, length = wire.sigma_angle_rad, wire.sigma_length_m
        sizes = (
            np.tile([angle, length, length, angle, angle], model.axis_count)
            if model.dh is not None
            else np.tile([length] * 3 + [angle] * 3, model.axis_count + 1)
        )
        self.nominal = np.concatenate(
            [
                *[np.array(p.at_m) for p in places],
                [wire.zero_m, *network_prior.wire_values()],
                np.zeros(int(self.free.sum()) + len(moved)),
            ]
        )
        self.sigma = np.concatenate(
            [
                *[np.full(3, p.sigma_m) for p in places],
                [wire.sigma_zero_m, *network_prior.wire_sigmas()],
                sizes[self.free],
                np.full(len(self.sag), network_prior.sigma_sag_rad_m),
                np.full(len(loaded), network_prior.sigma_flank_rad),
            ]
        )

    def _mouth_directions(self) -> list[tuple[int, Triple | None, NDArray[np.intp]]]:
        """Return every way a mouth looks: its exit, the place in front of it, and the rows of all its mountings."""
        ways: dict[tuple[int, Triple | None], list[NDArray[np.intp]]] = {}
        for m, mounting in enumerate(self.mountings):
            rows = np.arange(self.rows[m], self.rows[m + 1], dtype=np.intp)
            ways.setdefault((mounting.exit, mounting.mouth_at_m), []).append(rows)
        return [(exit_, mouth, np.concatenate(rows)) for (exit_, mouth), rows in ways.items()]

    def wire_terms(self, x: Array) -> WireTerms:
        """Return lengths (N,), and derivatives by joint (N, n) and by parameter (N, p)."""
        lengths, by_joint = np.empty(self.rows[-1]), np.empty((self.rows[-1], self.model.axis_count))
        by_x, directions = np.zeros((self.rows[-1], len(x))), np.empty((self.rows[-1], 3))
        geometry = np.zeros(len(self.free))
        geometry[self.free] = x[
            self.first + WIRE_PARAMETERS : self.first + WIRE_PARAMETERS + int(self.free.sum())
        ]
        for m, mounting in enumerate(self.mountings):
            rows = slice(self.rows[m], self.rows[m + 1])
            terms = self._mounted_terms(x, geometry, mounting, rows, by_x)
            lengths[rows], by_joint[rows], directions[rows] = terms.lengths, terms.by_joint, terms.directions
        for exit_, mouth, mouth_rows in self._mouths:
            at = slice(3 * exit_, 3 * exit_ + 3)
            bend = WireExit.from_wires(-by_x[mouth_rows, at], lengths[mouth_rows], x[at], mouth).lip_bend()
            by_x[mouth_rows, self.first + 2] = bend
            lengths[mouth_rows] += bend * x[self.first + 2]
        return WireTerms(self.poses, lengths, by_joint, by_x, directions)

    def _mounted_terms(
        self, x: Array, geometry: Array, mounting: WireMounting, rows: slice, by_x: Array
    ) -> WireTerms:
        """Return the terms of one mounting, its derivatives by its own parameters; fill its rows of ``by_x``."""
        first, poses = (
            self.first,
            WirePoses.from_record_side(self.poses.joints_rad[rows], self.poses.sigma_m[rows]),
        )
        exit_at = slice(3 * mounting.exit, 3 * mounting.exit + 3)
        hook = len(self.network_prior.exits) + mounting.hook
        hook_at = slice(3 * hook, 3 * hook + 3)
        inner = np.concatenate([x[exit_at], x[hook_at], x[first : first + 2], geometry])
        terms = wire_terms(self.model, inner, poses)
        by_inner = terms.by_parameter
        by_x[rows, exit_at], by_x[rows, hook_at] = by_inner[:, :3], by_inner[:, 3:6]
        by_x[rows, first : first + 2] = by_inner[:, 6:8]
        turns = 2.0 * np.pi * terms.lengths / self.network_prior.range_m
        by_x[rows, first + 3 : first + WIRE_PARAMETERS] = np.column_stack([np.sin(turns), np.cos(turns)])
        end = first + WIRE_PARAMETERS + int(self.free.sum())
        by_x[rows, first + WIRE_PARAMETERS : end] = by_inner[:, 8:][:, self.free]
        by_x[rows, end:] = np.einsum("nj,kj,kn->nk", terms.by_joint, self._sagging, self._sag_values[:, rows])
        bent = (
            by_x[rows, first + 3 : first + WIRE_PARAMETERS] @ x[first + 3 : first + WIRE_PARAMETERS]
            + by_x[rows, end:] @ x[end:]
        )
        return replace(terms, lengths=terms.lengths + bent)

    def length_covariance(self, terms: WireTerms, factor: float = 1.0) -> Array:
        """Return (N, N) [m^2]: noise, disturbances and what differs from day to day."""
        return self.disturbance_covariance(terms, factor) + self._noise_covariance(terms)

    def disturbance_covariance(self, terms: WireTerms, factor: float = 1.0) -> Array:
        """Return (N, N) [m^2]: what no parameter describes, larger by a factor than believed."""
        return disturbance_covariance(self.network_prior.wire.scale_disturbances(factor), terms, terms)

    def _noise_covariance(self, terms: WireTerms) -> Array:
        noise = np.diag(terms.noise_variance(self.network_prior.wire))
        for m, mounting in enumerate(self.mountings):
            rows = slice(self.rows[m], self.rows[m + 1])
            if mounting.another_day:
                hook = 3 * (len(self.network_prior.exits) + mounting.hook)
                hung = terms.by_parameter[rows][:, [hook, hook + 1, hook + 2, self.first]]
                noise[rows, rows] += hung @ hung.T * self.network_prior.wire.sigma_session_m**2
        for exit_, mouth, mouth_rows in self._mouths:
            exit_m = np.array(self.network_prior.exits[exit_].at_m)
            towards = -terms.by_parameter[mouth_rows, 3 * exit_ : 3 * exit_ + 3]
            wire = WireExit.from_wires(towards, terms.lengths[mouth_rows], exit_m, mouth)
            sigma = (
                self.network_prior.sigma_unseen_mouth_rad
                if mouth is None
                else self.network_prior.sigma_mouth_rad
            )
            turned = sigma * self.network_prior.exit_radius_m * wire.bend_by_mouth_turn()
            noise[np.ix_(mouth_rows, mouth_rows)] += turned @ turned.T
        return np.asarray(noise, dtype=np.float64)
