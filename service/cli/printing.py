"""Results on standard output, everything else on standard error; text of people and files is printed as it is."""

import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from cellcal.calibration.message import without_controls


class PlainConsole(Console):
    """A console that hands a terminal nothing to obey from texts of devices and files."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as rich does."""
        super().print(
            *(without_controls(each) if isinstance(each, str) else each for each in objects), **options
        )


STDERR_CONSOLE = PlainConsole(stderr=True, highlight=False, emoji=False)


@contextmanager
def say_while_waiting(text: str) -> Iterator[None]:
    """Show on a terminal's standard error what is waited for, as long as it is."""
    if not STDERR_CONSOLE.is_terminal:
        yield
        return
    with STDERR_CONSOLE.status(Text(text)):
        yield


class PlainTable(Table):
    """A table whose cells, headings and title are text: ``[red]`` or ``:robot:`` in a name is no markup."""

    def __init__(self, *headers: Any, title: str | None = None, **options: Any) -> None:
        plain = None if title is None else Text(without_controls(title), style="table.title")
        super().__init__(*headers, title=plain, **options)
        for column in self.columns:
            if isinstance(column.header, str):
                column.header = Text(column.header)

    def add_row(self, *cells: RenderableType | None, **options: Any) -> None:
        """Add a row; a cell that shall be coloured is a `Text`."""
        texts = (Text(without_controls(cell)) if isinstance(cell, str) else cell for cell in cells)
        super().add_row(*texts, **options)


def print_json(document: Mapping[str, object]) -> None:
    """Print one JSON object on standard output; NaN and infinity are refused."""
    sys.stdout.write(json.dumps(document, allow_nan=False, ensure_ascii=False) + "\n")
    sys.stdout.flush()
