"""Identification of an arm: which model the measurements support, how good it is, what stays unknown."""

from dataclasses import dataclass

import numpy as np

from calibration.cross_validation import Errors, Grouping, group_rows
from calibration.errors import CalibrationError, DegenerateDataError
from calibration.estimator import errors_m
from calibration.geometry import Array
from calibration.identifiability import CorrelatedPair, NotIdentified, correlated_pairs, not_identified
from calibration.judgement import Judgement, judge
from calibration.kinematics import RobotModel
from calibration.observations import Observations, Rows
from calibration.parameters import FRAMES, OFFSETS, ArmState
from calibration.robust import RobustFit
from calibration.selection import LEVELS, Options, fit_level, select
from calibration.series_breaks import SeriesBreak

_FEWEST_ROWS = {"length": 12, "point": 8, "pose": 6}


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
    judgement: Judgement  # empty if not asked for
    fit_m: Array  # (N,) errors of the fit itself
    not_identified: tuple[NotIdentified, ...]
    correlated: tuple[CorrelatedPair, ...]

    @property
    def before(self) -> Errors:
        """Base and tool fitted to the nominal arm, each fold predicted by the others."""
        return Errors.of(self.judgement.before_m)

    @property
    def held_out(self) -> Errors:
        """Each fold predicted by everything that the other folds lead to, breaks and level included."""
        return Errors.of(self.judgement.held_out_m)

    @property
    def fit(self) -> Errors:
        """Residuals of the kept rows: never an accuracy."""
        kept = np.delete(self.fit_m, self.rejected)
        return Errors.of(kept)


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
    choice = select(model, observations, grouping, options)
    robust = fit_level(model, choice.seen, choice.start, choice.level, options.priors)
    frames = fit_level(model, choice.seen, choice.start, FRAMES, options.priors)
    known = robust
    if choice.level == FRAMES:
        known = fit_level(model, choice.seen, choice.start, OFFSETS, options.priors)
    judgement = judge(model, observations, grouping, options) if options.judge else Judgement.none()
    return Identification(
        robust.fit.state,
        frames.fit.state,
        robust,
        choice.level,
        choice.level_reasons,
        choice.breaks,
        choice.break_reasons,
        robust.rejected,
        grouping,
        judgement,
        errors_m(robust.fit.state, robust.problem),
        not_identified(known.fit),
        correlated_pairs(known.fit),
    )
