"""The joints that a controller computes for programmed positions: pose, configuration and turn numbers."""

from collections.abc import Sequence
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.joint_kinds import beyond_limits
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.compensation.compensate import CompensationLimits
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.programs.branches import BRANCHES, AxesAtZero, all_branches, branch_numbers
from cellcal.calibration.programs.transfer import joints_near, nearest_turns
from cellcal.drivers.programs.brands import ConfigurationRule
from cellcal.service.engineering.programs.other_postures import (
    UNREACHABLE,
    OtherPostureSearch,
    taught_postures,
)
from cellcal.service.engineering.programs.project import Project

_FULL_TURN = 2 * np.pi
_ROUNDED_RAD = 1e-6  # a joint may be taught at its limit, and a pose is rounded
_ALIKE_RAD = 1e-4
_BORDER_RAD = 3e-4  # a pose is rounded to some 1e-5 rad, and a stretched wrist makes more of it
_FACTORY = CompensationLimits(branch_rad=0.3)

OTHER_CONFIGURATION = "no posture of the arm reaches this pose with the configuration {text}"
OTHER_TURNS = "no joints inside the limits have the turn numbers of {text}"
NO_POSTURE = (
    "the file says neither joints nor a configuration that counts, and no position before it does: state a starting "
    "posture in the project, put a move to joint angles in front of it, or write its configuration (KUKA: S and T) "
    "into it"
)


def posture_search(cell: Project, rule: ConfigurationRule | None) -> "PostureSearch | OtherPostureSearch":
    """Return what finds joints for the positions of a cell."""
    other = cell.other_arm
    if other is not None:
        return OtherPostureSearch(other, cell.controller)
    return PostureSearch(cell.nominal, cell.controller, rule)


def applied_rule(cell: Project, rule: ConfigurationRule | None) -> ConfigurationRule | None:
    """Return a maker's rule of configurations where it is known for the cell's arm: of six turning joints."""
    return rule if cell.other_arm is None else None


class PostureSearch:
    """Finds joints for the positions of one controller."""

    def __init__(self, nominal: RobotModel, controller: RobotModel, rule: ConfigurationRule | None) -> None:
        self._nominal = nominal
        self._controller = controller
        self._rule = rule
        self._exact = controller is nominal or np.array_equal(controller.placements, nominal.placements)

    @cached_property
    def _zero(self) -> AxesAtZero:
        """The axes at zero, found when the first pose needs a posture: programs of joints need none."""
        return AxesAtZero.from_model(self._nominal)

    def find_joints(
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
        fits = self._fitting_branches(candidates, reached, texts)
        taught = taught_postures(before, len(base_flange), 6)
        found, why = self._choose_branches(candidates, fits, taught)
        for i in np.flatnonzero(~fits.any(axis=0)).tolist():
            named = reached[:, i].any()
            why[i] = make_message(OTHER_CONFIGURATION, text=texts[i]) if named else UNREACHABLE
        self._polish_postures(found, base_flange, why)
        self._add_turns(found, texts, why)
        return found, why

    def nearest_postures(self, base_flange: Array, like: Array) -> Array:
        """Return the posture (N, 6) of each pose nearest to another one, whole turns included; NaN for none."""
        return _nearest_of(nearest_turns(all_branches(self._zero, base_flange), like), like)

    def same_postures(self, base_flange: Array, like: Array) -> Array:
        """Return joints (N, 6) for poses in the branch of other joints; the nearest ones where it does not reach."""
        near = nearest_turns(all_branches(self._zero, base_flange), like)
        same = near[branch_numbers(self._zero, like), np.arange(len(like))]
        reached = np.isfinite(same).all(axis=1, keepdims=True)
        return np.where(reached, same, _nearest_of(near, like))

    def _fitting_branches(
        self, candidates: Array, reached: NDArray[np.bool_], texts: Sequence[str]
    ) -> NDArray[np.bool_]:
        """Return (8, N): which branches reach the pose and are what the text says."""
        if self._rule is None:
            return reached
        fits = np.zeros_like(reached)
        for branch in range(BRANCHES):
            rows = np.flatnonzero(reached[branch])
            configurations = [texts[i] for i in rows.tolist()]
            fits[branch, rows] = self._rule.matches_postures(
                self._controller, candidates[branch, rows], configurations, turns=False
            )
        return fits

    def _choose_branches(
        self, candidates: Array, fits: NDArray[np.bool_], taught: Array
    ) -> tuple[Array, list[str]]:
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
            last = self._posture_before(found, i, taught)
            if last is None:
                found[i], why[i] = np.nan, NO_POSTURE
                continue
            near = nearest_turns(choice, last)
            found[i] = near[np.argmin(np.abs(near - last).sum(axis=1))]
        return found, why

    @staticmethod
    def _posture_before(found: Array, i: int, taught: Array) -> Array | None:
        """Return the posture before the i-th pose: the last that was found, or one that is taught after it."""
        last_found = int(np.flatnonzero(np.isfinite(found[:i, 0]))[-1:].max(initial=-1))
        last_taught = int(np.flatnonzero(np.isfinite(taught[: i + 1, 0]))[-1:].max(initial=-1))
        last: Array = taught[last_taught] if last_taught > last_found else found[last_found]
        return last if max(last_taught, last_found) >= 0 else None

    def _into_limits(self, candidates: Array) -> None:
        """Turn joints by whole turns into their limits where that is possible."""
        low, high = self._controller.lower_rad - _ROUNDED_RAD, self._controller.upper_rad + _ROUNDED_RAD
        for way in (1.0, -1.0):
            turned = candidates + way * _FULL_TURN
            outside = (candidates < low) | (candidates > high)
            np.copyto(candidates, turned, where=outside & (turned >= low) & (turned <= high))

    def _polish_postures(self, found: Array, base_flange: Array, why: list[str]) -> None:
        """Bring postures of the nominal arm to those of the controller's own arm."""
        rows = np.flatnonzero(np.isfinite(found).all(axis=1))
        if self._exact or not len(rows):
            return
        done = joints_near(TipArm(self._controller), base_flange[rows], found[rows], _FACTORY)
        found[rows] = np.where(done.has_converged[:, None], done.joints_rad, np.nan)
        for i in rows[~done.has_converged].tolist():
            why[i] = UNREACHABLE

    def _add_turns(self, found: Array, texts: Sequence[str], why: list[str]) -> None:
        """Add whole turns until the turn numbers of the text are met."""
        if self._rule is None:
            return
        rows = np.flatnonzero(np.isfinite(found).all(axis=1))
        unmatched = (
            rows[~self._turns_agree(found[rows], [texts[i] for i in rows.tolist()])] if len(rows) else rows
        )
        for way in self._turn_combinations(found, unmatched):
            if not len(unmatched):
                return
            turned = found[unmatched] + _FULL_TURN * np.array(way)
            inside = self._is_inside(turned)
            configurations = [texts[i] for i in unmatched.tolist()]
            agrees = inside & self._turns_agree(turned, configurations)
            found[unmatched[agrees]] = turned[agrees]
            unmatched = unmatched[~agrees]
        for i in unmatched.tolist():
            found[i], why[i] = np.nan, make_message(OTHER_TURNS, text=texts[i])

    def _turns_agree(self, joints: Array, texts: Sequence[str]) -> NDArray[np.bool_]:
        """Return which joints have the turn numbers of their texts.

        A joint taught on the border of two numbers comes back on either side of it, because the pose was rounded.
        """
        assert self._rule is not None
        found = self._rule.matches_postures(self._controller, joints, texts, turns=True)
        for border_shift in (_BORDER_RAD, -_BORDER_RAD):
            unmatched = np.flatnonzero(~found)
            if len(unmatched):
                configurations = [texts[i] for i in unmatched.tolist()]
                found[unmatched] = self._rule.matches_postures(
                    self._controller, joints[unmatched] + border_shift, configurations, turns=True
                )
        return found

    def _turn_combinations(self, found: Array, rows: NDArray[np.intp]) -> list[tuple[int, ...]]:
        """Return the combinations of whole turns that any of these postures could have inside the limits."""
        if not len(rows):
            return []
        low, high = self._controller.lower_rad - _ROUNDED_RAD, self._controller.upper_rad + _ROUNDED_RAD
        fewest = np.ceil((low - found[rows]) / _FULL_TURN).min(axis=0)
        most = np.floor((high - found[rows]) / _FULL_TURN).max(axis=0)
        turns = [range(int(a), int(b) + 1) for a, b in zip(fewest, most, strict=True)]
        some = [way for way in product(*turns) if any(way)]
        return sorted(some, key=lambda way: sum(map(abs, way)))

    def _is_inside(self, joints: Array) -> NDArray[np.bool_]:
        within = beyond_limits(self._controller, joints) <= _ROUNDED_RAD
        return np.asarray(within.all(axis=1), dtype=np.bool_)


def _nearest_of(near: Array, like: Array) -> Array:
    """Return which of eight postures (8, N, 6) is nearest to other joints (N, 6)."""
    apart = np.nan_to_num(np.abs(near - like).max(axis=2), nan=np.inf)
    best: Array = near[np.argmin(apart, axis=0), np.arange(len(like))]
    return best
