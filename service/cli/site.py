"""``cellcal site enroll | router | publish``: the view of many cells from afar."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter

site = App(
    name="site", help="Let a site see its cells from afar. Nothing that is said there reaches a robot."
)
_FOLDER = Path("site")


@site.command
def enroll(*cell: str, folder: Path = _FOLDER, name: str = "", endpoint: str = "", listen: str = "") -> int:
    """Begin a site, and add cells to it: keys, certificates, rules. Nothing is ever written over.

    Parameters
    ----------
    cell
        Cell files of this computer, or ID=PUBLIC_KEY of cells elsewhere (`cellcal certificate key` prints it there).
    folder
        Where the site's files are kept.
    name
        The site's name, at its beginning.
    endpoint
        HOST:PORT as cells reach the site's router, at its beginning.
    listen
        HOST:PORT where the router listens, where that is another one (0.0.0.0:7447).
    """
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.site.enrolment import NewSite, enroll_cells, parse_applicant

    new = NewSite(name, endpoint, listen) if name or endpoint or listen else None
    made = enroll_cells(folder, [parse_applicant(word) for word in cell], new)
    for path in made:
        STDERR_CONSOLE.print(
            f"{path.name}: carry {path} to the cell's computer over a safe way and delete it here. In the cell file:"
            f'\n\\[site]\nfolder = "{path.name}"'
        )
    STDERR_CONSOLE.print(
        f"The router is started with `cellcal site router --folder {folder}`; one that runs takes new cells in. "
        f"Keep {folder / 'ca.key'} where no other person has access: its owner can add cells."
    )
    return 0


@site.command
def router(*, folder: Path = _FOLDER) -> int:
    """Host the site's router until interrupted: the only part of the site that listens.

    Parameters
    ----------
    folder
        The site's folder, or its router/ alone.
    """
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.site.link_files import ROUTER_FILE
    from cellcal.service.site.router import host_router

    with interrupt_event() as leave:
        host_router(
            part_of(folder, "router", ROUTER_FILE), leave, partial(STDERR_CONSOLE.print, markup=False)
        )
    return 0


@site.command
def publish(cell: Path, /, *, from_cell_process: Annotated[bool, Parameter(negative=())] = False) -> int:
    """Tell the site of a cell whose service does not run; `cellcal serve` does it by itself.

    Without a running service the site sees the journal: runs, certificates, drift. Joints and devices need
    the service.

    Parameters
    ----------
    cell
        The cell file (TOML) with a [site] table.
    from_cell_process
        Read the output of a cell process (`python -m cellcal.service.cell_process`) from standard input; end with it.
    """
    import sys

    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.site.publisher import run_publisher

    config = read_cell_file(cell)
    STDERR_CONSOLE.print(f"Telling the site of {config.cell.name}. Ctrl+C ends it.", markup=False)
    with interrupt_event() as leave:
        run_publisher(config, sys.stdin.buffer if from_cell_process else None, leave)
    return 0


def part_of(folder: Path, part: str, file: str) -> Path:
    """Return a part's folder from itself, or from the site's."""
    return folder if (folder / file).exists() else folder / part


@contextlib.contextmanager
def interrupt_event() -> Iterator[threading.Event]:
    """Yield an event that an interrupt or a request to end sets, so that sessions are closed: else nothing ends."""
    leave = threading.Event()

    def set_it(*_: Any) -> None:
        leave.set()

    before = {number: signal.signal(number, set_it) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield leave
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
