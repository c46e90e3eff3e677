"""What the measurements support: where the device was moved, and how much model predicts unseen groups."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.cross_validation import Grouping, compare, deal_folds, held_out_errors
from calibration.errors import DegenerateDataError
from calibration.estimator import Problem, errors_m, estimate
from calibration.geometry import Array
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
from calibration.series_breaks import SeriesBreak, candidate_breaks, change_between, fit_frames, mounting_of

LEVELS = (FRAMES, OFFSETS, GEOMETRY, GRAVITY, RIPPLE)
_RIPPLE_ORDERS = (1, 2, 3, 4)
_DISTINCT_ANGLES = 20  # of a joint, before its ripple may be asked for
_ANGLE_STEP_RAD = 2e-3
_FOLDS = 10
_FOLDS_FOR_BREAKS = 5
_BREAK_GAIN = 0.1  # of the held-out RMSE: a mounting costs more trust than a parameter
_PATIENCE = 2
_BELIEVABLE = 8.0  # times the median error
_MOST_ROWS = 4000  # are looked at to choose; the fit takes all


@dataclass(frozen=True, slots=True)
class Options:
    """How to identify; the defaults suit any file."""

    level: int | None = None  # None: chosen by cross-validation
    seed: int = 0
    folds: int = _FOLDS
    find_breaks: bool = True
    priors: Priors = field(default_factory=Priors)
    judge: bool = True  # repeat every choice without each fold, for held-out errors


@dataclass(frozen=True, eq=False)
class Selection:
    """The choice that a set of rows leads to."""

    breaks: tuple[SeriesBreak, ...]  # in terms of these rows
    break_reasons: tuple[str, ...]
    start: ArmState  # base and tool fitted to the nominal arm
    seen: Observations  # the rows with their mountings
    level: int
    level_reasons: tuple[str, ...]


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


def select(model: RobotModel, observations: Observations, grouping: Grouping, options: Options) -> Selection:
    """Find the breaks of a series and choose the level, from these rows alone.

    Long series are looked at in every second, third … row; a break is then placed to the row.

    Notes
    -----
    Levels are tried in order. A wider one replaces the best so far only if it predicts groups that it has not
    seen better by 1 % and by more than the groups' own scatter. Rows that no level can believe do not vote.
    """
    rows = evenly(len(observations), _MOST_ROWS)
    some, groups = observations.take(rows), grouping.of_rows(rows)
    coarse, break_reasons = _choose_breaks(model, some, groups, options)
    breaks = _placed_to_the_row(model, observations, rows, coarse)
    at = [found.row for found in breaks]
    start = fit_frames(model, observations, at).state
    seen = with_mounting(observations, mounting_of(len(observations), at))
    folds = deal_folds(groups, options.folds, options.seed)
    trial = _Trial(model, seen.take(rows), groups, folds, start, options.priors)
    level, reasons = _choose_level(trial, options.level)
    return Selection(breaks, break_reasons, start, seen, level, reasons)


def evenly(count: int, most: int) -> Rows:
    """Return every k-th row, so that no more than ``most`` remain."""
    return np.arange(0, count, -(-count // most))


@dataclass(frozen=True, eq=False)
class _Trial:
    """Everything that cross-validation of a level needs."""

    model: RobotModel
    observations: Observations
    grouping: Grouping
    folds: Rows
    start: ArmState
    priors: Priors

    def unknowns(self, level: int) -> int:
        """Return how many unknowns a level has."""
        terms = terms_of_level(self.model, self.observations.joints_rad, level)
        kind, mountings = self.observations.kind, len(self.start.devices)
        return len(make_layout(self.model, kind, mountings, level=level, terms=terms))

    def held_out(self, level: int) -> Array:
        """Return the errors (N,) of rows predicted by fits without their fold."""

        def errors_without(training: Rows, held: Rows) -> Array:
            fit = fit_level(self.model, self.observations.take(training), self.start, level, self.priors)
            return errors_m(fit.fit.state, Problem.of(fit.fit.state, self.observations.take(held)))

        return held_out_errors(self.folds, errors_without)


def _choose_level(trial: _Trial, wanted: int | None) -> tuple[int, tuple[str, ...]]:
    if wanted is not None:
        return wanted, (f"level {wanted}, {LEVEL_NAMES[wanted]}, was asked for",)
    sizes = {level: trial.unknowns(level) for level in LEVELS}
    most = trial.observations.channels * len(trial.observations)
    possible = [level for level in LEVELS if level == FRAMES or sizes[level - 1] < sizes[level] <= most]
    errors = {level: trial.held_out(level) for level in possible}
    # The same rows vote on all levels: those that at least one of them can believe.
    smallest = np.min(list(errors.values()), axis=0)
    believable = smallest < _BELIEVABLE * np.median(smallest)
    best = FRAMES
    said = [
        f"level {level} ({LEVEL_NAMES[level]}) has {size} unknowns, more than {most} readings: not tried"
        for level, size in sizes.items()
        if size > most
    ]
    for level in possible[1:]:
        narrow = (f"level {best} ({LEVEL_NAMES[best]})", errors[best][believable])
        wide = (f"level {level} ({LEVEL_NAMES[level]})", errors[level][believable])
        comparison = compare(narrow, wide, trial.grouping.groups[believable])
        said.append(comparison.reason)
        if comparison.better:
            best = level
    return best, tuple(said)


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


def _placed_to_the_row(
    model: RobotModel, observations: Observations, rows: Rows, breaks: tuple[SeriesBreak, ...]
) -> tuple[SeriesBreak, ...]:
    """Return breaks of every k-th row as breaks of all rows: where the rows between fit better."""
    if not breaks or len(rows) == len(observations):
        return breaks
    state = fit_frames(model, observations.take(rows), [found.row for found in breaks]).state
    placed = []
    for mounting, found in enumerate(breaks):
        between = np.arange(rows[found.row - 1] + 1, rows[found.row])
        row = between[0] + change_between(*errors_in_both(state, observations.take(between), mounting))
        placed.append(SeriesBreak(int(row), found.bic_gain))
    return tuple(placed)


def errors_in_both(state: ArmState, observations: Observations, mounting: int) -> tuple[Array, Array]:
    """Return the errors (N,) of rows in this mounting and in the one after it."""
    first, second = (
        errors_m(state, Problem.of(state, with_mounting(observations, np.full(len(observations), m))))
        for m in (mounting, mounting + 1)
    )
    return first, second
