"""Words beside and between the numbers of a table: rows of several robots or targets, and headings further down."""

from collections import Counter
from collections.abc import Collection, Sequence

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.headings import PULSES_REMEDY, plain_name, without_unit
from cellcal.service.engineering.measured.table import MeasurementError, MeasurementTable

_ROBOTS = frozenset(
    (
        "robot",
        "robots",
        "robot_name",
        "robot_id",
        "robot_no",
        "robot_number",
        "robot_serial",
        "roboter",
        "manipulator",
    )
)
_TARGETS = frozenset(
    {
        "target",
        "target_name",
        "target_id",
        "target_no",
        "target_number",
        "smr",
        "ball",
        "reflector",
        "nest",
        "prism",
    }
    | {
        "tool",
        "tool_name",
        "tool_id",
        "tool_no",
        "tool_number",
        "utool",
        "tcp",
        "tcp_name",
        "werkzeug",
        "ziel",
    }
)
_MOST_UNUSED, _MOST_WORDS = 12, 8
_FEWEST_ROWS = 4  # of each word: a column of names has another one in nearly every row
_FARTHEST_DEG = 3600.0  # ten turns
_DEG_RAD = float(np.deg2rad(1.0))


def refuse_several_robots(table: MeasurementTable, rows: Rows, used: Collection[str]) -> None:
    """Refuse rows of which a column says that they are of several robots.

    Raises
    ------
    MeasurementError
        With the column and the robots that it names.
    """
    for name, words in _dividing_columns(table, rows, used, _ROBOTS):
        raise MeasurementError(
            make_message(
                "column {column!r} names {count} robots: {names}.",
                column=name,
                count=len(words),
                names=", ".join(words),
            ),
            remedy="Keep the rows of one robot in the file, or describe all of them in a layout (`--layout`, "
            "examples in `deploy/layouts/`).",
        )


def target_column(table: MeasurementTable, rows: Rows, used: Collection[str]) -> tuple[str, tuple[str, ...]]:
    """Return a column that tells several targets or tools of the rows apart, and their names; empty for none."""
    return next(iter(_dividing_columns(table, rows, used, _TARGETS)), ("", ()))


def unused_columns(table: MeasurementTable, rows: Rows, used: Collection[str]) -> dict[str, Array]:
    """Return columns that take no part and differ between rows: numbers, or a code for each word of a few."""
    found: dict[str, Array] = {}
    for name in table.names:
        if name in used or len(found) == _MOST_UNUSED:
            continue
        values = table.column_values(name)[rows]
        if not np.isfinite(values).all():
            cells = table.column_texts(name)
            words = [cells[row].strip() for row in rows]
            if len(set(words)) > _MOST_WORDS:
                continue
            values = np.unique(words, return_inverse=True)[1].reshape(-1).astype(float)
        if np.ptp(values) > 0.0:
            found[name] = values
    return found


def _dividing_columns(
    table: MeasurementTable, rows: Rows, used: Collection[str], plain_names: Collection[str]
) -> list[tuple[str, tuple[str, ...]]]:
    found = []
    for name in table.names:
        if name in used or plain_name(name) not in plain_names:
            continue
        cells = table.column_texts(name)
        counts = Counter(word for row in rows if (word := cells[row].strip()))
        if len(counts) > 1 and min(counts.values()) >= _FEWEST_ROWS:
            found.append((name, tuple(sorted(counts))))
    return found


def refuse_other_headings(table: MeasurementTable, names: Sequence[str]) -> None:
    """Refuse a table in which another heading stands further down, with other columns or units than the first.

    Raises
    ------
    MeasurementError
        With its line.
    """
    columns = {name: table.names.index(name) for name in names}
    column_names = {plain_name(name) for name in table.names}
    for row in sorted({row for row, at in table.texts if at in columns.values()}):
        cells = [table.texts.get((row, at), "") for at in columns.values()]
        headed = sum(plain_name(cell) in column_names for cell in cells)
        if all(cells) and 2 * headed >= len(cells) and not all(map(_is_same_heading, cells, names)):
            raise MeasurementError(
                make_message(
                    "line {line} is another heading ({cells}), with other columns or units than the first.",
                    line=int(table.lines[row]),
                    cells=", ".join(cells),
                ),
                remedy="Divide the file there: one table with one heading in each.",
            )


def _is_same_heading(cell: str, name: str) -> bool:
    written, first = ("".join(text.split()).lower() for text in (cell, name))
    return written in (first, "".join(without_unit(name).split()).lower())


def refuse_no_angles(names: Sequence[str], values: Array, units_rad: Array) -> None:
    """Refuse numbers (N, n) that were taken as degrees and are many turns: pulses or counts of encoders.

    Raises
    ------
    MeasurementError
        With the column and its largest number.
    """
    largest = np.max(np.abs(values), axis=0, initial=0.0)
    for name, most, unit in zip(names, largest, units_rad, strict=True):
        if np.isclose(unit, _DEG_RAD) and most > _FARTHEST_DEG:
            raise MeasurementError(
                make_message(
                    "column {column!r} holds {most:.6g}, taken as degrees: no joint turns so far.",
                    column=name,
                    most=float(most),
                ),
                remedy=PULSES_REMEDY,
            )
