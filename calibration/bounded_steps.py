"""The careful way to a pose: Levenberg-Marquardt inside a box of joints, for the few postures that need it."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from calibration.damped_solve import damped_step
from calibration.geometry import Array
from calibration.pose_gap import Arm, Flags, Gap, Target, gap_between

_FIRST_DAMPING = 1e-4
_FLOOR = 1e-12  # keeps Cholesky real where the arm is singular
_STUCK = 1e3  # of the damping: such steps are too small to matter, and still do not help
_STEPS = 80
_KICK_RAD = 0.02


@dataclass(eq=False)
class Search:
    """Postures on their way, components first and the pose last."""

    arm: Arm
    target: Target
    joints: Array  # (n, N) [rad]
    lower: Array  # (n, N), the box that is never left
    upper: Array
    gap: Gap
    settled: Flags  # no small step helps any more
    steps: Array  # (N,) taken

    @classmethod
    def begin(cls, arm: Arm, target: Target, joints: Array, box: tuple[Array, Array]) -> Self:
        """Return a search that starts inside its box."""
        count = joints.shape[1]
        gap = gap_between(arm, joints, target)
        return cls(arm, target, joints, *box, gap, np.zeros(count, dtype=bool), np.zeros(count))

    def run(self, position_m: float, angle_rad: float, max_step_rad: float) -> None:
        """Approach; leave singular resting places that are no nearest ones; approach again."""
        self._approach(position_m, angle_rad, max_step_rad)
        if self._kick(position_m, angle_rad):
            self._approach(position_m, angle_rad, max_step_rad)

    def pushes(self) -> tuple[Flags, Flags]:
        """Tell which joints (n, N) rest at the lower, and at the upper side of the box and would go on."""
        pull = np.einsum("kin,in->kn", self.gap.columns(self.arm), self.gap.error)
        return (self.joints <= self.lower) & (pull < 0), (self.joints >= self.upper) & (pull > 0)

    def trial(self, damping: Array, max_step_rad: float) -> Array:
        """Return where a damped step leads, joints that push against the box held still."""
        low, high = self.pushes()
        columns = self.gap.columns(self.arm) * ~(low | high)[:, None]
        step = damped_step(columns, self.gap.error, damping)
        longest = np.abs(step).max(axis=0)
        step *= np.minimum(1.0, max_step_rad / np.maximum(longest, 1e-300))
        return np.clip(self.joints + step, self.lower, self.upper)

    def _approach(self, position_m: float, angle_rad: float, max_step_rad: float) -> None:
        going = ~self.gap.met(position_m, angle_rad) & ~self.settled
        damping = np.full(len(going), _FIRST_DAMPING)
        for _ in range(_STEPS):
            if not going.any():
                return
            part = self._part(going)
            trial = part.trial(damping[going], max_step_rad)
            gap = gap_between(self.arm, trial, part.target)
            better = gap.cost < part.gap.cost
            chosen = np.flatnonzero(going)
            self._move(chosen[better], trial[:, better], gap, better)
            self.steps[chosen] += 1
            damping[chosen] = np.where(better, np.maximum(damping[chosen] * 0.1, _FLOOR), damping[chosen] * 8)
            self.settled |= damping > _STUCK
            going &= ~self.gap.met(position_m, angle_rad) & ~self.settled

    def _kick(self, position_m: float, angle_rad: float) -> bool:
        """Push interior resting places along the motion that the arm has lost there, and tell whether any moved.

        Where the tip does not follow a motion of the joints to first order, a pose may rest between two ways on:
        a wrist with axes 4 and 6 in line cannot begin to turn about the third direction.
        """
        low, high = self.pushes()
        resting = self.settled & ~self.gap.met(position_m, angle_rad) & ~(low | high).any(axis=0)
        if not resting.any():
            return False
        part = self._part(resting)
        matrices = part.gap.columns(self.arm).transpose(2, 1, 0)
        lost = np.linalg.svd(matrices)[2][:, -1].T
        chosen = np.flatnonzero(resting)
        best = part.gap.cost * (1 + 1e-6)
        for sign in (1.0, -1.0):
            trial = np.clip(part.joints + sign * _KICK_RAD * lost, part.lower, part.upper)
            gap = gap_between(self.arm, trial, part.target)
            better = gap.cost < best
            self._move(chosen[better], trial[:, better], gap, better)
            self.settled[chosen[better]] = False
            best = np.where(better, gap.cost, best)
        return not self.settled[chosen].all()

    def _part(self, chosen: Flags) -> "Search":
        return Search(
            self.arm,
            self.target.take(chosen),
            self.joints[:, chosen],
            self.lower[:, chosen],
            self.upper[:, chosen],
            self.gap.take(chosen),
            self.settled[chosen],
            self.steps[chosen],
        )

    def _move(self, rows: NDArray[np.intp], joints: Array, gap: Gap, better: Flags) -> None:
        """Accept new postures with what was seen there."""
        self.joints[:, rows] = joints
        old = self.gap
        fields = [
            (old.error, gap.error),
            (old.cosine, gap.cosine),
            (old.rotations, gap.rotations),
            (old.origins, gap.origins),
        ]
        for before, after in fields:
            before[..., rows] = after[..., better]
        self.gap = Gap(old.error, old.cosine, old.rotations, old.origins)
