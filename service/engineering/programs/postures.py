"""The joints that a controller computes for programmed positions: pose, configuration and turn numbers."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.compensation.compensate import CompensationLimits
from cellcal.calibration.compensation.pose_gap import Arm
from cellcal.calibration.geometry import Array
from cellcal.calibration.programs.branches import BRANCHES, AxesAtZero, all_branches
from cellcal.calibration.programs.transfer import joints_near, nearest_turns
from cellcal.drivers.programs.brands import ConfigurationRule

_FULL_TURN = 2 * np.pi
_ROUNDED_RAD = 1e-6  # a joint may be taught at its limit, and a pose is rounded
_ALIKE_RAD = 1e-4
_BORDER_RAD = 3e-4  # a pose is rounded to some 1e-5 rad, and a stretched wrist makes more of it
_FACTORY = CompensationLimits(branch_rad=0.3)

UNREACHABLE = "unreachable: the arm has no posture for this pose"
OTHER_CONFIGURATION = "no posture of the arm reaches this pose with the configuration {text}"
OTHER_TURNS = "no joints inside the limits have the turn numbers of {text}"
NO_POSTURE = (
    "the file says neither joints nor configuration, and no position before it does: write its configuration "
    "(KUKA: S and T) into it, or put a move to joint angles in front of it"
)


class PostureSearch:
    """Finds joints for the positions of one controller."""

    def __init__(self, nominal: RobotModel, controller: RobotModel, rule: ConfigurationRule | None) -> None:
        self._zero = AxesAtZero.of(nominal)
        self._controller = controller
        self._rule = rule
        self._exact = controller is nominal or np.array_equal(controller.placements, nominal.placements)

    def joints(
        self, base_flange: Array, texts: Sequence[str], before: Array | None
    ) -> tuple[Array, list[str]]:
        """Return joints (N, 6), NaN where there are none, and why (N,), "" where there are.

        Parameters
        ----------
        base_flange : (N, 4, 4)
            Poses of the flange in the controller's base, in the order of the program.
        texts : (N,)
            Configurations in the maker's spelling; empty where the file says none.
        before : (6,) or (N, 6) or None
            The posture before the first of them, or before each where one is taught there, else NaN: a pose without
            a configuration is taken near the last posture before it.
        """
        candidates = all_branches(self._zero, base_flange)
        self._into_limits(candidates)
        reached = np.asarray(np.isfinite(candidates).all(axis=2), dtype=np.bool_)
        fits = self._fitting(candidates, reached, texts)
        taught = np.full((len(base_flange), 6), np.nan)
        if before is not None and len(taught):
            taught[: len(before) if before.ndim == 2 else 1] = before
        found, why = self._chosen(candidates, fits, taught)
        for i in np.flatnonzero(~fits.any(axis=0)).tolist():
            named = reached[:, i].any()
            why[i] = OTHER_CONFIGURATION.format(text=texts[i]) if named else UNREACHABLE
        self._polish(found, base_flange, why)
        self._turn(found, texts, why)
        return found, why

    def alike(self, base_flange: Array, like: Array) -> Array:
        """Return the posture (N, 6) of each pose nearest to another one, whole turns included; NaN for none."""
        candidates = all_branches(self._zero, base_flange)
        near = nearest_turns(candidates, like)
        apart = np.nan_to_num(np.abs(near - like).max(axis=2), nan=np.inf)
        best: Array = near[np.argmin(apart, axis=0), np.arange(len(like))]
        return best

    def _fitting(
        self, candidates: Array, reached: NDArray[np.bool_], texts: Sequence[str]
    ) -> NDArray[np.bool_]:
        """Return (8, N): which branches reach the pose and are what the text says."""
        if self._rule is None:
            return reached
        fits = np.zeros_like(reached)
        for branch in range(BRANCHES):
            rows = np.flatnonzero(reached[branch])
            said = [texts[i] for i in rows.tolist()]
            fits[branch, rows] = self._rule.agrees(
                self._controller, candidates[branch, rows], said, turns=False
            )
        return fits

    def _chosen(self, candidates: Array, fits: NDArray[np.bool_], taught: Array) -> tuple[Array, list[str]]:
        """Take the branch that fits; of several, the one nearest to the posture before."""
        count = fits.shape[1]
        first = np.argmax(fits, axis=0)
        found = candidates[first, np.arange(count)]
        found[~fits.any(axis=0)] = np.nan
        why = [""] * count
        several = np.flatnonzero(fits.sum(axis=0) > 1)
        for i in several.tolist():
            choice = candidates[fits[:, i], i]
            if np.abs(nearest_turns(choice, choice[0]) - choice[0]).max() < _ALIKE_RAD:
                continue
            last = self._last(found, i, taught)
            if last is None:
                found[i], why[i] = np.nan, NO_POSTURE
                continue
            near = nearest_turns(choice, last)
            found[i] = near[np.argmin(np.abs(near - last).sum(axis=1))]
        return found, why

    @staticmethod
    def _last(found: Array, i: int, taught: Array) -> Array | None:
        """Return the posture before the i-th pose: the last that was found, or one that is taught after it."""
        known = int(np.flatnonzero(np.isfinite(found[:i, 0]))[-1:].max(initial=-1))
        said = int(np.flatnonzero(np.isfinite(taught[: i + 1, 0]))[-1:].max(initial=-1))
        last: Array = taught[said] if said > known else found[known]
        return last if max(said, known) >= 0 else None

    def _into_limits(self, candidates: Array) -> None:
        """Turn joints by whole turns into their limits where that is possible."""
        low, high = self._controller.lower_rad - _ROUNDED_RAD, self._controller.upper_rad + _ROUNDED_RAD
        for way in (1.0, -1.0):
            turned = candidates + way * _FULL_TURN
            outside = (candidates < low) | (candidates > high)
            np.copyto(candidates, turned, where=outside & (turned >= low) & (turned <= high))

    def _polish(self, found: Array, base_flange: Array, why: list[str]) -> None:
        """Bring postures of the nominal arm to those of the controller's own arm."""
        rows = np.flatnonzero(np.isfinite(found).all(axis=1))
        if self._exact or not len(rows):
            return
        done = joints_near(Arm(self._controller), base_flange[rows], found[rows], _FACTORY)
        found[rows] = np.where(done.converged[:, None], done.joints_rad, np.nan)
        for i in rows[~done.converged].tolist():
            why[i] = UNREACHABLE

    def _turn(self, found: Array, texts: Sequence[str], why: list[str]) -> None:
        """Add whole turns until the turn numbers of the text are met."""
        if self._rule is None:
            return
        rows = np.flatnonzero(np.isfinite(found).all(axis=1))
        left = rows[~self._agree(found[rows], [texts[i] for i in rows.tolist()])] if len(rows) else rows
        for way in self._ways(found, left):
            if not len(left):
                return
            turned = found[left] + _FULL_TURN * np.array(way)
            inside = self._inside(turned)
            said = [texts[i] for i in left.tolist()]
            agrees = inside & self._agree(turned, said)
            found[left[agrees]] = turned[agrees]
            left = left[~agrees]
        for i in left.tolist():
            found[i], why[i] = np.nan, OTHER_TURNS.format(text=texts[i])

    def _agree(self, joints: Array, texts: Sequence[str]) -> NDArray[np.bool_]:
        """Tell which joints have the turn numbers of their texts.

        A joint taught on the border of two numbers comes back on either side of it, because the pose was rounded.
        """
        assert self._rule is not None
        found = self._rule.agrees(self._controller, joints, texts, turns=True)
        for nudge in (_BORDER_RAD, -_BORDER_RAD):
            left = np.flatnonzero(~found)
            if len(left):
                said = [texts[i] for i in left.tolist()]
                found[left] = self._rule.agrees(self._controller, joints[left] + nudge, said, turns=True)
        return found

    def _ways(self, found: Array, rows: NDArray[np.intp]) -> list[tuple[int, ...]]:
        """Return the combinations of whole turns that any of these postures could have inside the limits."""
        if not len(rows):
            return []
        low, high = self._controller.lower_rad - _ROUNDED_RAD, self._controller.upper_rad + _ROUNDED_RAD
        fewest = np.ceil((low - found[rows]) / _FULL_TURN).min(axis=0)
        most = np.floor((high - found[rows]) / _FULL_TURN).max(axis=0)
        turns = [range(int(a), int(b) + 1) for a, b in zip(fewest, most, strict=True)]
        some = [way for way in product(*turns) if any(way)]
        return sorted(some, key=lambda way: sum(map(abs, way)))

    def _inside(self, joints: Array) -> NDArray[np.bool_]:
        low, high = self._controller.lower_rad - _ROUNDED_RAD, self._controller.upper_rad + _ROUNDED_RAD
        return np.asarray(((joints >= low) & (joints <= high)).all(axis=1), dtype=np.bool_)
