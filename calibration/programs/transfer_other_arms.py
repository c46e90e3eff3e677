"""Points of arms that have not six turning joints, brought to another place: SCARA, five joints, seven with one held.

Fewer than six joints keep the place and what they can of the turn; with more, the held ones stay at their taught
values. The posture is kept by going to the new place in small steps, or, of a SCARA, by the side of its elbow.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.compensation.other_joint_counts import approach_poses
from cellcal.calibration.geometry import Array, exp_twist, inverse_transform, log_transform
from cellcal.calibration.programs.scara import ScaraAxes, elbow_side, scara_axes, scara_postures
from cellcal.calibration.programs.transfer import TransferFrames, TransferResult, tip_poses

_REACHED_M, _REACHED_RAD = 1e-7, 1e-7
_NEAR_RAD = 0.5  # of any joint: beyond, the way is gone in steps
_STEPS = 24
_POSE = 6


@dataclass(frozen=True, eq=False)
class OtherArm:
    """The posture rules of an arm that has not six turning joints."""

    model: RobotModel  # nominal
    held: tuple[int, ...]  # joints (from 0) that stay at their values
    scara: ScaraAxes | None

    @classmethod
    def from_model(cls, model: RobotModel, held: tuple[int, ...]) -> "OtherArm":
        """Return the arm with the joints that stay."""
        return cls(model, held, scara_axes(model))

    @property
    def free_count(self) -> int:
        """The number of joints that bring the tip to a pose."""
        return self.model.axis_count - len(self.held)

    @property
    def turning(self) -> NDArray[np.bool_]:
        """Which joints (n,) turn."""
        slides = self.model.sliding
        return np.ones(self.model.axis_count, dtype=bool) if slides is None else ~slides

    def nearest_turns(self, joints: Array, to: Array) -> Array:
        """Return joints with those that turn brought within half a turn of another posture's."""
        near = joints - 2 * np.pi * np.round((joints - to) / (2 * np.pi))
        return np.asarray(np.where(self.turning, near, joints))


def transfer_other_arm(way: TransferFrames, joints_rad: Array, arm: OtherArm) -> TransferResult:
    """Find the joints with which the target's real tip is where the source's is, as near as the joints allow.

    A point is reached where the place is; ``left_rad`` is what is left of the turn.

    Parameters
    ----------
    way : TransferFrames
        Arms, and the change of base (4, 4) or (N, 4, 4).
    joints_rad : (N, n)
        Of the source's controller [rad, m], finite.
    arm : OtherArm
        The target's.
    """
    start_tips = tip_poses(way.source, joints_rad)
    targets = way.change @ start_tips
    found = approach_poses(way.target, targets, joints_rad, arm.held)
    joints, left_m, left_rad = found.joints_rad, found.position_m, found.angle_rad
    far = np.abs((joints - joints_rad)[:, arm.turning]).max(axis=1) > _NEAR_RAD
    rest = np.flatnonzero(far | ~_is_reached(arm, left_m, left_rad))
    if len(rest):
        of_rest = replace(way, change=way.change if way.change.ndim == 2 else way.change[rest])
        start = _start_of(of_rest, joints_rad[rest], start_tips[rest], targets[rest], arm)
        again = approach_poses(way.target, targets[rest], start, arm.held)
        joints[rest], left_m[rest], left_rad[rest] = again.joints_rad, again.position_m, again.angle_rad
    return TransferResult(
        joints,
        tip_poses(way.written, joints),
        targets,
        _is_reached(arm, left_m, left_rad),
        left_m,
        left_rad,
    )


def _is_reached(arm: OtherArm, left_m: Array, left_rad: Array) -> NDArray[np.bool_]:
    met = left_m <= _REACHED_M
    return np.asarray(met if arm.free_count < _POSE else met & (left_rad <= _REACHED_RAD), dtype=np.bool_)


def _start_of(
    way: TransferFrames, joints_rad: Array, start_tips: Array, targets: Array, arm: OtherArm
) -> Array:
    """Return joints near the targets on the side of the elbow, or at the end of the way, that the posture is on."""
    if arm.scara is None:
        return _go_stepwise(way, joints_rad, start_tips, arm)
    candidates, _ = scara_postures(arm.scara, targets @ inverse_transform(way.target.flange_tip))
    right = elbow_side(arm.scara, joints_rad) > 0
    chosen = arm.nearest_turns(np.where(right[:, None], *_by_side(arm.scara, candidates)), joints_rad)
    return np.where(np.isfinite(chosen), chosen, joints_rad)


def _by_side(scara: ScaraAxes, candidates: Array) -> tuple[Array, Array]:
    """Return the postures (N, 4) with a positive and with a negative sine of the elbow."""
    positive = elbow_side(scara, np.nan_to_num(candidates[0])) > 0
    first = np.where(positive[:, None], candidates[0], candidates[1])
    second = np.where(positive[:, None], candidates[1], candidates[0])
    return first, second


def _go_stepwise(way: TransferFrames, joints_rad: Array, start_tips: Array, arm: OtherArm) -> Array:
    """Return joints after a way along the screw of the change, which keeps the posture that it begins with."""
    twist = log_transform(way.change)
    joints = joints_rad
    for step in range(1, _STEPS + 1):
        part = exp_twist(twist * (step / _STEPS))
        joints = approach_poses(way.target, part @ start_tips, joints, arm.held).joints_rad
    return joints
