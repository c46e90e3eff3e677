"""Rows at which the device was moved: breaks are taken where they make unseen groups more predictable."""

from collections.abc import Sequence

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.cross_validation import (
    Grouping,
    assign_folds,
    compare_models,
)
from cellcal.calibration.identification.estimator import FitProblem, errors_m
from cellcal.calibration.identification.fold_errors import errors_without_folds
from cellcal.calibration.identification.frame_fits import (
    SHORTEST_MOUNTING,
    FrameFits,
    fit_frames,
    mount_at_breaks,
)
from cellcal.calibration.identification.observations import Observations, Rows, with_mounting
from cellcal.calibration.identification.parameters import ArmState
from cellcal.calibration.identification.series_breaks import (
    SeriesBreak,
    candidate_breaks,
    change_between,
    find_small_break,
    find_small_excursion,
    sort_breaks,
)
from cellcal.calibration.message import make_message

_FOLDS = 5
_LEAST_GAIN = 0.1  # of the held-out RMSE: a mounting costs more trust than a parameter
_PATIENCE = 2
_MOST_BREAKS = 8


def choose_breaks(
    fits: FrameFits, grouping: Grouping, seed: int
) -> tuple[tuple[SeriesBreak, ...], tuple[str, ...]]:
    """Return the breaks that make unseen groups more predictable, and why the search stopped.

    ``seed`` draws the folds that the groups are held out in.
    """
    trial = _BreakTrial(fits, grouping, assign_folds(grouping, _FOLDS, seed))
    waited = 0
    for candidate in candidate_breaks(fits.model, fits.observations, fits=fits):
        waited = 0 if trial.accept(candidate) else waited + 1
        if waited == _PATIENCE:
            break
    trial.replace_if_better(_placed_with_geometry(fits, trial.chosen))
    while len(trial.chosen) < _MOST_BREAKS and _accept_small(trial, fits):
        continue
    return trial.chosen, tuple(trial.reasons)


def _placed_with_geometry(fits: FrameFits, breaks: tuple[SeriesBreak, ...]) -> tuple[SeriesBreak, ...]:
    """Return breaks, each where its rows change from one place of the device to the next once the geometry is fitted.

    The errors of an arm that was never calibrated draw the break of a small move to rows beside it.
    """
    rows = [found.row for found in breaks]
    if not breaks or not fits.carry_geometry(rows):
        return breaks
    state = fits.fit_geometry(rows)[0].state
    edges = [0, *rows, len(fits.observations)]
    placed = []
    for mounting, found in enumerate(breaks):
        first, last = edges[mounting] + SHORTEST_MOUNTING, edges[mounting + 2] - SHORTEST_MOUNTING
        if first < last:
            around = fits.observations.select_rows(np.arange(first, last))
            edges[mounting + 1] = first + change_between(*errors_in_both_mountings(state, around, mounting))
        placed.append(SeriesBreak(edges[mounting + 1], found.bic_gain))
    return tuple(placed)


def _accept_small(trial: "_BreakTrial", fits: FrameFits) -> bool:
    """Take one more break, or two between which the device stood elsewhere, where the geometry shows it."""
    small = find_small_break(fits, trial.chosen)
    if small is not None and trial.accept(sort_breaks(*trial.chosen, small)):
        return True
    excursion = find_small_excursion(fits, trial.chosen)
    return excursion is not None and trial.accept(sort_breaks(*trial.chosen, *excursion))


class _BreakTrial:
    """The breaks that were accepted so far, and how well they predict groups that were not fitted."""

    def __init__(self, fits: FrameFits, grouping: Grouping, folds: Rows) -> None:
        self._fits, self._grouping, self._folds = fits, grouping, folds
        self._best: Array | None = None
        self.chosen: tuple[SeriesBreak, ...] = ()
        self.reasons: list[str] = []

    def accept(self, candidate: tuple[SeriesBreak, ...]) -> bool:
        """Take these breaks in place of the chosen ones where groups are surely better predicted; say why."""
        if self._best is None:
            self._best = _errors_with_breaks(self._fits, self._folds, ())
        errors = _errors_with_breaks(self._fits, self._folds, candidate)
        comparison = compare_models(
            (make_message("{break_count} breaks", break_count=len(self.chosen)), self._best),
            (make_message("{break_count} breaks", break_count=len(candidate)), errors),
            self._grouping.groups,
            least_gain=_LEAST_GAIN,
        )
        self.reasons.append(comparison.reason)
        if comparison.better:
            self.chosen, self._best = candidate, errors
        return comparison.better

    def replace_if_better(self, placed: tuple[SeriesBreak, ...]) -> None:
        """Take as many breaks at other rows where groups are predicted better with them."""
        if self._best is None or [each.row for each in placed] == [each.row for each in self.chosen]:
            return
        errors = _errors_with_breaks(self._fits, self._folds, placed)
        if np.median(errors) < np.median(self._best) and np.mean(errors**2) < np.mean(self._best**2):
            self.chosen, self._best = placed, errors


def _errors_with_breaks(fits: FrameFits, folds: Rows, breaks: Sequence[SeriesBreak]) -> Array:
    """Return held-out errors of plain fits of the geometry: quick, and good enough to compare mountings."""
    rows = [found.row for found in breaks]
    fit, _, _ = fits.fit_geometry(rows)
    mounted = mount_at_breaks(fits.observations, rows)
    problem = FitProblem.from_observations(fit.state, mounted)
    return errors_without_folds(fit, problem, np.ones(len(mounted)), folds)


def refine_breaks(
    model: RobotModel, observations: Observations, rows: Rows, breaks: tuple[SeriesBreak, ...]
) -> tuple[SeriesBreak, ...]:
    """Return breaks of every k-th row as breaks of all rows: where the rows between fit better."""
    if not breaks or len(rows) == len(observations):
        return breaks
    state = fit_frames(model, observations.select_rows(rows), [found.row for found in breaks]).state
    placed = []
    for mounting, found in enumerate(breaks):
        between = np.arange(rows[found.row - 1] + 1, rows[found.row])
        row = between[0] + change_between(
            *errors_in_both_mountings(state, observations.select_rows(between), mounting)
        )
        placed.append(SeriesBreak(int(row), found.bic_gain))
    return tuple(placed)


def errors_in_both_mountings(
    state: ArmState, observations: Observations, mounting: int
) -> tuple[Array, Array]:
    """Return the errors (N,) of rows in this mounting and in the one after it."""
    first, second = (
        errors_m(
            state,
            FitProblem.from_observations(state, with_mounting(observations, np.full(len(observations), m))),
        )
        for m in (mounting, mounting + 1)
    )
    return first, second
