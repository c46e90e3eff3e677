"""Points as the controller itself writes them, in columns: where their numbers stand, and new numbers for them."""

from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.calibration.orientation import values_from
from cellcal.drivers.kuka.program_files.usual import BEFORE_NUMBER
from cellcal.drivers.programs.columns import HALF, number_edits
from cellcal.drivers.programs.spans import Edit

LEAST_LENGTH_DECIMALS = 3  # of a millimetre: what a changed coordinate is written with at least
LEAST_ANGLE_DECIMALS = 4  # of a degree
LEAST_TURN = 0.2  # of the last digit of an angle; half of it is what rounding hides

_LEAST_TURNS = np.array([LEAST_TURN * radians(10.0**-decimals) for decimals in range(16)])


@dataclass(frozen=True, eq=False)
class WrittenPoints:
    """N positions' X Y Z A B C as they stand in the file."""

    starts: NDArray[np.int64]  # (N,) where the struct opens
    widths: NDArray[
        np.int64
    ]  # (N, 6) in characters; 0 where a position is not written so, or takes no change
    values: Array  # (N, 6) [mm, deg]
    decimals: NDArray[np.int64]  # (N, 2) that lengths and angles share

    def make_edits(self, rows: NDArray[np.int64], before: Array, after: Array) -> list[Edit]:
        """Return the numbers to write anew where rows go from poses to others (K, 4, 4)."""
        step, decimals = np.abs(after - before), self.decimals[rows]
        moved = step[:, :3, 3].max(axis=1) * 1e3 > HALF[decimals[:, 0]]
        # A, B and C have a second spelling, which must not come of an unchanged orientation.
        turned = step[:, :3, :3].max(axis=(1, 2)) > _LEAST_TURNS[decimals[:, 1]]
        values = np.full((len(rows), 6), np.nan)
        values[moved, :3] = after[moved, :3, 3] * 1e3
        if turned.any():
            values[turned, 3:] = np.rad2deg(values_from("kuka_abc", after[turned, :3, :3]))
        digits, widths = np.repeat(decimals, 3, axis=1), self.widths[rows]
        other = np.abs(values - self.values[rows]) > HALF[digits]
        return number_edits(self.starts[rows], widths, [BEFORE_NUMBER] * 6, values, digits, other)
