"""Numbers as people and instruments write them: one meaning, or a refusal with line and column."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from cellcal.calibration.message import make_message

_NUMBER = re.compile(r"[+-]?([0-9]+([.,][0-9]*)?|[.,][0-9]+)([eE][+-]?[0-9]+)?")
_UNIT_AT_END = re.compile(r"[\[(]\s*(\S+?)\s*[\])]\s*$|_([A-Za-zµ]+)$")
_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "in": 0.0254, "inch": 0.0254}
_OTHER_UNITS = frozenset({"deg", "rad", "°"})
_LARGEST = 1e9

Column = int | str


class TextError(ValueError):
    """The text has no meaning here; the sentence says where and why."""


@dataclass(frozen=True, slots=True)
class ColumnLayout:
    """The columns of the numbers, and their unit of length."""

    columns: tuple[Column, ...]  # names of the heading, or places counted from 1
    unit: str
    separator: str = ""  # empty: found out, where only one way gives numbers
    heading_lines: int = 0  # to leave out where columns are counted; names find their own heading

    @property
    def by_name(self) -> bool:
        """Whether the file must have a heading."""
        return any(isinstance(column, str) for column in self.columns)


@dataclass(frozen=True, slots=True)
class TextRow:
    """The numbers of one reading, in the unit of the source, and where they stand."""

    values: tuple[float, ...]
    line: int  # counted from 1; 0 when typed
    text: str


def metres_per(unit: str) -> float:
    """Return metres in one unit; raise KeyError for an unknown one."""
    return _METRES[unit]


def parse_number(cell: str) -> float:
    """Return the number in a cell; a comma is a decimal mark. Raise TextError for anything else."""
    plain = cell.strip().strip('"').strip().replace("\N{MINUS SIGN}", "-")
    if not _NUMBER.fullmatch(plain):
        raise TextError(
            make_message(
                "{cell!r} is not a number (thousands are written without a mark)", cell=cell.strip()[:40]
            )
        )
    value = float(plain.replace(",", "."))
    if abs(value) > _LARGEST:
        raise TextError(make_message("{cell!r} is too large to be a reading", cell=cell.strip()[:40]))
    return value


def parse_typed(line: str, count: int) -> tuple[float, ...]:
    """Return the numbers that a person typed, between blanks, tabs or semicolons; a comma is a decimal mark."""
    cells = [cell for cell in re.split(r"[;\s]+", line.strip()) if cell]
    if len(cells) != count:
        raise TextError(
            make_message(
                "{found} numbers instead of {count}; write blanks between them", found=len(cells), count=count
            )
        )
    return tuple(parse_number(cell) for cell in cells)


def rows_of(text: str, layout: ColumnLayout) -> list[TextRow]:
    """Return the readings of a table. Lines that are empty or begin with # count as lines, not as rows.

    Raises
    ------
    TextError
        No heading with the names asked for, a heading with another unit, or a cell that is no number.
    """
    rows: list[TextRow] = []
    places = None if layout.by_name else [int(column) - 1 for column in layout.columns]
    lines = [(at, line) for at, line in enumerate(text.splitlines(), start=1) if _is_counted(line)]
    for at, line in lines[0 if layout.by_name else layout.heading_lines :]:
        if places is None:
            places = _find_columns(line, layout)
        elif rows or not _is_units(line, places, layout):
            rows.append(TextRow(_read_values(line, at, places, layout), at, line.strip()))
    if places is None and lines:
        names = ", ".join(str(column) for column in layout.columns)
        raise TextError(make_message("no line names the columns {names}", names=names))
    return rows


def _is_counted(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _find_columns(line: str, layout: ColumnLayout) -> list[int] | None:
    """Return where the named columns are, when this line is the heading."""
    for separator in _possible_separators(layout, line):
        cells = [cell.strip().strip('"') for cell in _split_cells(line, separator)]
        plain = [_UNIT_AT_END.sub("", cell).strip().lower() for cell in cells]
        try:
            places = [_find_column(column, cells, plain) for column in layout.columns]
        except ValueError:
            continue
        for place in places[:3]:
            _check_unit(cells[place], layout.unit)
        return places
    return None


def _find_column(column: Column, cells: Sequence[str], plain: Sequence[str]) -> int:
    if isinstance(column, int):
        return column - 1
    return list(cells).index(column) if column in cells else list(plain).index(column.lower())


def _check_unit(cell: str, unit: str) -> None:
    found = _UNIT_AT_END.search(cell)
    heading_unit = "" if found is None else (found.group(1) or found.group(2)).lower()
    if heading_unit in _METRES and _METRES[heading_unit] != _METRES[unit]:
        raise TextError(
            make_message("the heading says {cell!r}, cell.toml says {unit}", cell=cell, unit=unit)
        )


def _is_units(line: str, places: Sequence[int], layout: ColumnLayout) -> bool:
    """Return whether this line below a heading names the unit of each column, and hold it against the cell file."""
    if not layout.by_name:
        return False
    cells = [cell.strip(' "[]()') for cell in _split_cells(line, _possible_separators(layout, line)[0])]
    words = [cells[place].lower() if place < len(cells) else "" for place in places]
    if not all(word in _METRES or word in _OTHER_UNITS for word in words):
        return False
    for word in words[:3]:
        _check_unit(f"[{word}]", layout.unit)
    return True


def _read_values(line: str, at: int, places: Sequence[int], layout: ColumnLayout) -> tuple[float, ...]:
    found: dict[tuple[float, ...], str] = {}
    faults: list[str] = []
    for separator in _possible_separators(layout, line):
        cells = _split_cells(line, separator)
        try:
            found[_read_numbers(cells, places)] = separator
        except TextError as fault:
            faults.append(str(fault))
    if len(found) > 1:
        raise TextError(
            make_message(
                "line {at}: it can be read in two ways; name the separator in cell.toml: {line!r}",
                at=at,
                line=line.strip()[:60],
            )
        )
    if not found:
        raise TextError(make_message("line {at}, {fault}", at=at, fault=faults[0]))
    return next(iter(found))


def _read_numbers(cells: Sequence[str], places: Sequence[int]) -> tuple[float, ...]:
    values = []
    for place in places:
        if place >= len(cells):
            raise TextError(
                make_message(
                    "column {column}: there are only {count} columns", column=place + 1, count=len(cells)
                )
            )
        try:
            values.append(parse_number(cells[place]))
        except TextError as fault:
            raise TextError(make_message("column {column}: {fault}", column=place + 1, fault=fault)) from None
    return tuple(values)


def _possible_separators(layout: ColumnLayout, line: str) -> tuple[str, ...]:
    if layout.separator:
        return (layout.separator,)
    for sure in (";", "\t"):
        if sure in line:
            return (sure,)
    return (",", " ")


def _split_cells(line: str, separator: str) -> list[str]:
    return line.split() if separator == " " else line.split(separator)
