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
_LISTED = re.compile(r"^(?P<stem>.*?\D)[_.\[(]?\s*(?P<number>\d{1,2})\s*[\])]?$")
_POSE_COUNTS = (12, 16)
_CALCULATED = re.compile(r"^o_t_(ee|c)(_[cd])?_$")  # the robot's own pose (libfranka)
_ORTHONORMAL = 0.02  # printed matrices are rounded


def name_matrix_elements(names: tuple[str, ...], rows: Sequence[Sequence[float | str]]) -> tuple[str, ...]:
    """Return names in which 16 or 12 numbered columns that hold a pose say their row and column: T0 is T_1_1.

    Whether such a list runs along rows (NumPy, C) or columns (MATLAB, Eigen, libfranka) is for its numbers to say.
    """
    families: dict[str, dict[int, int]] = {}
    for at, name in enumerate(names):
        if match := _LISTED.match(name):
            families.setdefault(match["stem"].strip(), {})[int(match["number"])] = at
    renamed = list(names)
    for stem, found in families.items():
        first, count = min(found), len(found)
        if count not in _POSE_COUNTS or first > 1 or sorted(found) != list(range(first, first + count)):
            continue
        columns = [found[first + i] for i in range(count)]
        numbers = np.array(
            [
                [cell if isinstance(cell, float) else np.nan for cell in (row[at] for at in columns)]
                for row in rows
                if len(row) > max(columns)
            ]
        )
        numbers = numbers[np.isfinite(numbers).all(axis=1)] if numbers.size else numbers.reshape(0, count)
        for at, element in zip(columns, _elements(numbers), strict=False):
            renamed[at] = f"{stem}_{element[0] + 1}_{element[1] + 1}"
    return tuple(renamed)


def _elements(numbers: Array) -> list[tuple[int, int]]:
    """Return row and column of each number of poses in a list (N, 16 or 12); empty where they are no poses."""
    height = numbers.shape[1] // 4
    along_rows = [divmod(at, 4) for at in range(4 * height)]
    along_columns = [(at % height, at // height) for at in range(4 * height)]
    fitting = []
    for elements in (along_rows, along_columns):
        poses = np.zeros((len(numbers), height, 4))
        for at, (row, column) in enumerate(elements):
            poses[:, row, column] = numbers[:, at]
        turns = poses[:, :3, :3]
        is_turn = np.abs(turns @ np.swapaxes(turns, 1, 2) - np.eye(3)).max(initial=0.0) < _ORTHONORMAL
        if is_turn and (poses[:, 3:] == [0.0, 0.0, 0.0, 1.0]).all():
            fitting.append(elements)
    return fitting[0] if len(numbers) and len(fitting) == 1 else []


def find_matrix(names: Sequence[str], plain: Mapping[str, str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the columns of a place, and nine of a rotation row by row; empty for what the table does not have."""
    families: dict[tuple[str, str], dict[tuple[int, int], str]] = {}
    for name in names:
        if match := _ELEMENT.match(plain[name]):
            key = (match["before"], match["after"])
            families.setdefault(key, {})[int(match["row"]), int(match["column"])] = name
    for (before, _), found in families.items():
        if _CALCULATED.match(before):
            continue
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
