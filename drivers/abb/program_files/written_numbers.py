"""Targets as the controller itself writes them, in columns: where their numbers stand, and new numbers for them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array, quaternion_from_rotation
from cellcal.drivers.abb.program_files.usual import GAPS
from cellcal.drivers.programs.columns import HALF, number_edits, widths_and_decimals
from cellcal.drivers.programs.spans import Edit

LEAST_LENGTH_DECIMALS = 3  # of a millimetre: what a changed coordinate is written with at least
LEAST_QUATERNION_DECIMALS = 6


@dataclass(frozen=True, eq=False)
class WrittenTargets:
    """N targets' numbers x y z q1 q2 q3 q4 as they stand in the file."""

    widths: NDArray[np.int64]  # (N, 7) in characters; 0 where a target is not written so, or takes no change
    values: Array  # (N, 7) [mm, 1]
    decimals: NDArray[np.int64]  # (N, 2) that lengths and the quaternion's elements share

    @classmethod
    def without_rows(cls, count: int) -> "WrittenTargets":
        """Return targets of which none is written so."""
        return cls(
            np.zeros((count, 7), dtype=np.int64),
            np.full((count, 7), np.nan),
            np.full((count, 2), (LEAST_LENGTH_DECIMALS, LEAST_QUATERNION_DECIMALS)),
        )

    def fill_rows(self, rows: NDArray[np.int64], texts: Sequence[str]) -> None:
        """Take the numbers of some rows as they are written, seven for each."""
        self.widths[rows], decimals = widths_and_decimals(texts, (3, 4))
        self.decimals[rows] = np.maximum(decimals, self.decimals[rows])
        self.values[rows] = np.array(list(map(float, texts))).reshape(-1, 7)

    def reorder_rows(self, order: NDArray[np.int64], fixed: Iterable[int]) -> "WrittenTargets":
        """Return rows in another order; those that take no change count as written otherwise."""
        self.widths[list(fixed)] = 0
        return WrittenTargets(self.widths[order], self.values[order], self.decimals[order])

    def make_edits(self, rows: NDArray[np.int64], starts: NDArray[np.int64], after: Array) -> list[Edit]:
        """Return the numbers to write anew where rows that start there go to poses (K, 4, 4)."""
        old, decimals = self.values[rows], self.decimals[rows]
        turned_to = quaternion_from_rotation(after[:, :3, :3])
        was = old[:, 3:] / np.sqrt((old[:, 3:] ** 2).sum(axis=1, keepdims=True))
        # q and -q are one orientation; the file keeps its own.
        turned_to = np.where((turned_to * was).sum(axis=1, keepdims=True) < 0, -turned_to, turned_to)
        turned = np.abs(turned_to - was).max(axis=1) > 0.5 * 10.0 ** -decimals[:, 1].astype(float)
        values = np.hstack([after[:, :3, 3] * 1e3, turned_to])
        digits = np.repeat(decimals, (3, 4), axis=1)
        other = np.abs(values - old) > HALF[digits]
        other[~turned, 3:] = False
        return number_edits(starts, self.widths[rows], GAPS, values, digits, other)
