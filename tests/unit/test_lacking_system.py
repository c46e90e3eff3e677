"""What a full disk, a container's nameless user and used-up descriptors end in: the cure that fits, no internal error."""

import errno
import getpass
import sqlite3
import sys
from pathlib import Path

import pytest

from cellcal.drivers.operator.terminal import TerminalOperator
from cellcal.service.exit_codes import ExitCode, exit_code_of
from cellcal.service.people import accounts, pin_hashing
from cellcal.service.people.accounts import AccountStore
from cellcal.service.people.errors import PeopleError
from cellcal.service.people.pin_hashing import pepper_of
from cellcal.service.unexpected_errors import log_in_lines


def test_a_user_without_a_name_may_run_procedures(monkeypatch: pytest.MonkeyPatch) -> None:
    def find_no_name() -> str:
        raise KeyError("getpwuid(): uid not found: 12345")

    monkeypatch.setattr(getpass, "getuser", find_no_name)
    assert TerminalOperator()._person.startswith("user ")


def test_used_up_descriptors_are_no_fault_of_ours() -> None:
    assert exit_code_of(OSError(errno.EMFILE, "Too many open files")) is ExitCode.REFUSED


@pytest.mark.parametrize(
    ("code", "cure"),
    [
        (sqlite3.SQLITE_FULL, "Make room"),
        (sqlite3.SQLITE_READONLY, "on a disk that may be written"),
        (sqlite3.SQLITE_NOTADB, "Restore it from a backup"),
    ],
)
def test_a_register_is_restored_only_where_it_is_damaged(
    code: int, cure: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> sqlite3.Connection:
        error = sqlite3.OperationalError("as the disk says")
        error.sqlite_errorcode = code
        raise error

    (tmp_path / "people.db").touch()
    monkeypatch.setattr(accounts.sqlite3, "connect", fail)
    with pytest.raises(PeopleError) as refused:
        AccountStore(tmp_path).list_people()
    assert cure in refused.value.remedy


def test_a_full_disk_for_the_pepper_is_no_matter_of_rights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(path: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(pin_hashing, "_create_pepper", fail)
    with pytest.raises(PeopleError) as refused:
        pepper_of(tmp_path)
    assert "Make room" in refused.value.remedy


def test_an_error_that_nothing_can_catch_is_one_line(caplog: pytest.LogCaptureFixture) -> None:
    class Falling:
        def __del__(self) -> None:
            raise RuntimeError("half made")

    before = sys.unraisablehook
    try:
        log_in_lines()
        Falling()
    finally:
        sys.unraisablehook = before
    assert [record.getMessage() for record in caplog.records] == [
        "an object could not be taken down: half made"
    ]
