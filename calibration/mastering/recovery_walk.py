"""Poses after an encoder loss that tell the turns in little robot time.

A robot that has lost its position may turn one axis at a time, slowly. The time of a recovery is therefore
the sum of the ways of all axes, and poses that are best for the turns alone cost most of an hour. Here
poses and the way between them are chosen together: a walk from where the robot stands.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.mastering.pose_design import TURN_UNCERTAINTY
from cellcal.calibration.wires.model import WirePoses
from cellcal.calibration.wires.reference import WirePredictor

AllowedPostures = Callable[[Array], Array]  # (M, n): booleans, True where all limits are kept

GOAL_TURNS = 0.02  # small enough to tell a new motor from lost turns, as a rule
_STANDING_RAD = 1e-6
_NEAR_RAD = np.deg2rad([20.0, 40.0, 90.0])  # most by which axes turn together
_STEP_RAD = float(np.deg2rad(20.0))
_START_STEP_RAD = float(np.deg2rad(25.0))
_START_SHARE = 0.35  # of the axes that turn before each pose of the first guess
_TRIES, _ROUNDS, _BREADTH = 2, 160, 8
_UNCERTAINTY_COST_S = 200.0  # what one e-fold of missing certainty may cost in robot time
_FORBIDDEN_S = 100.0  # for each corner that breaks a limit: far more than it could save
_WARM_S = 30.0
_AMPLE_POWER = 2.0
NEEDED_POWER, _NEEDED_WEIGHT = 1.4, 100.0  # some power is lost to what the recovery itself does not know
_POWER_S = 3.0  # what covering one more story well may cost in robot time
_AT_ONCE = 64  # sets of captures: their covariances together stay small


@dataclass(frozen=True, slots=True)
class JogTiming:
    """The time of a robot that jogs one axis after the other and comes to rest from one side."""

    speed_rad_s: float = 0.035
    overshoot_rad: float = 0.0174533
    settle_s: float = 1.0
    capture_s: float = 2.5

    def walk_seconds(self, walks: Array) -> Array:
        """Return the time of walks (B, K + 1, n), from where they start, a capture at each stop (B,) [s]."""
        ways = np.diff(walks, axis=1)
        moved, back = np.abs(ways) > _STANDING_RAD, ways < -_STANDING_RAD
        turning = (np.abs(ways) + back * 2.0 * self.overshoot_rad) / self.speed_rad_s
        resting = (1.0 * moved + back) * self.settle_s  # who comes from above goes beyond and returns
        seconds: Array = (turning + resting).sum(axis=(1, 2)) + self.capture_s * ways.shape[1]
        return seconds


@dataclass(frozen=True, eq=False)
class WalkPlanner:
    """Everything about a record and a cell that stays the same while walks are compared."""

    model: RobotModel
    record: MasteringRecord
    allowed: AllowedPostures
    jog_timing: JogTiming = field(default_factory=JogTiming)

    @cached_property
    def _wire_predictor(self) -> WirePredictor:
        return WirePredictor(self.model, *self.record.wire_lengths())

    def plan_walk(self, start_rad: Array, captures: int, *, seed: int = 0) -> Array:
        """Plan a walk whose captures tell every motor's turns to about ``GOAL_TURNS``, as quickly as found.

        Parameters
        ----------
        start_rad : (n,)
            Where the robot stands [rad].
        captures : int
            Poses to stop at.
        seed : int
            Of the search.

        Returns
        -------
        (captures, n)
            Joints in the order of travel [rad]. Limits are looked at where the walk turns: it is for the
            caller to check the ways between, and to ask for another walk where one is not allowed.

        Notes
        -----
        Simulated annealing (Kirkpatrick et al., 1983) over stops and their order. A change moves one axis over
        a stretch of the walk, lets it stand there, or exchanges two stops; a standing axis costs nothing. The
        best of a few walks from different first guesses is taken: they differ by more than longer cooling brings.
        """
        return self.plan_walks(start_rad, captures, seed=seed)[0]

    def plan_walks(self, start_rad: Array, captures: int, *, seed: int = 0) -> list[Array]:
        """Return a few walks of ``plan_walk`` from different first guesses, the best first."""
        start = np.asarray(start_rad, dtype=float)
        tries = [self._anneal_walk(start, captures, np.random.default_rng([seed, k])) for k in range(_TRIES)]
        return [walk for walk, _ in sorted(tries, key=lambda tried: tried[1])]

    def _anneal_walk(self, start: Array, captures: int, rng: np.random.Generator) -> tuple[Array, float]:
        """Return the best walk found in one cooling down, and its cost."""
        turned = rng.random((captures, len(start))) < _START_SHARE
        walk = start + np.cumsum(_START_STEP_RAD * rng.normal(size=turned.shape) * turned, axis=0)
        cost = float(self.walk_cost(walk[None], start)[0])
        best, least = walk, cost
        for k in range(_ROUNDS):
            others = _change_walk(walk, start, rng, _BREADTH)
            costs = self.walk_cost(others, start)
            found = int(np.argmin(costs))
            warmth = _WARM_S * (1.0 - k / _ROUNDS)
            if costs[found] < cost or rng.random() < np.exp((cost - costs[found]) / warmth):
                walk, cost = others[found], float(costs[found])
            if cost < least:
                best, least = walk, cost
        return best, least

    def rate_candidates(
        self, here_rad: Array, measured_rad: Array, candidates_rad: Array, *, efold_s: float
    ) -> tuple[Array, Array]:
        """Return what candidates (C, n) [rad] are worth, and how much each adds to the captures (M, n) [rad].

        A candidate adds the sum, over the motors, of the logs of the deviations without and with it. One e-fold of
        one motor is worth ``efold_s`` of robot time; the time to get there is taken off.
        """
        with_all = np.broadcast_to(measured_rad, (len(candidates_rad), *measured_rad.shape))
        sets = np.concatenate([with_all, candidates_rad[:, None]], axis=1)
        after = [self.turn_sigmas(sets[k : k + _AT_ONCE]) for k in range(0, len(sets), _AT_ONCE)]
        gain = np.log(self.turn_sigmas(measured_rad[None]) / np.concatenate(after)).sum(axis=1)
        return efold_s * gain - self._travel_seconds(here_rad, candidates_rad), gain

    def quick_checks(
        self,
        here_rad: Array,
        candidates_rad: Array,
        power: Array,
        shown: Array,
        captures: int,
        *,
        together: bool = False,
    ) -> list[int]:
        """Choose candidates (C, n) whose power (C, m), 1 being enough, covers every wrong story, near each other.

        ``shown`` (m,) is the power of the checks already made. Twice what is enough counts for nothing more; among
        candidates that add the same the nearest is taken. ``together``: what several captures see adds up in
        squares, for who judges them by their whole covariance; else the sharpest capture counts for each story.
        """
        chosen: list[int] = []
        measured, here = shown, here_rad
        while len(chosen) < min(captures, len(candidates_rad)):
            then = np.hypot(power, measured) if together else np.maximum(power, measured)
            gain = np.minimum(then, _AMPLE_POWER).sum(axis=1)
            gain += _NEEDED_WEIGHT * np.minimum(then, NEEDED_POWER).sum(axis=1)
            worth = gain - self._travel_seconds(here, candidates_rad) / _POWER_S
            worth[chosen] = -np.inf
            chosen.append(int(np.argmax(worth)))
            measured, here = then[chosen[-1]], candidates_rad[chosen[-1]]
        return chosen

    def _travel_seconds(self, here_rad: Array, candidates_rad: Array) -> Array:
        start = np.broadcast_to(here_rad, candidates_rad.shape)
        return self.jog_timing.walk_seconds(np.stack([start, candidates_rad], axis=1))

    def turn_sigmas(self, joints_rad: Array) -> Array:
        """Return what B sets of captures (B, K, n) [rad] would tell: one deviation per motor (B, n) [turns]."""
        sets, count, axes = joints_rad.shape
        predictor = self._wire_predictor
        terms = predictor.wire_terms(
            WirePoses.from_record_side(joints_rad.reshape(-1, axes), predictor.sigma_m)
        )
        scatter = predictor.scatter_of_sets(terms, count)
        by_turn = (terms.by_joint @ self.record.drive.radians_per_turn()).reshape(sets, count, axes)
        information = np.swapaxes(by_turn, 1, 2) @ np.linalg.solve(scatter, by_turn)
        covariance = np.linalg.inv(information + np.eye(axes) / TURN_UNCERTAINTY**2)
        return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))

    def walk_cost(self, walks: Array, start: Array) -> Array:
        """Return (B,) [s]: the time of walks (B, K, n) [rad] from ``start``, and what is left vague or forbidden."""
        excess_uncertainty = np.maximum(0.0, np.log(self.turn_sigmas(walks) / GOAL_TURNS)).sum(axis=1)
        whole = np.concatenate([np.broadcast_to(start, (len(walks), 1, len(start))), walks], axis=1)
        stops = walk_corners(whole)
        turned = np.any(stops != np.concatenate([whole[:, :1], stops[:, :-1]], axis=1), axis=2)
        forbidden = np.zeros(turned.shape, dtype=bool)
        forbidden[turned] = ~self.allowed(stops[turned]).astype(
            bool
        )  # where no axis turned, nothing new is to be seen
        costs: Array = (
            self.jog_timing.walk_seconds(whole)
            + _UNCERTAINTY_COST_S * excess_uncertainty
            + _FORBIDDEN_S * forbidden.sum(axis=1)
        )
        return costs


def walk_corners(walks: Array) -> Array:
    """Return where walks (B, K + 1, n) turn from one axis to the next, J1 first: (B, K n, n) [rad]."""
    count, stops, axes = walks.shape
    done = np.tril(np.ones((axes, axes), dtype=bool))
    ways: Array = np.where(done, walks[:, 1:, None, :], walks[:, :-1, None, :])
    return ways.reshape(count, (stops - 1) * axes, axes)


def nearby_joints(here_rad: Array, count: int, *, seed: int) -> Array:
    """Return ``count`` postures (count, n) [rad] that one to three axes reach, turned by up to 20, 40 or 90 deg."""
    rng = np.random.default_rng(seed)
    axes = len(here_rad)
    turned = rng.random((count, axes)).argsort(axis=1) < rng.integers(1, 4, (count, 1))
    farthest = rng.choice(_NEAR_RAD, (count, 1))
    nearby: Array = here_rad + turned * farthest * rng.uniform(-1.0, 1.0, (count, axes))
    return nearby


def _change_walk(walk: Array, start: Array, rng: np.random.Generator, count: int) -> Array:
    """Return ``count`` walks that differ from this one in one or two places."""
    walks = np.repeat(walk[None], count, axis=0)
    stops, axes = walk.shape
    for other in walks:
        for _ in range(rng.integers(1, 3)):
            first, axis, kind = rng.integers(stops), rng.integers(axes), rng.random()
            last = rng.integers(first, stops) + 1
            if kind < 0.45:
                other[first:last, axis] += _STEP_RAD * rng.normal()
            elif kind < 0.9:
                other[first:last, axis] = start[axis] if first == 0 else other[first - 1, axis]
            else:
                other[[first, last - 1]] = other[[last - 1, first]]
    return walks
