"""The command line: one file a group of commands; heavy imports inside the commands."""

import asyncio
import logging
import os
import sys
import traceback
from collections.abc import Sequence
from importlib.metadata import version as installed_version

from cyclopts import App, CycloptsError
from rich.console import Console
from rich.markup import escape

from cellcal.calibration.errors import CellError
from cellcal.service.cli.alignments import alignments
from cellcal.service.cli.backup import backup, restore
from cellcal.service.cli.bench import bench
from cellcal.service.cli.cells import check, fakes
from cellcal.service.cli.certificate import certificate, verify
from cellcal.service.cli.demo import demo
from cellcal.service.cli.export import export
from cellcal.service.cli.identify import identify
from cellcal.service.cli.mastering import mastering
from cellcal.service.cli.models import models
from cellcal.service.cli.monitor import monitor
from cellcal.service.cli.outlook import procedures
from cellcal.service.cli.parameters import parameters
from cellcal.service.cli.people import people
from cellcal.service.cli.poses import poses
from cellcal.service.cli.program import program
from cellcal.service.cli.runs import resume, run, runs, show
from cellcal.service.cli.serve import serve
from cellcal.service.cli.simulate_cell import simulate_cell
from cellcal.service.cli.site import site
from cellcal.service.cli.watch import watch
from cellcal.service.cli.webhooks import webhooks
from cellcal.service.exit_codes import ExitCode, exit_code_of

app = App(
    name="cellcal",
    help="Bring a robot cell's zero positions, tool, frames and kinematics back to the truth.",
    version=installed_version("cellcal"),
    version_flags=["--version"],
    help_format="plaintext",
    result_action="return_value",
    suppress_keyboard_interrupt=False,  # what is interrupted is said by us, with our exit code
)
for command in (
    demo,
    fakes,
    check,
    watch,
    serve,
    people,
    site,
    monitor,
    webhooks,
    procedures,
    run,
    runs,
    show,
    resume,
    certificate,
    verify,
    backup,
    restore,
    export,
    mastering,
    alignments,
    simulate_cell,
    identify,
    models,
    poses,
    parameters,
    program,
    bench,
):
    app.command(command)


def run_command_line(arguments: Sequence[str]) -> int:
    """Run one command and return its exit code; an error becomes a sentence, never a trace.

    Standard output carries results only; progress, logs and errors go to standard error.
    """
    logging.basicConfig(level=logging.WARNING, stream=sys.stderr, format="%(levelname)s: %(message)s")
    for library in ("pymodbus", "can", "canopen"):  # the drivers turn what matters into errors of ours
        logging.getLogger(library).setLevel(logging.CRITICAL)
    console = Console(stderr=True)
    try:
        result = app(list(arguments), exit_on_error=False, print_error=True, error_console=console)
    except CycloptsError:
        return ExitCode.USAGE
    except BrokenPipeError:
        return _reader_has_gone()
    except (Exception, KeyboardInterrupt, BaseExceptionGroup) as error:  # noqa: BLE001  the last line of defence
        return _say(console, *_leaves(error), of_a_run=list(arguments)[:1] in (["run"], ["resume"]))
    return int(result) if isinstance(result, int) else ExitCode.PASS


def _reader_has_gone() -> int:
    """`cellcal runs | head` is no fault: end as quietly as other commands do."""
    sys.stdout = open(os.devnull, "w")  # noqa: SIM115, PTH123  what is left in the buffer goes nowhere
    return ExitCode.PASS


def _leaves(error: BaseException) -> list[BaseException]:
    if isinstance(error, BaseExceptionGroup):
        return [leaf for inner in error.exceptions for leaf in _leaves(inner)]
    return [error]


def _say(console: Console, *errors: BaseException, of_a_run: bool) -> int:
    for error in errors:
        if isinstance(error, CellError):
            console.print(f"[bold red]{escape(error.message)}[/]", highlight=False)
            if error.remedy:
                console.print(f"[bold]What to do:[/] {escape(error.remedy.strip())}", highlight=False)
        elif isinstance(error, OSError) and error.filename is not None:
            console.print(
                f"[bold red]{escape(str(error.filename))}: {escape(str(error.strerror))}.[/]", highlight=False
            )
            console.print("[bold]What to do:[/] Give a path that exists and may be read and written.")
        elif isinstance(error, KeyboardInterrupt | asyncio.CancelledError):
            more = "; `cellcal resume last --cell CELL` goes on with it" if of_a_run else ""
            console.print(f"Cancelled. All that was stored is kept{more}.")
        else:
            console.print(
                f"[bold red]Internal error:[/] {escape(repr(error))}. This is our bug; please report it."
            )
            traceback.print_exception(error)
    return exit_code_of(errors[0])
