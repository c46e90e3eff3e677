"""A joint move in short steps, for a controller that drives what was ordered to its end when its client is gone.

The steps lie on the straight line between the joint angles, so the path is that of one move; what the arm may
travel alone is one step.
"""

import math

import numpy as np

from cellcal.calibration.geometry import Array


def step_targets(start_rad: Array, target_rad: Array, step_rad: float) -> list[Array]:
    """Return the ends of the steps, the target last; no axis turns further in one than ``step_rad``."""
    way = np.asarray(target_rad, dtype=float) - start_rad
    steps = max(1, math.ceil(float(np.abs(way).max()) / step_rad - 1e-9))
    return [start_rad + way * (k / steps) for k in range(1, steps)] + [np.asarray(target_rad, dtype=float)]
