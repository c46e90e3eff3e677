"""Where the external axes of a cell stand at the positions of a program, and which of them nothing states."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.positions import Positions
from cellcal.service.engineering.programs.external.moving_axes import CellAxes, ExternalAxis, same_axis

_BEYOND = 1e-9  # [m or rad]; a value may be taught at the end of its range


@dataclass(frozen=True, eq=False)
class PointAxes:
    """The external axes of N positions of one program, as a project knows them."""

    values: Array  # (N, A) of the project's axes [m or rad], NaN where the program states none
    columns: tuple[int, ...]  # (A,) of `Positions.all_external_axes`, -1 where the program has none
    contradictions: tuple[str, ...]  # (A,) why a column is not the axis, "" where it is


def point_axes_of(positions: Positions, axes: CellAxes) -> PointAxes:
    """Return the values of a cell's axes at every position."""
    table, columns = positions.all_external_axes, positions.external_columns
    values = np.full((len(positions), len(axes)), np.nan)
    found, contradictions = [], []
    for number, axis in enumerate(axes.axes):
        at = _column_of(positions, axis)
        found.append(at)
        contradictions.append(axis.contradiction_of(columns[at]) if at >= 0 else "")
        if at >= 0 and not contradictions[-1]:
            values[:, number] = axis.values_in_si(columns[at], table[:, at])
    return PointAxes(values, tuple(found), tuple(contradictions))


def _column_of(positions: Positions, axis: ExternalAxis) -> int:
    names = [column.name for column in positions.external_columns]
    return next((at for at, name in enumerate(names) if same_axis(name, axis.axis)), -1)


def written_values(positions: Positions, axes: CellAxes, point_axes: PointAxes, values: Array) -> Array:
    """Return values (N, A) as `PositionChange.external` takes them (N, k + m); NaN where nothing is written."""
    table = np.full((len(positions), len(positions.external_columns)), np.nan)
    for number, at in enumerate(point_axes.columns):
        if at >= 0:
            column = positions.external_columns[at]
            table[:, at] = axes.axes[number].written_values(column, values[:, number])
    return table


def has_unstated_axes(positions: Positions, axes: CellAxes) -> NDArray[np.bool_]:
    """Return (N,) which positions hold an extended axis that is not at zero, and that the project does not state."""
    count = positions.external.shape[1]
    names = [column.name for column in positions.external_columns[:count]] or [""] * count
    unstated = [at for at, name in enumerate(names) if not is_stated(name, axes)]
    table = np.abs(np.nan_to_num(positions.external[:, unstated]))
    moved: NDArray[np.bool_] = table.max(axis=1, initial=0.0) > 0
    return moved


def is_stated(name: str, axes: CellAxes) -> bool:
    """Return whether a project states the axis of a column."""
    return any(same_axis(name, axis.axis) for axis in axes.axes)


def stated_groups(positions: Positions, axes: CellAxes) -> frozenset[int]:
    """Return the motion groups all of whose axes the project states."""
    groups: dict[int, bool] = {}
    for column in positions.external_columns:
        if column.other_group:
            group = int(column.name[2])
            groups[group] = groups.get(group, True) and is_stated(column.name, axes)
    return frozenset(group for group, stated in groups.items() if stated)


def beyond_range(axes: CellAxes, values: Array) -> list[str]:
    """Return for each of N points which axis is beyond its range, "" where none is."""
    reasons = [""] * len(values)
    for number, axis in enumerate(axes.axes):
        beyond = (values[:, number] < axis.lower - _BEYOND) | (values[:, number] > axis.upper + _BEYOND)
        for row in np.flatnonzero(beyond).tolist():
            value = values[row, number] / axis.kind.per_unit
            reasons[row] = reasons[row] or make_message(
                "{axis} at {value:.3f} {unit} is beyond its range",
                axis=axis.axis,
                value=value,
                unit=axis.kind.unit,
            )
    return reasons
