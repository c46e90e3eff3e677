"""Rows of a cell that do not fit their robot by far: refused series by series, with the cure in a layout's words."""

import re

from cellcal.calibration.cells.cell import CalibrationCell, CellSeries
from cellcal.calibration.cells.identify import CellIdentification
from cellcal.calibration.identification.misfit import refuse_gross_misfit, refuse_misfit
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.calibration.identification.misfit_hypotheses import FileNames
from cellcal.calibration.identification.observations import LengthObservations, PointObservations
from cellcal.calibration.identification.position_scale import position_scale, refuse_wrong_scale
from cellcal.service.engineering.measured.cells import CellLayoutFile

_COLUMNS = re.compile(r'`--columns "?(\w+)=([^`"]*)"?`')
_UNITS = re.compile(r"`--units (\w+)=(\w+)`")
_ROBOT = re.compile(r"`--robot ([^`]+)`")


def refuse_misfit_of_series(cell: CalibrationCell, layout: CellLayoutFile) -> None:
    """Refuse a cell if the rows of one of its series fit its robot badly, and well with a known cause.

    Raises
    ------
    MisfitError
        With the series, the cause, and how a layout says it.
    """
    for series in cell.series:
        observations = series.observations
        if not isinstance(observations, PointObservations | LengthObservations):
            continue
        robot = cell.robot_of(series.target)
        model = robot.model if robot.previous is None else robot.previous.arm_model
        try:
            refuse_misfit(model, observations, _column_names(series, layout))
            refuse_wrong_scale(model, position_scale(model, observations))
        except MisfitError as error:
            raise _of_layout(error, series.name) from error


def refuse_gross_misfit_of_series(cell: CalibrationCell, found: CellIdentification) -> None:
    """Refuse a fit that leaves errors as large as the robot in one of its series.

    Raises
    ------
    MisfitError
        No known cause explains them.
    """
    for series, errors in zip(cell.series, found.series, strict=True):
        sizes = errors.held_out_m if len(errors.held_out_m) else errors.fit_m
        try:
            refuse_gross_misfit(cell.robot_of(series.target).model, series.observations, sizes)
        except MisfitError as error:
            raise _of_layout(error, series.name) from error


def _column_names(series: CellSeries, layout: CellLayoutFile) -> FileNames:
    reading = next((r for r in layout.readings if series.name.partition(": ")[0] == r.name), None)
    position = reading.columns if reading is not None and len(reading.columns) == 3 else ("X", "Y", "Z")
    return FileNames(
        layout.joints, position, layout.units["readings"], layout.units["joints"], layout.joint_coupling
    )


def _of_layout(error: MisfitError, series: str) -> MisfitError:
    """Return the error with the series it is about, and the cure as it is written in a layout."""
    remedy = _COLUMNS.sub(_layout_entry, error.remedy)
    remedy = _UNITS.sub(lambda m: f'`[units]` `{_unit_key(m[1])} = "{m[2]}"`', remedy)
    remedy = _ROBOT.sub(r'`model = "\1"` of its [[robot]]', remedy)
    remedy = remedy.replace(
        "`--joint-coupling geometric`", '`joint_coupling = "geometric"` in the layout'
    ).replace("`--joint-coupling controller`", '`joint_coupling = "controller"` in the layout')
    return MisfitError(f"series {series!r}: {error.message}", remedy=remedy, causes=error.causes)


def _layout_entry(found: re.Match[str]) -> str:
    words = ", ".join(f'"{word}"' for word in found[2].split(","))
    return (
        f"`[columns]` `joints = [{words}]`"
        if found[1] == "joints"
        else f"`columns = [{words}]` of the reading"
    )


def _unit_key(meaning: str) -> str:
    return meaning if meaning in ("joints", "rotation") else "readings"
