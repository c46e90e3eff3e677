"""The first statements on a database file that another process may be opening or closing at the same moment.

To change a file to write-ahead logging, or to recover what a killed process left, SQLite needs the file alone. It
then answers "database is locked" at once and does not wait as ``busy_timeout`` says (sqlite.org/wal.html,
"Sometimes queries return SQLITE_BUSY in WAL mode").
"""

import sqlite3
import time
from collections.abc import Iterable
from typing import Any, Protocol

_PATIENCE_S = 10.0
_PAUSE_S = 0.02


class Database(Protocol):
    """The part of a connection that is used here."""

    def execute(self, sql: str, /) -> Any:
        """Execute one statement."""
        ...


def prepare_database(database: Database, statements: Iterable[str]) -> None:
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
                if getattr(error, "sqlite_errorcode", 0) & 0xFF not in (
                    sqlite3.SQLITE_BUSY,
                    sqlite3.SQLITE_LOCKED,
                ):
                    raise
                if time.monotonic() > ends_s:
                    raise
            time.sleep(_PAUSE_S)
