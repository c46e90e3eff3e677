"""What people and instruments write has one meaning, or none."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellcal.drivers.file_import.number_text import (
    ColumnLayout,
    TextError,
    parse_number,
    parse_typed,
    rows_of,
)

XYZ = ColumnLayout(("x", "y", "z"), "mm")


@pytest.mark.parametrize(
    ("cell", "value"),
    [
        ("12", 12.0), (" 12.5 ", 12.5), ("12,5", 12.5), ("-0,25", -0.25), ("+3.", 3.0), (".5", 0.5),
        ("1.5e-3", 0.0015), ("1,5E+2", 150.0), ('"7,25"', 7.25), ("\N{MINUS SIGN}4", -4.0),
    ],
)  # fmt: skip
def test_a_comma_is_a_decimal_mark(cell: str, value: float) -> None:
    assert parse_number(cell) == value


@pytest.mark.parametrize(
    "cell",
    [
        "", "-", "nan", "NaN", "inf", "-Infinity", "1e400", "1.234,5", "1,234.5", "1 234", "1'234", "0x10", "1_000",
        "12 mm", "--", "1e9e9", "\N{ARABIC-INDIC DIGIT THREE}",
    ],
)  # fmt: skip
def test_anything_else_is_no_number(cell: str) -> None:
    with pytest.raises(TextError):
        parse_number(cell)


@given(st.floats(-1e8, 1e8), st.sampled_from([".", ","]))
def test_what_is_written_is_what_is_read(value: float, mark: str) -> None:
    assert parse_number(repr(value).replace(".", mark)) == value


@given(st.text(max_size=60))
def test_no_text_becomes_a_number_that_is_not_finite(text: str) -> None:
    try:
        values = parse_typed(text, 1)
    except TextError:
        return
    assert math.isfinite(values[0])


@pytest.mark.parametrize(
    "line", ["1,5 -2,5 300", "1.5; -2.5; 300", "1.5\t-2.5\t300", " 1,5;-2,5;300 ", "1.5   -2.5  300.0"]
)
def test_three_numbers_may_be_typed_in_any_of_these_ways(line: str) -> None:
    assert parse_typed(line, 3) == (1.5, -2.5, 300.0)


@pytest.mark.parametrize("line", ["", "1 2", "1 2 3 4", "1,2,3", "1.5,2.5,3.5", "a b c", "1 2 nan"])
def test_what_could_be_misread_is_asked_again(line: str) -> None:
    with pytest.raises(TextError):
        parse_typed(line, 3)


@pytest.mark.parametrize(
    "text",
    [
        "x;y;z\n1,5;2;3\n4;5;6,25\n",
        "x [mm];y [mm];z [mm]\n1.5;2;3\n4;5;6.25\n",
        "name\tX_mm\tY_mm\tZ_mm\nP1\t1.5\t2\t3\nP2\t4\t5\t6.25\n",
        "# a scan of the hall\n\nInstrument: Vantage\nx,y,z\n1.5,2,3\n\n# two\n4,5,6.25\n",
        "x y z\n1,5 2 3\n4 5 6,25\n",
        "x;y;z\nmm;mm;mm\n1,5;2;3\n4;5;6,25",
        "z;quality;y;x\n3;9;2;1,5\n6,25;9;5;4\n",
        '"x";"y";"z"\r\n"1,5";"2";"3"\r\n"4";"5";"6,25"\r\n',
    ],
)
def test_tables_as_instruments_write_them(text: str) -> None:
    assert [row.values for row in rows_of(text, XYZ)] == [(1.5, 2.0, 3.0), (4.0, 5.0, 6.25)]


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("x;y;z\n1;2;3\n1;nan;3\n", "line 3, column 2"),
        ("x;y;z\n1;2;3\n\n1;2;inf\n", "line 4, column 3"),
        ("x;y;z\n1;2;3\n1;2\n", "line 3, column 3"),
        ("x;y;z\n1;2;3\n;;\n", "line 3, column 1"),
        ("x;y;z\n1O.5;2;3\n", "line 2, column 1"),
        ("x [in];y [in];z [in]\n1;2;3\n", r"heading says 'x \[in\]'"),
        ("x;y;z\nin;in;in\n1;2;3\n", r"heading says '\[in\]'"),
        ("a;b;c\n1;2;3\n", "no line names the columns x, y, z"),
    ],
)
def test_a_bad_cell_is_reported_with_line_and_column(text: str, where: str) -> None:
    with pytest.raises(TextError, match=where):
        rows_of(text, XYZ)


def test_columns_may_be_counted_and_words_above_are_not_rows() -> None:
    layout = ColumnLayout((2, 3, 4), "mm", heading_lines=1)
    text = "Name;East;North;Up\nP1;1,5;2;3\nP2;4;5;6\n"
    assert [(row.values, row.line) for row in rows_of(text, layout)] == [
        ((1.5, 2.0, 3.0), 2),
        ((4.0, 5.0, 6.0), 3),
    ]


def test_a_first_row_that_is_spoilt_does_not_shift_the_others() -> None:
    for first in ("1;2;x", "in;1;mm", "nan;nan;nan", ";;", "---;---;---", "no reflector", '"";"";""'):
        with pytest.raises(TextError, match="line 1"):
            rows_of(f"{first}\n1;2;3\n", ColumnLayout((1, 2, 3), "mm"))
        with pytest.raises(TextError, match="line 2"):
            rows_of(f"x;y;z\n{first}\n1;2;3\n", XYZ)


def test_a_comma_that_could_be_either_is_refused_until_the_separator_is_named() -> None:
    one = ColumnLayout((1,), "mm")
    with pytest.raises(TextError, match="separator"):
        rows_of("12,5\n", one)
    assert rows_of("12,5\n", ColumnLayout((1,), "mm", ","))[0].values == (12.0,)
    assert rows_of("12,5\n", ColumnLayout((1,), "mm", ";"))[0].values == (12.5,)


def test_ones_are_numbers_and_no_units() -> None:
    assert [row.values for row in rows_of("x;y;z\n1;1;1\n2;2;2\n", XYZ)] == [(1.0, 1.0, 1.0), (2.0, 2.0, 2.0)]
