"""Postures that bring an arm to given poses, begun from the nearest of some known ones: their branch is kept."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.joint_kinds import beyond_limits
from cellcal.calibration.compensation.bounded_steps import BoundedSearch
from cellcal.calibration.compensation.compensate import CompensationLimits
from cellcal.calibration.compensation.pose_gap import LEVER_M, TargetPoses, TipArm, refuse_few_joints
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, is_rigid

EXACTLY = CompensationLimits()
_STARTS = 4  # known postures that are tried, nearest first
_MOST_KNOWN = 2000


@dataclass(frozen=True, eq=False)
class FoundPostures:
    """Joints for poses; those not reached are as near as was found."""

    joints_rad: Array  # (N, n)
    reached: NDArray[np.bool_]  # (N,)
    position_m: Array  # (N,) what is left


def postures_of_poses(
    arm: TipArm, base_tip: Array, known_rad: Array, limits: CompensationLimits = EXACTLY
) -> FoundPostures:
    """Solve the inverse kinematics of some poses.

    Parameters
    ----------
    arm : Arm
        Nominal or identified, with the tip that the poses are about.
    base_tip : (N, 4, 4)
        Poses of the tip in the robot's base.
    known_rad : (M, n)
        Postures that the arm has really taken, such as those measured [rad].
    limits : CompensationLimits
        Tolerances and longest step.

    Raises
    ------
    CalibrationError
        A pose that is no rigid transform, or no known posture.

    Notes
    -----
    Levenberg-Marquardt inside the joint limits (`calibration.compensation.bounded_steps`), from up to four known
    postures whose tip is nearest, a radian counting as 0.3 m.
    """
    if base_tip.ndim != 3 or not all(is_rigid(pose) for pose in base_tip):
        raise CalibrationError("a pose is a rigid transform (4, 4) of finite numbers")
    refuse_few_joints(arm.model)
    if not len(known_rad):
        raise CalibrationError("no known posture to start from")
    start_postures = known_rad[:: -(-len(known_rad) // _MOST_KNOWN)]
    target = TargetPoses(base_tip[:, :3, :3].transpose(2, 1, 0), base_tip[:, :3, 3].T)
    nearest = _nearest_postures(arm, target, start_postures)
    joints = start_postures[nearest[0]].copy()
    reached, distance = np.zeros(len(joints), dtype=bool), np.full(len(joints), np.inf)
    box = arm.model.lower_rad[:, None], arm.model.upper_rad[:, None]
    for start in nearest:
        going = np.flatnonzero(~reached)
        if not len(going):
            break
        begin = np.clip(start_postures[start[going]].T, *box)
        lower, upper = (np.repeat(side, len(going), axis=1) for side in box)
        search = BoundedSearch.start_inside(arm, target.select_poses(~reached), begin, (lower, upper))
        search.approach_poses(limits)
        better = search.gap.position_m < distance[going]
        joints[going[better]], distance[going[better]] = (
            search.joints.T[better],
            search.gap.position_m[better],
        )
        met = search.gap.is_reached(limits.position_m, limits.angle_rad)
        if arm.model.combined_limits:
            met &= (beyond_limits(arm.model, search.joints.T) <= 0.0).all(axis=1)
        joints[going[met]], distance[going[met]] = search.joints.T[met], search.gap.position_m[met]
        reached[going[met]] = True
    return FoundPostures(joints, reached, distance)


def _nearest_postures(arm: TipArm, target: TargetPoses, known_rad: Array) -> NDArray[np.intp]:
    """Return the known postures nearest to every pose (starts, N), nearest first."""
    rotations, origins = arm.compute_frames(known_rad.T)
    axes = rotations[-1].swapaxes(0, 1)
    count = min(_STARTS, len(known_rad))
    chosen = np.empty((count, target.place_m.shape[1]), dtype=np.intp)
    for i in range(chosen.shape[1]):
        apart = ((origins[-1] - target.place_m[:, i : i + 1]) ** 2).sum(axis=0)
        cosine = 0.5 * (np.einsum("ijn,ij->n", axes, target.axes[:, :, i]) - 1.0)
        chosen[:, i] = np.argsort(apart + (LEVER_M * np.arccos(np.clip(cosine, -1.0, 1.0))) ** 2)[:count]
    return chosen
