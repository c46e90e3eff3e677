"""A cell's journal opened read only: the process that writes it is not disturbed."""

import sqlite3
from pathlib import Path


def read_only(path: Path) -> sqlite3.Connection:
    """Open a database that this process must not change."""
    database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, isolation_level=None)
    database.execute("PRAGMA busy_timeout=5000")
    database.execute("PRAGMA query_only=ON")
    database.execute("PRAGMA trusted_schema=OFF")
    return database


def journal_to_read(path: Path) -> sqlite3.Connection | None:
    """Open a cell's journal; None while there is none: no file, or one whose first writer has not got to its table.

    Raises
    ------
    sqlite3.Error
        It is there and cannot be read.
    """
    if not path.exists():
        return None
    database = read_only(path)
    begun = False
    try:
        begun = database.execute("SELECT 1 FROM sqlite_schema WHERE name = 'event'").fetchone() is not None
    finally:
        if not begun:
            database.close()
    return database if begun else None
