"""Excel workbooks as people and programs write them: the right sheet and rows are read, and the rest is named."""

import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import openpyxl
import pytest
from openpyxl.chart import ScatterChart

from cellcal.service.engineering.measured.table import MeasurementError, read_table

HEADING = ["Point", "J1", "J2", "J3", "X", "Y", "Z"]
ROWS = [[f"P{i}", 1.5 * i, 10.25 - i, 2.5 * i, 100.5 + i, 200.25 - i, 300.5 + 2 * i] for i in range(12)]


def fill(sheet, rows=ROWS, heading=HEADING):
    for row in [heading, *rows]:
        sheet.append(row)


def save(path: Path, make: Callable[[openpyxl.Workbook], None]) -> Path:
    book = openpyxl.Workbook()
    make(book)
    book.save(path)
    return path


def rewrite(path: Path, old: bytes, new: bytes) -> Path:
    """Replace bytes in every part of a workbook."""
    with zipfile.ZipFile(path) as source:
        parts = {name: source.read(name) for name in source.namelist()}
    assert any(re.search(old, part) for part in parts.values())
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as target:
        for name, part in parts.items():
            target.writestr(name, re.sub(old, new, part))
    return path


def x_of(path: Path, sheet: str | None = None) -> list[float]:
    return read_table(path, sheet=sheet).column_values("X").tolist()


RIGHT = [row[4] for row in ROWS]


@pytest.mark.parametrize("size", [b"A1", b"A1:B2", b"A1:XFD1048576"])
def test_what_a_sheet_says_of_its_size_is_not_believed(tmp_path: Path, size: bytes) -> None:
    path = save(tmp_path / "m.xlsx", lambda book: fill(book.active))
    assert x_of(rewrite(path, rb'<dimension ref="[^"]*"', b'<dimension ref="' + size + b'"')) == RIGHT


def test_a_sheet_that_is_a_chart_is_passed_over(tmp_path: Path) -> None:
    def make(book):
        fill(book.active)
        book.create_chartsheet("Plot", 0).add_chart(ScatterChart())

    assert x_of(save(tmp_path / "m.xlsx", make)) == RIGHT


def test_a_hidden_sheet_is_read_only_where_it_is_named_or_alone(tmp_path: Path) -> None:
    def make(book):
        fill(book.active, [[*row[:4], 0.5, *row[5:]] for row in ROWS])
        book.active.title, book.active.sheet_state = "old", "hidden"
        fill(book.create_sheet("new"))

    path = save(tmp_path / "m.xlsx", make)
    assert x_of(path) == RIGHT
    assert set(x_of(path, "old")) == {0.5}
    assert "hidden" in read_table(path, sheet="old").dialect


def test_another_sheet_with_numbers_is_named(tmp_path: Path) -> None:
    def make(book):
        fill(book.active)
        fill(book.create_sheet("Day 2"))
        book.create_sheet("Notes").append(["made by", "a technician"])

    path = save(tmp_path / "m.xlsx", make)
    assert "not read: 'Day 2'" in read_table(path).dialect
    assert "Notes" not in read_table(path).dialect
    assert "not read" not in read_table(path, sheet="Day 2").dialect


def test_rows_that_a_filter_hides_are_named(tmp_path: Path) -> None:
    def make(book):
        fill(book.active)
        for row in (3, 4, 40):  # the last holds nothing
            book.active.row_dimensions[row].hidden = True

    table = read_table(save(tmp_path / "m.xlsx", make))
    assert len(table) == len(ROWS)
    assert "2 hidden rows" in table.dialect


@pytest.mark.parametrize("rows", [range(2, 14), [5]])
def test_a_formula_that_nothing_calculated_is_no_empty_cell(tmp_path: Path, rows) -> None:
    def make(book):
        fill(book.active)
        for row in rows:
            book.active.cell(row, 5, f"=B{row}+1")

    table = read_table(save(tmp_path / "m.xlsx", make))
    with pytest.raises(
        MeasurementError, match=f"'X' holds a formula without its value in line {rows[0]}"
    ) as refused:
        table.column_values("X")
    assert "calculate" in refused.value.remedy
    assert np.isfinite(table.column_values("Y")).all()


def test_a_calculated_formula_is_its_value_and_one_of_an_empty_text_is_empty(tmp_path: Path) -> None:
    def make(book):
        fill(book.active)
        book.active.cell(2, 5, "=A1+1")
        book.active.cell(3, 5, "=IF(A1,1,A3)")

    path = save(tmp_path / "m.xlsx", make)
    rewrite(path, rb"(<f>A1\+1</f>)<v\s*/>|(<f>A1\+1</f>)<v></v>", rb"\1\2<v>7.25</v>")
    rewrite(path, rb'<c r="E3"(?: t="\w+")?>', b'<c r="E3" t="str">')
    found = x_of(path)
    assert found[0] == 7.25
    assert np.isnan(found[1])


def test_a_workbook_is_known_by_its_bytes(tmp_path: Path) -> None:
    path = save(tmp_path / "m.xlsx", lambda book: fill(book.active))
    assert x_of(Path(shutil.copy(path, tmp_path / "m.csv"))) == RIGHT


@pytest.mark.parametrize("name", ["m.xls", "m.xlsx", "m.csv"])
def test_an_old_or_protected_workbook_is_refused_as_such(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(4096))
    with pytest.raises(MeasurementError, match="old Excel format") as refused:
        read_table(path)
    assert "password" in refused.value.remedy


def test_strict_open_xml_is_refused_with_its_cure(tmp_path: Path) -> None:
    path = save(tmp_path / "m.xlsx", lambda book: fill(book.active))
    transitional, strict = b"http://schemas.openxmlformats.org", b"http://purl.oclc.org/ooxml"
    rewrite(path, transitional + rb"/(spreadsheetml)/2006", strict + rb"/\1")
    rewrite(path, transitional + rb"/(officeDocument)/2006/relationships", strict + rb"/\1/relationships")
    with pytest.raises(MeasurementError, match="no sheet") as refused:
        read_table(path)
    assert "Strict" in refused.value.remedy


@pytest.mark.parametrize("name", ["m.csv", "m.xlsx"])
@pytest.mark.parametrize("word", ["Mean", "Std. Dev.", "MAX", "Mittelwert", "Standardabweichung", "标准差"])
def test_rows_that_sum_others_up_are_no_readings_and_named(tmp_path: Path, name: str, word: str) -> None:
    rows = [*ROWS, [word, *np.mean([row[1:] for row in ROWS], axis=0).tolist()]]
    path = tmp_path / name
    if name == "m.xlsx":
        save(path, lambda book: fill(book.active, rows))
    else:
        path.write_text(
            "\n".join(",".join(map(str, row)) for row in [HEADING, *rows]) + "\n", encoding="utf-8"
        )
    table = read_table(path)
    assert table.column_values("X").tolist() == RIGHT
    assert table.lines.tolist() == list(range(2, 14))
    assert f"{word!r} (14)" in table.dialect


def test_a_word_of_several_rows_is_a_name(tmp_path: Path) -> None:
    rows = [["max" if i % 2 else "min", *row[1:]] for i, row in enumerate(ROWS)]
    path = save(tmp_path / "m.xlsx", lambda book: fill(book.active, rows))
    assert x_of(path) == RIGHT
