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

from cellcal.procedures.progress import StepProgress as Event
from cellcal.service.cli.printing import STDERR_CONSOLE


@contextmanager
def live_progress(title: str) -> Iterator[Callable[[Event], None]]:
    """Show a run; give the callback that takes its events."""
    if not STDERR_CONSOLE.is_terminal:
        yield _print_line
        return
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=STDERR_CONSOLE, transient=True) as bars:
        task = bars.add_task(title, total=None)

        def on_event(event: Event) -> None:
            done = event.index if event.kind in ("finding", "replayed") else event.index - 1
            bars.update(
                task, description=f"{title}: {event.step}", completed=done, total=event.expected or None
            )
            if event.kind in ("failed", "paused"):
                bars.console.print(
                    f"[red]{event.kind}[/] {escape(event.step)}: {escape(_describe_event(event))}"
                )

        yield on_event


def _print_line(event: Event) -> None:
    if event.kind in ("finding", "replayed", "failed", "paused"):
        text = f"{event.kind} {event.index}/{event.expected} {event.step} {_describe_event(event)}".rstrip()
        STDERR_CONSOLE.print(text, markup=False)


def _describe_event(event: Event) -> str:
    return "cancelled" if event.message == "CancelledError" else event.message
