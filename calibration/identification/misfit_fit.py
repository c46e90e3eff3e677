"""A quick fit of base, tool and zeros to most of a series' rows: how well they fit their robot at all."""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import ArmFit, FitProblem, errors_m, estimate_arm
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
_SHARES = (0.6, 0.75)  # of the rows that fit best: these alone lead back to them
_LEAST_PROGRESS = 0.01  # of the cost: whether rows fit shows in factors of it
_LEAST_OF_LIMITED = 0.1  # of the cost, where only a score far below counts
_SAME = 0.02  # of the cost
_REACHED = 2.0  # times the limit: further down no choice of rows leads, unless outliers pull
_PULLED = {"point": 1.8, "length": 2.7}  # times the best rows' error; 1.4 and 2.2 without outliers


def motion_of(model: RobotModel, observations: MeasuredRows) -> float:
    """Return how far the nominal flange moved about its mean (RMS) [m]."""
    rows = spread_rows(len(observations), 2000)
    places = model.tip_positions(observations.joints_rad[rows], np.zeros(3))
    return float(np.sqrt(((places - places.mean(axis=0)) ** 2).sum(axis=1).mean()))


def fit_quickly(
    model: RobotModel, observations: Observations, *, limit_m: float = float("inf")
) -> MisfitScore:
    """Fit base, tool and zeros to most of the rows; outliers have no weight.

    A reading that cannot come below ``limit_m`` is not followed to its end: its score is then infinite.
    """
    best = MisfitScore(float("inf"))
    plain = places_only(observations)
    progress = _LEAST_PROGRESS if np.isinf(limit_m) else _LEAST_OF_LIMITED
    begun: list[_PlainFit] = []
    with suppress(CalibrationError, np.linalg.LinAlgError):
        for start in first_guess(model, plain):
            begun.append(_begin_fit(model, plain, start, progress))  # noqa: PERF401  one that fails keeps the others
    for at, fit in enumerate(begun):
        if any(fit.is_same(earlier) for earlier in begun[:at]) or not fit.can_reach(limit_m):
            continue
        with suppress(CalibrationError, np.linalg.LinAlgError):
            best = min(best, _finish_fit(model, fit, progress), key=lambda score: score.score_m)
    return best


def places_only(observations: Observations) -> Observations:
    """Return rows without attitudes and mountings."""
    if isinstance(observations, LengthObservations):
        return observations
    once = np.zeros(len(observations), dtype=np.intp)
    return PointObservations(observations.joints_rad, observations.positions_m, observations.sigma_m, once)


@dataclass(frozen=True, eq=False)
class _PlainFit:
    """A fit from one start to all rows, outliers among them."""

    problem: FitProblem
    fit: ArmFit
    all_rows_m: float  # RMS errors
    best_rows_m: float

    def is_same(self, other: "_PlainFit") -> bool:
        """Return whether another start led to the same place."""
        return abs(self.fit.cost - other.fit.cost) <= _SAME * other.fit.cost

    def can_reach(self, limit_m: float) -> bool:
        """Return whether a fit to most of the rows may come below a limit: outliers pull at this one as they like."""
        pulled = self.all_rows_m > _PULLED[self.problem.observations.kind] * self.best_rows_m
        return pulled or self.best_rows_m <= _REACHED * limit_m


def _begin_fit(
    model: RobotModel, observations: Observations, start: ArmState, least_progress: float
) -> _PlainFit:
    layout = make_layout(model, observations.kind, start.mounting_count, level=OFFSETS)
    problem = FitProblem.from_observations(start, observations)
    fit = estimate_arm(layout, start, problem, least_progress=least_progress)
    sizes = errors_m(fit.state, problem)
    best = sizes[sizes <= np.quantile(sizes, _SHARES[0])]
    return _PlainFit(problem, fit, float(np.sqrt((sizes**2).mean())), float(np.sqrt((best**2).mean())))


def _finish_fit(model: RobotModel, plain: _PlainFit, least_progress: float) -> MisfitScore:
    fit, layout, problem = plain.fit, plain.fit.layout, plain.problem
    for share in _SHARES:
        sizes = errors_m(fit.state, problem)
        weights = np.where(sizes <= np.quantile(sizes, share), 1.0, 1e-6)
        # After outliers the start may be far: the rows that fit best lead back.
        fit = estimate_arm(layout, fit.state, problem, weights, least_progress=least_progress)
    sizes = errors_m(fit.state, problem)
    observations = problem.observations
    freedom = 1.0 - len(layout) / (_SHARES[-1] * observations.channels * len(observations))
    score = float(trimmed_rms(sizes)) / float(np.sqrt(max(freedom, 0.1)))
    spread = np.sqrt(np.diag(fit.covariance)) * max(score / float(np.median(observations.sigma_m)), 1.0)
    return score_with_zeros(model, fit, spread, score)


def score_with_zeros(model: RobotModel, fit: ArmFit, spread: Array, score_m: float) -> MisfitScore:
    """Return what a fit leaves, with its zeros and their deviations as the controller shows joints.

    Parameters
    ----------
    spread : (p,)
        Standard deviations of the parameters of the fit.
    """
    offsets, sigma = np.zeros(model.axis_count), np.full(model.axis_count, _UNKNOWN_RAD)
    for at, parameter in enumerate(fit.layout.parameters):
        if parameter.role == "offset" and parameter.unit == "rad":  # not of a slide
            offsets[parameter.joint], sigma[parameter.joint] = fit.deviations[at], spread[at]
    # Offsets belong to angles against the link before; what is shown are the controller's joints.
    of_joints = np.linalg.inv(model.joint_coupling)
    sigmas = np.where(np.abs(of_joints) > 0, np.abs(of_joints) * sigma, 0.0).sum(axis=1)
    return MisfitScore(score_m, tuple((of_joints @ offsets).tolist()), tuple(sigmas.tolist()))
