"""Columns as a person types them: by name or number, with a turned sign or another zero."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.headings import without_unit
from cellcal.service.engineering.measured.table import MeasurementError

_ZERO = re.compile(r"^(?P<name>.+?)(?P<zero>[+-]\d+(?:\.\d+)?)$")
_MOST_DEG = 720.0
_MOST_MARKS = 6


@dataclass(frozen=True, slots=True)
class TypedColumn:
    """A column, what its values are multiplied with, and what is added to a joint."""

    name: str
    sign: float = 1.0
    zero_deg: float = 0.0

    @property
    def is_modified(self) -> bool:
        """Whether it is not taken as it is written."""
        return self.sign < 0 or self.zero_deg != 0.0

    @property
    def typed_text(self) -> str:
        """As one types it."""
        zero = f"{self.zero_deg:+g}" if self.zero_deg else ""
        return f"{'-' if self.sign < 0 else ''}{self.name}{zero}"


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
