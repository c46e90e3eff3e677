"""Identification of a cell: every series in one fit, its level chosen by unseen groups, what stays unknown named."""

from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.cells.cell import CalibrationCell
from cellcal.calibration.cells.first_guess import first_places
from cellcal.calibration.cells.levels import (
    CellOptions,
    CellTrial,
    choose_level,
    group_cell_rows,
    refuse_unknown_words,
)
from cellcal.calibration.cells.robust import RobustCellFit, widen_cell_fit
from cellcal.calibration.cells.state import CellFrames, CellState
from cellcal.calibration.cells.system import errors_m
from cellcal.calibration.cells.unknowns import find_not_identified
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.cross_validation import ErrorSummary
from cellcal.calibration.identification.identifiability import CorrelatedPair, NotIdentified, correlated_pairs
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.identification.parameters import FRAMES, OFFSETS
from cellcal.calibration.identification.selection import LEVELS
from cellcal.calibration.message import make_message

_FOLDS = 5
_INNER_FOLDS = 5
_LEAST_REDUNDANT = 1


@dataclass(frozen=True, slots=True)
class RejectedCellRow:
    """A row that was not fitted, and why."""

    series: str
    row: int
    reason: str


@dataclass(frozen=True, eq=False)
class SeriesErrors:
    """Errors of one series [m]: of the fit, and by procedures that saw nothing of a row."""

    name: str
    fit_m: Array  # (N,)
    rejected: Rows
    held_out: Rows  # rows that were held out: none of a short series
    before_m: Array  # of those, places alone fitted
    held_out_m: Array  # of those, level and fit chosen without them

    @property
    def fit_errors(self) -> ErrorSummary:
        """Residuals of the kept rows: never an accuracy."""
        return ErrorSummary.from_sizes(np.delete(self.fit_m, self.rejected))

    @property
    def before_errors(self) -> ErrorSummary:
        """The arms as they were known, with places fitted by other rows."""
        return ErrorSummary.from_sizes(self.before_m)

    @property
    def after_errors(self) -> ErrorSummary:
        """Each fold predicted by everything that the other folds lead to."""
        return ErrorSummary.from_sizes(self.held_out_m)


@dataclass(frozen=True, eq=False)
class CellIdentification:
    """The identified cell, and what may be believed about it."""

    state: CellState
    before: CellState  # places fitted to the arms as they were known
    robust: RobustCellFit
    level: int
    level_reasons: tuple[str, ...]
    series: tuple[SeriesErrors, ...]
    rejected: tuple[RejectedCellRow, ...]
    not_identified: tuple[NotIdentified, ...]
    correlated: tuple[CorrelatedPair, ...]
    groups: tuple[Rows, ...]  # of every series' rows, as they were held out together
    group_effects: tuple[str, ...]  # by how much rows that go together widen what is stated, for people


def fit_cell(cell: CalibrationCell, options: CellOptions | None = None) -> CellIdentification:
    r"""Identify all arms of a cell from all its series at once.

    Parameters
    ----------
    cell : Cell
        Robots, tools, devices, and rows in the order of measuring.
    options : CellOptions
        Level, priors, what may move.

    Returns
    -------
    CellIdentification
        With held-out errors by series, rejected rows included; points and frames: `calibration.cells.prediction`.

    Raises
    ------
    DegenerateDataError
        Fewer readings than unknown places, or a place that nothing shows roughly.
    CalibrationError
        A level or a parameter that does not exist.

    Notes
    -----
    Each series weighs as its own residuals show it, so that devices need not agree about what a sigma is. Where a
    frame is given with a deviation, that is a prior, counted once however many series see the frame.
    """
    options = options or CellOptions()
    if options.level is not None and options.level not in LEVELS:
        raise CalibrationError(
            make_message("there is no level {level}.", level=options.level),
            remedy=make_message(
                "Levels are {lowest_level} to {highest_level}.",
                lowest_level=LEVELS[0],
                highest_level=LEVELS[-1],
            ),
        )
    frames = CellFrames.from_cell(cell)
    refuse_unknown_words(frames, options)
    _refuse_too_few(frames)
    rows = tuple(np.arange(len(series.observations)) for series in cell.series)
    trial = CellTrial(frames, first_places(frames), options, rows, group_cell_rows(frames))
    before = trial.fit_level(FRAMES)
    trial = replace(trial, places=before.fit.state.places)
    level, reasons = choose_level(trial)
    groups = [trial.groups[trial.series_of == number] for number in range(len(rows))]
    robust, group_remarks = widen_cell_fit(trial.fit_level(level) if level != FRAMES else before, groups)
    offsets_fit = robust if level != FRAMES else widen_cell_fit(trial.fit_level(OFFSETS), groups)[0]
    errors = [errors_m(series, robust.fit.state) for series in robust.problem.series]
    return CellIdentification(
        robust.fit.state,
        before.fit.state,
        robust,
        level,
        reasons,
        _held_out_errors(trial, robust, errors),
        _rejected_rows(robust, errors),
        find_not_identified(offsets_fit.fit),
        correlated_pairs(offsets_fit.fit),
        tuple(groups),
        group_remarks,
    )


def _refuse_too_few(frames: CellFrames) -> None:
    unknown = sum(int(np.isinf(slot.place.sigma).sum()) for slot in frames.slots)
    readings = sum(len(s.observations) * s.observations.channels for s in frames.cell.series)
    if readings < unknown + _LEAST_REDUNDANT:
        raise DegenerateDataError(
            make_message(
                "{readings} readings cannot tell {unknown} unknown coordinates of frames.",
                readings=readings,
                unknown=unknown,
            ),
            remedy="Measure more postures, or give places that are known.",
        )


def _held_out_errors(
    trial: CellTrial, robust: RobustCellFit, errors: list[Array]
) -> tuple[SeriesErrors, ...]:
    """Predict every row that may be held out by choices and fits without its fold."""
    count = len(trial.groups)
    before, after, held_rows = np.zeros(count), np.zeros(count), np.zeros(0, dtype=np.intp)
    if trial.options.judge:
        folds = replace(trial, options=replace(trial.options, folds=min(_FOLDS, trial.options.folds))).folds
        for fold in range(int(folds.max()) + 1):
            fold_rows, rest = np.flatnonzero(folds == fold), np.flatnonzero(folds != fold)
            inner = trial.restrict_to_rows(rest)
            inner = replace(
                inner, options=replace(trial.options, folds=min(_INNER_FOLDS, trial.options.folds))
            )
            frames_only = inner.fit_level(FRAMES)
            inner = replace(inner, places=frames_only.fit.state.places)
            level, _ = choose_level(inner)
            before[fold_rows] = trial.prediction_errors(frames_only, fold_rows)
            after[fold_rows] = trial.prediction_errors(
                inner.fit_level(level) if level != FRAMES else frames_only, fold_rows
            )
        held_rows = np.flatnonzero(folds >= 0)
    found: list[SeriesErrors] = []
    start = 0
    for result, rows in zip(robust.series, trial.split_by_series(held_rows), strict=True):
        number = len(found)
        here = start + rows
        found.append(
            SeriesErrors(result.name, errors[number], result.rejected, rows, before[here], after[here])
        )
        start += len(errors[number])
    return tuple(found)


def _rejected_rows(robust: RobustCellFit, errors: list[Array]) -> tuple[RejectedCellRow, ...]:
    return tuple(
        RejectedCellRow(
            result.name,
            int(row),
            make_message(
                "off model and neighbours by {distance_mm:.2f} mm, {deviations:.1f} deviations (limit {limit:.1f})",
                distance_mm=sizes[row] * 1e3,
                deviations=result.deviations[row],
                limit=result.threshold,
            ),
        )
        for result, sizes in zip(robust.series, errors, strict=True)
        for row in result.rejected
    )
