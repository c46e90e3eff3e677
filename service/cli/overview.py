"""What `cellcal`, `cellcal --help` and `cellcal --version` print: at once, without loading a command."""

import sys
import textwrap
from collections.abc import Iterator, Sequence
from shutil import get_terminal_size

from cellcal.service.cli.command_table import COMMAND_GROUPS

PURPOSE = "Bring a robot cell's zero positions, tool, frames and kinematics back to the truth."
HELP_FLAGS = ("--help", "-h")
VERSION_FLAG = "--version"
_OPTIONS = (
    ("--help, -h", "Show this overview, or behind a command its arguments."),
    (VERSION_FLAG, "Show the version."),
    ("--install-completion", "Let the shell complete commands, cells and robots."),
)
_USUAL_WIDTH = 80
_NARROWEST = 50
_WIDEST = 110


def read_version() -> str:
    """Return the version of the installed package."""
    from importlib.metadata import version

    return version("cellcal")


def answer_at_once(arguments: Sequence[str]) -> bool:
    """Print the overview or the version where the arguments ask for it; return whether it was printed.

    What cannot be written is left to the full command line, which says why.
    """
    if not arguments or (len(arguments) == 1 and arguments[0] in HELP_FLAGS):
        text = "\n".join(overview_lines(_terminal_width()))
    elif list(arguments) == [VERSION_FLAG]:
        text = read_version()
    else:
        return False
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except (OSError, ValueError, AttributeError):  # without a standard output there is no such object
        return False
    return True


def overview_lines(width: int) -> Iterator[str]:
    """Yield the lines that show every command with its sentence, by what a person wants to do."""
    yield "Usage: cellcal COMMAND [ARGUMENTS]"
    yield ""
    yield from textwrap.wrap(PURPOSE, width)
    for title, commands in COMMAND_GROUPS:
        yield ""
        yield title
        for command in commands:
            yield from _entry_lines(command.name, command.summary, width)
    yield ""
    yield "Options"
    for name, sentence in _OPTIONS:
        yield from _entry_lines(name, sentence, width)
    yield ""
    yield "`cellcal COMMAND --help` shows what a command takes. Begin with `cellcal demo`."


def _entry_lines(name: str, sentence: str, width: int) -> list[str]:
    column = 24
    return textwrap.wrap(
        sentence,
        width,
        initial_indent=f"  {name:{column - 2}}",
        subsequent_indent=" " * column,
        break_on_hyphens=False,
    )


def _terminal_width() -> int:
    return min(max(get_terminal_size((_USUAL_WIDTH, 0)).columns, _NARROWEST), _WIDEST)
