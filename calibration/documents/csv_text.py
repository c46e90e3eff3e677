"""Separated values within limits: length of a cell, number of cells."""

import csv
import io
from collections.abc import Iterable

from cellcal.calibration.documents.errors import DocumentError

_MOST_CELLS = 20_000_000


def split_row(line: str, delimiter: str = ",") -> list[str]:
    """Return the cells of one line; a quotation mark that is never closed ends with the line.

    Raises
    ------
    DocumentError
        A cell is longer than any.
    """
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error as error:
        raise _table_error(str(error)) from error


def parse_rows(lines: str | Iterable[str], delimiter: str = ",") -> list[dict[str, str]]:
    """Return the rows below a row of names; cells that have no name are left out, missing ones are empty.

    Raises
    ------
    DocumentError
        A cell is longer than any, or a row is never ended.
    """
    source = io.StringIO(lines.removeprefix("\ufeff"), newline="") if isinstance(lines, str) else lines
    rows: list[dict[str, str]] = []
    cells = 0
    try:
        reader = csv.DictReader(source, delimiter=delimiter, restkey="", restval="")
        for row in reader:
            row.pop("", None)
            rows.append(row)
            cells += len(row)
            if cells > _MOST_CELLS:
                raise _table_error(f"it holds more than {_MOST_CELLS} cells")
    except csv.Error as error:
        raise _table_error(str(error)) from error
    return rows


def _table_error(why: str) -> DocumentError:
    return DocumentError(f"it is no table of separated values: {why}.", remedy="Export the table again.")
