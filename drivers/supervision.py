"""Supervision: what runs for as long as its process does is named when it fails, and is started again.

Every long-lived task and thread of this repository is begun here, and nowhere else: `tests/supervision` looks for
others in the source. A failure goes to the log with its cause and the next action, and into the register, which
pages, metrics and the site read. Between two starts there is a pause that grows; a task that fails at every start
is shown as such for as long as it does.
"""

import asyncio
import contextlib
import logging
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypedDict

from cellcal.calibration.errors import CellError

_log = logging.getLogger(__name__)
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.25, 4.0
SOUND_S = 30.0  # after so long without a failure the pause begins at the shortest again
_AFTER_S = 0.05
SHOWN_S = 60.0  # a failure that was overcome is shown for so long
REMEDY = "It is started again by itself. If this stays, send the log to the maker of the program."


class TroubleDocument(TypedDict):
    """The failures of a long-running task, as JSON."""

    task: str
    message: str
    remedy: str
    failures: int
    running: bool


@dataclass(frozen=True, slots=True)
class TaskTrouble:
    """An exception in a task: shown on pages, counted in metrics."""

    task: str
    message: str
    remedy: str
    failures: int  # one after the other
    running: bool  # whether it runs again

    def to_json(self) -> TroubleDocument:
        """Return it for a screen."""
        return {
            "task": self.task,
            "message": self.message,
            "remedy": self.remedy,
            "failures": self.failures,
            "running": self.running,
        }


@dataclass(slots=True)
class _TaskEntry:
    trouble: TaskTrouble | None = None
    failed_at_s: float = float("-inf")
    failures: int = 0  # one after the other
    total: int = 0
    running: bool = True
    gone: bool = False  # a link that failed, and has no other one under its name yet
    holder: "asyncio.Task[Any] | int | None" = None


class Supervisor:
    """The register of a process: which long-lived tasks there are, and what is wrong with them.

    Threads and the loop use it alike.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._entries: dict[str, _TaskEntry] = {}
        self._listeners: list[Callable[[], object]] = []

    def add_listener(self, changed: Callable[[], None]) -> Callable[[], None]:
        """Call ``changed`` after every change, in the loop that runs now; return what ends that."""
        loop = asyncio.get_running_loop()
        again: asyncio.TimerHandle | None = None

        def notify_listener() -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(change)

        def change() -> None:
            nonlocal again
            changed()
            if again is not None:
                again.cancel()
            left_s = self._shown_for_s()  # what is shown until then is to be shown no longer
            again = None if left_s is None else loop.call_later(left_s + _AFTER_S, change)

        def unlisten() -> None:
            self._listeners.remove(notify_listener)
            if again is not None:
                again.cancel()

        self._listeners.append(notify_listener)
        return unlisten

    def task_names(self) -> list[str]:
        """Return the tasks that are supervised just now."""
        with self._lock:
            return sorted(self._entries)

    def holder_of(self, name: str) -> "asyncio.Task[Any] | int | None":
        """Return the loop's task or the thread's identifier that does a task's work now; None where none does."""
        with self._lock:
            entry = self._entries.get(name)
            return None if entry is None or not entry.running else entry.holder

    def failure_counts(self) -> dict[str, int]:
        """Return how often each task has failed since this process began."""
        with self._lock:
            return {name: entry.total for name, entry in self._entries.items()}

    def list_troubles(self) -> list[TaskTrouble]:
        """Return what is wrong, and what was until a moment ago."""
        with self._lock:
            self._forget_old(self._clock())
            return [entry.trouble for entry in self._entries.values() if entry.trouble is not None]

    def note_start(self, name: str) -> None:
        """Note that a task runs."""
        with self._lock:
            entry = self._entries.setdefault(name, _TaskEntry())
            entry.running, entry.gone, entry.holder = True, False, _current_task()
            old = entry.trouble
            entry.trouble = None if old is None else _as_running(old)
        if old is not None:
            self._notify_listeners()

    def note_end(self, name: str) -> None:
        """Forget a task that ended because it was to."""
        with self._lock:
            gone = self._entries.pop(name, None)
        if gone is not None and gone.trouble is not None:
            self._notify_listeners()

    def note_failure(self, name: str, error: BaseException, *, running: bool = False) -> float:
        """Name a failure in the log and the register; return after which pause to go on [s]."""
        message, remedy = message_and_remedy_of(error)
        with self._lock:
            entry = self._entries.setdefault(name, _TaskEntry())
            now_s = self._clock()
            entry.failures = 1 if now_s - entry.failed_at_s > SOUND_S else entry.failures + 1
            entry.total += 1
            entry.failed_at_s, entry.running = now_s, running
            before, entry.trouble = (
                entry.trouble,
                TaskTrouble(name, message, remedy, entry.failures, running=running),
            )
            pause_s = min(FIRST_PAUSE_S * 2.0 ** min(entry.failures - 1, 10), LONGEST_PAUSE_S)
        if before is None or before.message != message:  # the same words each time would fill a disk
            _log.error("%s failed: %s %s", name, message, remedy, exc_info=_unexpected_error(error))
        self._notify_listeners()
        return pause_s

    def broke(self, name: str, error: BaseException) -> None:
        """Name the failure of one connection, whose link connects anew; without another one it is forgotten later."""
        self.note_failure(name, error, running=True)
        with self._lock:
            entry = self._entries[name]
            entry.gone, entry.holder = True, None

    def _forget_old(self, now_s: float) -> None:
        """Forget what was overcome a while ago, and links that failed then and never came back."""
        for name, entry in list(self._entries.items()):
            if entry.running and now_s - entry.failed_at_s >= SHOWN_S:
                entry.trouble = None
                if entry.gone:
                    del self._entries[name]

    def _shown_for_s(self) -> float | None:
        """Return after which time the next failure that was overcome is shown no longer; None where none is."""
        with self._lock:
            shown = [entry.failed_at_s for entry in self._entries.values() if entry.trouble and entry.running]
            return max(min(shown) + SHOWN_S - self._clock(), 0.0) if shown else None

    def _notify_listeners(self) -> None:
        for listener in list(self._listeners):
            try:
                listener()
            except Exception:  # noqa: BLE001  whatever it was, it is named and the others go on
                _log.exception("what shows troubles failed itself")


SUPERVISOR = Supervisor()


async def supervise(
    name: str, work: Callable[[], Awaitable[None]], register: Supervisor = SUPERVISOR
) -> None:
    """Do work until it returns or is cancelled; what it raises is named, and it is done anew."""
    while True:
        register.note_start(name)
        try:
            await work()
        except asyncio.CancelledError:
            if _is_cancelled():
                register.note_end(name)
                raise
            pause_s = register.note_failure(name, RuntimeError("it was cancelled from within"))
        except Exception as error:
            pause_s = register.note_failure(name, error)
            if _is_cancelled():  # what was raised while it left took the place of its cancellation
                register.note_end(name)
                raise asyncio.CancelledError from error
        else:
            register.note_end(name)
            return
        try:
            await asyncio.sleep(pause_s)
        except asyncio.CancelledError:
            register.note_end(name)
            raise


def raise_lost_cancellation() -> None:
    """Raise CancelledError where this task was cancelled and nothing came of it.

    ``asyncio.wait_for`` of Python 3.11 loses a cancellation that comes in the turn in which its work ends; an
    endless loop would go on.
    """
    if _is_cancelled():
        raise asyncio.CancelledError


def start_task(
    name: str, work: Callable[[], Awaitable[None]], register: Supervisor = SUPERVISOR
) -> asyncio.Task[None]:
    """Begin a long-lived task of the loop."""
    return asyncio.create_task(supervise(name, work, register), name=name)


def start_thread(
    name: str, work: Callable[[], None], leave: threading.Event, register: Supervisor = SUPERVISOR
) -> threading.Thread:
    """Begin a long-lived thread: its work is done anew when it raises, until it returns or ``leave`` is set."""
    thread = threading.Thread(
        target=_run_supervised, args=(name, work, leave, register), name=name, daemon=True
    )
    thread.start()
    return thread


def start_link_thread(name: str, work: Callable[[], None], broke: Callable[[str], None]) -> threading.Thread:
    """Begin the thread of one connection: what it raises is named and told to the link, which connects anew."""
    thread = threading.Thread(target=_serve_link, args=(name, work, broke), name=name, daemon=True)
    thread.start()
    return thread


def start_link_task(
    name: str, work: Callable[[], Awaitable[None]], broke: Callable[[Exception], None]
) -> asyncio.Task[None]:
    """Begin the task of one connection: what it raises is named and told to the link, which connects anew."""
    return asyncio.create_task(_serve_link_task(name, work, broke), name=name)


@contextlib.contextmanager
def log_failures(name: str, register: Supervisor = SUPERVISOR) -> Iterator[None]:
    """Name what is raised inside, and go on: for hearers whose failure must not stop the one who tells."""
    try:
        yield
    except Exception as error:  # noqa: BLE001  a failing listener must not stop the caller
        register.note_failure(name, error, running=True)


def message_and_remedy_of(error: BaseException) -> tuple[str, str]:
    """Return what happened and what to do, in words."""
    if isinstance(error, CellError):
        return str(error.message), error.remedy or REMEDY
    return f"{type(error).__name__}: {str(error)[:500]}", REMEDY


def _current_task() -> "asyncio.Task[Any] | int":
    try:
        task = asyncio.current_task()
    except RuntimeError:  # a thread without a loop
        task = None
    return threading.get_ident() if task is None else task


def _is_cancelled() -> bool:
    task = asyncio.current_task()
    return task is None or task.cancelling() > 0


def _as_running(trouble: TaskTrouble) -> TaskTrouble:
    return TaskTrouble(trouble.task, trouble.message, trouble.remedy, trouble.failures, running=True)


def _unexpected_error(error: BaseException) -> BaseException | None:
    return None if isinstance(error, CellError) else error


def _run_supervised(
    name: str, work: Callable[[], None], leave: threading.Event, register: Supervisor
) -> None:
    while not leave.is_set():
        register.note_start(name)
        try:
            work()
        except Exception as error:  # noqa: BLE001  whatever it was, it is named and the work is begun anew
            if leave.is_set():
                break
            leave.wait(register.note_failure(name, error))
        else:
            break
    register.note_end(name)


def _serve_link(name: str, work: Callable[[], None], broke: Callable[[str], None]) -> None:
    SUPERVISOR.note_start(name)
    try:
        work()
    except Exception as error:  # noqa: BLE001  whatever it was, the link is told and connects anew
        SUPERVISOR.broke(name, error)
        broke(message_and_remedy_of(error)[0])
    else:
        SUPERVISOR.note_end(name)


async def _serve_link_task(
    name: str, work: Callable[[], Awaitable[None]], broke: Callable[[Exception], None]
) -> None:
    SUPERVISOR.note_start(name)
    try:
        await work()
    except asyncio.CancelledError:
        SUPERVISOR.note_end(name)
        raise
    except Exception as error:  # noqa: BLE001  whatever it was, the link is told and connects anew
        SUPERVISOR.broke(name, error)
        broke(error)
    else:
        SUPERVISOR.note_end(name)
