"""The stop of a robot after a step that failed, carried out to its end whatever is cancelled meanwhile."""

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

from cellcal.calibration.errors import CellError
from cellcal.procedures.cell import Cell

R = TypeVar("R")
STOP_DEADLINE_S = 5.0


async def finish_cleanup(work: Coroutine[Any, Any, R]) -> R:
    """Wait for a clean-up, whatever else is cancelled meanwhile."""
    cleaning = asyncio.ensure_future(work)
    while not cleaning.done():
        try:
            await asyncio.wait({cleaning})
        except asyncio.CancelledError:
            continue  # our caller raises it, once all is settled: the task counts its cancellations
    return cleaning.result()


async def stop_and_wait(cell: Cell) -> bool:
    """Stop the robot; False where it does not confirm within `STOP_DEADLINE_S`."""
    try:
        async with asyncio.timeout(STOP_DEADLINE_S):
            await cell.robot.stop()
    except (CellError, TimeoutError):
        return False
    return True
