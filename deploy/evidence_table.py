"""Write what stands behind each ability into the set-up pages: `make types`. A test finds the table stale."""

import sys
from collections.abc import Iterator
from pathlib import Path

from cellcal.drivers.wire.tables import read_table_rows

_ROOT = Path(__file__).parents[1]
PAGE = _ROOT / "deploy" / "controller_setup" / "README.md"
_COLUMNS = (
    "driver",
    "ability",
    "read in the maker's document",
    "confirmed by an independent client",
    "confirmed on a robot",
)


def evidence_table() -> str:
    """Return the rows of every driver's evidence as one table in Markdown."""
    head = f"| {' | '.join(_COLUMNS)} |"
    return "\n".join((head, "|---" * len(_COLUMNS) + "|", *_rows())) + "\n"


def page_with(table: str) -> str:
    """Return the page of controllers, whose last part is the table."""
    text = PAGE.read_text(encoding="utf-8")
    return text[: text.index("| driver |")] + table


def _rows() -> Iterator[str]:
    for file in sorted(_ROOT.glob("drivers/*/evidence.tsv")):
        driver = file.parent.name
        for row in read_table_rows(f"cellcal.drivers.{driver}", file.name):
            name = f"{driver} {row['profile']}".strip()
            yield f"| {name} | {row['ability']} | {row['document']} | {row['client']} | {row['robot']} |"


if __name__ == "__main__":
    PAGE.write_text(page_with(evidence_table()), encoding="utf-8")
    sys.stderr.write(f"{PAGE} is written.\n")
