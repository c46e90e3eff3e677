"""``cellcal watch``: follow a cell's encoders, and recover or offer it."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.markup import escape

if TYPE_CHECKING:
    from cellcal.service.configuration.cell_file import CellConfig
    from cellcal.service.watching.watch import PositionLoss


def watch(cell: Path, /) -> int:
    """Follow the encoders of a cell until interrupted; on a loss offer the recovery, or run it where allowed.

    Keep it running while the robot is healthy: what it saw last narrows a recovery to a few turns.

    Parameters
    ----------
    cell
        The cell file (TOML); [watch] gives the period and whether a recovery may be started alone.
    """
    import asyncio
    from functools import partial

    from cellcal.service.cli.printing import EN_ROUTE
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.watching.follow import Listener, Watches, follow

    config = read_cell_file(cell)

    async def on_loss(loss: "PositionLoss") -> None:
        EN_ROUTE.print(f"{loss.robot} {loss.suspicion.headline}:", style="bold red", markup=False, end=" ")
        EN_ROUTE.print(loss.detected_by, markup=False)
        await _recover_or_offer(config, loss)

    say = partial(EN_ROUTE.print, markup=False)
    EN_ROUTE.print("Watching. Ctrl+C ends it.")
    watches = Watches(config, on_loss, say)
    asyncio.run(follow(watches, Listener(say)))
    return 0


async def _recover_or_offer(config: "CellConfig", loss: "PositionLoss") -> None:
    from cellcal.service.cli.printing import EN_ROUTE
    from cellcal.service.watching.loss_modes import LossMode
    from cellcal.service.watching.loss_response import answer_to

    answer, entry = answer_to(config, loss)
    kept = f" Journalled as {entry}." if entry else ""
    likely = "Most likely " * (loss.suspicion.mode is not LossMode.UNKNOWN) + loss.suspicion.mode
    EN_ROUTE.print(f"{likely}: {loss.suspicion.words}.{kept}", markup=False)
    if answer.procedure is None:
        EN_ROUTE.print("[bold]What to do:[/] compare the serial numbers; nothing is started for this robot.")
    elif not answer.starts_alone:
        EN_ROUTE.print(f"Not started alone: {'; '.join(answer.reasons)}.", markup=False)
        EN_ROUTE.print(f"[bold]What to do:[/] look at the robot, then: {escape(answer.command)}")
    else:
        EN_ROUTE.print(
            "The cell file allows it: the recovery starts, and asks a person for what the file does not answer."
        )
        await _recover_alone(config, loss.robot, answer.procedure, answer.settings)


async def _recover_alone(config: "CellConfig", robot: str, procedure: str, settings: dict[str, Any]) -> None:
    """Run the recovery; whatever keeps it from ending is said, and the watch goes on."""
    from rich.markup import escape

    from cellcal.calibration.errors import CellError
    from cellcal.drivers.operator.terminal import TerminalOperator
    from cellcal.service.cli.printing import EN_ROUTE
    from cellcal.service.cli.progress import live_progress
    from cellcal.service.cli.run_end import tell
    from cellcal.service.runs.launch import Where, start
    from cellcal.service.watching.automatic_operator import StandingAnswers
    from cellcal.service.watching.loss_response import WATCH

    operator = StandingAnswers(config.watch, TerminalOperator())
    try:
        with live_progress(procedure) as show_event:
            outcome = await start(Where(config, operator, robot, show_event, WATCH), procedure, settings)
    except CellError as error:
        EN_ROUTE.print(f"[bold red]The recovery was not begun:[/] {escape(str(error))}")
        return
    tell(outcome, config, as_json=False)
