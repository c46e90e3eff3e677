"""The held-out figure: every row predicted by a procedure that saw nothing of it, its choices included.

A fit that leaves rows out is not enough. If all rows have chosen the level, or told where the device was moved,
the rows left out have had their say. Here breaks, level and fit are made anew without each fold.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.break_choice import errors_in_both_mountings
from cellcal.calibration.identification.cross_validation import Grouping, assign_folds
from cellcal.calibration.identification.estimator import ArmFit, FitProblem, errors_m, place_columns
from cellcal.calibration.identification.frame_fits import mounting_of
from cellcal.calibration.identification.observations import Observations, Rows, with_mounting
from cellcal.calibration.identification.parameters import FRAMES
from cellcal.calibration.identification.residual_model import errors_with, residual_of
from cellcal.calibration.identification.selection import (
    IdentificationOptions,
    LevelSelection,
    evenly_spaced,
    select_level,
)
from cellcal.calibration.identification.series_breaks import change_between
from cellcal.calibration.identification.work_parts import SERIAL, PartRunner
from cellcal.calibration.message import make_message

_FOLDS = 5
_MANY_FOLDS = 10
_FEW_ROWS = 100  # up to here ten folds cost little, and each row left out costs much
_VERY_FEW_ROWS = 25  # up to here each group is a fold: which groups share one would show
_MOST_ROWS = 20_000  # are fitted in each fold; all rows are judged


@dataclass(frozen=True, eq=False)
class Judgement:
    """Errors of rows by procedures without their fold."""

    before_m: Array  # (N,) base and tool only
    held_out_m: Array  # (N,)
    levels: tuple[int, ...]  # chosen without each fold
    breaks: tuple[tuple[int, ...], ...]  # found without each fold, as rows of the series
    placed: Rows  # rows next to a break, whose order does not tell their mounting
    with_residual_m: Array  # (N,) with a residual model; empty if none was asked for
    variances_m2: (
        Array  # (N,) of the parameters, summed over places' coordinates, as each row's fit states them
    )
    own_m2: Array  # (N,) of the residual model, likewise

    @classmethod
    def without_rows(cls) -> "Judgement":
        """Return the judgement of no rows."""
        return cls(
            np.zeros(0), np.zeros(0), (), (), np.zeros(0, dtype=np.intp), *(np.zeros(0) for _ in range(3))
        )

    def describe_method(self, grouping: Grouping) -> str:
        """Return how the rows were judged, for people."""
        text = make_message(
            "cross-validation over {group_count} {group_kind} in {fold_count} folds; breaks, level and fit were made "
            "anew without each fold",
            group_count=grouping.group_count,
            group_kind=grouping.kind,
            fold_count=len(self.levels),
        )
        if not len(self.placed):
            return text
        return make_message(
            "{method}; {row_count} rows beside a break, whose order does not tell their mounting, were given to the "
            "one that they fit",
            method=text,
            row_count=len(self.placed),
        )


def judge_rows(
    model: RobotModel, observations: Observations, grouping: Grouping, options: IdentificationOptions
) -> Judgement:
    """Predict every row by everything that ``select`` and a fit make of the other folds."""
    return start_judgement(model, observations, grouping, options, SERIAL)()


def start_judgement(
    model: RobotModel,
    observations: Observations,
    grouping: Grouping,
    options: IdentificationOptions,
    runner: PartRunner,
) -> Callable[[], Judgement]:
    """Begin with the folds; return what waits for them and puts the judgement together."""
    folds = assign_folds(grouping, _number_of_folds(len(observations)), options.seed)
    inner = replace(options, folds=_FOLDS)
    begun = [
        runner.submit(_judge_fold, model, observations, grouping, inner, folds == fold)
        for fold in range(int(folds.max()) + 1)
    ]
    return lambda: _join_judgement(folds, [wait() for wait in begun])


@dataclass(frozen=True, eq=False)
class _FoldJudgement:
    """How the other folds judge the rows of one fold."""

    before_m: Array
    held_out_m: Array
    level: int
    breaks: tuple[int, ...]
    placed: Rows
    with_residual_m: Array  # empty if none was asked for
    variances_m2: Array
    own_m2: Array


def _judge_fold(
    model: RobotModel,
    observations: Observations,
    grouping: Grouping,
    options: IdentificationOptions,
    is_held: NDArray[np.bool_],
) -> _FoldJudgement:
    training, held_rows = np.flatnonzero(~is_held), np.flatnonzero(is_held)
    training = training[evenly_spaced(len(training), _MOST_ROWS)]
    choice = select_level(model, observations.select_rows(training), grouping.of_rows(training), options)
    rows, uncertain_rows = _held_out_mountings(choice, observations, training, held_rows)
    held_observations = with_mounting(observations.select_rows(held_rows), rows)
    mounted = choice.mounted_observations
    frames, fit = (choice.fit_level(model, level, options) for level in (FRAMES, choice.level))
    state = fit.fit.state
    before, after = (
        errors_m(each.fit.state, FitProblem.from_observations(each.fit.state, held_observations))
        for each in (frames, fit)
    )
    smooth, own = np.zeros(0), np.zeros(len(held_rows))
    if options.residual_model:
        residual = residual_of(fit, mounted, options.seed)
        smooth = errors_with(residual, state, held_observations)
        own = 3.0 * residual.predict_residual(held_observations.joints_rad)[1] ** 2
    breaks = tuple(int(training[found.row]) for found in choice.breaks)
    variances = place_variances(fit.fit, held_observations)
    return _FoldJudgement(before, after, choice.level, breaks, uncertain_rows, smooth, variances, own)


def _join_judgement(folds: Rows, judged: Sequence[_FoldJudgement]) -> Judgement:
    def join_folds(parts: Sequence[Array]) -> Array:
        joined = np.zeros(len(folds))
        for fold, part in enumerate(parts):
            joined[folds == fold] = part
        return joined

    has_residual = any(len(fold.with_residual_m) for fold in judged)
    return Judgement(
        join_folds([fold.before_m for fold in judged]),
        join_folds([fold.held_out_m for fold in judged]),
        tuple(fold.level for fold in judged),
        tuple(fold.breaks for fold in judged),
        np.sort(np.concatenate([fold.placed for fold in judged])),
        join_folds([fold.with_residual_m for fold in judged]) if has_residual else np.zeros(0),
        join_folds([fold.variances_m2 for fold in judged]),
        join_folds([fold.own_m2 for fold in judged]),
    )


def place_variances(fit: ArmFit, observations: Observations) -> Array:
    """Return the variance (N,) [m^2] that a fit expects of rows by its parameters alone, summed over coordinates."""
    columns = place_columns(fit.layout, fit.state, FitProblem.from_observations(fit.state, observations))[0][
        :, :3
    ]
    spread = np.tensordot(fit.covariance, columns, axes=1)
    variances: Array = np.einsum("pcn,pcn->n", columns, spread) * observations.sigma_m**2
    return variances


def _number_of_folds(rows: int) -> int:
    if rows <= _VERY_FEW_ROWS:
        return rows
    return _MANY_FOLDS if rows <= _FEW_ROWS else _FOLDS


def _held_out_mountings(
    choice: LevelSelection, observations: Observations, training: Rows, held_rows: Rows
) -> tuple[Rows, Rows]:
    """Return the mounting of every held-out row by its order, and the rows whose order does not tell it.

    Between the last row of one mounting and the first of the next, only a row's own value can say where the
    device was moved: one change there, where these rows fit best to base and tool alone.
    """
    first = [int(training[found.row]) for found in choice.breaks]
    mountings = mounting_of(len(observations), first)[held_rows]
    uncertain_rows = [np.arange(0)]
    for mounting, found in enumerate(choice.breaks):
        last = int(training[found.row - 1])
        between = np.flatnonzero((held_rows > last) & (held_rows < first[mounting]))
        if len(between):
            both = errors_in_both_mountings(
                choice.places, observations.select_rows(held_rows[between]), mounting
            )
            mountings[between] = mounting + (np.arange(len(between)) >= change_between(*both))
            uncertain_rows.append(held_rows[between])
    return mountings, np.concatenate(uncertain_rows)
