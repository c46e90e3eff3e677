"""The demo as it is told: lines, a bar for what moves, a closing table."""

from types import TracebackType
from typing import Self

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.text import Text

from cellcal.procedures.progress import StepProgress as Event
from cellcal.service.cli.printing import STDERR_CONSOLE, PlainTable
from cellcal.service.demo.report import DemoReport


class DemoPrinter:
    """Shows the story on standard error and its end on standard output."""

    def __init__(self, console: Console = STDERR_CONSOLE) -> None:
        self._console = console
        columns = (
            SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
            TimeElapsedColumn(),
        )  # fmt: skip
        self._bars = Progress(*columns, console=console, transient=True)
        self._task = self._bars.add_task("", total=None, visible=False)

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def print_line(self, line: str) -> None:
        """Tell one line."""
        self._bars.console.print(f"[bold cyan]▸[/] {escape(line)}", highlight=False)

    def on_event(self, event: Event) -> None:
        """Follow a run."""
        if event.kind == "started":
            self._bars.update(
                self._task, description=escape(event.step), completed=event.index - 1,
                total=event.expected or None, visible=True,
            )  # fmt: skip
        elif event.kind == "failed" and event.message != "CancelledError":
            self._bars.console.print(
                f"  [red]{escape(event.step)}: {escape(event.message)}[/]", highlight=False
            )
        elif event.kind == "ended":
            self._bars.update(self._task, visible=False)

    def close_with(self, report: DemoReport, console: Console | None = None) -> None:
        """Print the closing table: the claim beside the world's truth."""
        console = console or Console(highlight=False, emoji=False)
        console.print(_joint_table(report))
        before, after = report.tcp_error_before_m, report.tcp_error_after_m
        console.print(f"TCP error before: mean {before.mean * 1e3:8.3f} mm, max {before.max * 1e3:8.3f} mm")
        console.print(f"TCP error after:  mean {after.mean * 1e3:8.3f} mm, max {after.max * 1e3:8.3f} mm")
        for name, passed, sentence in report.gate:
            console.print(
                f"  [{'green' if passed else 'red'}]{'✓' if passed else '✗'}[/] {name}: {escape(sentence)}"
            )
        colour = "green" if report.verdict == "PASS" else "red"
        console.print(f"[bold {colour}]{report.verdict}[/] {escape(report.reason)}")
        console.print(f"detected by: {escape(report.detected_by)}")
        minutes, seconds = divmod(round(report.robot_time_s), 60)
        console.print(
            f"{report.captures} captures, joints turned for {minutes} min {seconds} s; story {report.seconds:.1f} s"
        )
        if report.clock is not None:
            console.print(report.clock.describe_time())


def _joint_table(report: DemoReport) -> PlainTable:
    table = PlainTable(
        "joint", "turns lost (truth)", "turns restored", "zero error (truth, deg)", "stated U k=2 (deg)",
        title="What was lost, what was restored", title_justify="left",
    )  # fmt: skip
    refused = report.verdict != "PASS"
    for joint in report.joints:
        exact = joint.offset_u_rad == 0.0
        same = joint.turns_lost == joint.turns_restored
        table.add_row(
            joint.name,
            f"{joint.turns_lost:+d}",
            "none"
            if refused
            else Text(f"{joint.turns_restored:+d}", style="green" if same or not exact else "red"),
            f"{np.rad2deg(joint.offset_error_rad):+.5f}",
            "no claim" if refused else "exact" if exact else f"{np.rad2deg(joint.offset_u_rad):.4f}",
        )
    return table
