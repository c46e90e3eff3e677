"""Cell files whose first robot has usual settings."""

from pathlib import Path

_TABLE = "[[robot]]"


def with_usual(path: Path, tables: str) -> Path:
    """Add tables to the first of two robots of a cell file, in place; return the file."""
    before, first, second = path.read_text(encoding="utf-8").split(_TABLE, 2)
    path.write_text(f"{before}{_TABLE}{first}{tables}\n{_TABLE}{second}", encoding="utf-8")
    return path
