"""A database file that another connection has alone for a moment is waited for."""

import sqlite3
import threading
from pathlib import Path

import pytest

from cellcal.service.record import database_setup
from cellcal.service.record.database_setup import prepare_database

STATEMENTS = ("PRAGMA journal_mode=WAL", "CREATE TABLE IF NOT EXISTS a(b INTEGER) STRICT")


class LockedTwice:
    """A connection whose first two statements find the file locked, as SQLite answers without waiting."""

    def __init__(self, database: sqlite3.Connection, other: sqlite3.Connection) -> None:
        self.database, self.other, self.refused = database, other, 0

    def execute(self, sql: str, /) -> sqlite3.Cursor:
        if self.refused < 2:
            self.other.execute("BEGIN EXCLUSIVE")
            try:
                return self.database.execute(sql)
            except sqlite3.OperationalError:
                self.refused += 1
                raise
            finally:
                self.other.execute("ROLLBACK")
        return self.database.execute(sql)


def test_a_file_that_is_locked_for_a_moment_is_waited_for(tmp_path: Path) -> None:
    first, other = (
        sqlite3.connect(tmp_path / "a.sqlite", isolation_level=None, timeout=0.0) for _ in range(2)
    )
    other.execute("CREATE TABLE there(a INTEGER)")
    locked = LockedTwice(first, other)
    prepare_database(locked, STATEMENTS)
    assert locked.refused == 2
    assert first.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    first.execute("INSERT INTO a VALUES (1)")


def test_a_file_that_stays_locked_and_a_wrong_statement_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(database_setup, "_PATIENCE_S", 0.0)
    first, other = (
        sqlite3.connect(tmp_path / "a.sqlite", isolation_level=None, timeout=0.0) for _ in range(2)
    )
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(sqlite3.OperationalError, match="locked"):
        prepare_database(first, STATEMENTS)
    other.execute("ROLLBACK")
    with pytest.raises(sqlite3.OperationalError, match="syntax"):
        prepare_database(first, ("CREATE NOTHING",))


def test_many_connections_may_begin_one_file_at_once(tmp_path: Path) -> None:
    failed: list[sqlite3.Error] = []

    def begin_file() -> None:
        try:
            database = sqlite3.connect(tmp_path / "a.sqlite", isolation_level=None)
            prepare_database(database, STATEMENTS)
            database.close()
        except sqlite3.Error as error:
            failed.append(error)

    threads = [threading.Thread(target=begin_file) for _ in range(12)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
