"""The journal keeps what it acknowledged, refuses what is not a fact, and betrays every edit."""

import random
import sqlite3
from pathlib import Path

import pytest

from cellcal.service.record.journal import Journal, NewEvent, StoreError


@pytest.fixture
def journal(tmp_path: Path):
    with Journal.open_file(tmp_path / "journal.db") as opened:
        yield opened


def test_an_event_comes_back_as_it_was_written(journal: Journal) -> None:
    stored = journal.append("run-1", "finding", {"value": 0.1, "name": "ä"}, key="a/1", actor="anna")
    assert journal.list_events() == [stored]
    assert stored.body == '{"name":"ä","value":0.1}'
    assert (stored.seq, stored.idx, stored.actor) == (1, 0, "anna")
    assert journal.head_hash() == stored.hash == stored.expected_hash()


def test_the_same_key_is_stored_once_and_another_fact_under_it_is_refused(journal: Journal) -> None:
    first = journal.append("run-1", "finding", {"n": 1}, key="touch 1/1")
    assert journal.append("run-1", "finding", {"n": 1}, key="touch 1/1") == first
    assert journal.append("run-2", "finding", {"n": 1}, key="touch 1/1") != first
    with pytest.raises(StoreError) as refused:
        journal.append("run-1", "finding", {"n": 2}, key="touch 1/1")
    assert refused.value.code == "store.conflict"
    assert len(journal.list_events()) == 2


def test_several_events_are_stored_together_or_not_at_all(journal: Journal) -> None:
    journal.append("run-1", "finding", {"n": 1}, key="taken")
    with pytest.raises(StoreError):
        journal.append_all("run-1", [NewEvent("end", {}), NewEvent("finding", {"n": 2}, "taken")])
    assert [event.kind for event in journal.list_events()] == ["finding"]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), object()])
def test_what_is_not_a_number_is_not_a_fact(journal: Journal, value: object) -> None:
    with pytest.raises(StoreError) as refused:
        journal.append("run-1", "finding", {"length_m": [1.0, value]})
    assert refused.value.code == "store.not_a_fact"
    assert journal.list_events() == []


def test_the_pragmas_that_make_it_durable_are_on(journal: Journal) -> None:
    ask = journal._database.execute
    assert ask("PRAGMA journal_mode").fetchall()[0][0] == "wal"
    assert ask("PRAGMA synchronous").fetchall()[0][0] == 2  # FULL
    assert ask("PRAGMA trusted_schema").fetchall()[0][0] == 0


def test_two_writers_share_one_chain(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    with Journal.open_file(path) as left, Journal.open_file(path) as right:
        for n in range(10):
            (left if n % 2 else right).append(f"run-{n % 3}", "finding", {"n": n})
        assert left.verify_chain() is None
        assert [event.seq for event in right.list_events()] == list(range(1, 11))
        assert [event.idx for event in right.list_events("run-0")] == [0, 1, 2, 3]


def _fill_journal(path: Path, count: int = 40) -> None:
    with Journal.open_file(path) as journal:
        for n in range(count):
            journal.append("run-1", "finding", {"n": n, "length_m": 1.5 + n / 7}, key=str(n))


def _edit_journal(path: Path, sql: str, *values: object) -> None:
    connection = sqlite3.connect(path)
    with connection:
        connection.execute(sql, values)
    connection.close()


@pytest.mark.parametrize(
    "sql",
    [
        """UPDATE event SET body = '{"length_m":9.0,"n":12}' WHERE seq = 13""",
        "UPDATE event SET kind = 'failed' WHERE seq = 13",
        "UPDATE event SET actor = 'eve' WHERE seq = 13",
        "UPDATE event SET mono_ns = mono_ns + 1 WHERE seq = 13",
        "UPDATE event SET hash = zeroblob(32) WHERE seq = 13",
        "DELETE FROM event WHERE seq = 13",
    ],
)
def test_an_edited_journal_opens_read_only_with_its_good_prefix(tmp_path: Path, sql: str) -> None:
    path = tmp_path / "journal.db"
    _fill_journal(path)
    _edit_journal(path, sql)
    with Journal.open_file(path) as journal:
        assert journal.damage is not None
        assert journal.damage.after_seq == 12
        assert len(journal.list_events()) == 12
        with pytest.raises(StoreError) as refused:
            journal.append("run-1", "finding", {})
    assert refused.value.code == "store.damaged"


def test_every_flipped_bit_of_a_row_is_found(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    _fill_journal(path, 5)
    with Journal.open_file(path) as journal:
        rows = journal.list_events()
    rng = random.Random(7)
    for _ in range(200):
        row = rng.choice(rows)
        place, bit = rng.randrange(len(row.body)), rng.randrange(7)
        flipped = row.body[:place] + chr(ord(row.body[place]) ^ 1 << bit) + row.body[place + 1 :]
        forged = type(row)(**{name: getattr(row, name) for name in row.__slots__} | {"body": flipped})
        assert forged.expected_hash() != row.hash


def test_a_file_that_is_no_database_is_damage_and_not_an_empty_journal(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    path.write_bytes(b"not a database at all " * 400)
    with Journal.open_file(path) as journal:
        assert journal.damage is not None
        assert journal.list_events() == []


def test_a_page_overwritten_in_the_file_is_found_on_opening(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    _fill_journal(path, 200)
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 4096] = bytes(4096)
    path.write_bytes(bytes(content))
    with Journal.open_file(path) as journal:
        assert journal.damage is not None
        assert len(journal.list_events()) <= 200


def test_a_full_disk_says_how_many_points_are_safe_and_keeps_them(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    with Journal.open_file(path) as journal:
        for n in range(4):
            journal.append("run-1", "finding", {"n": n})
        pages = journal._database.execute("PRAGMA page_count").fetchall()[0][0]
        journal._database.execute(f"PRAGMA max_page_count={pages}").fetchall()
        with pytest.raises(StoreError) as full:
            journal.append("run-1", "finding", {"samples": "x" * 100_000})
        assert full.value.code == "store.full"
        assert "your 4 points are safe" in str(full.value)
        with pytest.raises(StoreError):  # nothing more is accepted, not even what would fit
            journal.append("run-1", "finding", {"n": 5})
    with Journal.open_file(path) as journal:
        assert len(journal.list_events("run-1")) == 4
        assert journal.verify_chain() is None


@pytest.mark.parametrize("what", ["deleted", "moved", "replaced"])
def test_a_fact_for_a_file_that_was_taken_away_is_no_stored_fact(journal: Journal, what: str) -> None:
    journal.append("r", "started", {})
    moved = journal.path.with_name("moved.db")
    journal.path.rename(moved)
    if what == "deleted":
        moved.unlink()
    elif what == "replaced":
        Journal.open_file(journal.path).close()
    for _ in range(2):
        with pytest.raises(StoreError, match="was deleted, moved or replaced"):
            journal.append("r", "finding", {"n": 1})
