"""The careful way to a pose: Levenberg-Marquardt inside a box of joints, for the few postures that need it."""

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.compensation.damped_solve import damped_step
from cellcal.calibration.compensation.pose_gap import Flags, PoseGap, TargetPoses, TipArm, gap_between
from cellcal.calibration.geometry import Array

_FIRST_DAMPING = 1e-4
_FLOOR = 1e-12  # keeps Cholesky real where the arm is singular
_STUCK = 1e3  # of the damping: such steps are too small to matter, and still do not help
_STEPS = 80
_STEPS_BEYOND = 30
_RESTING = 1e-6  # slope over distance: no direction leads nearer
_RESTART_STEPS_RAD = (0.15, -0.15)
_WORTH = 1e-3  # of the squared distance, or another resting place is as good


class ReachTolerance(Protocol):
    """When a pose counts as reached, and the longest step."""

    @property
    def position_m(self) -> float: ...
    @property
    def angle_rad(self) -> float: ...
    @property
    def max_step_rad(self) -> float: ...


@dataclass(eq=False)
class BoundedSearch:
    """Postures on their way, components first and the pose last."""

    arm: TipArm
    target: TargetPoses
    joints: Array  # (n, N) [rad]
    lower: Array  # (n, N), the box that is never left
    upper: Array
    gap: PoseGap
    settled: Flags  # no small step helps any more
    steps: Array  # (N,) taken

    @classmethod
    def start_inside(cls, arm: TipArm, target: TargetPoses, joints: Array, box: tuple[Array, Array]) -> Self:
        """Return a search that starts inside its box."""
        count = joints.shape[1]
        gap = gap_between(arm, joints, target).copy_frames()  # the search writes better postures into them
        return cls(arm, target, joints, *box, gap, np.zeros(count, dtype=bool), np.zeros(count))

    def approach_poses(self, reach: ReachTolerance) -> None:
        """Approach; look on both sides of resting places where the arm is singular, and keep what is nearer."""
        self.take_steps(reach, _STEPS)
        for way in _RESTART_STEPS_RAD:
            self._search_beyond(reach, way)

    def find_pushes(self) -> tuple[Flags, Flags]:
        """Return which joints (n, N) rest at the lower, and at the upper side of the box and would go on."""
        pull = np.einsum("kin,in->kn", self.gap.tip_jacobian(self.arm), self.gap.error)
        return (self.joints <= self.lower) & (pull < 0), (self.joints >= self.upper) & (pull > 0)

    def trial_step(self, damping: Array, max_step_rad: float) -> tuple[Array, Array]:
        """Return where a damped step leads, joints that push against the box held still, and the slope (N,)."""
        low, high = self.find_pushes()
        columns = self.gap.tip_jacobian(self.arm) * ~(low | high)[:, None]
        step = damped_step(columns, self.gap.error, damping)
        longest = np.abs(step).max(axis=0)
        step *= np.minimum(1.0, max_step_rad / np.maximum(longest, 1e-300))
        pull = np.einsum("kin,in->kn", columns, self.gap.error)
        slope = np.sqrt(np.einsum("kn,kn->n", pull, pull))
        return np.clip(self.joints + step, self.lower, self.upper), slope

    def take_steps(self, reach: ReachTolerance, most: int) -> None:
        """Take up to so many damped steps each, never one that leads farther away."""
        going = ~self.gap.is_reached(reach.position_m, reach.angle_rad)
        damping = np.full(len(going), _FIRST_DAMPING)
        for _ in range(most):
            if not going.any():
                return
            part = self._select_postures(going)
            trial, pull = part.trial_step(damping[going], reach.max_step_rad)
            gap = gap_between(self.arm, trial, part.target)
            better = gap.squared_size < part.gap.squared_size
            chosen = np.flatnonzero(going)
            resting = pull <= _RESTING * np.sqrt(part.gap.squared_size)
            self._accept_postures(chosen[better], trial[:, better], gap, better)
            self.steps[chosen] += 1
            damping[chosen] = np.where(better, np.maximum(damping[chosen] * 0.1, _FLOOR), damping[chosen] * 8)
            self.settled[chosen] |= resting | (damping[chosen] > _STUCK)
            going &= ~self.gap.is_reached(reach.position_m, reach.angle_rad) & ~self.settled

    def _search_beyond(self, reach: ReachTolerance, way_rad: float) -> None:
        """Begin again from beside the resting places, along the motion that the arm has lost there.

        Where the tip does not follow a motion of the joints to first order, a pose may rest between two ways on:
        a wrist with axes 4 and 6 in line cannot begin to turn about the third direction.
        """
        low, high = self.find_pushes()
        given_up = ~self.gap.is_reached(reach.position_m, reach.angle_rad) & ~(low | high).any(axis=0)
        if not given_up.any():
            return
        part = self._select_postures(given_up)
        lost = np.linalg.svd(part.gap.tip_jacobian(self.arm).transpose(2, 1, 0))[2][:, -1].T
        joints = np.clip(part.joints + way_rad * lost, part.lower, part.upper)
        other = BoundedSearch.start_inside(self.arm, part.target, joints, (part.lower, part.upper))
        other.take_steps(reach, _STEPS_BEYOND)
        better = other.gap.squared_size < (1 - _WORTH) * part.gap.squared_size
        chosen = np.flatnonzero(given_up)
        self._accept_postures(chosen[better], other.joints[:, better], other.gap, better)
        self.settled[chosen[better]] = other.settled[better]
        self.steps[chosen] += other.steps

    def _select_postures(self, chosen: Flags) -> "BoundedSearch":
        return BoundedSearch(
            self.arm,
            self.target.select_poses(chosen),
            self.joints[:, chosen],
            self.lower[:, chosen],
            self.upper[:, chosen],
            self.gap.select_poses(chosen),
            self.settled[chosen],
            self.steps[chosen],
        )

    def _accept_postures(self, rows: NDArray[np.intp], joints: Array, gap: PoseGap, better: Flags) -> None:
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
        self.gap = PoseGap(old.error, old.cosine, old.rotations, old.origins)
