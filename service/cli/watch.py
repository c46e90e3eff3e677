"""``cellcal watch``: follow a cell's encoders, and recover or offer it."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from service.configuration.cell_file import CellConfig
    from service.watching.watch import PositionLoss


def watch(cell: Path, /) -> int:
    """Follow the encoders of a cell until interrupted; on a loss offer the recovery, or run it where allowed.

    Keep it running while the robot is healthy: what it saw last narrows a recovery to a few turns.

    Parameters
    ----------
    cell
        The cell file (TOML); [watch] gives the period and whether a recovery may be started alone.
    """
    import asyncio

    from service.cli.printing import EN_ROUTE
    from service.configuration.cell_file import read_cell_file
    from service.watching.follow import Listener, follow

    config = read_cell_file(cell)

    async def on_loss(loss: "PositionLoss") -> None:
        EN_ROUTE.print(f"[bold red]{loss.robot} {loss.suspicion.headline}:[/] {loss.detected_by}")
        await _recover_or_offer(config, loss)

    EN_ROUTE.print("Watching. Ctrl+C ends it.")
    asyncio.run(follow(config, Listener(EN_ROUTE.print, on_loss)))
    return 0


async def _recover_or_offer(config: "CellConfig", loss: "PositionLoss") -> None:
    from service.cli.printing import EN_ROUTE
    from service.cli.runs import run_live, tell
    from service.watching.answers_to_loss import journal_detection, prepare_answer
    from service.watching.loss_modes import LossMode

    entry = journal_detection(config, loss)
    answer = prepare_answer(config, loss)
    likely = "Most likely " * (loss.suspicion.mode is not LossMode.UNKNOWN) + loss.suspicion.mode
    EN_ROUTE.print(f"{likely}: {loss.suspicion.words}. Journalled as {entry}.")
    if answer.procedure is None:
        EN_ROUTE.print("[bold]What to do:[/] compare the serial numbers; nothing is started for this robot.")
    elif not answer.starts_alone:
        EN_ROUTE.print(f"Not started alone: {'; '.join(answer.reasons)}.", markup=False)
        EN_ROUTE.print(f"[bold]What to do:[/] look at the robot, then: {answer.command}")
    else:
        EN_ROUTE.print("The cell file allows it: the recovery starts, and asks where hands are needed.")
        outcome = await run_live(config, answer.procedure, loss.robot, answer.settings, None)
        tell(outcome, config, as_json=False)
