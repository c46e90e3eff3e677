"""A table as instruments write it: separators, decimal commas, preambles and units are found out."""

import io
import math
import re
from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.csv_text import split_row
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.documents.zip_archives import open_zip
from cellcal.calibration.errors import CellError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.encodings import encoding_of
from cellcal.service.engineering.measured.table_heads import (
    doubled_name,
    heading_names,
    is_remark,
    names_without_heading,
)
from cellcal.service.files import missing_file_words

_SEPARATORS = (";", "\t", ",", "|", " ")
_LOOK_AHEAD = 200  # lines, to find separator and decimal mark
_HEAD = 2000  # lines, to find the column names
_FEWEST_COLUMNS = 3
_GROUP_MARKS = re.compile("[ \u2009\u202f'\u2019]")
_GROUPED = re.compile(r"^[+-]?\d{1,3}([ \u2009\u202f'\u2019]\d{3})+([.,]\d+)?$")
_THOUSANDS = re.compile(r"^[+-]?\d{1,3}(,\d{3})+\.\d+$")  # without a point, a comma is a decimal mark
_UNIT_APART = re.compile(r"[ \t]+([\[(][^\s\])]*[\])])")  # J1 [deg] is one name between blanks
_EXCEL = {".xlsx", ".xlsm"}


class MeasurementError(CellError):
    """A file of measurements cannot be understood; the remedy names the option that helps."""

    code = "measurements"


@dataclass(frozen=True, eq=False)
class MeasurementTable:
    """Names and cells; a cell is a number, or the text that is not one. Rows may have been ragged."""

    names: tuple[str, ...]
    numbers: Array  # (N, k): not a number where there is a text, or nothing
    texts: Mapping[tuple[int, int], str]
    lines: Rows  # (N,) of the file, counted from one
    dialect: str  # for people
    has_heading: bool = True  # else the names are numbers of columns, or from a remark

    def __len__(self) -> int:
        return len(self.lines)

    def column_values(self, name: str) -> Array:
        """Return the numbers of a column."""
        found: Array = self.numbers[:, self.names.index(name)]
        return found

    def column_texts(self, name: str) -> list[str]:
        """Return the cells of a column as text."""
        at = self.names.index(name)
        return [
            self.texts.get((row, at), "" if math.isnan(number) else str(number))
            for row, number in enumerate(self.numbers[:, at].tolist())
        ]


def read_table(path: Path, *, sheet: str | None = None) -> MeasurementTable:
    """Read a CSV file or the first usable sheet of an Excel file.

    Raises
    ------
    MeasurementError
        No such file, no table of numbers in it, no header, or names that occur twice.
    """
    if not path.is_file():
        why, remedy = missing_file_words(path)
        raise MeasurementError(why, remedy=remedy)
    if path.suffix.lower() in _EXCEL:
        return _read_excel(path, sheet)
    try:
        return _read_text(path)
    except DocumentError as error:
        raise MeasurementError(
            make_message("{path}: {why}", path=path, why=error.why),
            remedy=error.remedy,
        ) from error


def _read_text(path: Path) -> MeasurementTable:
    content = read_plain_bytes(path)
    lines = io.StringIO(content.decode(encoding_of(content), errors="replace"), newline=None)
    separator, comma = _detect_dialect(
        list(islice((line for line in lines if line.strip() and not is_remark([line])), _LOOK_AHEAD))
    )
    lines.seek(0)
    mark = {"\t": "tab", " ": "blanks"}.get(separator, repr(separator))
    cells = ([_parse_cell(cell, comma) for cell in _split_line(line, separator)] for line in lines)
    return _build_table(
        path,
        cells,
        make_message("separated by {mark}, decimal comma", mark=mark)
        if comma
        else make_message("separated by {mark}, decimal point", mark=mark),
    )


_LONGEST_LINE, _MOST_EXCEL_CELLS = 200_000, 5_000_000


def _split_line(line: str, separator: str) -> list[str]:
    if separator == " ":
        return _UNIT_APART.sub(r"\1", line).split()
    # One line, one row: a quotation mark that is never closed must not swallow the rest of the file.
    if len(line) > _LONGEST_LINE:
        raise DocumentError("a line in it is longer than any of a table.", remedy="Export the table again.")
    return split_row(line.rstrip("\r\n"), separator)


def _detect_dialect(lines: Sequence[str]) -> tuple[str, bool]:
    """Return separator and whether the decimal mark is a comma: those that make most numbers of most rows."""
    best: tuple[float, str, bool] = (0.0, ",", False)
    for separator in _SEPARATORS:
        for comma in (False, True):
            if separator == "," and comma:
                continue
            counts = [
                sum(isinstance(_parse_cell(cell, comma), float) for cell in _split_line(line, separator))
                for line in lines
            ]
            common, often = (
                Counter(count for count in counts if count >= _FEWEST_COLUMNS).most_common(1)[0]
                if any(count >= _FEWEST_COLUMNS for count in counts)
                else (0, 0)
            )
            score = float(common * often)
            if score > best[0]:
                best = (score, separator, comma)
    return best[1], best[2]


def _parse_cell(text: str, comma: bool) -> float | str:
    cleaned = text.strip().strip('"').strip()
    number = cleaned.replace("\u2212", "-").replace("\u00a0", "")
    if _GROUPED.match(number):
        number = _GROUP_MARKS.sub("", number)
    if comma:
        number = number.replace(".", "").replace(",", ".") if "," in number else number
    elif _THOUSANDS.match(number):
        number = number.replace(",", "")
    if number[:1].isalpha() or "_" in number:  # float() would take nan, infinity and 1_000
        return cleaned
    try:
        value = float(number)
    except ValueError:
        return cleaned
    return value if math.isfinite(value) else cleaned


def _build_table(path: Path, cells: Iterable[list[float | str]], dialect: str) -> MeasurementTable:
    rows = iter(cells)
    head = list(islice(rows, _HEAD))
    counts = [0 if is_remark(row) else sum(isinstance(cell, float) for cell in row) for row in head]
    widths = Counter(count for count in counts if count >= _FEWEST_COLUMNS)
    if not widths:
        raise MeasurementError(
            make_message("{path} holds no table of numbers.", path=path),
            remedy="A file of measurements has one row a posture: joints, and what the device read.",
        )
    usual = widths.most_common(1)[0][0]
    first = next(i for i, count in enumerate(counts) if count >= max(_FEWEST_COLUMNS, 0.5 * usual))
    names = heading_names(head[:first], _filled_width(head[first]))
    has_heading = names is not None
    if names is None:
        remarks = [",".join(str(cell) for cell in row) for row in head[:first]]
        names = names_without_heading(head[first][: _filled_width(head[first])], remarks)
    if twice := doubled_name(names):
        raise MeasurementError(
            make_message("{path}: the column name {twice!r} occurs twice.", path=path, twice=twice),
            remedy="Rename one of them.",
        )
    numbers, texts, lines = array("d"), dict[tuple[int, int], str](), array("q")
    for line, row in enumerate(chain(head[first:], rows), start=first + 1):
        if not any(cell != "" for cell in row) or is_remark(row):
            continue
        padded = [*row[: len(names)], *[""] * (len(names) - len(row))]
        for at, cell in enumerate(padded):
            if isinstance(cell, str) and cell:
                texts[len(lines), at] = cell
        numbers.extend(cell if isinstance(cell, float) else math.nan for cell in padded)
        lines.append(line)
    shaped = np.frombuffer(numbers, dtype=float).reshape(-1, len(names))
    return MeasurementTable(names, shaped, texts, np.frombuffer(lines, dtype=np.int64), dialect, has_heading)


def _filled_width(row: list[float | str]) -> int:
    """Return how many cells of a row hold something; separators at its end make no columns."""
    return max((at + 1 for at, cell in enumerate(row) if cell != ""), default=0)


def _read_excel(path: Path, sheet: str | None) -> MeasurementTable:
    import warnings  # noqa: PLC0415  # openpyxl takes 100 ms that a CSV file need not pay

    from openpyxl import load_workbook  # noqa: PLC0415

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about styles and validations, which hold no measurement
        try:
            book = load_workbook(open_zip(read_plain_bytes(path)), read_only=True, data_only=True)
        except Exception as error:  # the library raises what its parts happen to raise
            raise MeasurementError(
                make_message("{path} is no Excel file.", path=path), remedy="Save it as CSV."
            ) from error
    try:
        if sheet is not None and sheet not in book.sheetnames:
            raise MeasurementError(
                make_message("{path} has no sheet {sheet!r}.", path=path, sheet=sheet),
                remedy=make_message("Sheets: {sheetnames}.", sheetnames=", ".join(book.sheetnames)),
            )
        for name in [sheet] if sheet is not None else book.sheetnames:
            cells = _excel_rows(path, book[name])
            if sum(sum(isinstance(c, float) for c in row) >= _FEWEST_COLUMNS for row in cells) >= 2:
                return _build_table(path, cells, f"Excel sheet {name!r}")
    finally:
        book.close()
    raise MeasurementError(
        make_message("{path} holds no table of numbers.", path=path), remedy="Name the sheet with `--sheet`."
    )


def _excel_rows(path: Path, sheet: Any) -> list[list[float | str]]:
    rows: list[list[float | str]] = []
    count = 0
    try:
        for row in sheet.iter_rows(values_only=True):
            rows.append([_excel_cell(value) for value in row])
            count += len(row)
            if count > _MOST_EXCEL_CELLS:  # a sheet may say that it is of any size
                break
    except Exception as error:  # the library raises what its parts happen to raise
        raise MeasurementError(
            make_message("{path} is no Excel file.", path=path), remedy="Save it as CSV."
        ) from error
    if count > _MOST_EXCEL_CELLS:
        raise MeasurementError(
            make_message(
                "{path} has more than {most_excel_cells} cells.",
                path=path,
                most_excel_cells=_MOST_EXCEL_CELLS,
            ),
            remedy="Save it as CSV.",
        )
    return rows


def _excel_cell(value: object) -> float | str:
    if value is None or isinstance(value, bool):
        return "" if value is None else str(value)
    if isinstance(value, int | float):
        return float(value) if math.isfinite(value) else str(value)
    return _parse_cell(str(value), "," in str(value) and "." not in str(value))
