"""The command line: one file a group of commands; heavy imports inside the commands."""

import os
import select
import sys
from collections.abc import Sequence
from contextlib import suppress

from cyclopts import App, CycloptsError, Parameter
from rich.console import Console
from rich.text import Text

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import without_controls
from cellcal.service.cli.command_table import COMMAND_GROUPS
from cellcal.service.cli.overview import PURPOSE, VERSION_FLAG, read_version
from cellcal.service.exit_codes import ExitCode, exit_code_of
from cellcal.service.unexpected_errors import (
    describe_unexpected,
    explain_os_error,
    is_about_the_system,
    log_in_lines,
)

app = App(
    default_parameter=Parameter(negative_iterable=()),  # an option left out is empty already
    name="cellcal",
    help=PURPOSE,
    version=read_version,
    version_flags=[VERSION_FLAG],
    version_format="plaintext",  # the reader of Markdown takes a tenth of a second
    help_format="markdown",
    result_action="return_value",
    suppress_keyboard_interrupt=False,  # what is interrupted is said by us, with our exit code
)
for _, commands in COMMAND_GROUPS:  # each command is imported when it is called
    for entry in commands:
        app.command(f"cellcal.service.cli.{entry.target}", name=entry.name)
app.register_install_completion_command()


def run_command_line(arguments: Sequence[str]) -> int:
    """Run one command and return its exit code; an error becomes a sentence, never a trace.

    Standard output carries results only; progress, logs and errors go to standard error.
    """
    log_in_lines()
    console = Console(stderr=True, emoji=False)
    try:
        result = call_command(list(arguments), console)
    except CycloptsError:
        return ExitCode.USAGE
    except BrokenPipeError as error:
        return _reader_has_gone() if _lacks_reader() else _print_errors(console, error, of_a_run=False)
    except UnicodeEncodeError as error:
        if not any("\ud800" <= letter <= "\udfff" for letter in "".join(arguments)):
            return _print_errors(console, error, of_a_run=False)
        _print_refusal(console, "an argument is not text in UTF-8.", "Write it in the terminal's characters.")
        return ExitCode.USAGE
    except (Exception, KeyboardInterrupt, BaseExceptionGroup) as error:  # noqa: BLE001  the last line of defence
        return _print_errors(
            console, *_leaf_errors(error), of_a_run=list(arguments)[:1] in (["run"], ["resume"])
        )
    return int(result) if isinstance(result, int) else ExitCode.PASS


def call_command(arguments: list[str], console: Console) -> object:
    """Call the command that the arguments name and return what it returns."""
    if not arguments or arguments[0] in app.help_flags:
        app.resolved_commands()  # the list of commands shows the sentence of each
    return app(arguments, exit_on_error=False, print_error=True, error_console=console)


def _lacks_reader() -> bool:
    """Return whether it is our own output that nothing reads any more, and not a device's or a child's pipe."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            poll = select.poll()
            poll.register(stream.fileno(), 0)
            if any(events & select.POLLERR for _, events in poll.poll(0)):
                return True
    return False


def _reader_has_gone() -> int:
    """`cellcal runs | head` is no fault: end as quietly as other commands do, and as they do not with 0."""
    sys.stdout = open(os.devnull, "w")  # noqa: SIM115, PTH123  what is left in the buffer goes nowhere
    return ExitCode.NO_READER


def _leaf_errors(error: BaseException) -> list[BaseException]:
    if isinstance(error, BaseExceptionGroup):
        return [leaf for inner in error.exceptions for leaf in _leaf_errors(inner)]
    return [error]


def _print_errors(console: Console, *errors: BaseException, of_a_run: bool) -> int:
    for error in errors:
        if isinstance(error, CellError):
            _print_refusal(console, error.message, error.remedy)
        elif isinstance(error, OSError) and is_about_the_system(error):
            _print_refusal(console, *explain_os_error(error))
        elif exit_code_of(error) is ExitCode.CANCELLED:
            more = "; `cellcal resume last --cell CELL` goes on with it" if of_a_run else ""
            console.print(f"Cancelled. All that was stored is kept{more}.")
        else:
            _print_refusal(console, *describe_unexpected(error))
    return exit_code_of(errors[0])


def _print_refusal(console: Console, message: str, remedy: str) -> None:
    """Print what went wrong; text that cannot be written as UTF-8 is escaped."""
    for style, text in (("bold red", message), ("", remedy.strip() and f"What to do: {remedy.strip()}")):
        if text:
            safe = without_controls(text.encode("utf-8", errors="backslashreplace").decode())
            console.print(
                Text(safe, style=style), highlight=False, soft_wrap=True
            )  # commands can be copied whole
