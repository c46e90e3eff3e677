"""Encoder counts, turns and zero offsets, both ways."""

from dataclasses import dataclass

import numpy as np

from calibration.errors import CalibrationError
from calibration.geometry import Array


@dataclass(frozen=True, slots=True)
class DriveTrain:
    """How motors turn joints: ``joint = interaction . (count - count_at_zero)``.

    ``radians_per_count`` is the interaction matrix, row-major; off-diagonal terms are the wrist coupling.
    ``counts_per_turn`` is the smallest count step after which the surviving single-turn reading repeats.
    """

    radians_per_count: tuple[tuple[float, ...], ...]
    counts_per_turn: tuple[int, ...]

    def __post_init__(self) -> None:
        matrix = np.array(self.radians_per_count, dtype=float)
        n = len(self.counts_per_turn)
        if matrix.shape != (n, n) or not np.isfinite(matrix).all() or min(self.counts_per_turn) <= 0:
            raise CalibrationError(f"a drive train of {n} axes needs a finite {n} x {n} interaction matrix")
        if abs(np.linalg.det(matrix / np.abs(matrix).max())) == 0.0:
            raise CalibrationError("the interaction matrix is singular: some joint would not turn at all")

    def joints(self, counts: Array, counts_at_zero: Array) -> Array:
        """Return joint angles (…, n) [rad] from counts (…, n) and the counts at joint angle zero (n,)."""
        return (np.asarray(counts, dtype=float) - np.asarray(counts_at_zero, dtype=float)) @ np.array(
            self.radians_per_count
        ).T

    def radians_per_turn(self) -> Array:
        """Return (n, n): column j is the joint motion [rad] of one whole turn of motor j."""
        return np.array(self.radians_per_count) * np.array(self.counts_per_turn, dtype=float)
