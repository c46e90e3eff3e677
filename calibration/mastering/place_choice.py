"""Places compared with each other: what visiting some of them would tell. All are looked at once."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import DriveTrain, RecoveryKit
from cellcal.calibration.mastering.place_evidence import PlaceProblem
from cellcal.calibration.mastering.pose_design import TURN_UNCERTAINTY
from cellcal.calibration.mastering.turn_verification import detection_deviations

_AMPLE_SIGMAS = 20.0


@dataclass(frozen=True, eq=False)
class PlaceChoice:
    """The places of a kit that could be visited again, in its order; places count from 0 here, nests left out."""

    by_turn: Array  # (m, n)
    scatter: Array  # (m, m)
    wrong_turns: Array  # (m, s) how far each wrong turn, and each two, would shift each row
    rows: tuple[slice, ...]
    per_turn: Array

    @classmethod
    def from_kit(
        cls, model: RobotModel, kit: RecoveryKit, robot: tuple[DriveTrain, tuple[int, ...]]
    ) -> "PlaceChoice":
        """Look at every place of a kit."""
        problem = PlaceProblem(model, kit, robot, kit.places)
        local = problem.linearise_at(np.zeros(model.axis_count))
        wrong_turns = detection_deviations(problem, local) * np.sqrt(np.diag(local.scatter))[:, None]
        return cls(local.by_turn, local.scatter, wrong_turns, tuple(local.rows), robot[0].radians_per_turn())

    def turn_covariance(self, chosen: Sequence[int]) -> Array:
        """Return (n, n) [turns^2] of real estimates of the turns from these places."""
        information = np.eye(self.by_turn.shape[1]) / TURN_UNCERTAINTY**2
        if len(chosen):
            at = np.concatenate([np.arange(self.rows[k].start, self.rows[k].stop) for k in chosen])
            by_turn = self.by_turn[at]
            information = information + by_turn.T @ np.linalg.solve(self.scatter[np.ix_(at, at)], by_turn)
        return np.asarray(np.linalg.inv(information), dtype=np.float64)

    def best_fit(self, count: int) -> list[int]:
        """Choose places greedily for the smallest sum of the variances of the joints' offsets (A-optimality)."""
        chosen: list[int] = []
        for _ in range(min(count, len(self.rows))):
            chosen.append(self.best_addition(chosen))
        return chosen

    def best_addition(self, chosen: Sequence[int]) -> int:
        """Return the place that makes the sum of the variances of the joints' offsets smallest beside these."""
        remaining = [k for k in range(len(self.rows)) if k not in chosen]
        return min(remaining, key=lambda k: self._turn_spread([*chosen, k]))

    def best_checks(self, covariance: Array, used: Sequence[int], count: int) -> list[int]:
        """Choose places that together show best the wrong story that they show worst.

        ``turn_covariance`` (n, n) [turns^2] is what the fitted places leave open.
        """
        variances = np.diag(self.scatter) + np.einsum("mi,ij,mj->m", self.by_turn, covariance, self.by_turn)
        power = self.wrong_turns / np.sqrt(variances)[:, None]
        by_place = np.array([power[row].max(axis=0) for row in self.rows])
        chosen: list[int] = []
        detection_power = np.zeros(by_place.shape[1])
        for _ in range(count):
            remaining = [k for k in range(len(self.rows)) if k not in (*used, *chosen)]
            then = np.minimum(np.maximum(by_place[remaining], detection_power), _AMPLE_SIGMAS)
            chosen.append(remaining[int(np.argmax(100.0 * then.min(axis=1) + then.mean(axis=1)))])
            detection_power = np.maximum(detection_power, by_place[chosen[-1]])
        return chosen

    def _turn_spread(self, chosen: list[int]) -> float:
        return float(np.trace(self.per_turn @ self.turn_covariance(chosen) @ self.per_turn.T))
