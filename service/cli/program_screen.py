"""Programs on the screen: summary first, worst first; nothing wider than the terminal."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from cellcal.service.cli.display_units import DEGREES_PER_RADIAN
from cellcal.service.cli.printing import STDERR_CONSOLE

if TYPE_CHECKING:
    from cellcal.service.engineering.programs.files import FoundPrograms, RefusedProgram
    from cellcal.service.engineering.programs.inspect import InspectedProgram, InspectionTotals
    from cellcal.service.engineering.programs.report import PointLine, ProgramsReport
    from cellcal.service.engineering.programs.report_sentences import ReportNote
    from cellcal.service.engineering.programs.versions import ProgramInCell

Item = TypeVar("Item")
_MOST_PROGRAMS = 40
_MOST_REFUSED = 20
_MOST_NOTES = 20
_LEGEND = (
    "beyond: points out of reach. misses: how far the real tip is from where the controller believes it, by the "
    "identified model. known: how surely that model knows the tip (k = 2). A name with ? is not known to the cell."
)
_VERSION = 8  # figures of a hash that are shown


@contextmanager
def counting_bar(
    title: str, total: int
) -> Iterator[Callable[[Callable[[Item], None]], Callable[[Item], None]]]:
    """Show a bar on a terminal's standard error while items are counted; give what makes a callback count."""
    if not STDERR_CONSOLE.is_terminal:
        yield lambda call: call
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=STDERR_CONSOLE, transient=True) as bars:
        task = bars.add_task(title, total=total)

        def count_calls(call: Callable[[Item], None]) -> Callable[[Item], None]:
            def call_and_count(item: Item) -> None:
                call(item)
                bars.advance(task)

            return call_and_count

        yield count_calls


def print_passed_over(found: "FoundPrograms") -> None:
    """Say which files of a folder look like programs by their suffix only, and which hold places unread."""
    from cellcal.service.engineering.programs.files import holds_unread_places
    from cellcal.service.engineering.programs.report_sentences import pluralize

    unread = [path for path in found.passed_over if holds_unread_places(path)]
    for paths, why in (
        ([path for path in found.passed_over if path not in unread], "no program inside"),
        (unread, "places in them are not read and stay"),
    ):
        if paths:
            names = ", ".join(path.name for path in paths[:5]) + (", …" if len(paths) > 5 else "")
            text = f"{pluralize(len(paths), 'file')} passed over, {why}: {names}"
            STDERR_CONSOLE.print(text, markup=False, soft_wrap=True)


@dataclass
class InspectionScreen:
    """Prints programs as they are inspected, and keeps of each what the summary needs."""

    as_json: bool
    points: bool
    _rows: list[tuple[str, ...]] = field(default_factory=list)
    _notes: list["ReportNote"] = field(default_factory=list)
    _tables: list[tuple[str, Table]] = field(default_factory=list)
    _first: bool = True

    def print_program(self, inspected: "InspectedProgram") -> None:
        """Take a program."""
        if self.as_json:
            sys.stdout.write('{"programs": [\n' if self._first else ",\n")
            sys.stdout.write(json.dumps(inspected.as_object(), allow_nan=False, ensure_ascii=False))
            self._first = False
            return
        self._rows.append(_inspected_row(inspected))
        self._notes += _notes_of(inspected)
        if self.points:
            self._tables.append((_name_of(inspected), _points_of(inspected)))

    def print_totals(self, totals: "InspectionTotals") -> None:
        """Print what is left to print."""
        if self.as_json:
            sys.stdout.write('{"programs": [' if self._first else "\n")
            rest = {
                "program_count": totals.programs,
                "point_count": totals.points,
                "out_of_reach": totals.out_of_reach,
                "not_identical": totals.not_identical,
                "refused": [_refused_object(one) for one in totals.refused],
            }
            sys.stdout.write(f"], {json.dumps(rest, ensure_ascii=False)[1:]}\n")
            return
        console = Console(highlight=False, emoji=False)
        from cellcal.service.engineering.programs.report_sentences import merge_notes, pluralize

        summary = f"{pluralize(totals.programs, 'program')}, {pluralize(totals.points, 'point')}"
        summary += f", {totals.out_of_reach} out of reach" if totals.out_of_reach else ""
        summary += f"; {pluralize(len(totals.refused), 'file')} refused" if totals.refused else ""
        bad = totals.exit_code != 0
        console.print(f"{summary}.", style="bold red" if bad else "bold", markup=False)
        _print_refused(console, totals.refused)
        if self._rows:
            console.print(_inspected_table(self._rows))
            if any(row[6] != "-" for row in self._rows):
                console.print(_LEGEND, markup=False)
        _print_notes(console, merge_notes(self._notes))
        for name, table in self._tables:
            console.print(f"\n{name}", style="bold", markup=False)
            console.print(table)


def print_report(report: "ProgramsReport", *, most: int, console: Console) -> None:
    """Print what became of programs."""
    from cellcal.service.engineering.programs.report_sentences import (
        accuracy_text,
        list_problems,
        verdict_text,
    )

    console.print(report.title, style="bold", markup=False)
    console.print(verdict_text(report), style="bold red" if report.exit_code else "bold green", markup=False)
    if accuracy_text(report):
        console.print(accuracy_text(report), markup=False)
    _print_refused(console, report.refused)
    if report.entries:
        console.print("\nPrograms, worst first: largest shift, largest expected error", style="bold")
        console.print(_programs_table(report))
    points = report.worst_first(most)
    if points:
        console.print(f"\nPoints, worst first: {len(points)} of {report.point_count}", style="bold")
        console.print(_points_table(points))
    _print_notes(console, list_problems(report))


def print_status(found: Sequence["ProgramInCell"], refused: Sequence["RefusedProgram"]) -> None:
    """Print which cell runs which version; what is not as it should be comes first."""
    from cellcal.service.engineering.programs.report_sentences import pluralize

    console = Console(highlight=False, emoji=False)
    bad = [one for one in found if not one.is_current]
    cells = len({one.cell for one in found})
    if found:
        summary = f"{pluralize(cells, 'cell')}, {pluralize(len(found), 'program')}: "
        summary += f"{len(bad)} not as in the master." if bad else "all as in the master."
        console.print(summary, style="bold red" if bad else "bold green", markup=False)
    _print_refused(console, refused)
    if not found:
        return
    table = _make_table(["cell", "program"], [])
    for name in ("state", "made from", "master has", "cloned on"):
        table.add_column(name, no_wrap=True)
    for one in sorted(found, key=lambda one: (one.is_current, one.cell, one.program)):
        versions = one.made_from_sha256[:_VERSION] or "-", one.master_sha256[:_VERSION]
        cells_of_row = (one.cell, one.program, one.state.value, *versions, one.made_at[:10] or "-")
        _add_row(table, cells_of_row, bad=not one.is_current)
    console.print(table)
    for one in found:
        if one.note:
            console.print(f"* {one.program} in {one.cell}: {one.note}", markup=False)


def status_as_object(
    found: Sequence["ProgramInCell"], refused: Sequence["RefusedProgram"]
) -> dict[str, object]:
    """Return the same for JSON."""
    return {
        "programs": [
            {
                "cell": one.cell,
                "program": one.program,
                "state": one.state.value,
                "ok": one.is_current,
                "made_from_sha256": one.made_from_sha256 or None,
                "master_sha256": one.master_sha256,
                "made_at": one.made_at or None,
                "note": one.note,
            }
            for one in found
        ],
        "refused": [_refused_object(one) for one in refused],
    }


def _programs_table(report: "ProgramsReport") -> Table:
    from cellcal.service.engineering.programs.report import largest_finite
    from cellcal.service.engineering.programs.result import CHANGED, LEFT, UNCHANGED

    entries = report.programs_worst_first()
    table = _make_table(["program"], ["points", "changed", "same", "left", "shift mm", "error mm"])
    for entry in entries[:_MOST_PROGRAMS]:
        counts = (entry.counts[CHANGED], entry.counts[UNCHANGED], entry.counts[LEFT])
        figures = largest_finite(entry.shift_m), largest_finite(entry.expected_m)
        cells = (str(len(entry.points)), *map(str, counts), *map(_format_mm, figures))
        _add_row(table, (entry.program, *cells), bad=bool(entry.counts[LEFT]))
    if len(entries) > _MOST_PROGRAMS:
        table.caption = f"{len(entries) - _MOST_PROGRAMS} more; --csv and --json hold all"
    return table


def _points_table(points: Sequence["PointLine"]) -> Table:
    table = _make_table(["program", "point"], ["line", "shift mm", "turn deg", "error mm"], ["left, because"])
    for point in points:
        figures = (
            str(point.line),
            _format_mm(point.shift_m),
            _format_deg(point.turn_rad),
            _format_mm(point.expected_m),
        )
        _add_row(table, (point.program, point.point, *figures, point.reason), bad=point.is_excluded)
    return table


def _inspected_row(inspected: "InspectedProgram") -> tuple[str, ...]:
    program, reach = inspected.program, inspected.reach
    return (
        _name_of(inspected),
        program.brand,
        str(len(program.positions)),
        _join_names(inspected.known_frames),
        _join_names(inspected.known_tools),
        str(len({text for text in program.positions.configurations if text})),
        "-" if reach is None else str(inspected.out_of_reach),
        "-" if reach is None else _format_mm(_largest_finite(reach.miss_m)),
        "-" if reach is None else _format_mm(_largest_finite(reach.expected_m)),
        {None: "", True: "yes", False: "NO"}[inspected.identical],
    )


def _inspected_table(rows: Sequence[tuple[str, ...]]) -> Table:
    heads = (
        "program",
        "brand",
        "points",
        "frames",
        "tools",
        "config.",
        "out of reach",
        "misses mm",
        "known mm",
    )
    printed = any(row[-1] for row in rows)
    shown = [i for i in range(len(heads)) if i < 6 or any(row[i] != "-" for row in rows)]
    table = Table(box=None, padding=(0, 1, 0, 0))
    for i in shown:
        table.add_column(heads[i], justify="right" if i in (2, 5, 6, 7, 8) else "left", overflow="fold")
    if printed:
        table.add_column("same bytes")
    for row in rows:
        _add_row(table, (*(row[i] for i in shown), *([row[-1]] if printed else [])), bad=False)
    return table


def _name_of(inspected: "InspectedProgram") -> str:
    from cellcal.service.engineering.programs.report import shown_name

    return shown_name(inspected.program.name, str(inspected.source.path))


def _points_of(inspected: "InspectedProgram") -> Table:
    heads = ["x mm", "y mm", "z mm"]
    reach = inspected.reach
    table = _make_table(["point"], heads, ["frame", "tool", "configuration"])
    if reach is not None:
        table.add_column("misses mm", justify="right")
        table.add_column("reach", overflow="fold")
    for i, point in enumerate(inspected.iter_points()):
        place = point["position_mm"] or [None] * 3
        cells = [_format_number(value) for value in place]
        words = [point["user_frame"] or "-", point["tool"] or "-", point["configuration"] or point["kind"]]
        reach_cells = [] if reach is None else [_format_mm(reach.miss_m[i]), reach.why[i] or "reached"]
        bad = reach is not None and bool(reach.failed[i])
        _add_row(table, (point["point"], *cells, *words, *reach_cells), bad=bad)
    return table


def _notes_of(inspected: "InspectedProgram") -> list["ReportNote"]:
    from cellcal.service.engineering.programs.report_sentences import ReportNote

    name = _name_of(inspected)
    notes = [ReportNote(name, remark.line, remark.text) for remark in inspected.program.remarks]
    if inspected.identical is False:
        notes.insert(
            0, ReportNote(name, 0, "printed other bytes than were read. This is our bug; please report it.")
        )
    return notes


def _print_refused(console: Console, refused: Sequence["RefusedProgram"]) -> None:
    from cellcal.service.engineering.programs.report_sentences import refusal_text

    for one in refused[:_MOST_REFUSED]:
        console.print(f"refused: {refusal_text(one)}", style="red", markup=False)
    if len(refused) > _MOST_REFUSED:
        console.print(f"{len(refused) - _MOST_REFUSED} more files refused.", style="red", markup=False)


def _print_notes(console: Console, notes: Sequence[str]) -> None:
    if notes:
        console.print("\nWhat to know before these programs run", style="bold", markup=False)
    for line in notes[:_MOST_NOTES]:
        console.print(f"* {line}", markup=False)
    if len(notes) > _MOST_NOTES:
        console.print(f"* {len(notes) - _MOST_NOTES} more such lines; JSON holds all.", markup=False)


def _make_table(words: Sequence[str], figures: Sequence[str], more: Sequence[str] = ()) -> Table:
    table = Table(box=None, padding=(0, 1, 0, 0), caption_justify="left")
    for name in words:
        table.add_column(name, overflow="fold")
    for name in figures:
        table.add_column(name, justify="right", overflow="fold")
    for name in more:
        table.add_column(name, overflow="fold")
    return table


def _add_row(table: Table, cells: Iterable[str], *, bad: bool) -> None:
    table.add_row(*map(escape, cells), style="red" if bad else "")  # names hold brackets


def _refused_object(one: "RefusedProgram") -> dict[str, str]:
    return {"file": one.file, "message": one.message, "remedy": one.remedy}


def _join_names(known_by_name: dict[str | None, bool]) -> str:
    return ", ".join(
        ("unsaid" if name is None else name) + ("" if there else "?") for name, there in known_by_name.items()
    )


def _largest_finite(figures: Any) -> float:
    from cellcal.service.engineering.programs.report import largest_finite

    return largest_finite(figures)


def _format_mm(value_m: float) -> str:
    return f"{value_m * 1e3:.3f}" if value_m == value_m else "-"  # noqa: PLR0124  NaN is not itself


def _format_deg(value_rad: float) -> str:
    return f"{value_rad * DEGREES_PER_RADIAN:.3f}" if value_rad == value_rad else "-"  # noqa: PLR0124


def _format_number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
