"""A run that is killed while it writes leaves no file half written, and the next run clears its drafts away."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cellcal.service import draft_files
from cellcal.service.draft_files import draft_beside, remove_drafts_once, remove_left_behind
from cellcal.service.engineering.programs.files import OutputFolder, whole_file
from cellcal.service.files import replace_file

KILLED = """
import os, signal, sys
from pathlib import Path
from cellcal.service.engineering.programs.files import whole_file
with whole_file(Path(sys.argv[1]), replace=True) as file:
    file.write(b"half")
    file.flush()
    os.kill(os.getpid(), signal.SIGKILL)
"""
KILLED_BEFORE_RENAMING = """
import os, signal, sys
from pathlib import Path
from cellcal.service.files import replace_file
Path.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
replace_file(Path(sys.argv[1]), "half")
"""


def killed_while_writing(path: Path, code: str = KILLED) -> None:
    ended = subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    assert ended.returncode == -signal.SIGKILL


def test_what_a_killed_run_left_is_removed_by_the_next_one(tmp_path: Path) -> None:
    below = tmp_path / "cell" / "below"
    below.mkdir(parents=True)
    (below / "A.LS").write_bytes(b"old")
    killed_while_writing(below / "A.LS")
    assert (below / "A.LS").read_bytes() == b"old"
    assert len(list(below.iterdir())) == 2

    OutputFolder(tmp_path / "cell", ())

    assert [path.name for path in below.iterdir()] == ["A.LS"]


def test_drafts_of_a_run_that_goes_on_and_files_of_others_stay(tmp_path: Path) -> None:
    (tmp_path / ".cellcal-notes").write_text("a person's")
    (tmp_path / ".cellcal-elsewhere-1-0123456789abcdef").write_text("another computer's")
    with whole_file(tmp_path / "B.LS", replace=False) as file:
        file.write(b"new")
        OutputFolder(tmp_path, ())
    assert (tmp_path / "B.LS").read_bytes() == b"new"
    assert len(list(tmp_path.iterdir())) == 3


def test_the_data_of_a_cell_are_tidied_once_and_only_of_what_is_surely_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = tmp_path / "settings.json"
    settings.write_text("old")
    killed_while_writing(settings, KILLED_BEFORE_RENAMING)
    assert settings.read_text() == "old"
    (left,) = tmp_path.glob(".cellcal-*")
    remove_drafts_once(tmp_path)
    assert left.exists()  # it may be of a container whose processes are not seen
    os.utime(left, (0, 0))
    remove_drafts_once(tmp_path)
    assert left.exists()
    monkeypatch.setattr(draft_files, "_tidied", set())
    remove_drafts_once(tmp_path)
    assert list(tmp_path.iterdir()) == [settings]


def test_a_folder_of_records_or_of_copies_is_tidied_by_the_next_write_into_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(draft_files, "_tidied", set())
    key, deeper = tmp_path / "key.pem", tmp_path / "of_another" / "file"
    deeper.parent.mkdir()
    for path in (key, deeper):
        path.write_text("old")
        killed_while_writing(path, KILLED_BEFORE_RENAMING)
        (left,) = path.parent.glob(".cellcal-*")
        os.utime(left, (0, 0))
    replace_file(tmp_path / "next.json", "{}")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["key.pem", "next.json", "of_another"]
    assert list(deeper.parent.glob(".cellcal-*"))  # below it others may write


def test_a_folder_that_a_killed_restore_left_goes_and_what_lies_deeper_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "getpid", lambda: 2**22 + 1)  # above the highest that a system gives
    stage, deeper = Path(draft_beside(tmp_path / "x")), Path(draft_beside(tmp_path / "below" / "x"))
    for folder in (stage, deeper):
        folder.mkdir(parents=True)
        (folder / "signing_key.pem").write_text("secret")
    remove_left_behind(tmp_path, deep=False)
    assert (stage.exists(), deeper.exists()) == (False, True)
