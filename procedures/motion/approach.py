"""How a robot comes to rest: every joint turning in the positive sense, by way of a point below where need be.

One side for all captures keeps the gears on one tooth flank. Plans check these corners, and steps go them. A few
captures come from the other side on purpose: what differs then is the gears' play, or something loose.
"""

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.drivers.interfaces import Joints

OVERSHOOT_RAD = 0.0174533  # 1 deg


def from_below(here_rad: Joints, there_rad: Joints) -> tuple[Joints, ...]:
    """Return the corners of a joint move that ends turning upwards: the end, with the point below it if need be."""
    below = tuple(t - OVERSHOOT_RAD if t < q else t for q, t in zip(here_rad, there_rad, strict=True))
    return (there_rad,) if below == tuple(there_rad) else (below, there_rad)


def from_above(here_rad: Joints, there_rad: Joints) -> tuple[Joints, ...]:
    """Return the corners of a joint move that ends with every joint turning downward: to the other tooth flank."""
    above = tuple(
        t + OVERSHOOT_RAD if q < t + OVERSHOOT_RAD else t for q, t in zip(here_rad, there_rad, strict=True)
    )
    return (there_rad,) if above == tuple(there_rad) else (above, there_rad)


def axis_by_axis(here_rad: Array, there_rad: Array) -> Array:
    """Return the corners (C, n) of jogs that bring one joint after the other there from below, J1 first."""
    corners, at = [], np.array(here_rad, dtype=float)
    for axis, target in enumerate(there_rad):
        hops = [target - OVERSHOOT_RAD, target] if target < at[axis] else [target]
        for hop in hops:
            at = at.copy()
            at[axis] = hop
            corners.append(at)
    return np.array(corners)
