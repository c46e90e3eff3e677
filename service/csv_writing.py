"""The one writer of separated values: text that a spreadsheet would take for a formula gets an apostrophe."""

import csv
import re
from collections.abc import Iterable
from typing import Any, Protocol

FORMULA_SIGNS = tuple("=+-@\t\r\n\uff1d\uff0b\uff0d\uff20")  # the last four are their wide forms
_SIGNS = frozenset(FORMULA_SIGNS)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)


class CsvSink(Protocol):
    """The text stream to which rows are written."""

    def write(self, text: str, /) -> Any:
        """Take a piece of text."""


def formula_safe(text: str) -> str:
    """Return a text as a cell that no spreadsheet computes; what is a number stays one."""
    return f"'{text}" if text[:1] in _SIGNS and not _NUMBER.fullmatch(text) else text


def write_rows(
    sink: CsvSink, rows: Iterable[Iterable[Any]], *, delimiter: str = ",", line_end: str = "\r\n"
) -> None:
    """Write rows; cells that are texts are made safe."""
    writer = csv.writer(sink, delimiter=delimiter, lineterminator=line_end)
    writer.writerows([formula_safe(cell) if cell.__class__ is str else cell for cell in row] for row in rows)
