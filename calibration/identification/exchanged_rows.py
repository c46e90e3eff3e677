"""Rejected rows whose measured values fit the joints of other rows: part of a series is in another order."""

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import FitProblem, errors_m
from cellcal.calibration.identification.identify import Identification
from cellcal.calibration.identification.lints import Lint
from cellcal.calibration.identification.observations import (
    LengthObservations,
    Observations,
    PoseObservations,
    Rows,
    points_of_poses,
    with_joints,
)
from cellcal.calibration.message import make_message

_FEWEST = 2
_MOST = 200  # rejected rows: a fit that leaves out more is not believed anyway
_NEIGHBOURS = 3  # rows before and behind a rejected one, whose joints may belong to it
_ROOM = 1.5  # times the largest error of the kept rows
_FAR = 4.0  # times closer must the other row's joints be than a row's own
_BY_CHANCE = 0.05  # pairs that may be expected where nothing was exchanged


def exchanged_rows(found: Identification, file_rows: Rows) -> list[Lint]:
    """Name rejected rows whose measured values belong to the joints of others.

    Parameters
    ----------
    found : Identification
        Its rows are those of the series, in order.
    file_rows : (N,)
        Their numbers in the file.
    """
    rows, observations = found.rejected, found.robust.problem.observations
    kept_m = np.delete(found.fit_m, rows)
    if not _FEWEST <= len(rows) <= _MOST or not len(kept_m):
        return []
    near_m = _ROOM * float(kept_m.max())
    others = _candidates(rows, len(observations))
    away = _pair_errors(found, rows, others)
    closest = away.argmin(axis=1)
    least_m = away[np.arange(len(rows)), closest]
    belongs = (least_m <= near_m) & (_FAR * least_m < found.fit_m[rows])
    by_chance = len(rows) * len(others) * _chance(observations, near_m)
    if belongs.sum() < _FEWEST or by_chance > _BY_CHANCE * belongs.sum():
        return []
    here, there = file_rows[rows[belongs]], file_rows[others[closest[belongs]]]
    return [
        Lint(
            "exchanged",
            make_message(
                "the measured values of {count} rows that were not fitted belong to the joints of other rows: that "
                "of row {first} to row {first_other}, … that of row {last} to row {last_other} (the first data "
                "row is row 0). Joints and measured values are in another order there: put them right in the file.",
                count=len(here),
                first=int(here[0]),
                first_other=int(there[0]),
                last=int(here[-1]),
                last_other=int(there[-1]),
            ),
            tuple(int(row) for row in here),
        )
    ]


def _candidates(rows: Rows, count: int) -> Rows:
    """Return rows whose joints may belong to a rejected row: the others of them, and their neighbours."""
    around = rows[:, None] + np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1)
    return np.unique(around[(around >= 0) & (around < count)])


def _pair_errors(found: Identification, rows: Rows, others: Rows) -> Array:
    """Return the errors (R, C) [m] of rows' measured values with the joints of others; infinite with their own."""
    observations = found.robust.problem.observations
    some = observations.select_rows(np.repeat(rows, len(others)))
    places = points_of_poses(some) if isinstance(some, PoseObservations) else some
    joints = np.tile(observations.joints_rad[others], (len(rows), 1))
    pairs = with_joints(places, joints)
    away = errors_m(found.state, FitProblem.from_observations(found.state, pairs))
    own = (joints == some.joints_rad).all(axis=1)
    return np.where(own, np.inf, away).reshape(len(rows), len(others))


def _chance(observations: Observations, near_m: float) -> float:
    """Return how likely a measured value is as near to a prediction that has nothing to do with it."""
    if isinstance(observations, LengthObservations):
        return 2.0 * near_m / max(float(np.ptp(observations.lengths_m)), near_m)
    spread = np.maximum(np.ptp(observations.positions_m, axis=0), near_m)
    return float(4.0 / 3.0 * np.pi * near_m**3 / np.prod(spread))
