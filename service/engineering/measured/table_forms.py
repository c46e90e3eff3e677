"""Tables that cannot be read as they lie: decimal commas among commas between cells, and postures side by side."""

from collections.abc import Sequence
from pathlib import Path

from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.errors import MeasurementError
from cellcal.service.engineering.measured.table_heads import Cells, is_remark

_FEWEST_NAMES = 4
_MOSTLY = 0.95  # of the rows


def refuse_divided_numbers(path: Path, above: Sequence[Cells], rows: Sequence[Cells]) -> None:
    """Refuse rows that are nearly twice as wide as their heading and hold whole numbers only.

    Raises
    ------
    MeasurementError
        With both counts.
    """
    headings = [
        (line, cells)
        for line, row in enumerate(above, start=1)
        if not is_remark(row)
        and len(cells := [cell for cell in row if cell != ""]) >= _FEWEST_NAMES
        and all(isinstance(cell, str) for cell in cells)
    ]
    if not headings:
        return
    line, names = headings[-1]
    filled = [[cell for cell in row if cell != ""] for row in rows if not is_remark(row)]
    wide = [row for row in filled if len(names) < len(row) <= 2 * len(names)]
    whole = all(cell.is_integer() for row in wide for cell in row if isinstance(cell, float))
    if len(wide) < _MOSTLY * sum(map(bool, filled)) or not whole:
        return
    raise MeasurementError(
        make_message(
            "{path}: line {line} names {names} columns, and the rows hold {cells} whole numbers: numbers with "
            "decimal commas stand between commas that separate cells.",
            path=path,
            line=line,
            names=len(names),
            cells=max(len(row) for row in wide),
        ),
        remedy="Export it again with semicolons or tabs between the cells, or with decimal points.",
    )


def refuse_transposed_table(path: Path, rows: Sequence[Cells]) -> None:
    """Refuse a table whose names stand in the first column, with the postures side by side.

    Raises
    ------
    MeasurementError
        With the names.
    """
    filled = [row for row in rows if any(cell != "" for cell in row) and not is_remark(row)]
    names = [row[0] for row in filled if isinstance(row[0], str) and row[0]]
    numbers = min((sum(isinstance(cell, float) for cell in row[1:]) for row in filled), default=0)
    if len(names) < max(_FEWEST_NAMES, len(filled)) or len(set(names)) < len(names) or numbers < len(filled):
        return
    raise MeasurementError(
        make_message(
            "{path}: the names ({names}) stand in the first column, and the postures side by side.",
            path=path,
            names=", ".join(names),
        ),
        remedy="Exchange rows and columns (in a spreadsheet: paste, transposed): one row a posture, the names above.",
    )
