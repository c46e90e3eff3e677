"""Poses as near as an arm comes to them: arms of fewer than six joints, and of more with some held.

Such an arm keeps the place of its tip and what it can of the orientation. A SCARA turns about its vertical axis only;
what a pose leans beside that is left, and its size is an answer, not a failure.
"""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.compensation.pose_gap import TargetPoses, TipArm, gap_between
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message

_POSE = 6  # numbers of a pose
_FIRST_STEPS, _LAST_STEPS = 40, 25
_LAST_WEIGHT = 1e-3  # of turns against places: what is left of a turn moves the tip by less than 1e-9 m
_MAX_STEP_RAD = 0.3
_SHARE = 0.01  # of the squared error that becomes damping: steps stay quadratic near the answer
_FLOOR = 1e-13


@dataclass(frozen=True, eq=False)
class NearestPoses:
    """Joints with the tip as near to poses as the arm comes."""

    joints_rad: Array  # (N, n)
    position_m: Array  # (N,) distance that is left
    angle_rad: Array  # (N,) turn that is left


def moves_six_joints(model: RobotModel) -> bool:
    """Return whether an arm has six joints, all of which turn: such an arm reaches a pose in single postures."""
    return model.axis_count == _POSE and model.sliding is None


def approach_poses(
    arm: TipArm, base_tip: Array, start_rad: Array, held: tuple[int, ...] = ()
) -> NearestPoses:
    """Bring the tip to poses, the place first and the orientation as near as the joints allow.

    Parameters
    ----------
    arm : TipArm
        With at most six joints beside those that stay. Its limits are not heeded.
    base_tip : (N, 4, 4)
        Poses of the tip in the robot's base.
    start_rad : (N, n)
        Where the search begins [rad, m], finite.
    held : tuple of int
        Joints (from 0) that stay as they are in ``start_rad``.

    Raises
    ------
    CalibrationError
        More than six joints are free.
    """
    model = arm.model
    free = [joint for joint in range(model.axis_count) if joint not in held]
    if not 0 < len(free) <= _POSE:
        raise CalibrationError(
            make_message(
                "{label}: {free_count} joints are free, and a pose tells six at most.",
                label=model.label,
                free_count=len(free),
            ),
            remedy="Name the joints that stay where they are.",
        )
    target = TargetPoses(base_tip[:, :3, :3].transpose(2, 1, 0), base_tip[:, :3, 3].T)
    joints = np.ascontiguousarray(start_rad.T)
    for step in range(_FIRST_STEPS + _LAST_STEPS):
        weight = 1.0 if step < _FIRST_STEPS else _LAST_WEIGHT
        joints = _take_step(arm, joints, target, free, weight)
    gap = gap_between(arm, joints, target)
    return NearestPoses(joints.T.copy(), gap.position_m, gap.angle_rad)


def _take_step(arm: TipArm, joints: Array, target: TargetPoses, free: list[int], weight: float) -> Array:
    gap = gap_between(arm, joints, target)
    weights = np.array([1.0] * 3 + [weight] * 3)
    error = (gap.error * weights[:, None]).T  # (N, 6)
    columns = (gap.tip_jacobian(arm)[free] * weights[:, None]).transpose(2, 0, 1)  # (N, k, 6)
    normal = columns @ columns.swapaxes(1, 2)
    damping = _SHARE * np.einsum("ni,ni->n", error, error) if weight == 1.0 else np.zeros(len(error))
    normal += (damping + _FLOOR)[:, None, None] * np.eye(len(free))
    step = np.linalg.solve(normal, (columns @ error[:, :, None]))[:, :, 0]
    step *= np.minimum(1.0, _MAX_STEP_RAD / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
    moved = joints.copy()
    moved[free] += step.T
    return moved
