"""Identification of an arm: which model the measurements support, how good it is, what stays unknown."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.cross_validation import (
    ErrorSummary,
    Grouping,
    compare_models,
    group_rows,
)
from cellcal.calibration.identification.distinct_postures import FEWEST_POSTURES, count_postures
from cellcal.calibration.identification.earlier_posterior import (
    EarlierPosterior,
    OffsetContradiction,
    contradicted_offsets,
    to_arm_parameters,
)
from cellcal.calibration.identification.effect_mixture import (
    AVERAGED_ROWS,
    UnmodelledEffects,
    average_over_misfits,
)
from cellcal.calibration.identification.estimator import errors_m
from cellcal.calibration.identification.free_parameters import StartingPoint, all_joint_terms, normalise_words
from cellcal.calibration.identification.group_effect import GroupEffect, widen_fit
from cellcal.calibration.identification.identifiability import (
    CorrelatedPair,
    NotIdentified,
    correlated_pairs,
    not_identified,
)
from cellcal.calibration.identification.judgement import Judgement, start_judgement
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.observations import Observations, Rows
from cellcal.calibration.identification.parameters import (
    FRAMES,
    GEAR,
    LEVEL_NAMES,
    OFFSETS,
    ArmState,
    Parameter,
)
from cellcal.calibration.identification.residual_model import ResidualModel, residual_of
from cellcal.calibration.identification.robust import RobustFit
from cellcal.calibration.identification.selection import (
    LEVELS,
    IdentificationOptions,
    LevelSelection,
    select_level,
)
from cellcal.calibration.identification.series_breaks import SeriesBreak
from cellcal.calibration.identification.work_parts import SERIAL, PartRunner
from cellcal.calibration.message import make_message

_FEWEST_ROWS = {"length": 12, "point": 8, "pose": 6}
_ENDLESS = 1e9  # degrees of freedom
_FEWEST_TO_PLACE = {"length": 9, "point": 5, "pose": 4}


@dataclass(frozen=True, eq=False)
class ResidualFinding:
    """A residual model, and whether unseen groups are better predicted with it."""

    model: ResidualModel
    chosen: bool
    reason: str
    held_out: ErrorSummary  # with it, of the rows that were cross-validated


@dataclass(frozen=True, eq=False)
class Identification:
    """The identified arm, and what may be believed about it."""

    state: ArmState
    frames: ArmState  # base and tool fitted to the nominal arm, by the same rows
    robust: RobustFit  # its covariance widened by what rows of a group share
    group_effect: GroupEffect
    level: int
    level_reasons: tuple[str, ...]
    breaks: tuple[SeriesBreak, ...]
    break_reasons: tuple[str, ...]
    rejected: Rows
    grouping: Grouping
    judgement: Judgement  # empty if not asked for
    fit_m: Array  # (N,) errors of the fit itself
    not_identified: tuple[NotIdentified, ...]
    correlated: tuple[CorrelatedPair, ...]
    residual: ResidualFinding | None = None
    contradicted: tuple[OffsetContradiction, ...] = ()  # offsets that an earlier fit has elsewhere
    options: IdentificationOptions = field(default_factory=IdentificationOptions)  # with which it was made
    misfit: UnmodelledEffects | None = None  # what few rows say about what the model lacks

    @property
    def before_errors(self) -> ErrorSummary:
        """Base and tool fitted to the nominal arm, each fold predicted by the others."""
        return ErrorSummary.from_sizes(self.judgement.before_m)

    @property
    def held_out(self) -> ErrorSummary:
        """Each fold predicted by everything that the other folds lead to, breaks and level included."""
        return ErrorSummary.from_sizes(self.judgement.held_out_m)

    @property
    def fit_errors(self) -> ErrorSummary:
        """Residuals of the kept rows: never an accuracy."""
        kept_m = np.delete(self.fit_m, self.rejected)
        return ErrorSummary.from_sizes(kept_m)


def identify_arm(
    model: RobotModel,
    observations: Observations,
    *,
    grouping: Grouping | None = None,
    options: IdentificationOptions | None = None,
    runner: PartRunner = SERIAL,
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
    runner : PartRunner
        Carries out the folds.

    Returns
    -------
    Identification
        With held-out errors of all rows, the rejected ones included: rejecting rows does not improve the figure.

    Raises
    ------
    DegenerateDataError
        Too few rows.
    CalibrationError
        A level that does not exist.
    """
    return start_identification(model, observations, grouping=grouping, options=options, runner=runner)()


def start_identification(
    model: RobotModel,
    observations: Observations,
    *,
    grouping: Grouping | None = None,
    options: IdentificationOptions | None = None,
    runner: PartRunner = SERIAL,
) -> Callable[[], Identification]:
    """Begin the long parts of `identify_arm`; return what does the rest and waits for them.

    Raises
    ------
    DegenerateDataError
        Too few rows.
    CalibrationError
        A level that does not exist.
    """
    options = _check_options(model, observations, options or IdentificationOptions())
    grouping = grouping or group_rows(observations.joints_rad)
    judging = start_judgement(model, observations, grouping, options, runner) if options.judge else None
    return partial(_finish_identification, model, observations, grouping, options, runner, judging)


def _finish_identification(
    model: RobotModel,
    observations: Observations,
    grouping: Grouping,
    options: IdentificationOptions,
    runner: PartRunner,
    judging: Callable[[], Judgement] | None,
) -> Identification:
    choice = select_level(model, observations, grouping, options, runner)
    runner.show_stage("fitting all rows")
    robust, frames = (choice.fit_level(model, level, options) for level in (choice.level, FRAMES))
    weighed = choice.fit_level(model, OFFSETS, options) if choice.level == FRAMES else robust
    runner.show_stage("predicting rows by fits and choices that have not seen them")
    judgement = Judgement.without_rows() if judging is None else judging()
    moved: tuple[OffsetContradiction, ...] = ()
    if options.start.covariance is not None:
        moved = contradicted_offsets(robust, EarlierPosterior(options.start.names, options.start.covariance))
    robust, effect, misfit = _state_uncertainty(robust, choice, grouping, options)
    robust, weak = replace(robust, fit=to_arm_parameters(robust.fit)), to_arm_parameters(weighed.fit)
    return Identification(
        robust.fit.state,
        frames.fit.state,
        robust,
        effect,
        choice.level,
        choice.level_reasons,
        choice.breaks,
        choice.break_reasons,
        robust.rejected,
        grouping,
        judgement,
        errors_m(robust.fit.state, robust.problem),
        not_identified(weak),
        correlated_pairs(weak),
        _judge_residual_model(robust, choice.mounted_observations, judgement, grouping, options)
        if options.residual_model
        else None,
        moved,
        options,
        misfit,
    )


def _state_uncertainty(
    robust: RobustFit, choice: LevelSelection, grouping: Grouping, options: IdentificationOptions
) -> tuple[RobustFit, GroupEffect, UnmodelledEffects | None]:
    """Return a fit with the deviations that may be stated: for rows that go together, and for few rows."""
    wide, effect = widen_fit(robust, grouping.groups)
    kept_count = len(robust.problem.observations) - len(robust.rejected)
    nothing_free = not len(robust.fit.layout)
    if kept_count > AVERAGED_ROWS or nothing_free or options.start.covariance is not None:
        return wide, effect, None
    misfit = average_over_misfits(robust, choice.mounted_observations)
    averaged = replace(robust.fit, covariance=misfit.covariance)
    sizes = [
        float((np.diag(fit.covariance) / fit.layout.prior_sigmas**2).sum()) for fit in (averaged, wide.fit)
    ]
    if effect.widening > 1.0 and sizes[1] > sizes[0]:
        return wide, effect, misfit
    # What the size of the residuals leaves open is in the average already.
    return replace(robust, fit=averaged, degrees_of_freedom=_ENDLESS), effect, misfit


def _check_options(
    model: RobotModel, observations: Observations, options: IdentificationOptions
) -> IdentificationOptions:
    """Return the options with their words spelled out; refuse what cannot be done before the work."""
    if options.level is not None and options.level not in LEVELS:
        names = ", ".join(f"{level} {LEVEL_NAMES[level]}" for level in LEVELS)
        raise CalibrationError(
            make_message("there is no level {level}.", level=options.level),
            remedy=make_message("Levels are: {names}.", names=names),
            code="usage",
        )
    layout = make_layout(model, observations.kind, 1, level=GEAR, terms=all_joint_terms(model))
    start = replace(options.start, free=normalise_words(options.start.free, layout.parameters))
    fewest = _fewest_rows(observations, start, layout.parameters)
    if len(observations) < fewest:
        raise DegenerateDataError(
            make_message(
                "too few usable rows to identify anything and to check it: {rows}.", rows=len(observations)
            ),
            remedy=make_message("Measure at least {fewest} postures, better 60.", fewest=fewest),
        )
    needed = min(fewest, FEWEST_POSTURES)
    postures = count_postures(observations.joints_rad, needed)
    if postures < needed:
        raise DegenerateDataError(
            make_message(
                "too few postures to identify anything and to check it: {postures}, in {rows} usable rows.",
                postures=postures,
                rows=len(observations),
            ),
            remedy=make_message(
                "Measure at least {fewest} postures, better 60; see that the joints change from row to row.",
                fewest=fewest,
            ),
        )
    return replace(options, start=start)


def _fewest_rows(observations: Observations, start: StartingPoint, parameters: tuple[Parameter, ...]) -> int:
    """Return how many rows determine what is free, and one more to check it."""
    if not start.free:
        has_posterior = start.covariance is not None
        return (_FEWEST_TO_PLACE if has_posterior else _FEWEST_ROWS)[observations.kind]
    needed = -(-sum(start.is_freed(parameter) for parameter in parameters) // observations.channels) + 1
    if start.holds_places:
        return max(needed, 2)
    return min(max(needed, _FEWEST_TO_PLACE[observations.kind]), _FEWEST_ROWS[observations.kind])


def _judge_residual_model(
    robust: RobustFit,
    observations: Observations,
    judgement: Judgement,
    grouping: Grouping,
    options: IdentificationOptions,
) -> ResidualFinding:
    plain, smooth = judgement.held_out_m, judgement.with_residual_m
    found = compare_models(
        ("the arm alone", plain), ("a residual model over the joints", smooth), grouping.groups
    )
    model = residual_of(robust, observations, options.seed)
    return ResidualFinding(model, found.better, found.reason, ErrorSummary.from_sizes(smooth))
