"""Postures with which an arm may have found a fixture: its tip at the fixture's points, held as in a program."""

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.compensation.compensate import CompensationLimits
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.calibration.programs.branches import AxesAtZero, all_branches
from cellcal.calibration.programs.transfer import joints_near, nearest_turns, tip_poses

_ATTITUDES = 6
_FAR_RAD = 2.5
_FAR = CompensationLimits(branch_rad=_FAR_RAD, position_m=1e-4, angle_rad=1e-3)


def fixture_postures(arm: TipArm, nominal: RobotModel, points_in_base_m: Array, joints_rad: Array) -> Array:
    """Return postures (M, n) with the tip at every fixture point, in up to six attitudes of a program.

    Parameters
    ----------
    arm : Arm
        With the tip that works in the program.
    nominal : RobotModel
        The arm that it is near to, whose postures are known in closed form.
    points_in_base_m : (k, 3)
        The fixture's points.
    joints_rad : (N, n)
        Postures of the program, N >= 1; those within reach of the points only are returned.
    """
    some = joints_rad[np.unique(np.linspace(0, len(joints_rad) - 1, _ATTITUDES).astype(np.intp))]
    start = np.repeat(some, len(points_in_base_m), axis=0)
    target_tips = tip_poses(arm, start)
    target_tips[:, :3, 3] = np.tile(points_in_base_m, (len(some), 1))
    near = _nearest_branch(nominal, target_tips @ inverse_transform(arm.flange_tip), start)
    there = np.isfinite(near).all(axis=1)
    found = joints_near(arm, target_tips[there], near[there], _FAR)
    reached: Array = found.joints_rad[found.has_converged]
    return reached


def _nearest_branch(nominal: RobotModel, base_flange: Array, like: Array) -> Array:
    """Return the nominal arm's posture (N, n) of each pose that is nearest to another one; NaN for none near it."""
    try:
        candidates = all_branches(AxesAtZero.from_model(nominal), base_flange)
    except CalibrationError:  # an arm without a closed form is searched for from the posture itself
        return like
    candidates = nearest_turns(candidates, like)
    apart = np.nan_to_num(np.abs(candidates - like).max(axis=2), nan=np.inf)
    best = np.argmin(apart, axis=0)
    row = np.arange(len(like))
    return np.where(apart[best, row, None] <= _FAR_RAD, candidates[best, row], np.nan)
