"""Which pose to measure next with a draw-wire on exits or hooks, and what all poses together will tell."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.wires.network import WireEquations, WireMounting, WireNetworkPrior


@dataclass(frozen=True, eq=False, slots=True)
class WirePrediction:
    """The uncertainty of places after the lengths so far, and what each candidate would add."""

    covariance: Array  # (3 P, 3 P) of the places asked for [m^2]
    gains: Array  # (C,) by how much a candidate would shrink the trace of the covariance of the first place [m^2]


def expected_covariance(
    model: RobotModel,
    network_prior: WireNetworkPrior,
    mountings: Sequence[WireMounting],
    places: Sequence[int],
    factor: float,
) -> Array:
    """Return (3 P, 3 P) [m^2]: how well these places are known once all mountings are measured.

    Parameters
    ----------
    model, belief : as for `fit_network`
        Linearised at the belief's own places.
    mountings : sequence of Mounting
        Measured or planned; lengths are not looked at.
    places : sequence of int
        Exits from 0, then hooks.
    factor : float
        How much larger the disturbances are than believed [1].
    """
    network, index = WireEquations(model, network_prior, mountings), _coordinate_indices(places)
    terms = network.wire_terms(network.nominal)
    spread = terms.by_parameter * network.sigma
    total = spread @ spread.T + network.length_covariance(terms, factor)
    shared = spread[:, index] * network.sigma[index]
    covariance: Array = np.diag(network.sigma[index] ** 2) - shared.T @ np.linalg.solve(total, shared)
    return (covariance + covariance.T) / 2.0


def look_ahead(
    model: RobotModel,
    network_prior: WireNetworkPrior,
    mountings: Sequence[WireMounting],
    candidates: WireMounting,
    place: int,
    factor: float = 1.0,
) -> WirePrediction:
    r"""Say what each candidate pose of one mounting would add to what is known of one place.

    Places, wire, arm and disturbances are one Gaussian; after the lengths so far, a candidate with covariance c
    to the place and variance v shrinks the trace of the place's covariance by ``|c|^2 / v`` (A-optimality).

    Parameters
    ----------
    model, belief, mountings : as for `fit_network`
        What is measured; may be empty.
    candidates : Mounting
        Poses that could be measured; its lengths are not looked at.
    place : int
        Exits from 0, then hooks.
    factor : float
        How much larger the disturbances are than believed [1].

    References
    ----------
    V. V. Fedorov, Theory of optimal experiments, 1972.
    """
    network, index = (
        WireEquations(model, network_prior, [*mountings, candidates]),
        _coordinate_indices([place]),
    )
    first = int(network.rows[-2])
    covariance, gains, _ = _condition_on_rows(network, index, first, factor)
    return WirePrediction(covariance, gains)


def best_order(
    model: RobotModel,
    network_prior: WireNetworkPrior,
    measured: Sequence[WireMounting],
    candidates: WireMounting,
    k: int,
) -> tuple[int, ...]:
    """Return k candidates of a mounting, best first, for the place that this mounting is there to find.

    Greedy; the place is the exit if it is the less well known one, else the hook.
    """
    network = WireEquations(model, network_prior, [*measured, candidates])
    exit_sigma = network_prior.exits[candidates.exit].sigma_m
    hook = len(network_prior.exits) + candidates.hook
    place = candidates.exit if exit_sigma >= network_prior.hooks[candidates.hook].sigma_m else hook
    _, gains, state = _condition_on_rows(network, _coordinate_indices([place]), int(network.rows[-2]), 1.0)
    chosen: list[int] = []
    while len(chosen) < min(k, len(gains)):
        gains = (state.shared**2).sum(axis=1) / np.diag(state.total)
        gains[chosen] = -np.inf
        best = int(np.argmax(gains))
        chosen.append(best)
        state = state.after_measuring(best)
    return tuple(chosen)


def with_poses(mounting: WireMounting, joints_rad: Array, sigma_m: float) -> WireMounting:
    """Return the mounting with other poses whose lengths are not known yet."""
    poses = tuple(tuple(float(q) for q in pose) for pose in joints_rad)
    return replace(mounting, joints_rad=poses, lengths_m=(0.0,) * len(poses), sigma_m=(sigma_m,) * len(poses))


@dataclass(frozen=True, eq=False, slots=True)
class _CandidateState:
    """Candidates after some looks: covariance with the place (C, 3), and among themselves (C, C)."""

    shared: Array
    total: Array

    def after_measuring(self, index: int) -> "_CandidateState":
        gain = self.total[:, index] / self.total[index, index]
        return _CandidateState(
            self.shared - np.outer(gain, self.shared[index]),
            self.total - np.outer(gain, self.total[index]) + 1e-18 * np.eye(len(gain)),
        )


def _condition_on_rows(
    network: WireEquations, index: list[int], first: int, factor: float
) -> tuple[Array, Array, _CandidateState]:
    """Return the place's covariance after the first rows, each other row's gain, and the state behind them."""
    terms = network.wire_terms(network.nominal)
    spread = terms.by_parameter * network.sigma
    total = spread @ spread.T + network.length_covariance(terms, factor)
    shared = spread[:, index] * network.sigma[index]
    solution = np.linalg.solve(total[:first, :first], np.hstack([total[:first, first:], shared[:first]]))
    across, towards = solution[:, : len(total) - first], solution[:, len(total) - first :]
    state = _CandidateState(
        shared[first:] - total[first:, :first] @ towards,
        total[first:, first:] - total[first:, :first] @ across,
    )
    covariance = np.diag(network.sigma[index] ** 2) - shared[:first].T @ towards
    gains: Array = (state.shared**2).sum(axis=1) / np.diag(state.total)
    return covariance, gains, state


def _coordinate_indices(places: Sequence[int]) -> list[int]:
    return [3 * place + axis for place in places for axis in range(3)]
