"""Rows whose target was not on the robot: one place is read again and again, whatever the joints.

A tracker is checked at a nest between poses, or a second ball stands in the cell. A target that the robot turns about
its own middle is also read at one place; there the arm explains it, here it does not.
"""

from collections.abc import Iterator

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.first_guess import base_and_tool
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.message import make_message

_UNITS_M = np.array([1.0, 1e-2, 1e-3, 0.0254, 0.3048])
_SAME_M = 1e-3  # a place within so much is the same
_ARM_MOVED_M = 0.2  # of the flange, between rows of one place
_OFF_M = 0.05  # from where the arm would have had the target …
_TIMES_OFF = 20.0  # … and so many times as far as 95 % of the other rows are
_FEWEST, _FEWEST_OTHERS = 2, 8
_MOST = 0.3  # of the rows
_PAIRS = 1000


def find_nest_readings(values: Array, base_flange: Array) -> dict[int, str]:
    """Return the rows in which another target than the robot's was read, and why.

    Parameters
    ----------
    values : (N, 3)
        Measured places, in any unit of length.
    base_flange : (N, 4, 4)
        Where the nominal flange was [m].
    """
    if values.shape[1] != 3 or len(values) < _FEWEST + _FEWEST_OTHERS:
        return {}
    flange_m = base_flange[:, :3, 3]
    places_m = values * _unit_m(values, flange_m)
    groups = [rows for rows in _rows_of_one_place(places_m) if _spread_m(flange_m[rows]) > _ARM_MOVED_M]
    if not groups:
        return {}
    suspects = np.unique(np.concatenate(groups))
    others = np.setdiff1d(np.arange(len(values)), suspects)
    if len(suspects) > _MOST * len(values) or len(others) < _FEWEST_OTHERS:
        return {}
    off_m = _distances_m(places_m, base_flange, others)
    limit_m = max(_OFF_M, _TIMES_OFF * float(np.quantile(off_m[others], 0.95)))
    found: dict[int, str] = {}
    for rows in groups:
        if off_m[rows].min() > limit_m:
            why = make_message(
                "the target was not on the robot: {count} rows read this place with other joints",
                count=len(rows),
            )
            found |= dict.fromkeys(rows.tolist(), why)
    return found


def _unit_m(values: Array, flange_m: Array) -> float:
    """Return the unit in which the places spread as the flange does [m]."""
    rows = np.arange(len(values))
    some = np.random.default_rng(1).permutation(rows)[:_PAIRS]
    moved = np.linalg.norm(np.diff(flange_m[some], axis=0), axis=1)
    read = np.linalg.norm(np.diff(values[some], axis=0), axis=1)
    ratio = float(np.median(moved)) / max(float(np.median(read)), 1e-12)
    return float(_UNITS_M[np.argmin(np.abs(np.log(_UNITS_M / max(ratio, 1e-12))))])


def _rows_of_one_place(places_m: Array) -> Iterator[Rows]:
    """Yield rows that lie in one cell of a grid; a place at a cell's edge lies inside one of the second grid."""
    for shift in (0.0, 0.5):
        cells = np.floor(places_m / (2.0 * _SAME_M) + shift)
        _, of, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        for cell in np.flatnonzero(counts >= _FEWEST):
            yield np.flatnonzero(of.reshape(-1) == cell)


def _spread_m(points_m: Array) -> float:
    return float(np.linalg.norm(np.ptp(points_m, axis=0)))


def _distances_m(places_m: Array, base_flange: Array, rows: Rows) -> Array:
    """Return how far each place is from where an arm that is placed by some rows would have its target [m] (N,)."""
    try:
        device_base, tool = base_and_tool(base_flange[rows], places_m[rows])
    except CalibrationError:
        return np.zeros(len(places_m))
    expected = (device_base @ base_flange @ tool)[:, :3, 3]
    distances: Array = np.linalg.norm(places_m - expected, axis=1)
    return distances
