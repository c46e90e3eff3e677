"""Postures with which an arm may have found a fixture: its tip at the fixture's points, held as in a program."""

import numpy as np

from calibration.compensation.compensate import CompensationLimits
from calibration.compensation.pose_gap import Arm
from calibration.geometry import Array
from calibration.programs.transfer import joints_near, tips

_ATTITUDES = 6
_FAR = CompensationLimits(branch_rad=2.5, position_m=1e-4, angle_rad=1e-3)


def fixture_postures(arm: Arm, points_in_base_m: Array, joints_rad: Array) -> Array:
    """Return postures (M, n) with the tip at every fixture point, in up to six attitudes of a program.

    Parameters
    ----------
    arm : Arm
        With the tip that works in the program.
    points_in_base_m : (k, 3)
        The fixture's points.
    joints_rad : (N, n)
        Postures of the program, N >= 1; those within reach of the points only are returned.
    """
    some = joints_rad[np.unique(np.linspace(0, len(joints_rad) - 1, _ATTITUDES).astype(np.intp))]
    start = np.repeat(some, len(points_in_base_m), axis=0)
    wanted = tips(arm, start)
    wanted[:, :3, 3] = np.tile(points_in_base_m, (len(some), 1))
    found = joints_near(arm, wanted, start, _FAR)
    reached: Array = found.joints_rad[found.converged]
    return reached
