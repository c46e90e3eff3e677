"""One service per data folder, whatever ended the one before."""

import errno
import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cellcal.calibration.errors import CellError
from cellcal.service.exit_codes import ExitCode, exit_code_of
from cellcal.service.record.robot_lock import LeaseHeldError, acquire_lease, is_held
from cellcal.service.record.service_lock import LOCK_NAME, DataFolderInUseError, hold_data_folder

# The lock is all that is tried: a process that only holds it, and is killed.
_HOLDER = """
import fcntl, os, sys
file = os.open(sys.argv[1], os.O_RDWR | os.O_CREAT, 0o600)
fcntl.flock(file, fcntl.LOCK_EX)
os.write(file, b"cellcal serve at http://127.0.0.1:1 (process 1)\\n")
print("held", flush=True)
sys.stdin.read()
"""


def test_a_second_service_is_refused_with_the_name_of_the_first(tmp_path: Path) -> None:
    with (
        hold_data_folder(tmp_path / "data", "cellcal serve of a.toml at http://127.0.0.1:8470"),
        pytest.raises(DataFolderInUseError) as refused,
        hold_data_folder(tmp_path / "data", "another one"),
    ):
        pass
    who = f"cellcal serve of a.toml at http://127.0.0.1:8470 (process {os.getpid()} on "
    assert refused.value.message.startswith(who)
    assert str(tmp_path / "data") in refused.value.message
    assert "end that process" in refused.value.remedy
    assert exit_code_of(refused.value) == ExitCode.BUSY


def test_a_killed_service_leaves_the_folder_free(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-S", "-c", _HOLDER, str(tmp_path / LOCK_NAME)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline()
        with pytest.raises(DataFolderInUseError, match="process 1"), hold_data_folder(tmp_path, "next"):
            pass
        holder.kill()
        holder.wait()
        with hold_data_folder(tmp_path, "next"):
            assert (tmp_path / LOCK_NAME).read_text(encoding="utf-8").startswith("next (process ")


def test_a_disk_without_locks_is_told_as_such(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(descriptor: int, how: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(CellError, match="cannot lock files: No locks available"):
        hold_data_folder(tmp_path, "one").__enter__()
    with pytest.raises(CellError, match="cannot lock files") as refused:
        acquire_lease(tmp_path, "F-1", "one").__enter__()
    assert not isinstance(refused.value, LeaseHeldError)


def test_a_robot_is_looked_at_where_the_disk_has_become_read_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = os.open

    def open_to_read(path: Path, flags: int, mode: int = 0o777) -> int:
        if flags & (os.O_RDWR | os.O_WRONLY):
            raise OSError(errno.EROFS, "Read-only file system", str(path))
        return opened(path, flags, mode)

    with acquire_lease(tmp_path, "F-1", "one"):
        monkeypatch.setattr(os, "open", open_to_read)
        assert is_held(tmp_path, "F-1")
    assert not is_held(tmp_path, "F-1")


def test_a_lock_file_of_another_user_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, flags: int) -> int:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(CellError, match="cannot be seen: Permission denied"):
        is_held(tmp_path, "F-1")
