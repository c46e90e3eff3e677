"""Tables as CSV and XLSX. A number that is read back is the same number; a text is never taken for a formula.

CSV: UTF-8 with a byte order mark, a row of names, a row of units, decimal point, lines ended as RFC 4180 says. Text
that a spreadsheet would take for a formula gets an apostrophe before it, which is how people write text there.
"""

import io
import math
import re
from collections.abc import Sequence
from typing import Any

from cellcal.service.csv_writing import FORMULA_SIGNS, write_rows
from cellcal.service.export.tables import ExportError, ExportTable, Value

BOM = "\ufeff"
CSV_TYPE = "text/csv; charset=utf-8"
XLSX_TYPE = "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet"
DELIMITERS = (",", ";", "\t")
_NOT_IN_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
_MOST_ROWS, _LONGEST_TEXT = 1_048_576, 32_767  # of a sheet, of a cell
_SHEET_NAME = re.compile(r"[\[\]:*?/\\']")


def as_csv(table: ExportTable, delimiter: str = ",") -> str:
    """Return a table as CSV text, without the mark."""
    if delimiter not in DELIMITERS:
        raise ExportError(
            f"{delimiter!r} is no delimiter of a CSV file.", remedy="Use a comma, a semicolon or a tab."
        )
    out = io.StringIO(newline="")
    heads = [
        [_escape_formula(column.name) for column in table.columns],
        [_escape_formula(column.unit) for column in table.columns],
    ]
    write_rows(
        out, [*heads, *([_as_text(value) for value in row] for row in table.rows)], delimiter=delimiter
    )
    return out.getvalue()


def as_csv_file(table: ExportTable, delimiter: str = ",") -> bytes:
    """Return a table as a CSV file with its mark, which tells a spreadsheet that it is UTF-8."""
    return (BOM + as_csv(table, delimiter)).encode("utf-8", errors="replace")


def as_xlsx_file(tables: Sequence[ExportTable]) -> bytes:
    """Return tables as sheets of one XLSX file."""
    from openpyxl import Workbook  # noqa: PLC0415  100 ms that only this format costs

    for table in tables:  # before a sheet is begun: one that is not ended leaves a file behind
        _refuse_what_is_no_fact(table)
        if len(table.rows) + 2 > _MOST_ROWS:
            raise ExportError(
                f"{table.title} has {len(table.rows)} rows, more than a sheet takes.",
                remedy="Export it as CSV.",
            )
    book = Workbook(write_only=True)
    for table in tables:
        sheet = book.create_sheet(_SHEET_NAME.sub(" ", table.title)[:31])
        sheet.freeze_panes = "A3"
        sheet.append([_make_cell(sheet, column.name, bold=True) for column in table.columns])
        sheet.append([_make_cell(sheet, column.unit) for column in table.columns])
        for row in table.rows:
            sheet.append([_make_cell(sheet, value) for value in row])
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def _as_text(value: Value) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return _escape_formula(value) if isinstance(value, str) else _format_number(value)


def _format_number(value: float) -> str:
    if not math.isfinite(value):
        raise ExportError("a number that is not finite is no fact.", remedy="Report this.")
    return repr(value)  # the shortest text that is read back as the same number


def _refuse_what_is_no_fact(table: ExportTable) -> None:
    for row in table.rows:
        for value in row:
            if isinstance(value, float):
                _format_number(value)


def _escape_formula(text: str) -> str:
    return f"'{text}" if text.startswith(FORMULA_SIGNS) else text


def _make_cell(sheet: Any, value: Value, *, bold: bool = False) -> Any:
    from openpyxl.cell import WriteOnlyCell  # noqa: PLC0415  as above
    from openpyxl.styles import Font  # noqa: PLC0415  as above

    if value is None or isinstance(value, bool):
        return WriteOnlyCell(sheet, value)
    text = _clean_text(value) if isinstance(value, str) else _format_number(value)
    cell = WriteOnlyCell(sheet, text)
    # the kind is said, not guessed: "=1+1" is text; and a number keeps all digits, of which openpyxl writes 16
    cell.data_type = "s" if isinstance(value, str) else "n"
    if isinstance(value, str) and value.startswith(FORMULA_SIGNS):
        cell.quotePrefix = True  # it stays text when it is edited
    if bold:
        cell.font = Font(bold=True)
    return cell


def _clean_text(text: str) -> str:
    """Return a text as a sheet can hold it; what it cannot is seen to be missing."""
    readable = _NOT_IN_XML.sub("\ufffd", text)
    return readable if len(readable) <= _LONGEST_TEXT else f"{readable[: _LONGEST_TEXT - 6]} (cut)"
