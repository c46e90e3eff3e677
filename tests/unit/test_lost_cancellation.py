"""A cancellation that a library lost ends a supervised loop all the same."""

import asyncio
import contextlib

from cellcal.drivers.supervision import raise_lost_cancellation, supervise
from cellcal.drivers.wire.cancellation import cancel_until_done


async def test_a_loop_ends_although_a_library_lost_its_cancellation() -> None:
    begun, rounds = asyncio.Event(), 0

    async def swallow_cancellation() -> None:
        nonlocal rounds
        while True:
            raise_lost_cancellation()
            rounds += 1
            begun.set()
            with contextlib.suppress(asyncio.CancelledError):  # as wait_for of Python 3.11 sometimes does
                await asyncio.sleep(3600.0)

    task = asyncio.create_task(supervise("a loop", swallow_cancellation))
    await begun.wait()
    task.cancel()
    await asyncio.wait({task})
    assert task.cancelled()
    assert rounds == 1


async def test_a_task_that_loses_cancellations_is_cancelled_until_it_ends() -> None:
    lost = 0

    async def lose_two_cancellations() -> None:
        nonlocal lost
        while True:
            try:
                await asyncio.Event().wait()
            except asyncio.CancelledError:
                lost += 1
                if lost > 2:
                    raise

    task, ended = asyncio.create_task(lose_two_cancellations()), asyncio.create_task(asyncio.sleep(0))
    await asyncio.sleep(0.01)
    await cancel_until_done(task, ended, every_s=0.01)
    assert task.cancelled()
    assert lost == 3
