"""What `cellcal identify` and `cellcal poses` show while they work, on a terminal: a bar and what is being done."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from cellcal.service.cli.printing import STDERR_CONSOLE
from cellcal.service.engineering.identification.forked_parts import NoDisplay, WorkDisplay


class _BarDisplay:
    def __init__(self, bars: Progress, task: TaskID) -> None:
        self._bars, self._task = bars, task

    def show_stage(self, text: str) -> None:
        self._bars.update(self._task, description=text, refresh=True)

    def show_parts(self, done: int, begun: int) -> None:
        self._bars.update(self._task, completed=done, total=begun, refresh=True)


@contextmanager
def work_display(first_stage: str = "reading the measurements") -> Iterator[WorkDisplay]:
    """Show a bar on a terminal's standard error, nothing elsewhere.

    It is drawn anew by the work itself: a thread of its own would be in the way of processes that are forked.
    """
    if not STDERR_CONSOLE.is_terminal:
        yield NoDisplay()
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=STDERR_CONSOLE, transient=True, auto_refresh=False) as bars:
        display = _BarDisplay(bars, bars.add_task(first_stage, total=None))
        display.show_stage(first_stage)
        yield display
