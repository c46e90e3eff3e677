"""External axes of a listing: E1 to E3 of the robot's group, and the joints of groups that are no arm.

A positioner is a group of its own, whose joints stand in the record of the same position. They become columns beside
the robot's own extended axes, named ``GP2 J1``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.ls_grammar import FIELD
from cellcal.drivers.fanuc.program_files.ls_numbers import kept_decimals
from cellcal.drivers.fanuc.program_files.ls_records import PositionRecord
from cellcal.drivers.programs.conditions import AxisUnit, ExternalColumn
from cellcal.drivers.programs.positions import JOINTS, Positions

if TYPE_CHECKING:
    from cellcal.drivers.fanuc.program_files.ls_edit import Edit, RecordTexts

ExternalUnits: TypeAlias = dict[str, AxisUnit]
_MOST_AXES = 5  # of a group that is no arm
_UNITS = {b"mm": AxisUnit.MILLIMETRES, b"deg": AxisUnit.DEGREES}
_PER_UNIT = {b"mm": 1e3, b"deg": 180.0 / np.pi}


def note_units(units: ExternalUnits, block: Sequence[PositionRecord]) -> None:
    """Add the units that some records write external axes in."""
    for record in block:
        for axis in record.axes:
            number = int(axis.number)
            if axis.letter == b"E" and record.group == 1:
                name = f"E{number}"
            elif axis.letter == b"J" and record.group != 1:
                name = f"GP{record.group} J{number}"
            else:
                continue
            unit = _UNITS[axis.unit]
            units[name] = unit if units.get(name, unit) == unit else AxisUnit.MIXED


def with_external_columns(positions: Positions, units: ExternalUnits) -> Positions:
    """Return positions whose external axes have names, with the joints of other groups beside the robot's rows."""
    width = positions.external.shape[1]
    own = [ExternalColumn(f"E{k + 1}", units.get(f"E{k + 1}", AxisUnit.UNSTATED)) for k in range(width)]
    others = _groups_of_few_axes(positions)
    if not others:
        return replace(positions, external_columns=tuple(own)) if own else positions
    rows_by_name = {
        (name, int(group)): row
        for row, (name, group) in enumerate(zip(positions.names, positions.groups, strict=True))
    }
    columns, values = list(own), []
    for group, count in others.items():
        columns += [
            ExternalColumn(f"GP{group} J{k + 1}", units.get(f"GP{group} J{k + 1}", AxisUnit.UNSTATED), True)
            for k in range(count)
        ]
        beside = np.full((len(positions), count), np.nan)
        for row, name in enumerate(positions.names):
            other = rows_by_name.get((name, group))
            if positions.groups[row] == 1 and other is not None:
                beside[row] = positions.joints[other, :count]
        values.append(beside)
    return replace(positions, group_axes=np.hstack(values), external_columns=tuple(columns))


def _groups_of_few_axes(positions: Positions) -> dict[int, int]:
    """Return the groups beside the robot's that hold joints, fewer than an arm's, and how many."""
    if not len(positions) or (positions.groups == 1).all():
        return {}
    found = {}
    for group in sorted({int(g) for g in positions.groups.tolist()} - {1}):
        rows = positions.groups == group
        kinds = {kind for kind, here in zip(positions.kinds, rows.tolist(), strict=True) if here}
        has_value = np.isfinite(positions.joints[rows]).any(axis=0)
        count = int(np.flatnonzero(has_value)[-1]) + 1 if has_value.any() else 0
        if kinds <= {JOINTS, "untaught"} and 0 < count <= _MOST_AXES:
            found[group] = count
    return found


def external_edits(blocks: "RecordTexts", rows: NDArray[np.int64], external: Array) -> Iterator["Edit"]:
    """Yield the edits that write external axes; those of another group stand in its own record."""
    columns = blocks.positions.external_columns
    rows_by_name = {
        (name, int(group)): row
        for row, (name, group) in enumerate(zip(blocks.positions.names, blocks.positions.groups, strict=True))
    }
    for row, values in zip(rows.tolist(), external, strict=True):
        for column, value in zip(columns, values.tolist(), strict=True):
            if np.isnan(value):
                continue
            at, letter, number = row, b"E", int(column.name[-1])
            if column.other_group:
                group = int(column.name[2])
                at, letter = rows_by_name.get((blocks.positions.names[row], group), -1), b"J"
            if at < 0:
                raise blocks.row_error(
                    row, make_message("holds no {column_name} to take a value.", column_name=column.name)
                )
            yield from _axis_edit(blocks, at, (letter, number), value)


def _axis_edit(blocks: "RecordTexts", row: int, axis: tuple[bytes, int], value: float) -> Iterator["Edit"]:
    block = blocks.match_any_form(row)
    data = blocks.place.data
    for found in FIELD.finditer(data, block.start(), block.end()):
        if (found[1], int(found[2])) != axis:
            continue
        if b"*" in found[3]:
            raise blocks.row_error(
                row,
                make_message(
                    "holds no value of {axis_letter}{axis_number}.",
                    axis_letter=axis[0].decode(),
                    axis_number=axis[1],
                ),
            )
        new = value * _PER_UNIT[found[4]]
        if abs(new - float(found[3])) > 0.5 * 10.0 ** -kept_decimals(found[3]) * (1 - 1e-9):
            yield *found.span(3), blocks.write_number(row, found[3], new)
        return
    raise blocks.row_error(
        row,
        make_message(
            "holds no {axis_letter}{axis_number} to take a value.",
            axis_letter=axis[0].decode(),
            axis_number=axis[1],
        ),
    )
