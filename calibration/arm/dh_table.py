"""A Denavit-Hartenberg table: one row a joint."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array


@dataclass(frozen=True, eq=False)
class DhTable:
    """One row a joint, ``Rot(z, theta) Trans(z, d) Trans(x, a) Rot(x, alpha) Rot(y, beta)``; fields are (n,).

    ``beta`` is Hayati's twist, for an axis (nearly) parallel to its predecessor, where ``d`` is not defined.

    References
    ----------
    S. Hayati, M. Mirmirani, Improving the absolute positioning accuracy of robot manipulators, J. Robotic
    Systems 2 (1985) 397: beta.
    """

    theta_rad: Array
    d_m: Array
    a_m: Array
    alpha_rad: Array
    beta_rad: Array

    def __post_init__(self) -> None:
        shapes = {np.shape(v) for v in (self.theta_rad, self.d_m, self.a_m, self.alpha_rad, self.beta_rad)}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise CalibrationError("the columns of a DH table must be as long as each other")

    def to_rows(self) -> Array:
        """Return (n, 5) in the order theta, d, a, alpha, beta [rad, m]."""
        return np.stack([self.theta_rad, self.d_m, self.a_m, self.alpha_rad, self.beta_rad], axis=1)

    @classmethod
    def from_rows(cls, rows: Array) -> Self:
        """Build from (n, 4) or (n, 5) rows theta, d, a, alpha[, beta]."""
        rows = np.asarray(rows, dtype=float)
        if rows.ndim != 2 or rows.shape[1] not in (4, 5):
            raise CalibrationError(f"DH rows have four or five numbers, not shape {rows.shape}")
        columns = list(rows.T) if rows.shape[1] == 5 else [*rows.T, np.zeros(len(rows))]
        return cls(*(read_only(column) for column in columns))

    def to_placements(self) -> Array:
        """Return (n, 4, 4): ``Trans(z, d) Trans(x, a) Rot(x, alpha) Rot(y, beta)`` of each row."""
        ca, sa = np.cos(self.alpha_rad), np.sin(self.alpha_rad)
        cb, sb = np.cos(self.beta_rad), np.sin(self.beta_rad)
        zero, one = np.zeros_like(ca), np.ones_like(ca)
        rows = [
            [cb, zero, sb, self.a_m],
            [sa * sb, ca, -sa * cb, zero],
            [-ca * sb, sa, ca * cb, self.d_m],
            [zero, zero, zero, one],
        ]
        return np.ascontiguousarray(np.array(rows).transpose(2, 0, 1))


def row_matrix(row: Array) -> Array:
    """Return ``Rot(z, theta) Trans(z, d) Trans(x, a) Rot(x, alpha) Rot(y, beta)`` (4, 4) of one row.

    ``row`` holds theta, d, a, alpha and, if it has five numbers, beta [rad, m].
    """
    c, s = math.cos(row[0]), math.sin(row[0])
    turn = np.array([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    matrix: Array = turn @ DhTable.from_rows(row[None]).to_placements()[0]
    return matrix


def read_only(array: Array) -> Array:
    """Return a copy that cannot be written."""
    copy = np.array(array, dtype=float)
    copy.setflags(write=False)
    return copy
