"""Which pose to measure next with a draw-wire on exits or hooks, and what all poses together will tell."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.wires.network import Mounting, Network, WireBelief


@dataclass(frozen=True, eq=False, slots=True)
class Outlook:
    """What is known of places after the lengths so far, and what each candidate would add."""

    covariance: Array  # (3 P, 3 P) of the places asked for [m^2]
    gains: Array  # (C,) by how much a candidate would shrink the trace of the covariance of the first place [m^2]


def expected_covariance(
    model: RobotModel, belief: WireBelief, mountings: Sequence[Mounting], places: Sequence[int], factor: float
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
    network, index = Network(model, belief, mountings), _coordinates(places)
    terms = network.terms(network.nominal)
    spread = terms.by_parameter * network.sigma
    total = spread @ spread.T + network.scatter(terms, factor)
    shared = spread[:, index] * network.sigma[index]
    covariance: Array = np.diag(network.sigma[index] ** 2) - shared.T @ np.linalg.solve(total, shared)
    return (covariance + covariance.T) / 2.0


def look_ahead(
    model: RobotModel,
    belief: WireBelief,
    mountings: Sequence[Mounting],
    candidates: Mounting,
    place: int,
    factor: float = 1.0,
) -> Outlook:
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
    network, index = Network(model, belief, [*mountings, candidates]), _coordinates([place])
    first = int(network.rows[-2])
    covariance, gains, _ = _conditioned(network, index, first, factor)
    return Outlook(covariance, gains)


def best_order(
    model: RobotModel, belief: WireBelief, known: Sequence[Mounting], candidates: Mounting, k: int
) -> tuple[int, ...]:
    """Return k candidates of a mounting, best first, for the place that this mounting is there to find.

    Greedy; the place is the exit if it is the less well known one, else the hook.
    """
    network = Network(model, belief, [*known, candidates])
    exit_sigma = belief.exits[candidates.exit].sigma_m
    hook = len(belief.exits) + candidates.hook
    place = candidates.exit if exit_sigma >= belief.hooks[candidates.hook].sigma_m else hook
    _, gains, state = _conditioned(network, _coordinates([place]), int(network.rows[-2]), 1.0)
    chosen: list[int] = []
    while len(chosen) < min(k, len(gains)):
        gains = (state.shared**2).sum(axis=1) / np.diag(state.total)
        gains[chosen] = -np.inf
        best = int(np.argmax(gains))
        chosen.append(best)
        state = state.after(best)
    return tuple(chosen)


def with_poses(mounting: Mounting, joints_rad: Array, sigma_m: float) -> Mounting:
    """Return the mounting with other poses whose lengths are not known yet."""
    poses = tuple(tuple(float(q) for q in pose) for pose in joints_rad)
    return replace(mounting, joints_rad=poses, lengths_m=(0.0,) * len(poses), sigma_m=(sigma_m,) * len(poses))


@dataclass(frozen=True, eq=False, slots=True)
class _State:
    """Candidates after some looks: covariance with the place (C, 3), and among themselves (C, C)."""

    shared: Array
    total: Array

    def after(self, index: int) -> "_State":
        gain = self.total[:, index] / self.total[index, index]
        return _State(
            self.shared - np.outer(gain, self.shared[index]),
            self.total - np.outer(gain, self.total[index]) + 1e-18 * np.eye(len(gain)),
        )


def _conditioned(
    network: Network, index: list[int], first: int, factor: float
) -> tuple[Array, Array, _State]:
    """Return the place's covariance after the first rows, each other row's gain, and the state behind them."""
    terms = network.terms(network.nominal)
    spread = terms.by_parameter * network.sigma
    total = spread @ spread.T + network.scatter(terms, factor)
    shared = spread[:, index] * network.sigma[index]
    known = np.linalg.solve(total[:first, :first], np.hstack([total[:first, first:], shared[:first]]))
    across, towards = known[:, : len(total) - first], known[:, len(total) - first :]
    state = _State(
        shared[first:] - total[first:, :first] @ towards,
        total[first:, first:] - total[first:, :first] @ across,
    )
    covariance = np.diag(network.sigma[index] ** 2) - shared[:first].T @ towards
    gains: Array = (state.shared**2).sum(axis=1) / np.diag(state.total)
    return covariance, gains, state


def _coordinates(places: Sequence[int]) -> list[int]:
    return [3 * place + axis for place in places for axis in range(3)]
