"""Poses that a table writes as matrices: m_00 to m_23, T11 to T34, R11 to R33, or nx, ny, nz, ox … az."""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array

MATRIX_FORMULAS = {
    "rotation_matrix": "the columns of the matrix are the axes of the target",
    "rotation_matrix_transposed": "the rows of the matrix are the axes of the target",
}
_ELEMENT = re.compile(r"^(?P<before>(?:.*\D)?)(?P<row>[0-4])_?(?P<column>[0-4])(?P<after>(?:_\D.*)?)$")
_ORTHONORMAL = 0.02  # printed matrices are rounded


def find_matrix(names: Sequence[str], plain: Mapping[str, str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the columns of a place, and nine of a rotation row by row; empty for what the table does not have."""
    families: dict[tuple[str, str], dict[tuple[int, int], str]] = {}
    for name in names:
        if match := _ELEMENT.match(plain[name]):
            key = (match["before"], match["after"])
            families.setdefault(key, {})[int(match["row"]), int(match["column"])] = name
    for found in families.values():
        for first in (0, 1):
            turn = [found.get((first + row, first + column), "") for row in range(3) for column in range(3)]
            place = tuple(found.get((first + row, first + 3), "") for row in range(3))
            if all(turn):
                return place if all(place) else (), tuple(turn)
    by_plain = {text: name for name, text in plain.items() if name in names}
    axes = [f"{axis}{of}" for of in "xyz" for axis in "noa"]
    return (), tuple(by_plain[axis] for axis in axes) if by_plain.keys() >= set(axes) else ()


def matrices_of(values: Array, convention: str) -> Mapping[str, Array]:
    """Return rotations (N, 3, 3) from nine numbers a row (N, 9), by each way to write them that may be meant.

    Raises
    ------
    CalibrationError
        A row that is no rotation.
    """
    written = values.reshape(-1, 3, 3)
    left, _, right = np.linalg.svd(written)
    turns = left @ right
    if np.abs(turns - written).max(initial=0.0) > _ORTHONORMAL or (np.linalg.det(turns) < 0).any():
        raise CalibrationError("a matrix among them is no rotation")
    ways = {"rotation_matrix": turns, "rotation_matrix_transposed": np.swapaxes(turns, 1, 2)}
    return {name: found for name, found in ways.items() if convention in ("", name)}
