"""A target that sits elsewhere on the flange from some row on: another ball, another tool, a target that slipped.

A device that was moved is an unknown of the identification (`series_breaks`); a target that changed is not, and its
change goes into every parameter. One place of change is looked for, by the target's coordinates behind it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import LinAlgError, lstsq

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import FitProblem, estimate_arm, place_columns
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.misfit_error import MisfitCause, one_target_error
from cellcal.calibration.identification.observations import (
    LengthObservations,
    Observations,
    PointObservations,
    Rows,
)
from cellcal.calibration.identification.parameters import GEOMETRY, OFFSETS, ParameterLayout
from cellcal.calibration.identification.quick_fit import spread_rows
from cellcal.calibration.message import make_message

_MOST_ROWS = 160
FEWEST_ROWS = 8  # on each side
_SPARE_CHANNELS = 24
TIMES_BETTER = 1.6  # what the rows leave over must fall by so much
BETTER_THAN_MOVED = 1.3  # times, than with a device that was moved at the same row
DEVIATIONS = 8.0
SMALLEST_M = 1e-4
_CURE = (
    "See which ball, target or tool was on the robot then, and whether it slipped. Divide the file there and "
    "identify each part, or describe both targets in a layout (`--layout`, examples in "
    "`deploy/layouts/`). Nothing was stored."
)


@dataclass(frozen=True, slots=True)
class TargetChange:
    """From which usable row on (from 0) a target sits elsewhere, by how much, and what the rows then leave."""

    row: int
    moved_m: float
    remaining_m: float
    before_m: float


@dataclass(frozen=True, eq=False)
class SeriesColumns:
    """Columns of the unknowns of a fit without a change, and the residuals that the rows of a series leave."""

    layout: ParameterLayout
    columns: Array  # (p, 3, N), whitened
    left: Array  # (3, N), whitened
    sigma_m: Array  # (N,)
    rows: Rows  # (N,) of the series


def series_columns(model: RobotModel, observations: Observations) -> SeriesColumns | None:
    """Return the columns of at most 160 rows in their order; None where no fit tells anything."""
    if isinstance(observations, LengthObservations) or len(observations) < 2 * FEWEST_ROWS:
        return None
    rows = spread_rows(len(observations), _MOST_ROWS)
    some = observations.select_rows(rows)
    places = PointObservations(
        some.joints_rad, some.positions_m, some.sigma_m, np.zeros(len(some), dtype=np.intp)
    )
    level = GEOMETRY
    if 3 * len(places) < len(make_layout(model, places.kind, 1, level=GEOMETRY)) + _SPARE_CHANNELS:
        level = OFFSETS
    layout = make_layout(model, places.kind, 1, level=level)
    try:
        start = first_guess(model, places)[0]
        problem = FitProblem.from_observations(start, places)
        state = estimate_arm(layout, start, problem).state
        columns, left = place_columns(layout, state, problem)
    except (CalibrationError, LinAlgError):
        return None
    return SeriesColumns(layout, columns, left, problem.observations.sigma_m, rows)


def find_target_change(found: SeriesColumns | None) -> TargetChange | None:
    """Return where the target changed its place on the flange, if one change explains the rows far better."""
    if found is None:
        return None
    try:
        target = found.layout.target_slice(0)
        return _best_change(found.columns, found.left, target, (found.sigma_m, found.rows))
    except LinAlgError:
        return None


def _best_change(
    columns: Array, left: Array, target: slice, series: tuple[Array, Rows]
) -> TargetChange | None:
    sigma_m, rows = series
    count = left.shape[1]
    plain = columns.transpose(2, 1, 0).reshape(3 * count, -1)  # channels of one row beside each other
    values = left.T.reshape(-1)
    of_target, of_device = plain[:, target], plain[:, :6]
    base = orthonormal_columns(plain)
    rest = values - base @ (base.T @ values)
    before = float(rest @ rest)
    best: tuple[float, int, Array, Array] | None = None
    for at in range(FEWEST_ROWS, count - FEWEST_ROWS + 1):
        moved, free, sum_left = _explained(base, rest, of_target, 3 * at)
        if best is None or sum_left < best[0]:
            best = sum_left, at, moved, free
    if best is None:
        return None
    after, at, moved, free = best
    freedom = max(3 * count - plain.shape[1] - 3, 1)
    scatter = after / freedom
    size_m = float(np.linalg.norm(moved))
    sigma_moved = float(np.sqrt(max(np.trace(np.linalg.pinv(free.T @ free)) * scatter, 1e-30)))
    device = _explained(base, rest, of_device, 3 * at)[2]
    if (
        before < TIMES_BETTER**2 * after
        or device < BETTER_THAN_MOVED**2 * after
        or size_m < max(DEVIATIONS * sigma_moved, SMALLEST_M)
    ):
        return None
    metres = float(np.median(sigma_m) * np.sqrt(3.0))
    return TargetChange(
        int(rows[at]),
        size_m,
        metres * float(np.sqrt(scatter)),
        metres * float(np.sqrt(before / freedom)),
    )


def orthonormal_columns(columns: Array) -> Array:
    """Return an orthonormal base of what columns span; unknowns that hide behind others add nothing."""
    left, sizes, _ = np.linalg.svd(
        columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-30), full_matrices=False
    )
    base: Array = left[:, sizes > 1e-7 * sizes[0]]
    return base


def _explained(base: Array, rest: Array, columns: Array, first: int) -> tuple[Array, Array, float]:
    """Return what unknowns that count from a channel on become, their columns beside the others, and what is left."""
    own = columns.copy()
    own[:first] = 0.0
    own = own - base @ (base.T @ own)
    found = np.asarray(lstsq(own, rest, rcond=1e-9)[0], dtype=np.float64)
    residual = rest - own @ found
    return found, own, float(residual @ residual)


def refuse_target_change(model: RobotModel, change: TargetChange | None, file_rows: Rows) -> None:
    """Refuse rows of two targets that were taken as of one; ``file_rows`` are the rows' numbers in the file.

    Raises
    ------
    MisfitError
        With the row, the distance and the cure.
    """
    if change is None:
        return
    says = make_message(
        "the target sits {moved_mm:.2f} mm elsewhere on the flange from row {row} on (the first data row is row 0)",
        moved_mm=change.moved_m * 1000.0,
        row=int(file_rows[change.row]),
    )
    cause = MisfitCause(("target",), says, _CURE, change.remaining_m)
    raise one_target_error(model, change.before_m, cause, _CURE)
