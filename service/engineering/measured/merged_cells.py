"""Joints that stand once for several readings: merged cells, and samples below the posture that they belong to."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.table import MeasurementTable

_MOSTLY = 0.9  # of the postures have as many readings


def fill_merged_joints(
    table: MeasurementTable, joints: Sequence[str], readings: Sequence[str]
) -> MeasurementTable:
    """Return a table in which rows without any joint have those of the row above; its dialect says so.

    Only where nearly every posture is followed by equally many rows without joints, and these rows read the place of
    the posture: a row whose joints were not recorded is not meant, nor the readings of a device that tells more often
    than the controller does while the arm moves.
    """
    at = [table.names.index(name) for name in joints]
    read = [table.names.index(name) for name in readings if name]
    blank: NDArray[np.bool_] = np.logical_and(
        np.isnan(table.numbers[:, at]).all(axis=1), np.isfinite(table.numbers[:, read]).all(axis=1)
    )
    for row, column in table.texts:
        if column in at:
            blank[row] = False
    starts = np.flatnonzero(~blank)
    if not blank.any() or not len(starts) or starts[0] != 0:
        return table
    counts = np.diff([*starts, len(blank)]) - 1
    usual = int(np.bincount(counts).argmax())
    if not usual or np.mean(counts == usual) < _MOSTLY:
        return table
    above = starts[np.cumsum(~blank) - 1]
    if _reads_on_the_way(table.numbers[:, read], starts, usual):
        return table
    numbers = table.numbers.copy()
    for column in at:
        numbers[blank, column] = table.numbers[above[blank], column]
    note = make_message(
        "{count} rows without joints have those of the row above: {readings} readings a posture",
        count=int(blank.sum()),
        readings=usual + 1,
    )
    return replace(table, numbers=numbers, dialect="; ".join([table.dialect, note]))


def _reads_on_the_way(readings: Array, starts: NDArray[np.intp], usual: int) -> bool:
    """Return whether the rows (N, c) between postures lie where the arm passes between them, not at the one above."""
    whole = np.flatnonzero(np.diff(starts) == usual + 1)
    first, following = readings[starts[whole]], readings[starts[whole + 1]]
    to_first, to_way = [], []
    for k in range(1, usual + 1):
        between = readings[starts[whole] + k]
        passed = first + k / (usual + 1) * (following - first)
        to_first.append(np.linalg.norm(between - first, axis=1))
        to_way.append(np.linalg.norm(between - passed, axis=1))
    if not len(whole):
        return False
    return bool(np.nanmedian(to_first) > np.nanmedian(to_way))
