"""Work that must reach its end although its caller is cancelled, a stop above all; and work that must end."""

import asyncio
from collections.abc import Coroutine
from typing import Any


async def run_to_end(work: Coroutine[Any, Any, None]) -> None:
    """Run ``work``, which ends by its own deadline, to its end even when we are cancelled; then re-raise."""
    task = asyncio.ensure_future(work)
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.wait({task})
        except asyncio.CancelledError as error:
            cancelled = error
    if cancelled is not None:
        raise cancelled from task.exception()
    task.result()


async def cancel_until_done(*tasks: asyncio.Future[Any], every_s: float) -> None:
    """Cancel tasks, and again every so often, until all have ended; what they raise is theirs.

    One cancellation may be lost: ``asyncio.wait_for`` of Python 3.11 drops one that comes in the turn in which its
    work ends, and the task goes on to whatever it waits for next. ``every_s`` [s] leaves time to clean up.
    """
    open_tasks = {task for task in tasks if not task.done()}
    while open_tasks:
        for task in open_tasks:
            task.cancel()
        _, open_tasks = await asyncio.wait(open_tasks, timeout=every_s)
