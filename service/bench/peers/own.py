"""cellcal itself, as one contestant among the others: through its public functions."""

from typing import Any

import numpy as np

from calibration.compensation import compensate as solve
from calibration.kinematics import DhTable, RobotModel


def compensate(inputs: dict[str, Any], measure: Any) -> dict[str, Any]:
    """Compensate all postures: targets, damping, status and verification included."""
    real, nominal = (
        RobotModel.from_dh(
            DhTable.from_rows(inputs[f"{name}_dh"]),
            name=name,
            lower_rad=np.full(6, -2 * np.pi),
            upper_rad=np.full(6, 2 * np.pi),
        )
        for name in ("real", "nominal")
    )
    joints = inputs["joints"]
    seconds, done = measure(lambda: solve(real, nominal, joints))
    return {"joints": done.joints_rad, "seconds": seconds, "claimed": done.converged}
