"""No cell is a formula, numbers stay numbers, and there is one writer."""

import ast
import csv
import io
from pathlib import Path

import pytest

from cellcal.service.csv_writing import formula_safe, write_rows

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    "text", ["=1+1", "+cmd()", "-2+3", "@SUM(A1)", "\tx", "\rx", "\nx", "\uff1dA1", "-", "+1_0", "-1e"]
)
def test_a_formula_is_text(text: str) -> None:
    assert formula_safe(text) == f"'{text}"
    out = io.StringIO(newline="")
    write_rows(out, [[text, -1.5, 3]])
    assert next(csv.reader(io.StringIO(out.getvalue(), newline=""))) == [f"'{text}", "-1.5", "3"]


@pytest.mark.parametrize("text", ["-1.5", "+3", "-1e-9", ".5", "P[1]", "", "a=b"])
def test_what_is_none_stays(text: str) -> None:
    assert formula_safe(text) == text


def test_there_is_one_writer() -> None:
    writers = set()
    for path in [
        p
        for package in ("service", "drivers", "calibration", "procedures")
        for p in (ROOT / package).rglob("*.py")
        if "import csv" in p.read_text(encoding="utf-8")
    ]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                isinstance(node, ast.Attribute)
                and node.attr in ("writer", "DictWriter")
                and ast.unparse(node.value) == "csv"
            ):
                writers.add(path.relative_to(ROOT).as_posix())
    assert writers == {"service/csv_writing.py"}
