"""What the measurements support: where the device was moved, and how much model predicts unseen groups."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.break_choice import choose_breaks, refine_breaks
from cellcal.calibration.identification.cross_validation import (
    Grouping,
    assign_folds,
    compare_models,
)
from cellcal.calibration.identification.fold_errors import errors_without_folds
from cellcal.calibration.identification.frame_fits import FrameFits, fit_frames, mount_at_breaks
from cellcal.calibration.identification.free_parameters import StartingPoint, all_joint_terms, level_of
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.level_fit import LevelTask, fit_level, terms_of_level
from cellcal.calibration.identification.observations import Observations, Rows, with_mounting
from cellcal.calibration.identification.parameters import (
    FRAMES,
    GEAR,
    GEOMETRY,
    GRAVITY,
    LEVEL_NAMES,
    OFFSETS,
    RIPPLE,
    ArmState,
    Priors,
    nominal_state,
)
from cellcal.calibration.identification.robust import RobustFit
from cellcal.calibration.identification.series_breaks import SeriesBreak
from cellcal.calibration.identification.work_parts import SERIAL, PartRunner
from cellcal.calibration.message import make_message

LEVELS = (FRAMES, OFFSETS, GEOMETRY, GRAVITY, RIPPLE, GEAR)
_QUICK_UNKNOWNS = 100
_FOLDS = 10
_PLAUSIBLE = 8.0  # times the median error
FEW_ROWS = 60  # up to here the priors still count beside the rows
_FEW_GAIN = 0.75
_MOST_ROWS = 4000  # are looked at to choose; the fit takes all


@dataclass(frozen=True, slots=True)
class IdentificationOptions:
    """Options of an identification; the defaults suit any file."""

    level: int | None = None  # None: chosen by cross-validation
    seed: int = 0
    folds: int = _FOLDS
    find_breaks: bool = True
    priors: Priors = field(default_factory=Priors)
    judge: bool = True  # repeat every choice without each fold, for held-out errors
    start: StartingPoint = field(default_factory=StartingPoint)
    residual_model: bool = False  # try a smooth function of the joints for what the arm leaves over


@dataclass(frozen=True, eq=False)
class LevelSelection:
    """The choice that a set of rows leads to."""

    breaks: tuple[SeriesBreak, ...]  # in terms of these rows
    break_reasons: tuple[str, ...]
    places: ArmState  # base and tool fitted to the arm as it was known before
    mounted_observations: Observations  # the rows with their mountings
    level: int
    level_reasons: tuple[str, ...]
    fits: Mapping[int, RobustFit]  # of all the rows, by level, as far as the choice needed them

    def fit_level(self, model: RobotModel, level: int, options: IdentificationOptions) -> RobustFit:
        """Return the robust fit of a level to all the rows."""
        rows, places = self.mounted_observations, self.places
        return self.fits.get(level) or fit_level(model, rows, places, level, options.priors, options.start)


def select_level(
    model: RobotModel,
    observations: Observations,
    grouping: Grouping,
    options: IdentificationOptions,
    runner: PartRunner = SERIAL,
) -> LevelSelection:
    """Find the breaks of a series and choose the level, from these rows alone; the runner fits the folds.

    Long series are looked at in every second, third … row; a break is then placed to the row.

    Notes
    -----
    Levels are tried in order. A wider one replaces the best so far only if it predicts groups that it has not
    seen better by 1 % and by more than the groups' own scatter. Rows that every level predicts badly do not count.
    """
    rows = evenly_spaced(len(observations), _MOST_ROWS)
    some, groups = observations.select_rows(rows), grouping.of_rows(rows)
    breaks: tuple[SeriesBreak, ...] = ()
    break_reasons: tuple[str, ...] = ()
    known_places = options.start.places
    if known_places is not None and options.start.holds_places:
        once = np.zeros(len(observations), dtype=np.intp)
        mounted = with_mounting(observations, once)
        places = nominal_state(model, (known_places.device,), known_places.flange_tool)
    else:
        chain = options.start.rigid_arm(model)
        runner.show_stage("looking for rows at which the device was moved")
        fits = FrameFits(chain, some)
        if options.find_breaks:
            coarse, break_reasons = choose_breaks(fits, groups, options.seed)
            breaks = refine_breaks(chain, observations, rows, coarse)
        at = [found.row for found in breaks]
        every = len(rows) == len(observations)
        places = (fits.fit_breaks(at) if every else fit_frames(chain, observations, at)).state
        mounted = mount_at_breaks(observations, at)
    folds = assign_folds(groups, options.folds, options.seed)
    trial = _LevelTrial(model, mounted.select_rows(rows), groups, folds, places, options)
    level, reasons, of_some = _choose_level(trial, options.level, runner)
    of_all_rows = of_some if len(rows) == len(observations) else {}
    return LevelSelection(breaks, break_reasons, places, mounted, level, reasons, of_all_rows)


def evenly_spaced(count: int, most: int) -> Rows:
    """Return every k-th row, so that no more than ``most`` remain."""
    return np.arange(0, count, -(-count // most))


@dataclass(frozen=True, eq=False)
class _LevelTrial:
    """Everything that cross-validation of a level needs."""

    model: RobotModel
    observations: Observations
    grouping: Grouping
    folds: Rows
    places: ArmState
    options: IdentificationOptions

    def task_of(self, level: int) -> LevelTask:
        """Return what the fits of a level start from."""
        return LevelTask(self.model, self.places, level, self.options.priors, self.options.start)

    def unknown_count(self, level: int) -> int:
        """Return how many unknowns a level has."""
        terms = terms_of_level(self.model, self.observations.joints_rad, level)
        kind, mountings = self.observations.kind, len(self.places.devices)
        layout = make_layout(self.model, kind, mountings, level=level, terms=terms)
        return sum(self.options.start.is_freed(parameter) for parameter in layout.parameters)

    def level_of_free(self) -> tuple[int, tuple[str, ...]]:
        """Return the level of the parameters that were named, which is no choice of ours."""
        start, terms = self.options.start, all_joint_terms(self.model)
        every = make_layout(self.model, self.observations.kind, 1, level=GEAR, terms=terms).parameters
        level = level_of(start, every)
        return level, (f"level {level}, {LEVEL_NAMES[level]}, has what is free: {', '.join(start.free)}",)


def _judge_level(trial: _LevelTrial, level: int) -> tuple[RobustFit, Array]:
    """Return the fit of a level to all rows, and the errors (N,) of rows predicted without their fold.

    Rows that the fit rejects are fitted in no fold, and predicted as all others.
    """
    robust = trial.task_of(level).fit(trial.observations)
    weights = np.ones(len(trial.observations))
    weights[robust.rejected] = 0.0
    return robust, errors_without_folds(robust.fit, robust.problem, weights, trial.folds)


def _choose_level(
    trial: _LevelTrial, forced_level: int | None, runner: PartRunner
) -> tuple[int, tuple[str, ...], dict[int, RobustFit]]:
    """Return the level, the reasons, and the fits of the trial's rows that this took, by level."""
    fits: dict[int, RobustFit] = {}
    if forced_level is not None:
        why = make_message(
            "level {level}, {level_name}, was asked for",
            level=forced_level,
            level_name=LEVEL_NAMES[forced_level],
        )
        return forced_level, (why,), fits
    if trial.options.start.free:
        return *trial.level_of_free(), fits
    sizes = {level: trial.unknown_count(level) for level in LEVELS}
    few = len(trial.observations) <= FEW_ROWS and trial.options.start.is_nominal
    possible, notes = possible_levels(sizes, trial.observations.channels * len(trial.observations), few=few)
    compared = np.ones(len(trial.observations), dtype=bool)
    runner.show_stage("comparing levels on rows left out")

    def start_level(level: int) -> Callable[[], tuple[RobustFit, Array]]:
        return runner.submit(_judge_level, trial, level)

    # Gear ratios wait for what ripple does.
    begun = {level: start_level(level) for level in possible if level != GEAR}

    @cache
    def held_out(level: int) -> Array:
        fits[level], errors = (begun.get(level) or start_level(level))()
        return errors

    level, reasons = best_level(possible, held_out, trial.grouping.groups, compared)
    if few and level < GEOMETRY in possible:
        raised, why = _level_of_few(level, {each: held_out(each) for each in (level, GEOMETRY)})
        return raised, (*notes, *reasons, why), fits
    return level, (*notes, *reasons), fits


def _level_of_few(narrow: int, errors: Mapping[int, Array]) -> tuple[int, str]:
    """Return the geometry for few rows if it predicts them better by a quarter, sure or not, and why.

    Of few rows hardly any gain is sure. Priors keep what the rows do not show where it is expected, and deviations as
    wide as that; a narrower level would state its few parameters as if all others were nominal.
    """
    before, after = (
        np.array([np.median(errors[level]), np.sqrt(np.mean(errors[level] ** 2))])
        for level in (narrow, GEOMETRY)
    )
    name = _level_text(GEOMETRY)
    figures = f"{after[1] * 1e3:.3f} mm (level {narrow}: {before[1] * 1e3:.3f})"
    if (after < _FEW_GAIN * before).all():
        return GEOMETRY, f"{name}: {figures}: better, and its priors state what few rows leave open"
    return narrow, f"{name}: {figures}: not better by a quarter, in the median and in the mean square"


def possible_levels(
    sizes: Mapping[int, int], readings: int, *, few: bool = False
) -> tuple[list[int], list[str]]:
    """Return the levels that so many readings can carry, given their numbers of unknowns, and why not the others.

    More than a hundred unknowns with ripple need two readings each: with fewer, the priors decide, and the fit takes
    more time for less information. The geometry of few rows is carried by its priors, however many unknowns it has.
    """
    most = {
        level: readings // 2 if level >= RIPPLE and size > _QUICK_UNKNOWNS else readings
        for level, size in sizes.items()
    }
    if few and GEOMETRY in most:
        most[GEOMETRY] = max(readings, sizes[GEOMETRY])
    possible = [level for level in sizes if level == FRAMES or sizes[level - 1] < sizes[level] <= most[level]]
    notes = [
        make_message(
            "{level}: {unknown_count} unknowns are too many for {reading_count} readings: not tried",
            level=_level_text(level),
            unknown_count=size,
            reading_count=readings,
        )
        for level, size in sizes.items()
        if size > most[level]
    ]
    return possible, notes


def best_level(
    possible: Sequence[int], held_out: Callable[[int], Array], groups: Rows, compared: NDArray[np.bool_]
) -> tuple[int, tuple[str, ...]]:
    """Return the level whose held-out errors are surely the smallest, narrower ones first, and every comparison.

    Gear ratios are tried where ripple is worth its unknowns: what a ratio does, ripple shows as long waves.
    """
    errors = {level: held_out(level) for level in possible if level != GEAR}
    best, notes = _compare_levels(errors, groups, compared)
    if GEAR in possible and best == RIPPLE:
        errors[GEAR] = held_out(GEAR)
        best, notes = _compare_levels(errors, groups, compared)
    elif GEAR in possible:
        notes.append(
            make_message("{level}: not tried, because ripple does not help", level=_level_text(GEAR))
        )
    return best, tuple(notes)


def _level_text(level: int) -> str:
    return make_message("level {level}, {level_name}", level=level, level_name=LEVEL_NAMES[level])


def _compare_levels(
    errors: Mapping[int, Array], groups: Rows, compared: NDArray[np.bool_]
) -> tuple[int, list[str]]:
    # The same rows count for all levels: those that at least one of them predicts plausibly.
    smallest = np.min(list(errors.values()), axis=0)
    plausible = compared & (smallest < _PLAUSIBLE * np.median(smallest[compared]))
    best, notes = FRAMES, []
    for level in [level for level in errors if level != FRAMES]:
        narrow = (make_message("level {level}", level=best), errors[best][plausible])
        wide = (_level_text(level), errors[level][plausible])
        comparison = compare_models(narrow, wide, groups[plausible])
        notes.append(comparison.reason)
        if comparison.better:
            best = level
    return best, notes


__all__ = [
    "FEW_ROWS",
    "LEVELS",
    "IdentificationOptions",
    "LevelSelection",
    "best_level",
    "evenly_spaced",
    "fit_level",
    "possible_levels",
    "select_level",
    "terms_of_level",
]
