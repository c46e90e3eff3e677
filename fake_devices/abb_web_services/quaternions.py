"""Orientations as an ABB controller writes them.

Imitates
    The quaternion of a robtarget, w first.
Source
    ABB 3HAC050973-001 rev M.
Modelled
    All rotations.
Not modelled
    Nothing.
"""

import math
from typing import Any

import numpy as np


def quaternion_of(rotation: np.ndarray[Any, np.dtype[np.float64]]) -> list[float]:
    """Return w x y z of a rotation, by its largest component."""
    r = rotation
    squares = [
        1 + r[0, 0] + r[1, 1] + r[2, 2],
        1 + r[0, 0] - r[1, 1] - r[2, 2],
        1 - r[0, 0] + r[1, 1] - r[2, 2],
        1 - r[0, 0] - r[1, 1] + r[2, 2],
    ]
    largest = int(np.argmax(squares))
    s = 2.0 * math.sqrt(float(squares[largest]))
    rows = (
        (s / 4, (r[2, 1] - r[1, 2]) / s, (r[0, 2] - r[2, 0]) / s, (r[1, 0] - r[0, 1]) / s),
        ((r[2, 1] - r[1, 2]) / s, s / 4, (r[0, 1] + r[1, 0]) / s, (r[0, 2] + r[2, 0]) / s),
        ((r[0, 2] - r[2, 0]) / s, (r[0, 1] + r[1, 0]) / s, s / 4, (r[1, 2] + r[2, 1]) / s),
        ((r[1, 0] - r[0, 1]) / s, (r[0, 2] + r[2, 0]) / s, (r[1, 2] + r[2, 1]) / s, s / 4),
    )
    return [float(value) for value in rows[largest]]
