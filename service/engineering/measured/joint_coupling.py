"""Joints as a controller counts them, from a file that may count one against the link before."""

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.service.engineering.measured.table import MeasurementError


def controller_joints(angles_rad: Array, model: RobotModel, joint_coupling: str) -> Array:
    """Return joints (N, n) as the controller counts them, from geometric ones if the user says so.

    Raises
    ------
    MeasurementError
        Joints are neither of the two.
    """
    conventions = ("", "controller", "geometric")
    if joint_coupling not in conventions:
        raise MeasurementError(
            f"joints cannot be {joint_coupling!r}.",
            remedy="joint_coupling is controller (as on the pendant) or geometric.",
        )
    if joint_coupling != "geometric":
        return angles_rad
    signed: Array = angles_rad * np.sign(np.diag(model.joint_coupling))
    return np.asarray(np.linalg.solve(model.joint_coupling, signed.T).T, dtype=np.float64)
