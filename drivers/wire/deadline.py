"""Everything waits with a deadline, and a missed one says what was waited for."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from types import TracebackType
from typing import Self

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceTimeoutError

_REMEDY = "Check the device, its cable, and address and port in the cell file, then try again."
_HALF_REMEDY = (
    "Something between cuts answers, or another kind of server answers there: compare over a cable straight to the "
    "controller, then look at firewall, proxy and address."
)
_LATE_S = 0.02  # a timer that comes later than that: this process stood still
_LAST_LOOK_S = 0.05  # what had come by then is taken in that time


class AnswerDeadline:
    """``asyncio.timeout`` for answers: one that came in time counts, also where this process was late to read it.

    After a standstill of the process the event loop reads the answer and ends the wait in the same turn, and the
    end would win. A limit that is late itself therefore lets the loop take first what has come.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._timeout = asyncio.timeout(None)

    async def __aenter__(self) -> Self:
        await self._timeout.__aenter__()
        self._loop = asyncio.get_running_loop()
        self._due_s = self._loop.time() + self._seconds
        self._timer = self._loop.call_at(self._due_s, self._end_limit)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._timer.cancel()
        await self._timeout.__aexit__(kind, error, trace)

    def has_expired(self) -> bool:
        """Whether the block was ended by this limit."""
        return self._timeout.expired()

    def _end_limit(self) -> None:
        now_s = self._loop.time()
        self._timeout.reschedule(now_s + (_LAST_LOOK_S if now_s - self._due_s > _LATE_S else 0.0))


@asynccontextmanager
async def answer_deadline(
    device: str, seconds: float, doing: str, *, is_half: Callable[[], bool] = lambda: False
) -> AsyncIterator[None]:
    """Raise DeviceTimeoutError when the block takes longer than ``seconds``.

    ``is_half`` tells then whether an answer has begun that did not end.
    """
    limit = AnswerDeadline(seconds)
    try:
        async with limit:
            yield
    except TimeoutError:
        if not limit.has_expired():
            raise
        raise timeout_error(device, seconds, doing, is_half=is_half()) from None


def timeout_error(device: str, seconds: float, doing: str, *, is_half: bool = False) -> DeviceTimeoutError:
    """Return the error of a device that did not come to an end in time, or that began an answer and stopped."""
    if is_half:
        return DeviceTimeoutError(
            device,
            make_message(
                "{doing}: an answer began and did not end within {seconds:.4g} s.",
                doing=doing,
                seconds=seconds,
            ),
            remedy=_HALF_REMEDY,
        )
    return DeviceTimeoutError(
        device,
        make_message("{doing} took longer than {seconds:.4g} s.", doing=doing, seconds=seconds),
        remedy=_REMEDY,
    )
