"""How much model the series of a cell support: levels judged by groups of rows, of any series, that were held out."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.cells.robust import RobustCellFit, fit_cell_robustly
from cellcal.calibration.cells.state import CellFrames, CellLayout, cell_layout
from cellcal.calibration.cells.system import CellProblem, errors_m
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.cross_validation import Grouping, assign_folds, group_rows
from cellcal.calibration.identification.free_parameters import GROUPS, PLACE_ROLES, all_joint_terms
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.identification.parameters import LEVEL_NAMES, Parameter, Priors
from cellcal.calibration.identification.selection import (
    LEVELS,
    best_level,
    evenly_spaced,
    possible_levels,
    terms_of_level,
)
from cellcal.calibration.message import make_message

_FEWEST_COMPARED = 12  # rows of a series: fewer are needed to place its device, and are always fitted
_MOST_ROWS = 4000
_FOLDS = 10


@dataclass(frozen=True, slots=True)
class CellOptions:
    """Options of the fit of a cell; the defaults suit any."""

    level: int | None = None  # None: chosen by cross-validation
    seed: int = 0
    folds: int = _FOLDS
    priors: Priors = field(default_factory=Priors)
    free: tuple[
        str, ...
    ] = ()  # groups, joints and names of what may move of arms and devices; none: all of a level
    fixed: tuple[str, ...] = ()  # the same words, of what may not; names of places, too
    judge: bool = True  # choose level and fit anew without each fold, for held-out errors


@dataclass(frozen=True, eq=False)
class CellTrial:
    """Some rows of a cell with their groups, and a start for the places."""

    frames: CellFrames
    places: Array  # (M, 4, 4)
    options: CellOptions
    rows: tuple[Rows, ...]  # of every series
    groups: Rows  # (total,): of these rows, series after series

    def restrict_to_rows(self, chosen: Rows) -> "CellTrial":
        """Return the trial of some of its rows, numbered through all series."""
        groups = np.unique(self.groups[chosen], return_inverse=True)[1].reshape(-1)
        rows = tuple(mine[part] for mine, part in zip(self.rows, self.split_by_series(chosen), strict=True))
        return replace(self, rows=rows, groups=groups)

    @cached_property
    def series_of(self) -> Rows:
        """The series of every row (total,)."""
        return np.repeat(np.arange(len(self.rows)), [len(rows) for rows in self.rows])

    def split_by_series(self, chosen: Rows) -> list[Rows]:
        """Return rows numbered through all series as rows of each."""
        starts = np.cumsum([0, *(len(rows) for rows in self.rows)]).tolist()
        return [chosen[(chosen >= a) & (chosen < b)] - a for a, b in pairwise(starts)]

    @cached_property
    def is_compared(self) -> NDArray[np.bool_]:
        """Whether a row may be held out (total,): rows of short series are needed to place their devices."""
        sizes = np.array([len(rows) for rows in self.rows])
        may = (sizes >= _FEWEST_COMPARED) | (sizes == sizes.max())
        return np.asarray(may[self.series_of])

    @cached_property
    def folds(self) -> Rows:
        """The fold of every row (total,), -1 for rows that are always fitted."""
        fold_of_row = np.full(len(self.groups), -1)
        compared = np.flatnonzero(self.is_compared)
        groups = Grouping(self.groups, "").of_rows(compared)
        fold_of_row[compared] = assign_folds(groups, self.options.folds, self.options.seed)
        return fold_of_row

    def layout_of(self, level: int) -> CellLayout:
        """Return what a level leaves unknown, of that what the options free."""
        cell = self.frames.cell
        terms = []
        for robot in cell.robots:
            joints = [s.observations.joints_rad for s in cell.series if cell.robot_of(s.target) is robot]
            whole = np.concatenate(joints) if joints else np.zeros((0, robot.model.axis_count))
            terms.append(terms_of_level(robot.model, whole, level))
        return without_fixed(cell_layout(self.frames, level, terms, self.options.priors), self.options)

    def problem_of(self, layout: CellLayout) -> CellProblem:
        """Return the rows of the trial for a layout's joint terms."""
        return CellProblem.from_frames(self.frames, layout.expected).select_rows(self.rows)

    def fit_level(self, level: int, chosen: Rows | None = None) -> RobustCellFit:
        """Fit a level to the rows of the trial, or to some."""
        layout = self.layout_of(level)
        problem = self.problem_of(layout)
        if chosen is not None:
            problem = problem.select_rows(self.split_by_series(chosen))
        start = replace(layout.expected, places=self.places)
        return fit_cell_robustly(layout, start, problem)

    def prediction_errors(self, fit: RobustCellFit, chosen: Rows) -> Array:
        """Return the errors of some rows by a fit of others [m]."""
        problem = self.problem_of(fit.fit.layout).select_rows(self.split_by_series(chosen))
        return np.concatenate([errors_m(series, fit.fit.state) for series in problem.series])

    def held_out(self, level: int) -> Array:
        """Return the errors (total,) [m] by fits without the row's fold; zero for rows that are never left out."""
        errors = np.zeros(len(self.groups))
        for fold in range(int(self.folds.max()) + 1):
            held_rows = np.flatnonzero(self.folds == fold)
            errors[held_rows] = self.prediction_errors(
                self.fit_level(level, np.flatnonzero(self.folds != fold)), held_rows
            )
        return errors

    @cached_property
    def weights(self) -> Array:
        """How much an error of each row counts (total,): in units of the series with the smallest stated sigma."""
        sigma = np.array([float(np.median(s.observations.sigma_m)) for s in self.frames.cell.series])
        weights: Array = (sigma.min() / sigma)[self.series_of]
        return weights


def choose_level(trial: CellTrial) -> tuple[int, tuple[str, ...]]:
    """Return the level that predicts unseen groups best, and why; wider ones must be surely better."""
    forced_level = trial.options.level
    if forced_level is not None:
        return forced_level, (
            make_message(
                "level {level}, {level_name}, was asked for",
                level=forced_level,
                level_name=LEVEL_NAMES[forced_level],
            ),
        )
    few = trial.restrict_to_rows(evenly_spaced(len(trial.groups), _MOST_ROWS))
    sizes = {level: len(few.layout_of(level)) for level in LEVELS}
    observations = [series.observations for series in few.frames.cell.series]
    most = sum(len(rows) * of.channels for rows, of in zip(few.rows, observations, strict=True))
    possible, notes = possible_levels(sizes, most)
    level, reasons = best_level(
        possible, lambda each: few.held_out(each) * few.weights, few.groups, few.is_compared
    )
    return level, (*notes, *reasons)


def group_cell_rows(frames: CellFrames) -> Rows:
    """Return the group of every row, series after series: rows of one robot in one posture share one.

    Series that were measured at the same stops must not tell on each other, so groups are found over all of them.
    """
    cell, groups, first = frames.cell, {}, 0
    for robot in cell.robots:
        mine = [s for s in cell.series if cell.robot_of(s.target) is robot]
        if not mine:
            continue
        joints = np.concatenate([s.observations.joints_rad for s in mine])
        labels = [s.groups for s in mine if s.groups is not None]
        given_groups = np.concatenate(labels) if len(labels) == len(mine) else None
        found = group_rows(joints, given_groups)
        at = 0
        for series in mine:
            count = len(series.observations)
            groups[series.name] = first + found.groups[at : at + count]
            at += count
        first += found.group_count
    return np.concatenate([groups[series.name] for series in cell.series])


def without_fixed(layout: CellLayout, options: CellOptions) -> CellLayout:
    """Return the layout without what the options hold."""
    fixed_parameters = [
        p for p in layout.parameters if any(_names_parameter(word, p) for word in options.fixed)
    ]
    if options.free:
        fixed_parameters += [
            p
            for p in layout.parameters
            if p.role not in (*PLACE_ROLES, "target", "device")
            and not any(_names_parameter(w, p) for w in options.free)
        ]
    names = {parameter.name for parameter in fixed_parameters}
    free = [i for i in layout.free if layout.whole[i].name not in names]
    return replace(layout, free=np.array(free, dtype=np.intp))


def _names_parameter(word: str, parameter: Parameter) -> bool:
    if word in GROUPS:
        return parameter.role in GROUPS[word]
    return parameter.name == word or parameter.name.startswith(f"{word} ")


def refuse_unknown_words(frames: CellFrames, options: CellOptions) -> None:
    """Refuse words of the options that name nothing of the cell, at any level.

    Raises
    ------
    CalibrationError
        With what could be meant.
    """
    terms = [all_joint_terms(robot.model) for robot in frames.cell.robots]
    all_parameters = cell_layout(frames, LEVELS[-1], terms, options.priors).whole
    for word in (*options.free, *options.fixed):
        if not any(_names_parameter(word, parameter) for parameter in all_parameters):
            near = sorted({p.name.rsplit(" ", 1)[0] for p in all_parameters if p.role != "harmonic"})
            raise CalibrationError(
                make_message("there is no parameter {word!r} in this cell.", word=word),
                remedy=make_message(
                    "Groups: {groups_text}. Names begin with: {near_text}.",
                    groups_text=", ".join(GROUPS),
                    near_text=", ".join(near),
                ),
            )
