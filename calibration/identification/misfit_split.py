"""Whether rows that fit nothing fit in two parts, one behind the other: a device that was moved far in between."""

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.identification.misfit_fit import fit_quickly, places_only
from cellcal.calibration.identification.observations import (
    MeasuredRows,
    PointObservations,
    PoseObservations,
)
from cellcal.calibration.identification.quick_fit import point_scores, spread_rows

_FEWEST_ROWS = 8  # of each part
_MOST_ROWS = 80
_MOST_SPLITS = 40


def find_split(model: RobotModel, observations: MeasuredRows, limit_m: float) -> int | None:
    """Return from which row on the rows fit by themselves as those before do; None where no such row is found.

    Parameters
    ----------
    limit_m : float
        What rows that fit leave at most [m].
    """
    if not isinstance(observations, PointObservations | PoseObservations):
        return None
    places = places_only(observations)
    if not isinstance(places, PointObservations) or len(places) < 2 * _FEWEST_ROWS:
        return None
    flanges = model.base_flange(places.joints_rad)

    def score_of(part: slice) -> float:
        rows = np.arange(len(places))[part]
        rows = rows[spread_rows(len(rows), _MOST_ROWS)]
        once = np.zeros(1, dtype=bool)
        return float(point_scores(flanges[rows][None], places.positions_m[rows][None], once)[0])

    def worse_part(row: int) -> float:
        return max(score_of(slice(row)), score_of(slice(row, None)))

    last = len(places) - _FEWEST_ROWS
    step = max((last - _FEWEST_ROWS) // _MOST_SPLITS, 1)
    best = min(range(_FEWEST_ROWS, last + 1, step), key=worse_part)
    while step > 1:
        near = range(max(best - step, _FEWEST_ROWS), min(best + step, last) + 1, max(step // 8, 1))
        best, step = min(near, key=worse_part), max(step // 8, 1)
    parts = (np.arange(best), np.arange(best, len(places)))
    left = [fit_quickly(model, places.select_rows(part)).score_m for part in parts]
    return best if max(left) <= limit_m else None
