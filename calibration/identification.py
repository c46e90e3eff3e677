"""Identification of an arm: which model the measurements support, how good it is, what stays unknown."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.cross_validation import (
    Errors,
    Grouping,
    compare,
    deal_folds,
    group_rows,
    held_out_errors,
)
from calibration.errors import CalibrationError, DegenerateDataError
from calibration.estimator import Problem, errors_m, estimate
from calibration.geometry import Array
from calibration.identifiability import CorrelatedPair, NotIdentified, correlated_pairs, not_identified
from calibration.joint_terms import JointTerm, gravity_terms, harmonic_terms
from calibration.kinematics import RobotModel
from calibration.observations import Observations, Rows, with_mounting
from calibration.parameters import (
    FRAMES,
    GEOMETRY,
    GRAVITY,
    LEVEL_NAMES,
    OFFSETS,
    RIPPLE,
    ArmState,
    Priors,
    make_layout,
)
from calibration.robust import RobustFit, fit_robustly
from calibration.series_breaks import SeriesBreak, candidate_breaks, fit_frames, mounting_of

LEVELS = (FRAMES, OFFSETS, GEOMETRY, GRAVITY, RIPPLE)
_RIPPLE_ORDERS = (1, 2, 3, 4)
_DISTINCT_ANGLES = 20  # of a joint, before its ripple may be asked for
_ANGLE_STEP_RAD = 2e-3
_FOLDS = 10
_FOLDS_FOR_BREAKS = 5
_BREAK_GAIN = 0.1  # of the held-out RMSE: a mounting costs more trust than a parameter
_PATIENCE = 2
_FEWEST_ROWS = {"length": 12, "point": 8, "pose": 6}
_BELIEVABLE = 8.0  # times the median error


@dataclass(frozen=True, slots=True)
class Options:
    """How to identify; the defaults suit any file."""

    level: int | None = None  # None: chosen by cross-validation
    seed: int = 0
    folds: int = _FOLDS
    find_breaks: bool = True
    priors: Priors = field(default_factory=Priors)


@dataclass(frozen=True, eq=False)
class Identification:
    """The identified arm, and what may be believed about it."""

    state: ArmState
    frames: ArmState  # base and tool fitted to the nominal arm, by the same rows
    robust: RobustFit
    level: int
    level_reasons: tuple[str, ...]
    breaks: tuple[SeriesBreak, ...]
    break_reasons: tuple[str, ...]
    rejected: Rows
    grouping: Grouping
    before_m: Array  # (N,) held-out errors of the nominal arm
    held_out_m: Array  # (N,) held-out errors of the chosen level
    fit_m: Array  # (N,) errors of the fit itself
    not_identified: tuple[NotIdentified, ...]
    correlated: tuple[CorrelatedPair, ...]

    @property
    def before(self) -> Errors:
        """Base and tool fitted to the nominal arm, each group predicted by the others."""
        return Errors.of(self.before_m)

    @property
    def held_out(self) -> Errors:
        """Each group predicted by a fit of the others."""
        return Errors.of(self.held_out_m)

    @property
    def fit(self) -> Errors:
        """Residuals of the kept rows: never an accuracy."""
        kept = np.delete(self.fit_m, self.rejected)
        return Errors.of(kept)


def terms_of_level(model: RobotModel, joints_rad: Array, level: int) -> tuple[JointTerm, ...]:
    """Return the joint terms that a level has; a joint's ripple needs twenty distinct angles."""
    if level < GRAVITY:
        return ()
    sag = gravity_terms(model)
    if level < RIPPLE:
        return sag
    distinct = [len(np.unique(np.round(angle / _ANGLE_STEP_RAD))) for angle in joints_rad.T]
    ripple = harmonic_terms(model, _RIPPLE_ORDERS)
    return (*sag, *(term for term in ripple if distinct[term.joint] >= _DISTINCT_ANGLES))


def fit_level(
    model: RobotModel, observations: Observations, start: ArmState, level: int, priors: Priors
) -> RobustFit:
    """Fit one level robustly, from a state of any level of the same arm."""
    terms = terms_of_level(model, observations.joints_rad, level)
    state = replace(
        start, geometry=np.zeros_like(start.geometry), terms=terms, coefficients=np.zeros(len(terms))
    )
    layout = make_layout(
        model, observations.kind, len(start.devices), level=level, terms=terms, priors=priors
    )
    return fit_robustly(layout, state, Problem.of(state, observations))


def identify(
    model: RobotModel,
    observations: Observations,
    *,
    grouping: Grouping | None = None,
    options: Options | None = None,
) -> Identification:
    r"""Identify an arm: find moved devices, choose the level, fit robustly, say what is unknown.

    Parameters
    ----------
    model : RobotModel
        Nominal.
    observations : Observations
        In the order of measuring; their mounting is ignored.
    grouping : Grouping or None
        Rows that belong together for cross-validation; None looks for runs of constant wrist, else blocks.
    options : Options
        Level, seed, folds, priors.

    Returns
    -------
    Identification
        With held-out errors of all rows, the rejected ones included: nobody looks better by rejecting.

    Raises
    ------
    DegenerateDataError
        Too few rows.
    CalibrationError
        A level that does not exist.

    Notes
    -----
    Levels are tried in order. A wider one replaces the best so far only if it predicts groups that it has not
    seen better by 1 % and by more than the groups' own scatter. Rows that no level can believe do not vote.
    """
    options = options or Options()
    if options.level is not None and options.level not in LEVELS:
        raise CalibrationError(
            f"there is no level {options.level}.", remedy=f"Levels are {LEVELS[0]} to {LEVELS[-1]}."
        )
    fewest = _FEWEST_ROWS[observations.kind]
    if len(observations) < fewest:
        raise DegenerateDataError(
            f"{len(observations)} usable rows are too few to identify anything and to check it.",
            remedy=f"Measure at least {fewest} postures, better 60.",
        )
    grouping = grouping or group_rows(observations.joints_rad)
    breaks, break_reasons = _choose_breaks(model, observations, grouping, options)
    rows = [found.row for found in breaks]
    start = fit_frames(model, observations, rows).state
    seen = with_mounting(observations, mounting_of(len(observations), rows))
    trial = _Trial(
        model, seen, grouping, deal_folds(grouping, options.folds, options.seed), start, options.priors
    )
    level, reasons, errors = _choose_level(trial, options.level)
    robust = fit_level(model, seen, start, level, options.priors)
    judged = robust if level > FRAMES else fit_level(model, seen, start, OFFSETS, options.priors)
    return Identification(
        robust.fit.state,
        fit_level(model, seen, start, FRAMES, options.priors).fit.state,
        robust,
        level,
        reasons,
        breaks,
        break_reasons,
        robust.rejected,
        grouping,
        errors[FRAMES],
        errors[level],
        errors_m(robust.fit.state, robust.problem),
        not_identified(judged.fit),
        correlated_pairs(judged.fit),
    )


@dataclass(frozen=True, eq=False)
class _Trial:
    """Everything that cross-validation of a level needs."""

    model: RobotModel
    observations: Observations
    grouping: Grouping
    folds: Rows
    start: ArmState
    priors: Priors

    def held_out(self, level: int) -> Array:
        """Return the errors (N,) of rows predicted by fits without their fold."""

        def errors_without(training: Rows, held: Rows) -> Array:
            fit = fit_level(self.model, self.observations.take(training), self.start, level, self.priors)
            return errors_m(fit.fit.state, Problem.of(fit.fit.state, self.observations.take(held)))

        return held_out_errors(self.folds, errors_without)


def _choose_level(trial: _Trial, wanted: int | None) -> tuple[int, tuple[str, ...], dict[int, Array]]:
    errors = {FRAMES: trial.held_out(FRAMES)}
    if wanted is not None:
        if wanted != FRAMES:
            errors[wanted] = trial.held_out(wanted)
        return wanted, (f"level {wanted}, {LEVEL_NAMES[wanted]}, was asked for",), errors
    for level in LEVELS[1:]:
        if level < GRAVITY or terms_of_level(trial.model, trial.observations.joints_rad, level):
            errors[level] = trial.held_out(level)
    # The same rows vote on all levels: those that at least one of them can believe.
    smallest = np.min(list(errors.values()), axis=0)
    believable = smallest < _BELIEVABLE * np.median(smallest)
    best, reasons = FRAMES, []
    for level in [level for level in errors if level != FRAMES]:
        narrow = (f"level {best} ({LEVEL_NAMES[best]})", errors[best][believable])
        wide = (f"level {level} ({LEVEL_NAMES[level]})", errors[level][believable])
        comparison = compare(narrow, wide, trial.grouping.groups[believable])
        reasons.append(comparison.reason)
        if comparison.better:
            best = level
    return best, tuple(reasons), errors


def _choose_breaks(
    model: RobotModel, observations: Observations, grouping: Grouping, options: Options
) -> tuple[tuple[SeriesBreak, ...], tuple[str, ...]]:
    """Return the breaks that make unseen groups more predictable, and why the search stopped."""
    if not options.find_breaks:
        return (), ()
    folds = deal_folds(grouping, _FOLDS_FOR_BREAKS, options.seed)
    chosen: tuple[SeriesBreak, ...] = ()
    best, reasons, waited = None, [], 0
    for candidate in candidate_breaks(model, observations):
        if best is None:
            best = _errors_with_breaks(model, observations, folds, ())
        errors = _errors_with_breaks(model, observations, folds, candidate)
        comparison = compare(
            (f"{len(chosen)} breaks", best),
            (f"{len(candidate)} breaks", errors),
            grouping.groups,
            least_gain=_BREAK_GAIN,
        )
        reasons.append(comparison.reason)
        waited = 0 if comparison.better else waited + 1
        if comparison.better:
            chosen, best = candidate, errors
        if waited == _PATIENCE:
            break
    return chosen, tuple(reasons)


def _errors_with_breaks(
    model: RobotModel, observations: Observations, folds: Rows, breaks: Sequence[SeriesBreak]
) -> Array:
    """Return held-out errors of plain fits of the geometry: quick, and good enough to compare mountings."""
    rows = [found.row for found in breaks]
    frames = fit_frames(model, observations, rows).state
    seen = with_mounting(observations, mounting_of(len(observations), rows))
    layout = make_layout(model, seen.kind, len(rows) + 1, level=GEOMETRY)

    def errors_without(training: Rows, held: Rows) -> Array:
        state = estimate(layout, frames, Problem.of(frames, seen.take(training))).state
        return errors_m(state, Problem.of(state, seen.take(held)))

    try:
        return held_out_errors(folds, errors_without)
    except DegenerateDataError:
        return np.full(len(seen), np.inf)
