"""Keeps the tasks of the fake devices running: what one raises is named, and it goes on.

A fake that stops silently makes tests and demos wait for a device that is not simulated.
"""

import asyncio
import logging
from collections.abc import Awaitable, Callable

_LOG = logging.getLogger(__name__)
_PAUSE_S = 0.1


def keep_running(name: str, work: Callable[[], Awaitable[None]]) -> asyncio.Task[None]:
    """Begin a task that runs until it is cancelled or returns."""
    return asyncio.create_task(_keep_going(name, work), name=name)


async def _keep_going(name: str, work: Callable[[], Awaitable[None]]) -> None:
    while True:
        try:
            await work()
        except Exception:  # noqa: BLE001  whatever it was, it is named and the others go on
            _LOG.exception("%s failed and is begun again", name)
            task = asyncio.current_task()
            if task is not None and task.cancelling():  # raised while it left, in place of its cancellation
                return
            await asyncio.sleep(_PAUSE_S)
        else:
            return
