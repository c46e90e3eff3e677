"""Ways between poses before anything moves: what of a walk is still allowed."""

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.motion.motion_check import MotionLimits
from cellcal.procedures.motion.plan_ways import allowed_start, walk_allowed

MODEL = load_model("fanuc_m6ib")
HERE = np.radians([0.0, 0.0, 0.0, 0.0, -45.0, 0.0])


def _turned(axis: int, turn_deg: float) -> np.ndarray:
    return HERE + np.radians(turn_deg) * np.eye(6)[axis]


def test_a_walk_is_gone_up_to_the_pose_before_a_broken_limit() -> None:
    walk = [_turned(0, 20.0), _turned(0, 40.0), _turned(0, 400.0), _turned(0, 20.0)]
    assert not walk_allowed(MODEL, HERE, walk, MotionLimits())
    assert len(allowed_start(MODEL, HERE, walk, MotionLimits())) == 2
    assert len(allowed_start(MODEL, HERE, walk[:2], MotionLimits())) == 2
    assert allowed_start(MODEL, HERE, walk[2:], MotionLimits()) == []
