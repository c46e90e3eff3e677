"""Work for a client that may leave: it goes on only for as long as the client waits for the answer."""

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

from fastapi import Request

from cellcal.calibration.errors import CellError

Answer = TypeVar("Answer")


class ClientGoneError(CellError):
    """The client of a request has closed its connection."""

    code = "guard.gone"


async def answer_while_awaited(request: Request, work: Coroutine[Any, Any, Answer]) -> Answer:
    """Return what the work returns, or raise what it raises; cancel it when the client has gone.

    Raises
    ------
    ClientGoneError
        Nothing waits for the answer any more.
    """
    answering, leaving = asyncio.ensure_future(work), asyncio.ensure_future(_wait_for_leave(request))
    try:
        await asyncio.wait({answering, leaving}, return_when=asyncio.FIRST_COMPLETED)
        if not answering.done():
            raise ClientGoneError("the request broke off.")
        return answering.result()
    finally:
        for task in (answering, leaving):
            task.cancel()
        await asyncio.gather(answering, leaving, return_exceptions=True)


async def _wait_for_leave(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
