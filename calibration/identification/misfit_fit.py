"""A quick fit of base, tool and zeros to most of a series' rows: how well they fit their robot at all."""

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.identification.estimator import FitProblem, errors_m, estimate_arm
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.misfit_error import MisfitScore
from cellcal.calibration.identification.observations import (
    LengthObservations,
    MeasuredRows,
    Observations,
    PointObservations,
)
from cellcal.calibration.identification.parameters import OFFSETS, ArmState
from cellcal.calibration.identification.quick_fit import spread_rows, trimmed_rms

_UNKNOWN_RAD = 1e6  # deviation of a zero that is not fitted
_LEAST_PROGRESS = 0.01  # of the cost: whether rows fit shows in factors of it


def motion_of(model: RobotModel, observations: MeasuredRows) -> float:
    """Return how far the nominal flange moved about its mean (RMS) [m]."""
    rows = spread_rows(len(observations), 2000)
    places = model.tip_positions(observations.joints_rad[rows], np.zeros(3))
    return float(np.sqrt(((places - places.mean(axis=0)) ** 2).sum(axis=1).mean()))


def fit_quickly(model: RobotModel, observations: Observations) -> MisfitScore:
    """Fit base, tool and zeros to most of the rows; outliers have no weight."""
    best = MisfitScore(float("inf"))
    plain = places_only(observations)
    try:
        starts = first_guess(model, plain)
        for start in starts:
            fitted = _fit_from(model, plain, start)
            if fitted.score_m < best.score_m:
                best = fitted
    except (CalibrationError, np.linalg.LinAlgError):
        return best
    return best


def places_only(observations: Observations) -> Observations:
    """Return rows without attitudes and mountings."""
    if isinstance(observations, LengthObservations):
        return observations
    once = np.zeros(len(observations), dtype=np.intp)
    return PointObservations(observations.joints_rad, observations.positions_m, observations.sigma_m, once)


def _fit_from(model: RobotModel, observations: Observations, start: ArmState) -> MisfitScore:
    layout = make_layout(model, observations.kind, start.mounting_count, level=OFFSETS)
    problem = FitProblem.from_observations(start, observations)
    fit = estimate_arm(layout, start, problem, least_progress=_LEAST_PROGRESS)
    for share in (0.6, 0.75):
        sizes = errors_m(fit.state, problem)
        weights = np.where(sizes <= np.quantile(sizes, share), 1.0, 1e-6)
        # After outliers the start may be far: the rows that fit best lead back.
        fit = estimate_arm(layout, fit.state, problem, weights, least_progress=_LEAST_PROGRESS)
    sizes = errors_m(fit.state, problem)
    freedom = 1.0 - len(layout) / (0.75 * observations.channels * len(observations))
    score = float(trimmed_rms(sizes)) / float(np.sqrt(max(freedom, 0.1)))
    offsets, sigma = np.zeros(model.axis_count), np.full(model.axis_count, _UNKNOWN_RAD)
    spread = np.sqrt(np.diag(fit.covariance)) * max(score / float(np.median(observations.sigma_m)), 1.0)
    for at, parameter in enumerate(layout.parameters):
        if parameter.role == "offset" and parameter.unit == "rad":  # not of a slide
            offsets[parameter.joint], sigma[parameter.joint] = fit.deviations[at], spread[at]
    # Offsets belong to angles against the link before; what is shown are the controller's joints.
    of_joints = np.linalg.inv(model.joint_coupling)
    sigmas = np.where(np.abs(of_joints) > 0, np.abs(of_joints) * sigma, 0.0).sum(axis=1)
    return MisfitScore(score, tuple((of_joints @ offsets).tolist()), tuple(sigmas.tolist()))
