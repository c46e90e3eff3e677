"""``cellcal demo``: a fake cell to try everything on, in a browser or as a story in the terminal."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, TextIO

from cyclopts import Parameter

from cellcal.service.cli.model_argument import ModelArgument

_SLOWEST, _FASTEST = 1.0, 2000.0  # beyond it a reading takes longer in the world than an arm may stand still
_IN_A_STORY, _ON_PAGES = 600.0, 20.0  # on pages a person wants to see the robot move


def demo(  # noqa: PLR0913  a command's options are its arguments
    *,
    headless: Annotated[bool, Parameter(negative=())] = False,
    port: int | None = None,
    browser: bool = True,
    loss: str | None = None,
    robot: ModelArgument | None = None,
    seed: int = 1,
    time_factor: float | None = None,
    keep: Path | None = None,
    as_json: Annotated[bool, Parameter(name="--json", negative=())] = False,
) -> int:
    """Try cellcal on a fake cell: lose its encoders, get its zero back, over real sockets.

    In a terminal it opens the pages in a browser and runs until Ctrl+C: a fake cell, the service, and a button for
    each kind of loss and fault. With --headless, --loss, --robot or --json, without a terminal, or where CI is set,
    it tells the main job as a story and ends by itself.

    Parameters
    ----------
    headless
        Tell the story in the terminal.
    port
        Serve the pages at this port of 127.0.0.1, with or without a terminal (8471, another where that is taken).
    browser
        Open a browser where there is a display.
    loss
        The story's loss: turns (battery; the usual one), motor:J1 … motor:J6 (motor exchanged), all (every
        reference gone), crash (arm bent), memory (the controller forgot), backup (an old one was loaded), swap
        (another arm).
    robot
        Tell the story on this six-axis robot (`cellcal models`, a model file or a description) in place of the
        demo's own; its gears, masses and stiffness are generic.
    seed
        The world's hidden truth; another seed is another robot.
    time_factor
        How much faster than real the world's clock runs (600 in a story, 20 with pages); the record before the
        story is taken fast in any case.
    keep
        Keep the cell file, the journal and the signed certificates in this folder.
    as_json
        Print one JSON object on standard output; the story goes to standard error.
    """
    import tempfile

    from cellcal.service.cli.printing import STDERR_CONSOLE

    _refuse_impossible(seed, time_factor, keep)
    with _drivers_without_warnings(), tempfile.TemporaryDirectory(prefix="cellcal-demo-") as scratch:
        folder = keep or Path(scratch)
        if not (headless or as_json or loss is not None or robot is not None) and is_for_pages(
            port, sys.stderr
        ):
            from cellcal.service.demo.built_pages import see_to_pages
            from cellcal.service.demo.demo_server import DemoOptions, show_wizard

            def print_line(line: str) -> None:
                STDERR_CONSOLE.print(line, markup=False, soft_wrap=True)

            if see_to_pages(print_line) or port is not None:
                show_wizard(folder, DemoOptions(seed, time_factor or _ON_PAGES, port, browser, print_line))
                return 0
        code = _run_headless(
            folder, (loss or "turns", robot), seed, time_factor or _IN_A_STORY, as_json=as_json
        )
    if keep is not None:
        _write_demo_certificate(keep)
    return code


@contextmanager
def _drivers_without_warnings() -> Iterator[None]:
    """Log errors of drivers only: that the firmware of a fake is unverified is no news."""
    import logging

    log = logging.getLogger("cellcal.drivers")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)


def is_for_pages(port: int | None, stream: TextIO) -> bool:
    """Whether an interactive terminal is present to show pages and take Ctrl+C."""
    in_ci = os.environ.get("CI", "").lower() not in ("", "0", "false")
    return port is not None or (stream.isatty() and not in_ci)


def _run_headless(
    folder: Path, speech: tuple[str, str | None], seed: int, time_factor: float, *, as_json: bool
) -> int:
    import asyncio

    from cellcal.service.cli.demo_output import DemoPrinter
    from cellcal.service.cli.printing import print_json
    from cellcal.service.demo.demo_arm import plan_demo_arm
    from cellcal.service.demo.recovery_demo import DemoScenario, fault_of, run_recovery_demo
    from cellcal.service.exit_codes import ExitCode

    loss, robot = speech
    fault_of(loss)  # a misspelt loss is said before anything starts
    arm = None if robot is None else plan_demo_arm(robot)
    with DemoPrinter() as printer:
        plot = DemoScenario(loss, seed, time_factor, printer.print_line, printer.on_event, arm)
        report = asyncio.run(run_recovery_demo(folder, plot))
    if as_json:
        print_json(report.as_object())
    else:
        printer.close_with(report)
    return ExitCode.PASS if report.verdict == "PASS" else ExitCode.REFUSED


def _write_demo_certificate(folder: Path) -> None:
    """Write the certificate of the recovery, or the record of its refusal, and say how to check it."""
    from cellcal.service.cli.certificate import issue_after_run
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.configuration.cell_file import read_cell_file

    issued = issue_after_run(read_cell_file(folder / "cell.toml"), "last")
    if issued is not None:
        check = f"cellcal verify {issued.json_path} --key {issued.key.public_key}"
        STDERR_CONSOLE.print(f"check it with:\n{check}", markup=False, soft_wrap=True)


def _refuse_impossible(seed: int, time_factor: float | None, keep: Path | None) -> None:
    from cellcal.calibration.errors import CellError

    if seed < 0:
        raise CellError(f"--seed {seed} is negative.", remedy="Give 0 or more.", code="usage")
    if time_factor is not None and not _SLOWEST <= time_factor <= _FASTEST:  # also what is not a number
        raise CellError(
            f"--time-factor {time_factor:g} is not possible.",
            remedy=f"Give {_SLOWEST:g} (real time) to {_FASTEST:g}.",
            code="usage",
        )
    if keep is not None and (keep / "cell.toml").exists():
        raise CellError(
            f"{keep} holds the cell of an earlier demo.", remedy="Give --keep another folder.", code="usage"
        )
