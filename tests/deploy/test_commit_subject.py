"""The commit-msg check refuses long and missing subjects and a body without an empty line before it."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "deploy/commit_subject.py"


@pytest.mark.parametrize(
    ("message", "accepted"),
    [
        ("Add a driver\n\nBecause it was missing.\n", True),
        ("Add a driver", True),
        ("x" * 72, True),
        ("x" * 73, False),
        ("# only a comment\n", False),
        ("Add a driver\nBecause it was missing.\n", False),
    ],
)
def test_a_commit_message_is_accepted_or_refused(tmp_path, message, accepted):
    path = tmp_path / "COMMIT_EDITMSG"
    path.write_text(message, encoding="utf-8")
    done = subprocess.run([sys.executable, SCRIPT, path], capture_output=True, text=True, check=False)
    assert (done.returncode == 0) is accepted
    assert bool(done.stderr) is not accepted
