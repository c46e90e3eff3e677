"""Joints that stand once for several readings: merged cells, and samples below the posture that they belong to."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.table import MeasurementTable

_MOSTLY = 0.9  # of the postures have as many readings


def fill_merged_joints(
    table: MeasurementTable, joints: Sequence[str], readings: Sequence[str]
) -> MeasurementTable:
    """Return a table in which rows without any joint have those of the row above; its dialect says so.

    Only where nearly every posture is followed by equally many rows without joints: a row whose joints were not
    recorded is not meant.
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
    numbers = table.numbers.copy()
    for column in at:
        numbers[blank, column] = table.numbers[above[blank], column]
    note = make_message(
        "{count} rows without joints have those of the row above: {readings} readings a posture",
        count=int(blank.sum()),
        readings=usual + 1,
    )
    return replace(table, numbers=numbers, dialect="; ".join([table.dialect, note]))
