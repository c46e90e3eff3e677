"""Where a further reading of the target is expected at any posture, and the radius in space that holds 95 %."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.held_out_regions import learn_model_error
from cellcal.calibration.identification.identify import Identification
from cellcal.calibration.identification.lints import beyond_fitted_range
from cellcal.calibration.identification.model_error import ModelError, expanded_in_space
from cellcal.calibration.identification.parameters import FRAMES, GEOMETRY, GRAVITY, RIPPLE
from cellcal.calibration.identification.selection import fit_level
from cellcal.calibration.identification.tip_uncertainty import predict_tips

_NARROWEST_RAD = 0.1
_RIVALS = (
    GEOMETRY,
    GRAVITY,
    RIPPLE,
)  # levels that may stand in for each other among the rows, and not beyond


@dataclass(frozen=True, eq=False)
class ReadingPrediction:
    """Places of further readings in the frame of `predict_tips`, the posture first."""

    positions_m: Array  # (N, 3)
    covariances_m2: Array  # (N, 3, 3) of a reading: parameters, device, and what the model lacks
    expanded_m: Array  # (N,) radius that holds 95 % of readings
    parameters_m2: Array  # (N, 3, 3) of the parameters alone
    parameters_expanded_m: Array  # (N,) radius to 95 % if the model lacked nothing
    beyond: NDArray[np.bool_]  # (N,) turns a joint further than any fitted row
    far: NDArray[np.bool_]  # (N,) beyond, or worse known than any posture among the rows
    model_error: ModelError


def predict_readings(found: Identification, joints_rad: Array) -> ReadingPrediction:
    """Predict readings at postures (N, n) [rad], with the residual model where it was chosen.

    Notes
    -----
    Away from the measured postures the levels that fit the rows alike part, and the rows do not tell which one is
    right: by how far they part is added there. What no level describes grows with the way beyond a joint's range: as
    far beyond as the range is wide, its deviation is doubled.
    """
    error = learn_model_error(found)
    tips = predict_tips(found.robust.fit, joints_rad)
    positions, own = tips.positions_m, np.zeros(len(joints_rad))
    if found.residual is not None and found.residual.chosen:
        residual_m, sigma = found.residual.model.predict_residual(joints_rad)
        positions, own = positions + residual_m @ found.state.devices[-1].device_base[:3, :3].T, sigma**2
    beyond = np.zeros(len(joints_rad), dtype=bool)
    fitted_rad = found.robust.problem.observations.joints_rad
    for note in beyond_fitted_range(fitted_rad, joints_rad):
        beyond[list(note.rows)] = True
    far = error.is_extrapolated(tips.covariance_m2) | beyond
    own += error.variance_m2 * ((1.0 + _range_excess(fitted_rad, joints_rad)) ** 2 - 1.0)
    own[far] += _level_disagreement_m2(found, joints_rad[far], tips.positions_m[far])
    return ReadingPrediction(
        positions,
        error.total_covariance(tips.covariance_m2, own),
        error.expanded_m(tips.covariance_m2, own, beyond),
        tips.covariance_m2,
        expanded_in_space(tips.covariance_m2, error.degrees_of_freedom),
        beyond,
        far,
        error,
    )


def _range_excess(fitted_rad: Array, joints_rad: Array) -> Array:
    """Return how far each posture (N,) is beyond the fitted range of a joint, in widths of that range; at most 1."""
    low, high = fitted_rad.min(axis=0), fitted_rad.max(axis=0)
    beyond = np.maximum(np.maximum(low - joints_rad, joints_rad - high), 0.0)
    widths = np.maximum(high - low, _NARROWEST_RAD)
    excess: Array = np.minimum(beyond / widths, 1.0).max(axis=1, initial=0.0)
    return excess


def _level_disagreement_m2(found: Identification, joints_rad: Array, positions_m: Array) -> Array:
    """Return the variance a coordinate (N,) that the levels' disagreement is worth."""
    worst = np.zeros(len(joints_rad))
    if found.level == FRAMES or not len(joints_rad):
        return worst
    observations, options = found.robust.problem.observations, found.options
    for level in _RIVALS:
        if level == found.level:
            continue
        fit = fit_level(
            found.state.nominal, observations, found.frames, level, options.priors, options.start
        ).fit
        apart = ((predict_tips(fit, joints_rad).positions_m - positions_m) ** 2).sum(axis=1)
        worst = np.maximum(worst, apart / 3.0)
    return worst
