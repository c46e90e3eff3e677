"""Joints for poses of arms that have not six turning joints: a SCARA, an arm of five joints or of seven.

What makers' configurations say of such arms is not known here. A pose takes the posture nearest to the one before,
and a configuration that differs from that of the points before it is not guessed at.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.joint_kinds import beyond_limits, drawn_range
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.compensation.other_joint_counts import approach_poses
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.programs.scara import elbow_side, scara_postures
from cellcal.calibration.programs.transfer_other_arms import OtherArm

LEANEST_RAD = 2e-4  # what rounding makes of a pose: some decimals of a degree
_REACHED_M = 1e-6
_STARTS = 15  # drawn postures from which those of a pose are searched
_BLOCK = 4096
_ROUNDED_RAD = 1e-6
_STRETCHED = 1e-3  # sine of an elbow that is on neither side
UNREACHABLE = "unreachable: the arm has no posture for this pose"
NO_POSTURE = (
    "the file says no joints, and which way an arm of {joints} joints stands there is told by the posture before it: "
    "state starting_posture_deg, or put a move to joint angles in front of it"
)
OTHER_TEXT = (
    "its configuration {text} is another than that of the points before it, and what it says of an arm of {joints} "
    "joints is not known: put a move to joint angles in front of it"
)
LEANS = "its pose is turned by {lean_deg:.2f} deg from what an arm of {joints} joints can take there"


def taught_postures(before: Array | None, count: int, axes: int) -> Array:
    """Return the posture (count, axes) taught before each pose, NaN where none is.

    ``before`` is one posture (axes,), before the first pose, or one before each of the first poses (N, axes).
    """
    taught = np.full((count, axes), np.nan)
    if before is not None and count:
        taught[: len(before) if before.ndim == 2 else 1] = before
    return taught


class OtherPostureSearch:
    """Finds joints for the positions of one controller, as `PostureSearch` does for six joints."""

    def __init__(self, arm: OtherArm, controller: RobotModel) -> None:
        self._arm, self._controller = arm, controller

    def find_joints(
        self, base_flange: Array, texts: Sequence[str], before: Array | None
    ) -> tuple[Array, list[str]]:
        """Return joints (N, n), NaN where there are none, and why (N,), "" where there are.

        Parameters
        ----------
        base_flange : (N, 4, 4)
            Poses of the flange in the controller's base, in the order of the program.
        texts : (N,)
            Configurations in the maker's spelling; empty where the file says none.
        before : (N, n) or None
            The posture before each pose where one is taught there, else NaN.
        """
        count, axes = len(base_flange), self._controller.axis_count
        taught = taught_postures(before, count, axes)
        last_taught = _carried_forward(taught)
        found, why = np.full((count, axes), np.nan), [""] * count
        taught_rows = np.flatnonzero(np.isfinite(last_taught[:, 0]))
        for i in np.flatnonzero(~np.isfinite(last_taught[:, 0])).tolist():
            why[i] = make_message(NO_POSTURE, joints=axes)
        for first in range(0, len(taught_rows), _BLOCK):
            rows = taught_rows[first : first + _BLOCK]
            candidates, lean = self._candidates(base_flange[rows], last_taught[rows])
            for i, row in enumerate(rows.tolist()):
                if lean[i] > LEANEST_RAD:
                    why[row] = make_message(LEANS, lean_deg=float(np.degrees(lean[i])), joints=axes)
                elif not np.isfinite(candidates[:, i]).all(axis=1).any():
                    why[row] = UNREACHABLE
            self._choose_postures(candidates, rows, (taught, texts), (found, why))
        return found, why

    def _choose_postures(
        self,
        candidates: Array,
        rows: NDArray[np.intp],
        stated: tuple[Array, Sequence[str]],
        outcome: tuple[Array, list[str]],
    ) -> None:
        """Take the posture nearest to the one before, pose after pose, while the configuration stays as it is."""
        (taught, texts), (found, why) = stated, outcome
        last, text = None, ""
        earlier = np.flatnonzero(np.isfinite(found[: int(rows[0]), 0]))
        if len(earlier):
            last, text = found[earlier[-1]], texts[int(earlier[-1])]
        for i, row in enumerate(rows.tolist()):
            if np.isfinite(taught[row, 0]):
                last, text = taught[row], ""
            if why[row] or last is None:
                continue
            if text and texts[row] != text:
                why[row] = make_message(OTHER_TEXT, text=texts[row], joints=len(last))
                continue
            choice = candidates[np.isfinite(candidates[:, i]).all(axis=1), i]
            found[row] = self._nearest_of(choice, last)
            last, text = found[row], texts[row]

    def _nearest_of(self, choice: Array, last: Array) -> Array:
        near = self._into_limits(self._arm.nearest_turns(choice, last))
        if self._arm.scara is not None:
            sides = elbow_side(self._arm.scara, np.vstack([near, last]))
            same = np.sign(sides[:-1]) == np.sign(sides[-1])
            near = near[same] if same.any() and abs(sides[-1]) > _STRETCHED else near
        inside = (beyond_limits(self._controller, near) <= _ROUNDED_RAD).all(axis=1)
        near = near[inside] if inside.any() else near
        apart = np.abs(near - last)[:, self._arm.turning].sum(axis=1)
        return np.asarray(near[np.argmin(apart)])

    def _into_limits(self, joints: Array) -> Array:
        """Turn joints by whole turns into their limits where that is possible."""
        low, high = self._controller.lower_rad - _ROUNDED_RAD, self._controller.upper_rad + _ROUNDED_RAD
        found = joints.copy()
        for way in (2 * np.pi, -2 * np.pi):
            turned = joints + way
            fits = self._arm.turning & ((joints < low) | (joints > high)) & (turned >= low) & (turned <= high)
            np.copyto(found, turned, where=fits)
        return found

    def _candidates(self, base_flange: Array, last: Array) -> tuple[Array, Array]:
        """Return postures (K, N, n) of the controller's arm, NaN where there is none, and the least turn left."""
        arm, tip = self._arm, TipArm(self._controller)
        count = len(base_flange)
        if arm.scara is not None:
            starts, lean = scara_postures(arm.scara, base_flange)
            starts = np.where(np.isfinite(starts), starts, last)
        else:
            low, high = drawn_range(self._controller)
            drawn = np.random.default_rng(7).uniform(low, high, (_STARTS, count, len(low)))
            drawn[:, :, list(arm.held)] = last[:, list(arm.held)]
            starts = np.concatenate([last[None], drawn])
        targets = np.tile(base_flange, (len(starts), 1, 1))
        done = approach_poses(tip, targets, starts.reshape(-1, starts.shape[2]), arm.held)
        shape = (len(starts), count)
        left_m, left_rad = done.position_m.reshape(shape), done.angle_rad.reshape(shape)
        at_place = left_m <= _REACHED_M
        joints = np.where(
            (at_place & (left_rad <= LEANEST_RAD))[:, :, None], done.joints_rad.reshape(starts.shape), np.nan
        )
        least = np.where(at_place, left_rad, np.inf).min(axis=0)
        least = np.where(np.isfinite(least), least, 0.0)  # a place beyond the reach: no turn is the reason
        return joints, lean if arm.scara is not None else least


def _carried_forward(postures: Array) -> Array:
    """Return the last posture (N, n) that is stated at each row or before it; NaN before the first."""
    stated = np.where(np.isfinite(postures[:, 0]), np.arange(len(postures)), -1)
    last = np.maximum.accumulate(stated) if len(stated) else stated
    found: Array = np.where((last >= 0)[:, None], postures[np.maximum(last, 0)], np.nan)
    return found
