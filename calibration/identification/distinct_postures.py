"""How many postures rows were really measured at: encoders flicker while an arm stands."""

import numpy as np

from cellcal.calibration.geometry import Array

_SAME_POSTURE = 2e-3  # rad, or m where a joint slides
FEWEST_POSTURES = (
    5  # of which something is said of the arm: some are held out, the others place base and target
)


def count_postures(joints_rad: Array, most: int) -> int:
    """Return how many of the postures (N, n) differ by more than encoders flicker; counting ends at ``most``."""
    found: list[Array] = []
    for joints in joints_rad:
        if len(found) == most:
            break
        if all(np.abs(joints - one).max() > _SAME_POSTURE for one in found):
            found.append(joints)
    return len(found)
