"""A run that is killed while it writes leaves no file half written, and the next run clears its drafts away."""

import signal
import subprocess
import sys
from pathlib import Path

from cellcal.service.engineering.programs.files import OutputFolder, whole_file

KILLED = """
import os, signal, sys
from pathlib import Path
from cellcal.service.engineering.programs.files import whole_file
with whole_file(Path(sys.argv[1]), replace=True) as file:
    file.write(b"half")
    file.flush()
    os.kill(os.getpid(), signal.SIGKILL)
"""


def killed_while_writing(path: Path) -> None:
    ended = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
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
