"""A run as it goes on, on standard error: a bar where there is a terminal, a line a step elsewhere."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
)

from cellcal.procedures.progress import Progress as Event
from cellcal.service.cli.printing import EN_ROUTE


@contextmanager
def live_progress(title: str) -> Iterator[Callable[[Event], None]]:
    """Show a run; give the callback that takes its events."""
    if not EN_ROUTE.is_terminal:
        yield _print_line
        return
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=EN_ROUTE, transient=True) as bars:
        task = bars.add_task(title, total=None)

        def update(event: Event) -> None:
            done = event.index if event.kind in ("finding", "replayed") else event.index - 1
            bars.update(
                task, description=f"{title}: {event.step}", completed=done, total=event.expected or None
            )
            if event.kind in ("failed", "paused"):
                bars.console.print(f"[red]{event.kind}[/] {escape(event.step)}: {escape(_told(event))}")

        yield update


def _print_line(event: Event) -> None:
    if event.kind in ("finding", "replayed", "failed", "paused"):
        text = f"{event.kind} {event.index}/{event.expected} {event.step} {_told(event)}".rstrip()
        EN_ROUTE.print(text, markup=False)


def _told(event: Event) -> str:
    return "cancelled" if event.message == "CancelledError" else event.message
