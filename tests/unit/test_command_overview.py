"""`cellcal --help` names every command with the sentence of its own help, and loads none of them."""

import subprocess
import sys

import pytest

from cellcal.service.cli.app import app
from cellcal.service.cli.command_table import COMMAND_GROUPS
from cellcal.service.cli.overview import overview_lines

ENTRIES = [entry for _, commands in COMMAND_GROUPS for entry in commands]


def test_each_command_has_the_first_sentence_of_its_own_help() -> None:
    commands = {name: each for name, each in app.resolved_commands().items() if not name.startswith("-")}
    assert commands.keys() == {entry.name for entry in ENTRIES}
    for entry in ENTRIES:
        own = " ".join(commands[entry.name].help.split("\n\n")[0].split())
        assert own == entry.summary, entry.name


@pytest.mark.parametrize("width", [50, 80, 110])
def test_the_overview_fits_the_terminal_and_names_every_command(width: int) -> None:
    lines = list(overview_lines(width))
    assert all(len(line) <= max(width, 80) for line in lines)
    assert all(any(line.startswith(f"  {entry.name} ") for line in lines) for entry in ENTRIES)


def test_neither_the_overview_nor_the_version_loads_what_reads_arguments() -> None:
    script = (
        "import sys; from cellcal.service.cli.overview import answer_at_once as answer;"
        "assert answer(['--help']) and answer([]) and answer(['--version']) and not answer(['demo', '--help']);"
        "sys.exit(sum(name in sys.modules for name in ('cyclopts', 'rich', 'numpy', 'pydantic')))"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
