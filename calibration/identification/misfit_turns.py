"""Targets or devices that were measured in turn, row by row: each series of every so many rows fits by itself."""

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.identification.misfit_error import MisfitCause, MisfitScore
from cellcal.calibration.identification.misfit_fit import fit_quickly
from cellcal.calibration.identification.observations import Observations, PointObservations
from cellcal.calibration.message import make_message

_COUNTS = (2, 3, 4)
_FEWEST_ROWS = 12  # of each target or device
_CURE = (
    "Say which target or device each row is of in a column of its own, and keep the rows of one in the file, or "
    "describe all of them in a layout (`--layout`, examples in `deploy/layouts/`)."
)


def turn_causes(model: RobotModel, series: Observations, limit_m: float) -> tuple[MisfitCause, ...]:
    """Return how many targets or devices took turns, if the rows of each leave no more than the limit [m].

    However far apart they are: no row is compared with one of another.
    """
    if not isinstance(series, PointObservations):
        return ()
    for count in _COUNTS:
        if len(series) < count * _FEWEST_ROWS:
            return ()
        left_m = max(score.score_m for score in _each_alone(model, series, count))
        if left_m <= limit_m:
            says = make_message(
                "{count} targets or devices were measured in turn, row by row, and the rows of each fit by "
                "themselves",
                count=count,
            )
            return (MisfitCause(("turns",), says, _CURE, left_m),)
    return ()


def _each_alone(model: RobotModel, series: PointObservations, count: int) -> list[MisfitScore]:
    rows = np.arange(len(series))
    return [fit_quickly(model, series.select_rows(rows[first::count])) for first in range(count)]
