"""``cellcal watch``: follow a cell's encoders, and recover or offer it."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.markup import escape

if TYPE_CHECKING:
    from cellcal.service.configuration.cell_file import CellConfig
    from cellcal.service.watching.watch import PositionLoss

Json = Annotated[
    bool, Parameter(name="--json", negative=(), help="With --once: print one JSON object on standard output.")
]


def watch(
    cell: Path,
    /,
    *,
    once: Annotated[bool, Parameter(negative=())] = False,
    accept: tuple[str, ...] = (),
    as_json: Json = False,
) -> int:
    """Follow the encoders of a cell until interrupted; on a loss offer the recovery, or run it where allowed.

    Keep it running while the robot is healthy: what it saw last narrows a recovery to a few turns.

    Parameters
    ----------
    cell
        The cell file (TOML); [watch] gives the period and whether a recovery may be started alone.
    once
        Look once at each robot and end, as for a timer at night. Exit code 0: all as before; 3: a position is or was
        lost, or a zero changed; 5: a robot was not read; 4: one was compared with nothing. The gravest counts.
    accept
        With --once: a robot whose present zero and log a person has judged to be right. A mastering record is
        answered by a new one only.
    """
    if once:
        return _look_once(cell, frozenset(accept), as_json=as_json)
    if accept or as_json:
        _refuse_without_once()
    import asyncio
    from functools import partial

    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.watching.follow import RobotListener, RobotWatches, follow_robots

    config = read_cell_file(cell)

    async def on_loss(loss: "PositionLoss") -> None:
        STDERR_CONSOLE.print(
            f"{loss.robot} {loss.suspicion.headline_text}:", style="bold red", markup=False, end=" "
        )
        STDERR_CONSOLE.print(loss.detected_by, markup=False)
        await _recover_or_offer(config, loss)

    say = partial(STDERR_CONSOLE.print, markup=False)
    STDERR_CONSOLE.print("Watching. Ctrl+C ends it.")
    watches = RobotWatches(config, on_loss, say)
    asyncio.run(follow_robots(watches, RobotListener(say)))
    return 0


def _refuse_without_once() -> None:
    from cellcal.calibration.errors import CellError

    raise CellError("--accept and --json belong to one look.", remedy="Give --once, too.", code="usage")


def _look_once(cell: Path, accept: frozenset[str], *, as_json: bool) -> int:
    import asyncio

    from cellcal.calibration.errors import CellError
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.watching.nightly_look import LookedAtRobot, look_at_cell, night_exit_code

    config = read_cell_file(cell)
    unknown = accept - {entry.name for entry in config.robots}
    if unknown:
        raise CellError(f"the cell file names no robot {', '.join(sorted(unknown))}.", code="usage")

    def report(each: LookedAtRobot) -> None:
        STDERR_CONSOLE.print(
            f"{each.robot}  {each.state.upper()}  {each.sentence}", markup=False, soft_wrap=True
        )

    found = asyncio.run(look_at_cell(config, accept=accept, report=report))
    if as_json:
        print_json(
            {"robots": [{"robot": one.robot, "state": one.state, "text": one.sentence} for one in found]}
        )
    return night_exit_code(found)


async def _recover_or_offer(config: "CellConfig", loss: "PositionLoss") -> None:
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.watching.loss_modes import LossMode
    from cellcal.service.watching.loss_response import answer_to

    answer, entry = answer_to(config, loss)
    journal_note = f" Journalled as {entry}." if entry else ""
    likely = "Most likely " * (loss.suspicion.mode is not LossMode.UNKNOWN) + loss.suspicion.mode
    STDERR_CONSOLE.print(f"{likely}: {loss.suspicion.words}.{journal_note}", markup=False)
    if answer.procedure is None:
        wrong = loss.suspicion.mode is LossMode.WRONG_ROBOT
        advice = "compare the serial numbers" if wrong else "mend it at the pendant, then run a drift check"
        STDERR_CONSOLE.print(f"[bold]What to do:[/] {advice}; nothing is started for this robot.")
    elif not answer.starts_unattended:
        STDERR_CONSOLE.print(f"Not started alone: {'; '.join(answer.reasons)}.", markup=False)
        STDERR_CONSOLE.print(f"[bold]What to do:[/] look at the robot, then: {escape(answer.command)}")
    else:
        STDERR_CONSOLE.print(
            "The cell file allows it: the recovery starts, and asks a person for what the file does not answer."
        )
        await _recover_unattended(config, loss.robot, answer.procedure, answer.settings)


async def _recover_unattended(
    config: "CellConfig", robot: str, procedure: str, settings: Mapping[str, object]
) -> None:
    """Run the recovery; whatever keeps it from ending is said, and the watch goes on."""
    from rich.markup import escape

    from cellcal.calibration.errors import CellError
    from cellcal.drivers.operator.terminal import TerminalOperator
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.cli.progress import live_progress
    from cellcal.service.cli.run_end import print_outcome
    from cellcal.service.runs.launch import RunTarget, start_run
    from cellcal.service.watching.automatic_operator import AutomaticOperator
    from cellcal.service.watching.loss_response import WATCH

    operator = AutomaticOperator(config.watch, TerminalOperator())
    try:
        with live_progress(procedure) as show_event:
            outcome = await start_run(
                RunTarget(config, operator, robot, show_event, WATCH), procedure, settings
            )
    except CellError as error:
        STDERR_CONSOLE.print(f"[bold red]The recovery was not begun:[/] {escape(str(error))}")
        return
    print_outcome(outcome, config, as_json=False)
