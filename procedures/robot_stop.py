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
            continue  # `raise_if_cancelled` raises it, once all is settled
    return cleaning.result()


def raise_if_cancelled() -> None:
    """Raise CancelledError where this task was cancelled, also while a clean-up did not listen to it."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


async def stop_and_wait(cell: Cell) -> bool:
    """Stop the robot; False where it does not confirm within `STOP_DEADLINE_S`."""
    try:
        async with asyncio.timeout(STOP_DEADLINE_S):
            await cell.robot.stop()
    except (CellError, TimeoutError):
        return False
    return True
