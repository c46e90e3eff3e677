"""The fit behind ``cellcal identify``: rows of a file that fit their robot, identified beside the look at them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.identification.axis_scales import find_axis_scale, refuse_axis_scale
from cellcal.calibration.identification.cross_validation import Grouping, group_rows
from cellcal.calibration.identification.identify import Identification, start_identification
from cellcal.calibration.identification.misfit import refuse_misfit
from cellcal.calibration.identification.misfit_error import MisfitError, cure_by_column
from cellcal.calibration.identification.mixed_targets import find_mixed_targets, refuse_mixed_targets
from cellcal.calibration.identification.observations import Observations, PoseObservations, Rows
from cellcal.calibration.identification.position_scale import (
    PositionScale,
    position_scale,
    refuse_wrong_scale,
)
from cellcal.calibration.identification.rows_apart import RowsApart, find_rows_apart
from cellcal.calibration.identification.selection import IdentificationOptions
from cellcal.calibration.identification.series_changes import find_series_changes, refuse_series_changes
from cellcal.calibration.identification.target_change import (
    find_target_change,
    refuse_target_change,
    series_columns,
)
from cellcal.calibration.identification.temperature import temperature_effect
from cellcal.calibration.identification.work_parts import PartRunner
from cellcal.service.engineering.identification.identify_check import (
    PreparedMeasurements,
    bring_to_temperature,
    file_names,
    without_contradicting_attitudes,
)
from cellcal.service.engineering.identification.identify_start import IdentificationStart, StartOptions
from cellcal.service.engineering.identification.identify_verdicts import IdentificationLimits
from cellcal.service.engineering.measured.measurements import ReadOptions
from cellcal.service.engineering.measured.table import MeasurementError


@dataclass(frozen=True, slots=True)
class IdentifyOptions:
    """Options of an identification."""

    level: int | None = None
    check: Path | None = None
    train_rows: int | None = None
    seed: int = 0
    read: ReadOptions = field(default_factory=ReadOptions)
    start: StartOptions = field(default_factory=StartOptions)
    residual_model: bool = False
    limits: IdentificationLimits = field(default_factory=IdentificationLimits)


@dataclass(frozen=True, eq=False)
class FittedRows:
    """The identification of some of a file's rows, and what was found about them beside it."""

    prepared: PreparedMeasurements  # at one temperature
    split: tuple[Rows, Rows]  # rows that were fitted, and rows held out
    chain: RobotModel
    found: Identification
    scale: PositionScale | None
    elsewhere: RowsApart | None = None  # rows of the file that take no part: they fit by themselves

    @property
    def rows(self) -> Observations:
        """The rows that were fitted."""
        return self.prepared.observations.select_rows(self.split[0])


def fit_rows(
    model: RobotModel,
    prepared: PreparedMeasurements,
    start: IdentificationStart,
    options: IdentifyOptions,
    runner: PartRunner,
) -> FittedRows:
    """Identify the arm; whether the rows fit it at all is found out beside the long parts, and refused first."""
    chain = start.point.rigid_arm(model)
    names = file_names(prepared.measurements)
    wait_for_fit = cache(runner.submit(refuse_misfit, chain, prepared.observations, names))
    if isinstance(prepared.observations, PoseObservations):
        wait_for_fit()  # what contradicts is that of rows that fit
        prepared = without_contradicting_attitudes(chain, prepared)
    wait_for_changes = cache(runner.submit(_refuse_changes, chain, prepared))
    train, held_out = _split_rows(len(prepared.observations), options)
    grouping = group_rows(
        prepared.measurements.observations.joints_rad[train], prepared.grouping.groups[train]
    )
    grouping = Grouping(grouping.groups, prepared.grouping.kind)
    if prepared.measurements.temperature is not None:  # its effect is that of rows that belong together
        wait_for_fit()
        wait_for_changes()
        prepared = _at_one_temperature(model, prepared, train, grouping)
    fit_options = _options_of_fit(options, start, held_out)
    begun = _begin_fit(model, chain, prepared, (train, grouping), fit_options, runner)
    wait_for_fit()
    wait_for_changes()
    scale, found = begun()
    elsewhere = None if len(held_out) else find_rows_apart(found)
    if elsewhere is not None and elsewhere.fits_alone:
        train = np.delete(train, elsewhere.rows)
        grouping = grouping.of_rows(np.delete(np.arange(len(grouping.groups)), elsewhere.rows))
        scale, found = _begin_fit(model, chain, prepared, (train, grouping), fit_options, runner)()
        return FittedRows(prepared, (train, held_out), chain, found, scale, elsewhere)
    return FittedRows(prepared, (train, held_out), chain, found, scale)


def _begin_fit(
    model: RobotModel,
    chain: RobotModel,
    prepared: PreparedMeasurements,
    training: tuple[Rows, Grouping],
    options: IdentificationOptions,
    runner: PartRunner,
) -> Callable[[], tuple[PositionScale | None, Identification]]:
    """Begin the fit of some rows and of their common factor; return what waits for both."""
    train, grouping = training
    rows = prepared.observations.select_rows(train)
    wait_for_scale = runner.submit(_believed_scale, chain, rows)
    identify = start_identification(model, rows, grouping=grouping, options=options, runner=runner)
    return lambda: (wait_for_scale(), identify())


def _options_of_fit(
    options: IdentifyOptions, start: IdentificationStart, held_out: Rows
) -> IdentificationOptions:
    return IdentificationOptions(
        level=options.level,
        seed=options.seed,
        judge=not len(held_out) or options.residual_model,
        start=start.point,
        residual_model=options.residual_model,
    )


def _at_one_temperature(
    model: RobotModel, prepared: PreparedMeasurements, train: Rows, grouping: Grouping
) -> PreparedMeasurements:
    """Return measurements brought to one temperature, where the rows that are fitted show that it matters."""
    temperature = prepared.measurements.temperature
    if temperature is None:
        return prepared
    effect = temperature_effect(model, prepared.observations.select_rows(train), temperature[train], grouping)
    return prepared if effect is None else bring_to_temperature(prepared, effect)


def _split_rows(count: int, options: IdentifyOptions) -> tuple[Rows, Rows]:
    """Return training rows, in order, and all other rows."""
    if options.train_rows is None:
        return np.arange(count), np.arange(0)
    if not 0 < options.train_rows < count:
        raise MeasurementError(
            f"{options.train_rows} training rows of {count} leave nothing to hold out.",
            remedy=f"Give `--train-rows` between 1 and {count - 1}.",
        )
    order = np.random.default_rng(options.seed).permutation(count)
    return np.sort(order[: options.train_rows]), np.sort(order[options.train_rows :])


def _refuse_changes(chain: RobotModel, prepared: PreparedMeasurements) -> None:
    """Refuse rows within which a target, device or zero of a joint changed, or one coordinate of another size."""
    observations, rows = prepared.observations, prepared.measurements.rows
    series = series_columns(chain, observations)
    try:
        refuse_series_changes(chain, find_series_changes(series, observations), rows)
        refuse_target_change(chain, find_target_change(series), rows)
        refuse_mixed_targets(chain, find_mixed_targets(series, observations), rows)
        position = file_names(prepared.measurements).position
        refuse_axis_scale(chain, observations, find_axis_scale(series, observations), position)
    except MisfitError as error:
        column = prepared.measurements.targets[0]
        if not column or all("target" not in cause.kinds for cause in error.causes):
            raise
        raise MisfitError(error.message, remedy=cure_by_column(column), causes=error.causes) from error


def _believed_scale(chain: RobotModel, rows: Observations) -> PositionScale | None:
    """Return the common factor of positions, unless it is one that is refused."""
    scale = position_scale(chain, rows)
    refuse_wrong_scale(chain, scale)
    return scale
