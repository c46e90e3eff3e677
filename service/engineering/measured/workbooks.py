"""Excel workbooks as people keep them: which sheet is read, and what in it the eye or the library does not see."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from cellcal.calibration.documents.zip_archives import open_zip
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.cell_numbers import parse_lone_cell
from cellcal.service.engineering.measured.errors import MeasurementError

Cells = list[float | str]
FEWEST_COLUMNS = 3
ZIP_BEGINS, OLD_BEGINS = b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_LOOK_AHEAD = 2000  # rows of a sheet that is not read, to see whether it holds numbers
_MOST_CELLS = 5_000_000
_VISIBLE = "visible"
_ROW = re.compile(rb"<row\b([^>]*)>")
_HIDDEN = re.compile(rb"""\shidden=["'](?:1|true)["']""")
_NUMBER = re.compile(rb"""\sr=["'](\d{1,7})["']""")
# A cell with a formula and no value: a program wrote the file, and no spreadsheet program has computed it since.
_UNCALCULATED = re.compile(
    rb"<c\b([^>]*)>\s*<f\b(?:[^>]*/>|[^>]*>[^<]*</f>)\s*(?:<v\s*/>|<v>\s*</v>)?\s*</c>"
)
_PLACE = re.compile(rb"""\sr=["']([A-Z]{1,3})(\d{1,7})["']""")
_TEXT_CELL = re.compile(rb"""\st=["']str["']""")  # its value may be an empty text


@dataclass(frozen=True, slots=True)
class WorkbookSheet:
    """The cells of one sheet, its first row first."""

    name: str
    rows: list[Cells]
    dialect: str  # for people: which sheet, and what they may not expect of it
    uncalculated: dict[int, int]  # column from 0: the first row, from 1, with a formula that has no value
    others: tuple[str, ...] = ()  # sheets with numbers, too


def holds_table(rows: Sequence[Cells]) -> bool:
    """Return whether at least two rows have numbers enough for a posture and a reading."""
    return sum(sum(isinstance(c, float) for c in row) >= FEWEST_COLUMNS for row in rows) >= 2


def read_workbook(path: Path, content: bytes, sheet: str | None) -> WorkbookSheet:
    """Read the named sheet of a workbook, or the first one with a table; hidden ones come last.

    Raises
    ------
    MeasurementError
        No workbook that can be read, no such sheet, no table in it, or more cells than are read.
    """
    if content.startswith(OLD_BEGINS):
        raise MeasurementError(
            make_message("{path} is of the old Excel format (.xls), or protected by a password.", path=path),
            remedy="Save it as .xlsx without a password, or as CSV.",
        )
    book = _open_workbook(path, content)
    try:
        sheets = {one.title: one for one in book.worksheets}
        if not sheets:
            raise MeasurementError(
                make_message("{path} has no sheet that can be read.", path=path),
                remedy="Save it as an Excel workbook (.xlsx), not as Strict Open XML; or as CSV.",
            )
        if sheet is not None and sheet not in sheets:
            raise MeasurementError(
                make_message("{path} has no sheet {sheet!r}.", path=path, sheet=sheet),
                remedy=make_message("Sheets: {sheetnames}.", sheetnames=", ".join(sheets)),
            )
        ordered = sorted(sheets, key=lambda name: sheets[name].sheet_state != _VISIBLE)
        for at, name in enumerate(ordered if sheet is None else [sheet]):
            rows = _sheet_rows(path, sheets[name])
            if holds_table(rows):
                visible = [one for one in ordered[at + 1 :] if sheets[one].sheet_state == _VISIBLE]
                others = [] if sheet is not None else [one for one in visible if _is_table(path, sheets[one])]
                return _with_warnings(path, sheets[name], rows, others)
    finally:
        book.close()
    raise MeasurementError(
        make_message("{path} holds no table of numbers.", path=path), remedy="Name the sheet with `--sheet`."
    )


def _open_workbook(path: Path, content: bytes) -> Any:
    import warnings  # noqa: PLC0415  # openpyxl takes 100 ms that a CSV file need not pay

    from openpyxl import load_workbook  # noqa: PLC0415

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about styles and validations, which hold no measurement
        try:
            return load_workbook(open_zip(content), read_only=True, data_only=True)
        except Exception as error:  # the library raises what its parts happen to raise
            raise _no_workbook(path) from error


def _no_workbook(path: Path) -> MeasurementError:
    return MeasurementError(make_message("{path} is no Excel file.", path=path), remedy="Save it as CSV.")


def _is_table(path: Path, sheet: Any) -> bool:
    return holds_table(_sheet_rows(path, sheet, most_rows=_LOOK_AHEAD))


def _sheet_rows(path: Path, sheet: Any, *, most_rows: int | None = None) -> list[Cells]:
    """Return the cells of a sheet as far as it has any; what it says of its own size is not believed."""
    rows: list[Cells] = []
    count = 0
    try:
        sheet.reset_dimensions()
        for row in islice(sheet.iter_rows(values_only=True), most_rows):
            rows.append([_cell_value(value) for value in row])
            count += len(row)
            if count > _MOST_CELLS:
                break
    except Exception as error:  # the library raises what its parts happen to raise
        raise _no_workbook(path) from error
    if count > _MOST_CELLS:
        raise MeasurementError(
            make_message(
                "{path} has more than {most_excel_cells} cells.", path=path, most_excel_cells=_MOST_CELLS
            ),
            remedy="Save it as CSV.",
        )
    return rows


def _cell_value(value: object) -> float | str:
    if value is None or isinstance(value, bool):
        return "" if value is None else str(value)
    if isinstance(value, int | float):
        return float(value) if math.isfinite(value) else str(value)
    return parse_lone_cell(str(value))


def _with_warnings(path: Path, sheet: Any, rows: list[Cells], others: Sequence[str]) -> WorkbookSheet:
    try:
        with sheet._get_source() as source:  # noqa: SLF001  # the library passes neither of the two on
            xml = source.read()
    except Exception as error:  # the library raises what its parts happen to raise
        raise _no_workbook(path) from error
    words = [make_message("Excel sheet {sheet!r}", sheet=sheet.title)]
    if sheet.sheet_state != _VISIBLE:
        words.append(make_message("which is hidden"))
    if hidden := _count_hidden(xml, rows):
        words.append(
            make_message("its {count} hidden rows with numbers are read like all others", count=hidden)
        )
    if others:
        names = ", ".join(map(repr, others))
        words.append(make_message("not read: {names}, with numbers, too (`--sheet`)", names=names))
    return WorkbookSheet(sheet.title, rows, "; ".join(words), _uncalculated_columns(xml), tuple(others))


def _count_hidden(xml: bytes, rows: Sequence[Cells]) -> int:
    """Return how many hidden rows hold numbers: rows that a filter hides take part, which its user may not expect."""
    found = 0
    for row in _ROW.finditer(xml):
        number = _NUMBER.search(row[1])
        if number and _HIDDEN.search(row[1]) and int(number[1]) <= len(rows):
            found += sum(isinstance(cell, float) for cell in rows[int(number[1]) - 1]) >= FEWEST_COLUMNS
    return found


def _uncalculated_columns(xml: bytes) -> dict[int, int]:
    found: dict[int, int] = {}
    for cell in _UNCALCULATED.finditer(xml):
        place = _PLACE.search(cell[1])
        if place and not _TEXT_CELL.search(cell[1]):
            column = 0
            for letter in place[1]:
                column = column * 26 + letter - ord("A") + 1
            found.setdefault(column - 1, int(place[2]))
    return found
