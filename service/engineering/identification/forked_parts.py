"""The parts of an identification shared out among the processors, by processes that are forked at its beginning."""

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from multiprocessing.reduction import ForkingPickler
from typing import Any, Protocol, TypeVar

from cellcal.calibration.identification.work_parts import PartRunner
from cellcal.service.engineering.forked_processes import prepare_process, processor_count

Result = TypeVar("Result")
_SHOWN_EVERY_S = 0.1


class WorkDisplay(Protocol):
    """Shows what is being done, and how many of the parts that are known so far are done."""

    def show_stage(self, text: str) -> None:
        """Show what the work is about from now on."""

    def show_parts(self, done: int, begun: int) -> None:
        """Show how far the parts are; called again and again while they are waited for."""


class NoDisplay:
    """Shows nothing."""

    def show_stage(self, text: str) -> None:
        """Show nothing."""

    def show_parts(self, done: int, begun: int) -> None:
        """Show nothing."""


class ForkedRunner:
    """Carries out parts in processes; a part whose process was ended from outside is carried out in this one."""

    def __init__(self, pool: ProcessPoolExecutor, display: WorkDisplay) -> None:
        self._pool, self._display = pool, display
        self._parts: list[Future[object]] = []

    def submit(self, function: Callable[..., Result], /, *arguments: object) -> Callable[[], Result]:
        """Begin a part, as soon as a process is free."""
        here = partial(function, *arguments)
        try:
            # Packed here: the pool's own thread would do so later, while this one goes on and changes what it holds.
            part: Future[Result] = self._pool.submit(_carry_out, bytes(ForkingPickler.dumps(here)))
        except BrokenProcessPool:
            return here
        self._parts.append(part)  # type: ignore[arg-type]  # looked at for its end only
        return partial(self._wait_for, part, here)

    def show_stage(self, text: str) -> None:
        """Pass it on."""
        self._display.show_stage(text)
        self._show_parts()

    def _wait_for(self, part: "Future[Result]", here: Callable[[], Result]) -> Result:
        while not wait([part], _SHOWN_EVERY_S).done:
            self._show_parts()
        self._show_parts()
        try:
            return part.result()
        except BrokenProcessPool:  # memory was full, perhaps: one part at a time needs less
            return here()

    def _show_parts(self) -> None:
        self._display.show_parts(sum(part.done() for part in self._parts), len(self._parts))


def _carry_out(packed: bytes) -> Any:
    return ForkingPickler.loads(packed)()


class DisplayedRunner:
    """Carries out parts one after the other in this process, and shows how far they are."""

    def __init__(self, display: WorkDisplay) -> None:
        self._display = display
        self._begun = self._done = 0

    def submit(self, function: Callable[..., Result], /, *arguments: object) -> Callable[[], Result]:
        """Put a part off."""
        self._begun += 1
        return partial(self._carry_out, partial(function, *arguments))

    def show_stage(self, text: str) -> None:
        """Pass it on."""
        self._display.show_stage(text)

    def _carry_out(self, part: Callable[[], Result]) -> Result:
        result = part()
        self._done += 1
        self._display.show_parts(self._done, self._begun)
        return result


@contextmanager
def share_parts(display: WorkDisplay) -> Iterator[PartRunner]:
    """Give what carries out parts, on all processors where the system can fork this process safely.

    Other threads must not run in this process: a lock that another thread has at the moment of forking is never
    released in the forked process.
    """
    processors = processor_count()
    can_fork = "fork" in multiprocessing.get_all_start_methods() and threading.active_count() == 1
    if processors < 2 or not can_fork:
        yield DisplayedRunner(display)
        return
    import_module("scipy.special")  # takes half a second: once, before each process would do it
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(processors, multiprocessing.get_context("fork"), prepare_process)
    pool.submit(os.getpid).result()  # all are forked with the first part, before any thread begins
    forked = set(multiprocessing.active_children()) - others
    finished = False
    try:
        yield ForkedRunner(pool, display)
        finished = True
    finally:
        if not finished:  # their work has no receiver
            for process in forked:
                process.kill()  # one that is not prepared yet would not take another signal
        pool.shutdown(cancel_futures=True)
