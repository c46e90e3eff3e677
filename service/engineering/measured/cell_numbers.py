"""Numbers in the cells of a table: with a decimal comma, marks of thousands, and a unit behind them."""

import math
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.headings import unit_named, unit_of

_PLAIN = re.compile(r"[+-]?[0-9]+(?:\.[0-9]*)?(?:[eE][+-]?[0-9]+)?")
_GROUP_MARKS = re.compile("[ \u00a0\u2009\u202f'\u2019]")
_GROUPED = re.compile("^[+-]?\\d{1,3}([ \u00a0\u2009\u202f'\u2019]\\d{3})+([.,]\\d+)?$")
_THOUSANDS = re.compile(r"^[+-]?\d{1,3}(,\d{3})+\.\d+$")  # without a point, a comma is a decimal mark
_POINT_THOUSANDS = re.compile(r"^[+-]?\d{1,3}(\.\d{3})+,\d+$")
_MAYBE_THOUSANDS = re.compile(r"^[+-]?[1-9]\d{0,2}[.,]\d{3}$")
_WITH_UNIT = re.compile(
    r"(?P<number>[+-]?[\d.,][^A-Za-z\u00b0\u00ba\u2103\u2109\u00b5\u03bc\u3040-\uffff]*?(?:[eE][+-]?\d+)?)\s*"
    r"(?P<unit>[^\d\s.,+-]\D{0,15})"
)
_D_EXPONENT = re.compile(
    r"(?P<digits>[+-]?(?:\d+[.,]\d*|[.,]\d+))[dD](?P<power>[+-]?\d{1,3})"
)  # as Fortran prints
_SEXAGESIMAL = re.compile(
    r"(?P<sign>[+-]?)(?P<degrees>\d{1,3})\s*[\u00b0\u00ba]\s*(?:(?P<parts>[0-5]?\d[.,]\d+)\s*['\u2032\u2019]"
    r"|(?P<minutes>[0-5]?\d)\s*['\u2032\u2019]\s*(?:(?P<seconds>[0-5]?\d(?:[.,]\d+)?)\s*(?:\"|\u2033|\u201d|'')?)?)"
)
_TEMPERATURES = {"°c": "°C", "℃": "°C", "degc": "°C", "°f": "°F", "℉": "°F", "degf": "°F"}
_MARKS = frozenset(
    "'\"\u2032\u2033\u201d"
)  # feet and inches, minutes and seconds of arc: nothing tells which
_LARGE_WHOLE = 100.0
_SHOWN = 40  # characters of a cell

COMMA, POINT = "comma", "point"  # the decimal mark for certain
MAYBE_COMMA, MAYBE_POINT = "comma or thousands", "point or thousands"  # 1,234 and 1.234


class WrittenNumber(float):
    """A number of a cell that says more than its value: a unit, or which decimal mark its file has."""

    __slots__ = ("mark", "text", "unit")
    text: str
    unit: str  # one spelling, or empty
    mark: str  # COMMA, POINT, MAYBE_COMMA, MAYBE_POINT, or empty

    @classmethod
    def of(cls, value: float, text: str, unit: str = "", mark: str = "") -> "WrittenNumber":
        """Return a number with what stood in its cell."""
        found = cls(value)
        found.text, found.unit, found.mark = text, unit, mark
        return found


def parse_cell(text: str, *, comma: bool) -> float | str:
    """Return the finite number in a cell, or its text; ``comma`` says that a comma is the decimal mark."""
    cleaned = text.strip().strip('"').strip()
    if not comma and _PLAIN.fullmatch(cleaned) and math.isfinite(value := float(cleaned)):
        return value  # most cells of most files: nothing below changes them
    if any(
        "\uff0b" <= sign <= "\uff19" for sign in cleaned
    ):  # as a Chinese or Japanese keyboard writes digits
        cleaned = unicodedata.normalize("NFKC", cleaned)
    number = cleaned.replace("\u2212", "-")
    plain = _plain_number(number, cleaned, comma=comma)
    if plain is not None:
        return plain
    angle = _read_angle(number, cleaned)
    quantity = _read_with_unit(number, cleaned, comma=comma) if angle is None else angle
    return cleaned if quantity is None else quantity


def parse_lone_cell(text: str) -> float | str:
    """Return the number in a cell of a file without one decimal mark, such as a sheet; else its text."""
    if text.rfind(",") > text.rfind("."):
        return parse_cell(text, comma=True)
    value = parse_cell(text, comma=False)
    if isinstance(value, str) or not re.search(r"\.\d", text):
        return value
    # A number with thousands and a fraction, 1,234.5, has its decimal mark for certain.
    digits = re.match(r"[+-]?[\d.,]*", text.strip().strip('"').strip().replace("\u2212", "-"))
    mark = MAYBE_POINT if digits and _MAYBE_THOUSANDS.match(digits[0]) else POINT
    return WrittenNumber.of(float(value), text, value.unit if isinstance(value, WrittenNumber) else "", mark)


def _read_angle(number: str, cell: str) -> WrittenNumber | None:
    """Return an angle in degrees, minutes and seconds [deg]."""
    angle = _SEXAGESIMAL.fullmatch(number)
    if angle is None:
        return None
    seconds = float((angle["seconds"] or "0").replace(",", "."))
    minutes = float((angle["parts"] or angle["minutes"]).replace(",", "."))
    size = int(angle["degrees"]) + minutes / 60.0 + seconds / 3600.0
    return WrittenNumber.of(-size if angle["sign"] == "-" else size, cell, "deg")


def _read_with_unit(number: str, cell: str, *, comma: bool) -> WrittenNumber | None:
    match = _WITH_UNIT.fullmatch(number) if number[:1] in "+-.,0123456789" else None
    unit = _unit_behind(match["unit"]) if match else ""
    if not unit or match is None:
        return None
    value = _plain_number(match["number"].strip(), cell, comma=comma)
    if value is None:
        return None
    return WrittenNumber.of(value, cell, unit, value.mark if isinstance(value, WrittenNumber) else "")


def _unit_behind(text: str) -> str:
    word = text.strip().strip("[]()").strip()
    if not word or _MARKS & set(word):
        return ""
    return unit_named(word) or _TEMPERATURES.get(word.lower(), "")


def _plain_number(number: str, cell: str, *, comma: bool) -> float | None:
    """Return the number of a text without a unit; None for what is none."""
    if number[:1].isalpha() or "_" in number:  # float() would take nan, infinity and 1_000
        return None
    if _GROUPED.match(number):
        number = _GROUP_MARKS.sub("", number)
    if exponent := _D_EXPONENT.fullmatch(number):
        number = f"{exponent['digits']}e{exponent['power']}"
    number, mark = _with_decimal_point(number) if comma else (_without_thousands(number), "")
    try:
        value = float(number)
    except ValueError:
        return None
    if not math.isfinite(value):
        return None
    return WrittenNumber.of(value, cell, "", mark) if mark else value


def _without_thousands(number: str) -> str:
    return number.replace(",", "") if _THOUSANDS.match(number) else number


def _with_decimal_point(number: str) -> tuple[str, str]:
    """Return a number of a file with decimal commas as Python writes it, and its mark; no number if it has both."""
    if "," not in number:
        mark = MAYBE_POINT if _MAYBE_THOUSANDS.match(number) else POINT
        return number, mark if "." in number else ""
    if _POINT_THOUSANDS.match(number):
        number = number.replace(".", "")
    if "." in number:
        return "", ""  # 1,234.5
    return number.replace(",", "."), MAYBE_COMMA if _MAYBE_THOUSANDS.match(number) else COMMA


def number_in(text: str, unit: str, units: Mapping[str, float]) -> float:
    """Return the number of a cell in a unit; a cell without a unit is in this one.

    Raises
    ------
    ValueError
        It is no finite number, or one in a unit of another kind; the sentence quotes the cell.
    """
    value = parse_cell(text, comma=False)
    if isinstance(value, str):
        raise ValueError(make_message("{cell!r} cannot be read as a number", cell=text.strip()[:_SHOWN]))
    stated = value.unit if isinstance(value, WrittenNumber) else ""
    if not stated or stated == unit:
        return float(value)
    if stated not in units or unit not in units:
        raise ValueError(make_message("{cell!r} is not in {unit}", cell=text.strip()[:_SHOWN], unit=unit))
    return float(value) * units[stated] / units[unit]


@dataclass
class ColumnMarks:
    """The signs of units and of the decimal mark in the cells of a table's columns."""

    units: dict[int, dict[str, tuple[int, str]]] = field(
        default_factory=dict
    )  # column: unit: first line and text
    marks: dict[int, dict[str, tuple[int, str]]] = field(default_factory=dict)
    with_unit: dict[int, set[int]] = field(default_factory=dict)  # column: rows
    fractions: dict[int, tuple[int, str]] = field(
        default_factory=dict
    )  # column: the first fraction that no text wrote: a number of a sheet

    grouped: set[int] = field(default_factory=set)  # columns with both marks in a cell: one is of thousands

    def note_cell(self, at: int, row: int, line: int, cell: WrittenNumber) -> None:
        """Note what a cell of a column says beside its number."""
        if cell.unit:
            self.units.setdefault(at, {}).setdefault(cell.unit, (line, cell.text))
            self.with_unit.setdefault(at, set()).add(row)
        if cell.mark:
            self.marks.setdefault(at, {}).setdefault(cell.mark, (line, cell.text))
            if "," in cell.text and "." in cell.text:
                self.grouped.add(at)

    def note_number(self, at: int, line: int, number: float) -> None:
        """Note a number without a text; the first fraction of a column is of use."""
        if at not in self.fractions and not number.is_integer():
            self.fractions[at] = (line, f"{number:g}")

    def names_with_units(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of columns; one whose cells have a unit is named with it, if its heading has none."""
        found = list(names)
        for at, units in self.units.items():
            if len(units) == 1 and not unit_of(found[at]):
                found[at] = f"{found[at]} [{next(iter(units))}]"
        return tuple(found)

    def doubts(self, names: Sequence[str], numbers: Array, lines: Rows) -> Mapping[int, str]:
        """Return the columns whose numbers have no one meaning, and the cells that say so."""
        found: dict[int, str] = {}
        for at in range(len(names)):
            why = (
                self._unit_doubt(at, names[at], numbers[:, at], lines)
                or self._mark_doubt(at, names[at], numbers[:, at], lines)
                or self._file_doubt(at, names)
            )
            if why:
                found[at] = why
        return found

    def _unit_doubt(self, at: int, name: str, values: Array, lines: Rows) -> str:
        units = list(self.units.get(at, {}).items())
        if not units:
            return ""
        (first, (line, text)), *rest = units
        if rest:
            other_line, other = rest[0][1]
            return _two_cells(name, (line, text), (other_line, other), make_message("their units differ"))
        stated = unit_of(name)
        if stated and stated != first:
            return make_message(
                "column {column!r} holds {cell!r} in line {line}, and its heading says {unit}",
                column=name,
                cell=text,
                line=line,
                unit=stated,
            )
        bare = np.isfinite(values)
        bare[list(self.with_unit[at])] = False
        if bare.any() and first not in _TEMPERATURES.values():
            row = int(np.argmax(bare))
            return _two_cells(
                name,
                (line, text),
                (int(lines[row]), f"{values[row]:g}"),
                make_message("one of them has no unit"),
            )
        return ""

    def _mark_doubt(self, at: int, name: str, values: Array, lines: Rows) -> str:
        """Return what the cells of one column say against each other's decimal mark."""
        marks = self.marks.get(at, {})
        commas = marks.get(COMMA) or marks.get(MAYBE_COMMA)
        if commas is None:
            return ""
        points = marks.get(POINT) or marks.get(MAYBE_POINT)
        if points is not None:
            why = make_message("a comma and a point cannot both be the decimal mark")
            return _two_cells(name, commas, points, why)
        if COMMA in marks:
            return ""
        why = make_message("the comma may be a mark of thousands")
        if at in self.fractions:
            return _two_cells(name, commas, self.fractions[at], why)
        whole = np.isfinite(values) & (values == np.round(values)) & (np.abs(values) >= _LARGE_WHOLE)
        if whole.any():
            row = int(np.argmax(whole))
            return _two_cells(name, commas, (int(lines[row]), f"{values[row]:g}"), why)
        return ""

    def _file_doubt(self, at: int, names: Sequence[str]) -> str:
        """Return what other columns say against the decimal mark of one whose cells all may have thousands.

        A file has one decimal mark: where it is the comma, 1.234 may be 1234, and where it is the point, 1,234 may be
        1234.
        """
        marks = self.marks.get(at, {})
        if MAYBE_POINT in marks and POINT not in marks:
            cell, other = marks[MAYBE_POINT], self._first_against(POINT, COMMA)
            if other is None and self._first_with(POINT) is None:
                other = self._first_with(MAYBE_COMMA)
            why = make_message("the point may be a mark of thousands")
        elif MAYBE_COMMA in marks and COMMA not in marks:
            cell, other = marks[MAYBE_COMMA], self._first_against(COMMA, POINT)
            if other is None and self._first_with(COMMA) is None:
                other = self._first_with(MAYBE_POINT) or next(iter(self.fractions.items()), None)
            why = make_message("the comma may be a mark of thousands")
        else:
            return ""
        if other is None:
            return ""
        return make_message(
            "column {column!r} holds {cell!r} in line {line}, and column {other_column!r} holds {other!r} in line "
            "{other_line}: {why}",
            column=names[at],
            cell=cell[1],
            line=cell[0],
            other_column=names[other[0]],
            other=other[1][1],
            other_line=other[1][0],
            why=why,
        )

    def _first_against(self, mark: str, other: str) -> tuple[int, tuple[int, str]] | None:
        """Return the first column that certainly has the other decimal mark, if it counts.

        A single one among several with this mark, such as names 1.1 and 1.2 in a file of decimal commas, does not,
        unless its cells have both marks.
        """
        others = [at for at, marks in self.marks.items() if other in marks]
        alike = [at for at, marks in self.marks.items() if mark in marks]
        if len(others) == 1 and len(alike) > 1 and others[0] not in self.grouped:
            return None
        return self._first_with(other)

    def _first_with(self, mark: str) -> tuple[int, tuple[int, str]] | None:
        """Return the first column with a cell of a mark, and that cell."""
        return next(((at, marks[mark]) for at, marks in sorted(self.marks.items()) if mark in marks), None)


def _two_cells(name: str, first: tuple[int, str], second: tuple[int, str], why: str) -> str:
    return make_message(
        "column {column!r} holds {cell!r} in line {line} and {other!r} in line {other_line}: {why}",
        column=name,
        cell=first[1],
        line=first[0],
        other=second[1],
        other_line=second[0],
        why=why,
    )
