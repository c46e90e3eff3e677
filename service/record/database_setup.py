"""The first statements on a database file that another process may be opening or closing at the same moment.

To change a file to write-ahead logging, or to recover what a killed process left, SQLite needs the file alone. It
then answers "database is locked" at once and does not wait as ``busy_timeout`` says (sqlite.org/wal.html,
"Sometimes queries return SQLITE_BUSY in WAL mode").
"""

import sqlite3
import time
from collections.abc import Iterable, Sequence
from typing import Any, Protocol

from cellcal.calibration.message import make_message

DURABLE = (  # what is committed survives a power cut
    "PRAGMA busy_timeout=5000",
    "PRAGMA journal_mode=WAL",
    "PRAGMA synchronous=FULL",
    "PRAGMA trusted_schema=OFF",
)
_PATIENCE_S = 10.0
_PAUSE_S = 0.02


class SqlRows(Protocol):
    """The rows that a statement returns."""

    def fetchall(self) -> list[Any]: ...


class SqlDatabase(Protocol):
    """The part of a sqlite3 connection (autocommit) that is used; tests give the journal a failing disk."""

    def execute(self, sql: str, parameters: Sequence[Any] = ..., /) -> SqlRows: ...
    def close(self) -> None: ...


def primary_code(error: sqlite3.Error) -> int:
    """Return SQLite's primary result code, which extended codes have in their low byte; 0 for Python's own errors."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF


def prepare_database(database: SqlDatabase, statements: Iterable[str]) -> None:
    """Execute statements in order, each again while the file is locked, for ten seconds at most.

    Raises
    ------
    sqlite3.Error
        A statement failed, or the file stayed locked.
    """
    ends_s = time.monotonic() + _PATIENCE_S
    for statement in statements:
        while True:
            try:
                database.execute(statement).fetchall()
                break
            except sqlite3.OperationalError as error:
                if primary_code(error) not in (
                    sqlite3.SQLITE_BUSY,
                    sqlite3.SQLITE_LOCKED,
                ):
                    raise
                if time.monotonic() > ends_s:
                    raise
            time.sleep(_PAUSE_S)


def find_foreign_rules(database: SqlDatabase) -> str:
    """Return the first view, trigger or virtual table of a database: our own have none.

    A view may yield rows without end, and a trigger changes what is stored later.
    """
    rows = database.execute(
        "SELECT type, name FROM sqlite_schema WHERE type IN ('view', 'trigger') OR sql LIKE 'CREATE VIRTUAL %'"
    ).fetchall()
    if not rows:
        return ""
    kind, name = rows[0]
    return make_message("it holds the {kind} {name!r}", kind=kind, name=str(name)[:60])
