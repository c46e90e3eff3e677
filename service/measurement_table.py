"""A table as instruments write it: separators, decimal commas, preambles and units are found out."""

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

from calibration.errors import CellError

_SEPARATORS = (";", "\t", ",", "|", " ")
_LOOK_AHEAD = 60  # lines
_FEWEST_COLUMNS = 3
_GROUP_MARKS = re.compile("[ \u2009\u202f'\u2019]")
_GROUPED = re.compile(r"^[+-]?\d{1,3}([ \u2009\u202f'\u2019]\d{3})+([.,]\d+)?$")
_THOUSANDS = re.compile(r"^[+-]?\d{1,3}(,\d{3})+\.\d+$")  # without a point, a comma is a decimal mark
_EXCEL = {".xlsx", ".xlsm"}


class MeasurementError(CellError):
    """A file of measurements cannot be understood; the remedy names the option that helps."""

    code = "measurements"


@dataclass(frozen=True, slots=True)
class Table:
    """Names and cells; a cell is a number, or the text that is not one. Rows may be ragged."""

    names: tuple[str, ...]
    rows: tuple[tuple[float | str, ...], ...]
    lines: tuple[int, ...]  # of the file, counted from one, for each row
    dialect: str  # for people

    def column(self, name: str) -> list[float | str]:
        """Return the cells of a column; rows that are too short give an empty text."""
        at = self.names.index(name)
        return [row[at] if at < len(row) else "" for row in self.rows]


def read_table(path: Path, *, sheet: str | None = None) -> Table:
    """Read a CSV file or the first usable sheet of an Excel file.

    Raises
    ------
    MeasurementError
        No such file, no table of numbers in it, no header, or names that occur twice.
    """
    if not path.is_file():
        raise MeasurementError(f"there is no file {path}.", remedy="Check the name.")
    if path.suffix.lower() in _EXCEL:
        return _read_excel(path, sheet)
    lines = _text(path).splitlines()
    separator, comma = _dialect(lines)
    split = _split(lines, separator)
    table = _assemble(path, [[_cell(cell, comma) for cell in cells] for cells in split], "")
    mark = {"\t": "tab", " ": "blanks"}.get(separator, repr(separator))
    return Table(
        table.names, table.rows, table.lines, f"separated by {mark}, decimal {'comma' if comma else 'point'}"
    )


def _text(path: Path) -> str:
    data = path.read_bytes()
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    for order, high_bytes in (("utf-16-le", data[1:400:2]), ("utf-16-be", data[:400:2])):
        if high_bytes.count(0) > len(high_bytes) // 2:
            return data.decode(order, errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _split(lines: Sequence[str], separator: str) -> list[list[str]]:
    if separator == " ":
        return [line.split() for line in lines]
    # One line, one row: a quotation mark that is never closed must not swallow the rest of the file.
    return [next(csv.reader([line], delimiter=separator), []) for line in lines]


def _dialect(lines: Sequence[str]) -> tuple[str, bool]:
    """Return separator and whether the decimal mark is a comma: those that make most numbers of most rows."""
    sample = [line for line in lines if line.strip()][:_LOOK_AHEAD]
    best: tuple[float, str, bool] = (0.0, ",", False)
    for separator in _SEPARATORS:
        for comma in (False, True):
            if separator == "," and comma:
                continue
            counts = [
                sum(isinstance(_cell(cell, comma), float) for cell in cells)
                for cells in _split(sample, separator)
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


def _cell(text: str, comma: bool) -> float | str:
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


def _assemble(path: Path, cells: list[list[float | str]], dialect: str) -> Table:
    numbers = [sum(isinstance(cell, float) for cell in row) for row in cells]
    widths = Counter(count for count in numbers if count >= _FEWEST_COLUMNS)
    if not widths:
        raise MeasurementError(
            f"{path} holds no table of numbers.",
            remedy="A file of measurements has one row a posture: joints, and what the device read.",
        )
    usual = widths.most_common(1)[0][0]
    first = next(i for i, count in enumerate(numbers) if count >= max(_FEWEST_COLUMNS, 0.5 * usual))
    names = _names(path, cells[:first], len(cells[first]))
    filled = [(i + 1, row) for i, row in enumerate(cells[first:], start=first) if any(c != "" for c in row)]
    return Table(names, tuple(tuple(row) for _, row in filled), tuple(line for line, _ in filled), dialect)


def _names(path: Path, above: list[list[float | str]], width: int) -> tuple[str, ...]:
    """Return the header: the line above the numbers, with a line of units between them if there is one."""
    lines = [[str(cell).strip() for cell in row] for row in above if any(str(cell).strip() for cell in row)]
    lines = [_without_mark(row) for row in lines]
    header = [row for row in lines if len(row) >= width or sum(map(bool, row)) >= width]
    if not header:
        raise MeasurementError(
            f"{path} has no line of column names above its numbers.",
            remedy="Write one, such as q1,q2,q3,q4,q5,q6,x,y,z; `--columns` then says what is what.",
        )
    names, units = header[-1], [""] * len(header[-1])
    if len(header) > 1 and all(_is_unit(cell) for cell in header[-1]):
        names, units = header[-2], header[-1]
    joined = [
        f"{n} [{u.strip('[]()')}]" if u and u not in n else n for n, u in zip(names, units, strict=False)
    ]
    doubled = [name for name, count in Counter(n for n in joined if n).items() if count > 1]
    if doubled:
        raise MeasurementError(
            f"{path}: the column name {doubled[0]!r} occurs twice.", remedy="Rename one of them."
        )
    return tuple(name or f"column {i + 1}" for i, name in enumerate(joined))


def _without_mark(row: list[str]) -> list[str]:
    """Drop the comment mark of a header such as ``# q1 q2``."""
    if row and row[0] in ("#", "%", "//"):
        return row[1:]
    return [row[0].lstrip("#%").strip(), *row[1:]] if row else row


def _is_unit(cell: str) -> bool:
    return cell.strip("[]()").lower() in {
        "",
        "mm",
        "m",
        "cm",
        "µm",
        "um",
        "deg",
        "°",
        "rad",
        "degc",
        "°c",
        "s",
        "-",
        "1",
    }


def _read_excel(path: Path, sheet: str | None) -> Table:
    import warnings  # noqa: PLC0415  # openpyxl takes 100 ms that a CSV file need not pay

    from openpyxl import load_workbook  # noqa: PLC0415

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about styles and validations, which hold no measurement
        try:
            book = load_workbook(path, read_only=True, data_only=True)
        except (OSError, KeyError, ValueError, BadZipFile) as error:
            raise MeasurementError(f"{path} is no Excel file.", remedy="Save it as CSV.") from error
    try:
        if sheet is not None and sheet not in book.sheetnames:
            raise MeasurementError(
                f"{path} has no sheet {sheet!r}.", remedy=f"Sheets: {', '.join(book.sheetnames)}."
            )
        for name in [sheet] if sheet is not None else book.sheetnames:
            cells = [[_excel_cell(value) for value in row] for row in book[name].iter_rows(values_only=True)]
            if sum(sum(isinstance(c, float) for c in row) >= _FEWEST_COLUMNS for row in cells) >= 2:
                return _assemble(path, cells, f"Excel sheet {name!r}")
    finally:
        book.close()
    raise MeasurementError(f"{path} holds no table of numbers.", remedy="Name the sheet with `--sheet`.")


def _excel_cell(value: object) -> float | str:
    if value is None or isinstance(value, bool):
        return "" if value is None else str(value)
    if isinstance(value, int | float):
        return float(value) if math.isfinite(value) else str(value)
    return _cell(str(value), "," in str(value) and "." not in str(value))
