"""What an identification's predictions miss: by rows held out among neighbours, and by regions held out whole."""

import numpy as np

from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.error_tails import tail_reach
from cellcal.calibration.identification.estimator import FitProblem, errors_m
from cellcal.calibration.identification.identify import Identification
from cellcal.calibration.identification.judgement import Judgement, judge_rows, place_variances
from cellcal.calibration.identification.model_error import HeldOutErrors, ModelError, model_error
from cellcal.calibration.identification.observations import Observations, Rows
from cellcal.calibration.identification.residual_model import errors_with, residual_of
from cellcal.calibration.identification.selection import evenly_spaced, fit_level

_REGIONS = 8
_ROWS_A_REGION = 6  # at least, on the average
_MOST_ROWS = 1500  # are fitted without each region


def learn_model_error(found: Identification) -> ModelError:
    """Return how far further readings may be from an identification's predictions.

    Mistakes are no readings of this arm, and do not count; how many rows there were is reported beside.

    Raises
    ------
    CalibrationError
        As `judge`, where the identification was not judged yet.
    """
    observations, judged = found.robust.problem.observations, found.judgement
    if not len(judged.held_out_m):
        judged = judge_rows(found.state.nominal, observations, found.grouping, found.options)
    reach = tail_reach(found.robust.deviations, observations.channels, len(found.rejected))
    mistakes = found.rejected[found.robust.deviations[found.rejected] > reach]
    readings = np.delete(np.arange(len(observations)), mistakes)
    near = _among_neighbours(found, judged, observations.kind).select_rows(readings)
    far = _regions_left_out(found, observations.select_rows(readings))
    tail_rows = len(found.rejected) - len(mistakes)
    return model_error(near, far, max(found.robust.degrees_of_freedom, 1.0), tail_rows)


def _uses_residual(found: Identification) -> bool:
    return found.residual is not None and found.residual.chosen


def _among_neighbours(found: Identification, judged: Judgement, kind: str) -> HeldOutErrors:
    channels = 1 if kind == "length" else 3
    if _uses_residual(found):
        return HeldOutErrors(judged.with_residual_m, judged.variances_m2, judged.own_m2, channels)
    return HeldOutErrors(judged.held_out_m, judged.variances_m2, np.zeros(len(judged.held_out_m)), channels)


def _regions_left_out(found: Identification, observations: Observations) -> HeldOutErrors:
    """Predict every region of postures by fits of the others, at the level and mountings that all rows chose."""
    channels = 1 if observations.kind == "length" else 3
    some = observations.select_rows(evenly_spaced(len(observations), _MOST_ROWS))
    regions = posture_regions(some.joints_rad, min(_REGIONS, len(some) // _ROWS_A_REGION))
    parts = []
    for region in range(int(regions.max(initial=0)) + 1 if regions.any() else 0):
        held_rows, training = (
            some.select_rows(np.flatnonzero(regions == region)),
            some.select_rows(np.flatnonzero(regions != region)),
        )
        if len(np.unique(training.mounting)) < len(np.unique(some.mounting)):
            continue
        try:
            parts.append(_predict_rows(found, training, held_rows))
        except DegenerateDataError:
            continue
    if not parts:
        return HeldOutErrors.without_rows(channels)
    errors, variances, own = (np.concatenate(column) for column in zip(*parts, strict=True))
    return HeldOutErrors(errors, variances, own, channels)


def _predict_rows(
    found: Identification, training: Observations, held_rows: Observations
) -> tuple[Array, Array, Array]:
    options, model = found.options, found.state.nominal
    robust = fit_level(model, training, found.frames, found.level, options.priors, options.start)
    state, own = robust.fit.state, np.zeros(len(held_rows))
    if not _uses_residual(found):
        return (
            errors_m(state, FitProblem.from_observations(state, held_rows)),
            place_variances(robust.fit, held_rows),
            own,
        )
    residual = residual_of(robust, training, options.seed)
    own = 3.0 * residual.predict_residual(held_rows.joints_rad)[1] ** 2
    return errors_with(residual, state, held_rows), place_variances(robust.fit, held_rows), own


def posture_regions(joints_rad: Array, number: int) -> Rows:
    """Return the region (N,) of every posture: the most spread one is halved along its main direction, again."""
    regions = np.zeros(len(joints_rad), dtype=np.intp)
    for new in range(1, max(number, 1)):
        spreads = [
            float(joints_rad[regions == r].var(axis=0).sum()) * np.sum(regions == r) for r in range(new)
        ]
        rows = np.flatnonzero(regions == int(np.argmax(spreads)))
        away = joints_rad[rows] - joints_rad[rows].mean(axis=0)
        along = away @ np.linalg.svd(away, full_matrices=False)[2][0]
        regions[rows[along > np.median(along)]] = new
    return regions
