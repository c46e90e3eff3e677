"""A table as instruments write it: separators, decimal commas, preambles and units are found out."""

import io
import math
import re
from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice, pairwise
from pathlib import Path

import numpy as np

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.csv_text import split_row
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.cell_numbers import (
    ColumnMarks,
    WrittenNumber,
    parse_cell,
)
from cellcal.service.engineering.measured.encodings import text_of_table
from cellcal.service.engineering.measured.errors import (
    MeasurementError as MeasurementError,  # noqa: PLC0414  # readers of tables import it from here
)
from cellcal.service.engineering.measured.list_cells import has_lists, spread_lists
from cellcal.service.engineering.measured.matrix_columns import name_matrix_elements
from cellcal.service.engineering.measured.record_lines import holds_records, join_records
from cellcal.service.engineering.measured.summary_rows import block_summaries, calculated_rows, summary_rows
from cellcal.service.engineering.measured.table_forms import refuse_divided_numbers, refuse_transposed_table
from cellcal.service.engineering.measured.table_heads import (
    doubled_name,
    heading_names,
    is_counting_heading,
    is_remark,
    name_quaternion_apart,
    names_without_heading,
    numbers_groups,
    only_counts,
)
from cellcal.service.engineering.measured.workbooks import (
    FEWEST_COLUMNS,
    OLD_BEGINS,
    ZIP_BEGINS,
    read_workbook,
)
from cellcal.service.files import missing_file_words

_SEPARATORS = (";", "\t", ",", "|", " ")
_LOOK_AHEAD = 200  # lines, to find separator and decimal mark
_HEAD = 2000  # lines, to find the column names
_MOSTLY = 0.5  # of the rows of a column of numbers
_SHOWN = 40  # characters of a cell
_UNIT_APART = re.compile(r"[ \t]+([\[(][^\s\])]*[\])])")  # J1 [deg] is one name between blanks
_UNIT_BEHIND = re.compile(
    r"(?<=[\d.])[ \t]+(mm|cm|m|um|\u00b5m|inch|deg|degrees|rad|mrad|\u00b0)(?=[ \t\r\n]|$)"
)  # 12.3 deg is one cell between blanks
_EXCEL = {".xlsx", ".xlsm"}
_KRL = re.compile(rb"\s*\{\s*(?:[A-Za-z]\w*\s*:\s*)?(?:A1|X)\s+[-+.\d]+")
_BEGINS_AS_NUMBER = re.compile(r"[+-]?[\d.,]*\d")
WRITE_PLAINLY = (
    "Write numbers with a decimal point and no marks of thousands, and all of a column in the unit that its heading "
    "names."
)


@dataclass(frozen=True, eq=False)
class MeasurementTable:
    """Names and cells; a cell is a number, or the text that is not one. Rows may have been ragged."""

    names: tuple[str, ...]
    numbers: Array  # (N, k): not a number where there is a text, or nothing
    texts: Mapping[tuple[int, int], str]
    lines: Rows  # (N,) of the file, counted from one
    dialect: str  # for people
    has_heading: bool = True  # else the names are numbers of columns, or from a remark
    doubts: Mapping[int, str] = field(
        default_factory=dict
    )  # columns whose numbers have no one meaning, and why
    uncalculated: Mapping[int, int] = field(
        default_factory=dict
    )  # columns with formulas that have no value, and the first such line
    sheets: tuple[str, ...] = ()  # of a workbook: the one that was read, and others with numbers

    def __len__(self) -> int:
        return len(self.lines)

    def column_values(self, name: str) -> Array:
        """Return the numbers of a column.

        Raises
        ------
        MeasurementError
            Its cells have different units, or more than one decimal mark.
        """
        at = self.names.index(name)
        if at in self.doubts:
            raise MeasurementError(make_message("{why}.", why=self.doubts[at]), remedy=WRITE_PLAINLY)
        if at in self.uncalculated:
            raise MeasurementError(
                make_message(
                    "column {column!r} holds a formula without its value in line {line}.",
                    column=name,
                    line=self.uncalculated[at],
                ),
                remedy="Open the file in a spreadsheet program, let it calculate, and save it.",
            )
        found: Array = self.numbers[:, at]
        return found

    def numeric_names(self) -> tuple[str, ...]:
        """Return the columns in which most of the filled rows hold numbers."""
        often = np.isfinite(self.numbers).mean(axis=0) >= _MOSTLY if len(self) else np.ones(len(self.names))
        names = [name for name, numeric in zip(self.names, often, strict=True) if numeric]
        return tuple(name for name in names if self.has_heading or not self._counts_rows(name))

    def _counts_rows(self, name: str) -> bool:
        """Return whether a column does nothing but number the rows."""
        numbers = self.numbers[:, self.names.index(name)]
        return len(numbers) > 2 and bool((np.diff(numbers) == 1.0).all())

    def column_texts(self, name: str) -> list[str]:
        """Return the cells of a column as text, whole numbers without a point."""
        at = self.names.index(name)
        return [
            self.texts.get((row, at), "" if math.isnan(number) else f"{number:.15g}")
            for row, number in enumerate(self.numbers[:, at].tolist())
        ]


def read_table(path: Path, *, sheet: str | None = None, fewest: int = FEWEST_COLUMNS) -> MeasurementTable:
    """Read a CSV file, of ``fewest`` numbers a row or more, or the first usable sheet of an Excel file.

    Raises
    ------
    MeasurementError
        No such file, no table of numbers in it, no header, or names that occur twice.
    """
    if not path.is_file():
        why, remedy = missing_file_words(path)
        raise MeasurementError(why, remedy=remedy)
    try:
        content = read_plain_bytes(path)
        if path.suffix.lower() in _EXCEL or content.startswith((ZIP_BEGINS, OLD_BEGINS)):
            return _read_excel(path, content, sheet)
        if sheet:
            raise MeasurementError(
                make_message("{path} is no workbook, and has no sheet {sheet!r}.", path=path, sheet=sheet),
                remedy="Leave `--sheet` out, or give the workbook.",
            )
        return _read_text(path, content, fewest)
    except DocumentError as error:
        raise MeasurementError(
            make_message("{path}: {why}", path=path, why=error.why),
            remedy=error.remedy,
        ) from error


def _read_text(path: Path, content: bytes, fewest: int) -> MeasurementTable:
    if krl := _KRL.match(content):
        raise MeasurementError(
            make_message(
                "{path}: its rows are KRL text ({begin}…).", path=path, begin=krl[0].decode().strip()
            ),
            remedy="Write a heading A1, A2 … A6, X, Y, Z, and in each row the numbers alone, without braces and "
            "names.",
        )
    if content.lstrip()[:2] in (b"[{", b"[[") or content.lstrip()[:1] in (b"{", b"<"):
        raise MeasurementError(
            make_message("{path} holds no table: it is JSON or XML.", path=path),
            remedy="Export the measurements as CSV or Excel: a heading, and one row a posture.",
        )
    lines: Iterable[str] = io.StringIO(text_of_table(content), newline=None)
    first = list(islice(lines, _LOOK_AHEAD))
    lines = chain(first, lines)
    if holds_records(first):
        lines = iter(first := join_records(path, list(lines)))
    elif has_lists(first):
        lines = iter(first := spread_lists(path, list(lines)))
    separator, comma = _detect_dialect(
        [line for line in first if line.strip() and not is_remark([line])][:_LOOK_AHEAD], fewest
    )
    mark = {"\t": "tab", " ": "blanks"}.get(separator, repr(separator))
    cells = ([parse_cell(cell, comma=comma) for cell in _split_line(line, separator)] for line in lines)
    return _build_table(
        path,
        cells,
        make_message("separated by {mark}, decimal comma", mark=mark)
        if comma
        else make_message("separated by {mark}, decimal point", mark=mark),
        fewest,
    )


_LONGEST_LINE = 200_000
_MOST_NAMED = 6  # summaries


def _split_line(line: str, separator: str) -> list[str]:
    if separator == " ":
        return _UNIT_BEHIND.sub(r"\1", _UNIT_APART.sub(r"\1", line)).split()
    # One line, one row: a quotation mark that is never closed must not swallow the rest of the file.
    if len(line) > _LONGEST_LINE:
        raise DocumentError("a line in it is longer than any of a table.", remedy="Export the table again.")
    return split_row(line.rstrip("\r\n"), separator)


def _detect_dialect(lines: Sequence[str], fewest: int) -> tuple[str, bool]:
    """Return separator and whether the decimal mark is a comma: those that make most numbers of most rows."""
    best: tuple[float, str, bool] = (0.0, ",", False)
    for separator in _SEPARATORS:
        for comma in (False, True):
            if separator == "," and comma:
                continue
            counts = [
                sum(isinstance(parse_cell(cell, comma=comma), float) for cell in _split_line(line, separator))
                for line in lines
            ]
            common, often = (
                Counter(count for count in counts if count >= fewest).most_common(1)[0]
                if any(count >= fewest for count in counts)
                else (0, 0)
            )
            score = float(common * often)
            if score > best[0] and not (separator == " " and best[1] == "\t" and _hold_words(lines)):
                best = (score, separator, comma)
    return best[1], best[2]


def _hold_words(lines: Sequence[str]) -> bool:
    """Return whether blanks between tabs stand inside names and remarks (``point 1``), and divide no two numbers.

    A row divided at blanks is divided at its tabs, too, so that a number in a name would always count for blanks.
    """
    apart = [cell.split() for line in lines for cell in line.split("\t")]
    return not any(
        isinstance(parse_cell(first, comma=False), float)
        and isinstance(parse_cell(second, comma=False), float)
        for words in apart
        for first, second in pairwise(words)
    )


def _build_table(
    path: Path, cells: Iterable[list[float | str]], dialect: str, fewest: int = FEWEST_COLUMNS
) -> MeasurementTable:
    rows = iter(cells)
    head = list(islice(rows, _HEAD))
    counts = [0 if is_remark(row) else sum(isinstance(cell, float) for cell in row) for row in head]
    widths = Counter(count for count in counts if count >= fewest)
    if not widths:
        raise _no_table(path, head)
    usual = widths.most_common(1)[0][0]
    enough = [i for i, count in enumerate(counts) if count >= max(fewest, 0.5 * usual)]
    first = next(
        (
            i
            for i, under in pairwise(enough)
            if not (
                is_counting_heading(head[i], head[under])
                or (i == enough[0] and (only_counts(head[i]) or numbers_groups(head[i], head[i + 1 : under])))
            )
        ),
        enough[-1],
    )
    names = heading_names(head[:first], _filled_width(head[first]))
    has_heading = names is not None
    if names is None:
        refuse_divided_numbers(path, head[:first], head[first:])
        refuse_transposed_table(path, head[first:])
        remarks = [",".join(str(cell) for cell in row) for row in head[:first]]
        names = names_without_heading(head[first][: _filled_width(head[first])], remarks)
    names = name_matrix_elements(name_quaternion_apart(names, head[first:]), head[first:])
    if twice := doubled_name(names):
        raise MeasurementError(
            make_message("{path}: the column name {twice!r} occurs twice.", path=path, twice=twice),
            remedy="Rename one of them.",
        )
    return _without_summaries(
        _fill_table(names, chain(head[first:], rows), first + 1, dialect, has_heading=has_heading)
    )


def _fill_table(
    names: tuple[str, ...], rows: Iterable[list[float | str]], line: int, dialect: str, *, has_heading: bool
) -> MeasurementTable:
    """Return the table of rows that begin at a line of the file."""
    marks = ColumnMarks()
    numbers, texts, lines = array("d"), dict[tuple[int, int], str](), array("q")
    for at_line, row in enumerate(rows, start=line):
        if not any(cell != "" for cell in row) or is_remark(row):
            continue
        padded = [*row[: len(names)], *[""] * (len(names) - len(row))]
        for at, cell in enumerate(padded):
            if isinstance(cell, str):
                if cell:
                    texts[len(lines), at] = cell
            elif isinstance(cell, WrittenNumber):
                marks.note_cell(at, len(lines), at_line, cell)
            else:
                marks.note_number(at, at_line, cell)
        numbers.extend(cell if isinstance(cell, float) else math.nan for cell in padded)
        lines.append(at_line)
    shaped = np.frombuffer(numbers, dtype=float).reshape(-1, len(names))
    numbers_of_lines = np.frombuffer(lines, dtype=np.int64)
    return MeasurementTable(
        marks.names_with_units(names),
        shaped,
        texts,
        numbers_of_lines,
        dialect,
        has_heading,
        marks.doubts(names, shaped, numbers_of_lines),
    )


def _without_summaries(table: MeasurementTable) -> MeasurementTable:
    """Return a table without the rows that sum others up; its dialect names them."""
    found = {
        **calculated_rows(table.numbers),
        **block_summaries(table.texts, table.numbers),
        **summary_rows(table.texts, len(table)),
    }
    if not found:
        return table
    kept_rows = [row for row in range(len(table)) if row not in found]
    place = {row: at for at, row in enumerate(kept_rows)}
    shown = ", ".join(f"{word!r} ({table.lines[row]})" for row, word in list(found.items())[:_MOST_NAMED])
    if len(found) > _MOST_NAMED:
        shown = make_message("{} and {} more", shown, len(found) - _MOST_NAMED)
    left_out = make_message("summaries of rows left out, with their lines: {shown}", shown=shown)
    return replace(
        table,
        numbers=table.numbers[kept_rows],
        texts={(place[row], at): text for (row, at), text in table.texts.items() if row in place},
        lines=table.lines[kept_rows],
        dialect="; ".join([table.dialect, left_out]),
    )


def _no_table(path: Path, head: list[list[float | str]]) -> MeasurementError:
    """Return the refusal of a file without rows of numbers; it names the cell that keeps one from being a number."""
    for line, row in enumerate(head, start=1):
        begun = [cell for cell in row if isinstance(cell, float) or _BEGINS_AS_NUMBER.match(cell)]
        strange = [cell for cell in begun if isinstance(cell, str)]
        if len(begun) >= FEWEST_COLUMNS and strange and not is_remark(row):
            return MeasurementError(
                make_message(
                    "{path} holds no table of numbers: in line {line}, {cell!r} is no number and no number with a "
                    "unit.",
                    path=path,
                    line=line,
                    cell=strange[0][:_SHOWN],
                ),
                remedy=WRITE_PLAINLY,
            )
    return MeasurementError(
        make_message("{path} holds no table of numbers.", path=path),
        remedy="A file of measurements has one row a posture: joints, and what the device read.",
    )


def _filled_width(row: list[float | str]) -> int:
    """Return how many cells of a row hold something; separators at its end make no columns."""
    return max((at + 1 for at, cell in enumerate(row) if cell != ""), default=0)


def _read_excel(path: Path, content: bytes, sheet: str | None) -> MeasurementTable:
    found = read_workbook(path, content, sheet)
    table = _build_table(path, found.rows, found.dialect)
    return replace(table, uncalculated=found.uncalculated, sheets=(found.name, *found.others))
