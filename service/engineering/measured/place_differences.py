"""Places that a file writes as differences from others: when they are asked about, and sums that a person names."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.columns import TableLayout
from cellcal.service.engineering.measured.difference_words import sum_remedy
from cellcal.service.engineering.measured.errors import MeasurementError
from cellcal.service.engineering.measured.headings import unit_of, without_unit
from cellcal.service.engineering.measured.place_choice import is_calculated
from cellcal.service.engineering.measured.table import MeasurementTable
from cellcal.service.engineering.measured.typed_columns import find_column

_PLACES = {"position", "controller"}


def refuse_nominal_places(
    model: RobotModel, joints: tuple[Array, Array], layout: TableLayout, places: Array
) -> None:
    """Refuse places that the nominal robot calculates, where the file has differences from them beside.

    ``joints`` are those of usable rows (N, n) [rad] and the step to which they are rounded (n,) [rad]; ``places``
    (N, 3) are as written.

    Raises
    ------
    MeasurementError
        They are calculated, and what the device read is in the differences.
    """
    if layout.is_named or not layout.differences or not is_calculated(model, *joints, places):
        return
    raise MeasurementError(
        make_message(
            "{columns} are calculated from the joints by the nominal robot, not measured.",
            columns=", ".join(layout.position),
        ),
        remedy=sum_remedy(layout.differences, layout.position),
    )


def with_sums(
    table: MeasurementTable, columns: Mapping[str, Sequence[str]]
) -> tuple[MeasurementTable, dict[str, Sequence[str]]]:
    """Return a table with a column for each sum of two that was typed, such as ``x+dx``, and the columns by name.

    Raises
    ------
    MeasurementError
        The two columns are in different units.
    """
    named = dict(columns)
    for meaning in _PLACES.intersection(columns):
        found = []
        for text in columns[meaning]:
            pair = _pair_of(table.names, text.strip())
            table, name = (table, text) if pair is None else _with_sum(table, *pair)
            found.append(name)
        named[meaning] = tuple(found)
    return table, named


def _pair_of(names: Sequence[str], text: str) -> tuple[str, str, str] | None:
    """Return the two columns of a sum or difference, and the sign between; both are names, or both are numbers."""
    if find_column(names, text):
        return None
    for mark in re.finditer(r"[+-]", text):
        parts = text[: mark.start()].strip(), text[mark.end() :].strip()
        left, right = (find_column(names, part) for part in parts)
        if left and right and parts[0].isdecimal() == parts[1].isdecimal():
            return left, right, mark[0]
    return None


def _with_sum(table: MeasurementTable, left: str, right: str, sign: str) -> tuple[MeasurementTable, str]:
    units = {unit for unit in (unit_of(left), unit_of(right)) if unit}
    if len(units) > 1:
        raise MeasurementError(
            make_message(
                "the columns {names} are in different units: {units}.",
                names=f"{left}, {right}",
                units=", ".join(sorted(units)),
            ),
            remedy="Write them in one unit, and say so in their headings.",
        )
    name = f"{without_unit(left)}{sign}{without_unit(right)}"
    name = f"{name} [{units.pop()}]" if units else name
    if name in table.names:
        return table, name
    values = table.column_values(left) + (1.0 if sign == "+" else -1.0) * table.column_values(right)
    at = [table.names.index(each) for each in (left, right)]
    behind = len(table.names)
    texts = {(row, behind): text for (row, column), text in table.texts.items() if column in at}
    summed = replace(
        table,
        names=(*table.names, name),
        numbers=np.column_stack([table.numbers, values]),
        texts={**table.texts, **texts},
    )
    return summed, name
