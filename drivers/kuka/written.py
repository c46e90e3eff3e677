"""Points as the controller itself writes them, in columns: where their numbers stand, and new numbers for them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import repeat
from math import radians

import numpy as np
from numpy.typing import NDArray

from calibration.geometry import Array
from calibration.orientation import values_from
from drivers.kuka.usual import BEFORE_NUMBER
from drivers.programs.spans import Edit

LEAST_LENGTH_DECIMALS = 3  # of a millimetre: what a changed coordinate is written with at least
LEAST_ANGLE_DECIMALS = 4  # of a degree
LEAST_TURN = 0.2  # of the last digit of an angle; half of it is what rounding hides
BEYOND = 1e7  # mm; no robot goes there

# By decimals, to the last bit what is reckoned of a single number.
_HALF = np.array([0.5 * 10.0**-decimals * (1 - 1e-9) for decimals in range(16)])
_LEAST_TURNS = np.array([LEAST_TURN * radians(10.0**-decimals) for decimals in range(16)])


@dataclass(frozen=True, eq=False)
class Written:
    """N positions' X Y Z A B C as they stand in the file."""

    starts: NDArray[np.int64]  # (N,) where the struct opens
    widths: NDArray[
        np.int64
    ]  # (N, 6) in characters; 0 where a position is not written so, or takes no change
    values: Array  # (N, 6) [mm, deg]
    decimals: NDArray[np.int64]  # (N, 2) that lengths and angles share

    def takes(self, rows: NDArray[np.int64], frame_tip: Array) -> NDArray[np.bool_]:
        """Return (K,): whether rows are written so, and a pose (K, 4, 4) is given for them."""
        given = np.isfinite(frame_tip).all(axis=(1, 2))
        near = np.abs(frame_tip[:, :3, 3]).max(axis=1) * 1e3 < BEYOND
        return np.asarray((self.widths[rows, 0] > 0) & given & near)

    def edits(self, rows: NDArray[np.int64], before: Array, after: Array) -> list[Edit]:
        """Return the numbers to write anew where rows go from poses to others (K, 4, 4)."""
        step, decimals = np.abs(after - before), self.decimals[rows]
        moved = step[:, :3, 3].max(axis=1) * 1e3 > _HALF[decimals[:, 0]]
        # A, B and C have a second spelling, which must not come of an unchanged orientation.
        turned = step[:, :3, :3].max(axis=(1, 2)) > _LEAST_TURNS[decimals[:, 1]]
        values = np.full((len(rows), 6), np.nan)
        values[moved, :3] = after[moved, :3, 3] * 1e3
        if turned.any():
            values[turned, 3:] = np.rad2deg(values_from("kuka_abc", after[turned, :3, :3]))
        digits, widths = np.repeat(decimals, 3, axis=1), self.widths[rows]
        other = np.abs(values - self.values[rows]) > _HALF[digits]
        ends = self.starts[rows, None] + np.cumsum(widths + BEFORE_NUMBER, axis=1)
        texts = [
            f"{round(value, decimals) + 0.0:.{decimals}f}"  # no -0.000
            for value, decimals in zip(values[other].tolist(), digits[other].tolist(), strict=True)
        ]
        return list(zip((ends - widths)[other].tolist(), ends[other].tolist(), texts, strict=True))


def widths_and_decimals(texts: Sequence[str]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return of K positions' numbers as written (6 K) their widths (K, 6) and decimals (K, 2)."""
    widths = np.fromiter(map(len, texts), np.int64, len(texts))
    points = np.fromiter(map(str.find, texts, repeat(".")), np.int64, len(texts))
    decimals = np.where(points < 0, 0, widths - points - 1).reshape(-1, 2, 3).max(axis=2)
    return widths.reshape(-1, 6), np.maximum(decimals, (LEAST_LENGTH_DECIMALS, LEAST_ANGLE_DECIMALS))
