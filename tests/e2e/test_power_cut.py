"""What the journal acknowledged survives a power cut; without syncing it would not."""

import json
import random
import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import apsw

from cellcal.service.record.journal import Journal
from tests.e2e.power_cut.disk import DiskVfs, SimulatedDisk

CUTS = 300
EVENTS = 30


class ApswDatabase:
    """Gives the journal an SQLite that runs on a simulated disk."""

    def __init__(self, disk: SimulatedDisk, name: str, *, synchronous: str | None) -> None:
        self._vfs = DiskVfs(name, disk)
        self._synchronous = synchronous
        self._connection = apsw.Connection("journal.db", vfs=name)
        self.execute("PRAGMA locking_mode=EXCLUSIVE")  # WAL without shared memory

    def execute(self, sql: str, parameters: Sequence[Any] = (), /) -> "ApswDatabase":
        if self._synchronous is not None:
            sql = sql.replace("synchronous=FULL", f"synchronous={self._synchronous}")
        try:
            self._rows = list(self._connection.execute(sql, tuple(parameters)))
        except (apsw.CorruptError, apsw.NotADBError) as error:
            raise _sqlite_error(sqlite3.DatabaseError, error) from error
        except apsw.Error as error:
            raise _sqlite_error(sqlite3.OperationalError, error) from error
        return self

    def fetchall(self) -> list[Any]:
        return self._rows

    def close(self) -> None:
        try:
            self._connection.close()
        finally:
            self._vfs.unregister()


def _sqlite_error(kind: type[sqlite3.Error], error: apsw.Error) -> sqlite3.Error:
    translated = kind(str(error))
    translated.sqlite_errorcode = error.extendedresult if hasattr(error, "extendedresult") else 0
    return translated


def _write_until_dark(disk: SimulatedDisk, name: str, synchronous: str | None) -> list[tuple[str, int]]:
    """Append events until the power fails; return what was acknowledged."""
    acknowledged: list[tuple[str, int]] = []
    database = None
    try:
        database = ApswDatabase(disk, name, synchronous=synchronous)
        journal = Journal(Path("journal.db"), connect=lambda _: database)
        for n in range(EVENTS):
            run_id = f"run-{n % 2}"
            journal.append(run_id, "finding", {"n": n, "raw": "ab" * (n * 37 % 400)}, key=str(n))
            acknowledged.append((run_id, n))
    except Exception:
        assert disk.cut_at is not None  # nothing else may fail
    finally:
        _close_in_the_dark(database)
    return acknowledged


def _close_in_the_dark(database: ApswDatabase | None) -> None:
    try:
        if database is not None:
            database.close()
    except Exception:  # a dead machine closes nothing
        return


def _journal_survives(disk: SimulatedDisk, name: str, acknowledged: list[tuple[str, int]]) -> bool:
    """Whether the journal is whole and holds everything acknowledged, once."""
    database = ApswDatabase(disk, name, synchronous=None)
    try:
        journal = Journal(Path("journal.db"), connect=lambda _: database)
        found = [(event.run_id, json.loads(event.body)["n"]) for event in journal.list_events()]
        return journal.damage is None and found[: len(acknowledged)] == acknowledged
    except Exception:
        return False
    finally:
        database.close()


def lost_in(cuts: int, seed: int, synchronous: str | None) -> int:
    """Return in how many of so many power cuts an acknowledged event was lost or the journal damaged."""
    whole = SimulatedDisk()
    _write_until_dark(whole, f"whole-{seed}", synchronous)
    lost = 0
    for cut in range(cuts):
        rng = random.Random(f"{seed}/{cut}")
        disk = SimulatedDisk(cut_at=rng.randrange(1, whole.operations))
        acknowledged = _write_until_dark(disk, f"cut-{seed}-{cut}", synchronous)
        lost += not _journal_survives(disk.after_the_cut(rng), f"found-{seed}-{cut}", acknowledged)
    return lost


def test_the_journal_on_the_simulated_disk_is_the_real_one() -> None:
    database = ApswDatabase(SimulatedDisk(), "same", synchronous=None)
    journal = Journal(Path("journal.db"), connect=lambda _: database)
    assert database.execute("PRAGMA journal_mode").fetchall() == [("wal",)]
    assert database.execute("PRAGMA synchronous").fetchall() == [(2,)]
    journal.close()


def test_nothing_acknowledged_is_lost_in_300_power_cuts() -> None:
    assert lost_in(CUTS, seed=1, synchronous=None) == 0


def test_the_same_cuts_without_syncing_lose_or_damage() -> None:
    cuts = 100
    assert lost_in(cuts, seed=2, synchronous="OFF") > cuts / 2


def test_the_same_cuts_with_normal_syncing_lose_what_was_acknowledged() -> None:
    cuts = 100
    assert lost_in(cuts, seed=3, synchronous="NORMAL") > cuts / 2
