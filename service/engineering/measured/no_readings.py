"""Rows in which the device read nothing: zeros, fill-in numbers, a reading that stood still while the arm moved."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array

_FILL_INS = (
    999.0,
    9999.0,
    99999.0,
    999999.0,
    9999999.0,
    999.9,
    9999.9,
    999.99,
    9999.99,
    999.999,
    9999.999,
    99999.999,
)
_STOOD_M = 1e-3  # of the flange: beyond, the arm moved
_FEWEST_FROZEN = {
    1: 3,
    3: 2,
}  # equal readings in a row, by their numbers: one length may come twice by chance
_MOST_FROZEN = 0.5  # of the rows: above, it is no fault of single rows
_MOST_ZEROS = 0.9  # of the rows: above, a column of zeros is what the device reads


def no_readings(values: Array, flange_m: Array) -> dict[int, str]:
    """Return the rows of usable numbers that are no reading, and why.

    Parameters
    ----------
    values : (N, k)
        What the device read, as written: a length, or x, y, z.
    flange_m : (N, 3)
        Where the nominal flange was [m].
    """
    found: dict[int, str] = {}
    _fill_ins(values, found)
    _mark_zeros(values, found)
    _mark_frozen(values, flange_m, found)
    return found


def _fill_ins(values: Array, found: dict[int, str]) -> None:
    size = np.abs(values)
    fill = np.isin(size, _FILL_INS)
    for column in range(values.shape[1]):
        rows = np.flatnonzero(fill[:, column])
        others = size[~fill[:, column], column]
        if len(rows) and (
            not len(others) or _stands_out(size[rows, column], others) or fill[rows].all(axis=1).all()
        ):
            for row in rows.tolist():
                found.setdefault(row, f"{values[row, column]:g} is a fill-in, no reading")


def _stands_out(few: Array, others: Array) -> bool:
    """Return whether numbers lie outside what the other rows hold."""
    return bool(few.min() > others.max() or few.max() < others.min())


def _mark_zeros(values: Array, found: dict[int, str]) -> None:
    zero = (values == 0.0).all(axis=1)
    if zero.mean() > _MOST_ZEROS:
        return
    for row in np.flatnonzero(zero).tolist():
        found.setdefault(row, f"{', '.join(['0'] * values.shape[1])} is no reading")


def _mark_frozen(values: Array, flange_m: Array, found: dict[int, str]) -> None:
    """Find readings that repeat the one before to the last digit although the arm moved."""
    rows = [row for row in range(len(values)) if row not in found]
    fewest = _FEWEST_FROZEN[1 if values.shape[1] == 1 else 3]
    stood: list[int] = []
    run: list[int] = []
    for row in [*rows, -1]:
        if row >= 0 and run and _is_repeat(values, flange_m, run[-1], row):
            run.append(row)
            continue
        # The first may be a reading; nothing tells whether it is, and one row is no loss.
        stood += run if len(run) >= fewest else []
        run = [row]
    if len(stood) <= _MOST_FROZEN * len(values):
        found |= dict.fromkeys(stood, "the same reading stands in neighbouring rows although the arm moved")


def _is_repeat(values: Array, flange_m: Array, before: int, row: int) -> bool:
    moved = float(np.linalg.norm(flange_m[row] - flange_m[before]))
    return bool((values[row] == values[before]).all()) and moved > _STOOD_M


def usable_without(good: NDArray[np.bool_], found: Sequence[int]) -> NDArray[np.bool_]:
    """Return which rows remain usable; ``found`` counts the usable ones."""
    remaining = good.copy()
    remaining[np.flatnonzero(good)[list(found)]] = False
    return remaining
