"""One daemon thread that does blocking calls in turn; it may be abandoned and never holds up the process."""

import asyncio
import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

T = TypeVar("T")
_Job = tuple[Callable[[], Any], asyncio.Future[Any]]


class CallWorker:
    """Runs what it is given, one after the other."""

    def __init__(self, name: str) -> None:
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run_jobs, name=name, daemon=True)
        self._thread.start()

    async def run_call(self, call: Callable[[], T]) -> T:
        """Return what ``call`` returns or raises. Cancelling leaves the call to end in its own time."""
        future: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        self._jobs.put((call, future))
        return await future

    def stop(self) -> None:
        """Let the thread end after what it is doing. Does not wait."""
        self._jobs.put(None)

    def join(self, seconds: float) -> bool:
        """Wait for the end; return whether it came."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def _run_jobs(self) -> None:
        while (job := self._jobs.get()) is not None:
            call, future = job
            if future.cancelled():
                continue
            result: Any = None
            failure: BaseException | None = None
            try:
                result = call()
            except BaseException as error:  # noqa: BLE001 - handed to the caller, whatever it is
                failure = error
            with suppress(RuntimeError):  # the loop may have ended meanwhile
                future.get_loop().call_soon_threadsafe(_deliver_result, future, result, failure)


def _deliver_result(future: asyncio.Future[Any], result: Any, failure: BaseException | None) -> None:
    if future.cancelled():
        return
    if failure is None:
        future.set_result(result)
    else:
        future.set_exception(failure)
