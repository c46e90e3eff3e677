"""On a terminal each command that works or waits for long says at what, before it says anything else."""

import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest

CELL = Path(__file__).parents[2] / "deploy" / "example_cells" / "fanuc_draw_wire.toml"
CASES = {
    "poses": (["poses", "--robot", "ur10e", "--sigma-mm", "0.05", "--count", "8", "--candidates", "60"],
              ["looking at the robot", "drawing postures", "choosing poses", "comparing them", "not checked"]),
    "check": (["check", str(CELL)], ["asking the devices of the cell", "cell cell-7"]),
    "record": (["mastering", "record", "127.0.0.1:1"],
               ["reading the files of 127.0.0.1:1", "no FTP server answers"]),
}  # fmt: skip


def output_on_terminal(arguments: list[str]) -> str:
    """Return all that a command writes to a terminal, without what moves the cursor."""
    own, other = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120"}
    command = [sys.executable, "-m", "cellcal", *arguments]
    with subprocess.Popen(command, stdin=other, stdout=other, stderr=other, env=environment) as started:
        os.close(other)
        written = bytearray()
        try:
            while piece := os.read(own, 65536):
                written += piece
        except OSError:
            pass  # the command has closed the terminal's other end
        started.wait()
    os.close(own)
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", written.decode(errors="replace"))


@pytest.mark.parametrize("command", CASES)
def test_what_is_done_is_shown_before_the_result(command: str) -> None:
    arguments, words = CASES[command]
    output = output_on_terminal(arguments)
    places = [output.find(word) for word in words]
    assert -1 not in places, (words, output[:2000])
    assert places == sorted(places)
