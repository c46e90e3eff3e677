"""A cancellation that a library lost ends a supervised loop all the same."""

import asyncio
import contextlib

from cellcal.drivers.supervision import raise_lost_cancellation, supervise


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
