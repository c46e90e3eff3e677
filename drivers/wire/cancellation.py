"""Work that must reach its end although its caller is cancelled, a stop above all; and work that must end."""

import asyncio
import contextvars
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, TypeVar

_Result = TypeVar("_Result")


async def run_to_end(work: Coroutine[Any, Any, _Result] | asyncio.Future[_Result]) -> _Result:
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
    return task.result()


async def run_in_thread_to_end(function: Callable[..., _Result], *arguments: Any) -> _Result:
    """Run a function in a thread and return only when the thread is done with it, also when we are cancelled.

    A cancelled ``asyncio.to_thread`` leaves its thread at work: a file is then written after its writer has ended.
    The thread's future is awaited itself and not through a task, which the end of the loop would cancel.
    """
    call = partial(contextvars.copy_context().run, function, *arguments)
    return await run_to_end(asyncio.get_running_loop().run_in_executor(None, call))


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
