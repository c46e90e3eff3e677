"""Columns as a person types them: by name or number, with a turned sign or another zero."""

import re
from collections.abc import Mapping, Sequence

from cellcal.calibration.identification.column_options import TypedColumn, is_bare, is_typable
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.headings import without_unit
from cellcal.service.engineering.measured.table import MeasurementError

_ZERO = re.compile(r"^(?P<name>.+?)(?P<zero>[+-]\d+(?:\.\d+)?)$")
_MOST_DEG = 720.0
_MOST_MARKS = 6


def parse_columns(
    names: Sequence[str], texts: Sequence[str], *, with_zero: bool = True
) -> tuple[TypedColumn, ...]:
    """Return columns by what was typed: a name, its number counted from 1, ``-J2``; of joints also ``J2+90``.

    Raises
    ------
    MeasurementError
        No such column.
    """
    return tuple(_parse_column(names, text.strip(), _MOST_DEG if with_zero else 0.0) for text in texts)


def _parse_column(names: Sequence[str], text: str, most_deg: float) -> TypedColumn:
    found = _parse_text(names, text)
    if found is None or abs(found.zero_deg) > most_deg:
        raise MeasurementError(
            make_message("there is no column {text!r}.", text=text),
            remedy=f"Columns are: {', '.join(names)}; or write their numbers, counted from 1.",
        )
    return found


def _parse_text(names: Sequence[str], text: str) -> TypedColumn | None:
    """Return what a text names; several signs and zeros one after the other add up."""
    sign, zero = 1.0, 0.0
    for _ in range(_MOST_MARKS):
        name = find_column(names, text)
        if name:
            return TypedColumn(name, sign, zero)
        match = _ZERO.match(text)
        if match:
            text, zero = match["name"], zero + float(match["zero"])
        elif text.startswith("-"):
            text, sign = text[1:], -sign
        else:
            return None
    return None


def find_column(names: Sequence[str], text: str) -> str:
    """Return the column of a name, with or without its unit, or of a number counted from 1; empty without any."""
    if text in names:
        return text
    without = [name for name in names if without_unit(name) == text]
    if len(without) == 1:
        return without[0]
    number = int(text) if text.isdecimal() and text.isascii() and len(text) < 5 else 0
    return names[number - 1] if 1 <= number <= len(names) else ""


def written_as(names: Sequence[str], name: str) -> str:
    """Return what to type for a column: its name, shorter without its unit, or its number where no name can be."""
    short = without_unit(name)
    texts = [text for text in (name, short) if is_bare(text)] + [name] * is_typable(name)
    for text in (*texts, str(names.index(name) + 1)):
        found = _parse_text(names, f"-{text}+90")
        if found == TypedColumn(name, -1.0, 90.0):
            return text
    return name


def typed_columns(
    names: Sequence[str], columns: Mapping[str, Sequence[str]], joint_count: int
) -> dict[str, tuple[TypedColumn, ...]]:
    """Return the columns that were typed by their meaning.

    Raises
    ------
    MeasurementError
        No such meaning or column, another number of columns than the meaning has, or one of them twice.
    """
    counts = {
        "joints": joint_count,
        "position": 3,
        "length": 1,
        "controller": 3,
        "rotation": None,
        "group": 1,
    }
    found = {}
    for meaning, texts in columns.items():
        if meaning not in counts:
            raise MeasurementError(
                make_message("--columns knows no {meaning!r}.", meaning=meaning),
                remedy=make_message("It knows {meanings}.", meanings=", ".join(sorted(counts))),
            )
        found[meaning] = parse_columns(names, texts, with_zero=meaning == "joints")
        _refuse_wrong_count(names, meaning, found[meaning], counts[meaning])
    return found


def _refuse_wrong_count(
    names: Sequence[str], meaning: str, typed: Sequence[TypedColumn], count: int | None
) -> None:
    columns = [column.name for column in typed]
    twice = next((name for name in columns if columns.count(name) > 1), "")
    if not twice and count in (None, len(columns)):
        return
    says = (
        make_message("{meaning} names column {column!r} twice.", meaning=meaning, column=twice)
        if twice
        else make_message(
            "{meaning} has {found} columns, and needs {count}.",
            meaning=meaning,
            found=len(columns),
            count=count,
        )
    )
    raise MeasurementError(
        says, remedy=f"Columns are: {', '.join(names)}; or write their numbers, counted from 1."
    )
