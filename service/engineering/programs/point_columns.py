"""Columns of the positions of several programs, one after the other."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.drivers.programs.positions import Positions

Some = TypeVar("Some", bound=np.generic)


def side_by_side(parts: Sequence[NDArray[Some]], empty: NDArray[Some]) -> NDArray[Some]:
    """Return columns of some programs one after the other."""
    return parts[0] if len(parts) == 1 else np.concatenate([empty, *parts])  # a large file is not copied


def joints_of(positions: Positions, axes: int) -> Array:
    """Return the joints (N, axes) of a program's positions, NaN where it holds none."""
    joints = positions.joints
    if joints.shape[1] == axes:
        return joints
    wide = np.full((len(joints), axes), np.nan)
    wide[:, : min(axes, joints.shape[1])] = joints[:, :axes]
    return wide


def marked_rows(positions: Positions, rows: frozenset[int]) -> NDArray[np.bool_]:
    """Return (N,) which positions are among some rows."""
    marked = np.zeros(len(positions), dtype=bool)
    marked[sorted(rows)] = True
    return marked
