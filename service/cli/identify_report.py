"""What ``cellcal identify`` prints for people: the figures, why, what is doubtful, and what stays unknown."""

from typing import TYPE_CHECKING

from rich.markup import escape

from cellcal.service.cli.display_units import DISPLAY_UNITS
from cellcal.service.engineering.identification.identify_findings import (
    identified_rows,
    unknown_by_cure,
    unknown_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rich.console import Console

    from cellcal.calibration.identification.cross_validation import ErrorSummary
    from cellcal.calibration.identification.identifiability import NotIdentified
    from cellcal.calibration.identification.offset_acceptance import OffsetAcceptance
    from cellcal.calibration.identification.tip_uncertainty import HayatiTable
    from cellcal.service.cli.printing import PlainTable
    from cellcal.service.engineering.identification.identify import IdentifyReport
    from cellcal.service.engineering.identification.identify_at import TipsAt
    from cellcal.service.engineering.measured.usable_rows import RejectedRow

MOST_ROWS_SHOWN = 12
COLOURS = {"pass": "green", "fail": "red", "undecided": "yellow"}
HEADING = "RMSE of groups held out, and whether it is surely smaller:"
_ENDLESS = 1e6  # degrees of freedom: a number of them tells a reader nothing


def print_report(console: "Console", report: "IdentifyReport") -> None:
    """Print the whole report but for what is asked for separately."""
    from rich.markup import escape

    for guess in report.measurements.guesses:
        console.print(f"[dim]read: {escape(guess)}[/]")
    _print_errors(console, report)
    _print_reasons(console, report)
    for lint in report.lints:
        console.print(f"[yellow]note[/] {escape(lint.message)}")
    _print_rejected(console, report)
    _print_parameters(console, report)
    _print_verdicts(console, report)
    console.print(f"{report.seconds:.1f} s")


def _print_errors(console: "Console", report: "IdentifyReport") -> None:
    from cellcal.calibration.arm.shown_names import shown_name
    from cellcal.calibration.identification.parameters import LEVEL_NAMES
    from cellcal.service.cli.printing import PlainTable

    title = f"{shown_name(report.robot)}: {_describe_rows(report)}"
    table = PlainTable("errors (mm)", "rows", "RMSE", "mean", "95 %", "max", title=title)
    robot = "the nominal robot" if report.start == "nominal" else report.start
    level = f"{report.level}, {LEVEL_NAMES[report.level]}"
    described = report.described
    figures = (
        (f"before: base and tool fitted to {robot}", report.before),
        ("before, rows that the model describes", None if described is None else described.before),
        *held_out_figures(level, report.held_out, None if described is None else described.held_out),
        ("held out: and a residual model", report.with_residual),
        ("fit (residuals, not an accuracy)", report.fit),
        ("check file", report.check),
        ("check file: and a residual model", report.check_with_residual),
    )
    for title, errors in figures:
        if errors is not None:
            _add_error_row(table, title, errors)
    console.print(table)
    console.print(f"Held out by {escape(report.held_out_by)}.")


def held_out_figures(
    level: str, every: "ErrorSummary", described: "ErrorSummary | None"
) -> list[tuple[str, "ErrorSummary"]]:
    """Return held-out figures with their names: of the rows that the model describes, and with those put aside."""
    if described is None:
        return [(f"held out: level {level}", every)]
    return [
        (f"held out, rows that the model describes: level {level}", described),
        (f"held out, with {every.n - described.n} put aside: level {level}", every),
    ]


def _describe_rows(report: "IdentifyReport") -> str:
    from cellcal.service.engineering.measured.usable_rows import REPEAT

    usable = len(report.measurements.rows)
    if usable == report.rows:
        return f"{usable} rows"
    repeats = sum(row.kind == REPEAT for row in report.rejected)
    return f"{usable} usable rows of {report.rows}" + (f", {repeats} repeat another" if repeats else "")


def _print_reasons(console: "Console", report: "IdentifyReport") -> None:
    from rich.markup import escape

    found = report.identification
    levels = [str(level) for level in found.judgement.levels]
    if len(set(levels)) > 1:
        console.print(f"[dim]Without one fold each, the level would be {', '.join(levels)}.[/]")
    if report.breaks:
        rows = ", ".join(str(row) for row in report.breaks)
        console.print(f"[bold]The device was moved[/] before rows {rows} (the first data row is row 0).")
    reasons = (*found.break_reasons, *found.level_reasons)
    if reasons:
        console.print(HEADING)
    for reason in reasons:
        console.print(f"  {escape(reason)}")
    if found.residual is not None:
        chosen = "used" if found.residual.chosen else "not used"
        console.print(f"Residual model {chosen}: {escape(found.residual.reason)}")
        console.print(
            "It serves the figures here and `--at`: sets and `program compensate` hold the arm's parameters alone."
        )


def _add_error_row(table: "PlainTable", title: str, errors: "ErrorSummary") -> None:
    sizes = (errors.rmse_m, errors.mean_m, errors.p95_m, errors.max_m)
    table.add_row(title, str(errors.n), *(f"{size * 1e3:.3f}" for size in sizes))


def _print_rejected(console: "Console", report: "IdentifyReport") -> None:
    from cellcal.service.engineering.measured.usable_rows import ELSEWHERE, OUTLIER, REPEAT, UNREAD

    elsewhere = [row for row in report.rejected if row.kind == ELSEWHERE]
    unread = [row for row in report.rejected if row.kind == UNREAD]
    outliers = [row for row in report.rejected if row.kind == OUTLIER]
    repeats = [row for row in report.rejected if row.kind == REPEAT]
    if unread:
        console.print(f"[bold]{len(unread)} rows hold no reading[/] and take no part")
        _print_rows(console, unread)
    if elsewhere:
        console.print(
            f"[bold]{len(elsewhere)} rows of another series[/] take no part, nor do held-out errors count them"
        )
        _print_rows(console, elsewhere)
    if repeats:
        console.print(f"[bold]{len(repeats)} rows repeat another[/] to the last digit and count once")
        _print_rows(console, repeats)
    if outliers:
        console.print(
            f"[bold]{len(outliers)} rows rejected[/], not fitted; held-out errors are told with and without them"
        )
        _print_rows(console, outliers)


def _print_rows(console: "Console", rows: "list[RejectedRow]") -> None:
    from rich.markup import escape

    for item in rows[:MOST_ROWS_SHOWN]:
        console.print(f"  row {item.row}: {escape(item.reason)}")
    if len(rows) > MOST_ROWS_SHOWN:
        console.print(f"  … and {len(rows) - MOST_ROWS_SHOWN} more (`--json` lists all)")


def _print_parameters(console: "Console", report: "IdentifyReport") -> None:
    from rich.markup import escape

    from cellcal.service.cli.printing import PlainTable

    shown, ripple = identified_rows(report)
    if shown:
        table = PlainTable("identified", "off nominal", "sigma", "unit")
        for name, value, sigma, kind in shown:
            unit, scale = DISPLAY_UNITS[kind]
            table.add_row(name, f"{value * scale:+.4f}", f"{sigma * scale:.4f}", unit)
        console.print(table)
    if ripple:
        console.print(f"and {ripple} coefficients of ripple (`--json` lists them)")
    held_names = [p.name for p in report.parameters if p.held]
    if held_names:
        console.print(f"Held as in {escape(report.start)}: {len(held_names)} parameters.")
    console.print(f"[dim]{_coverage_sentence(report)}[/]")
    if report.identification.group_effect.said:
        console.print(f"[yellow]note[/] {escape(report.identification.group_effect.said)}")
    print_unknown(console, unknown_of(report))
    _print_correlated(console, report)


def _coverage_sentence(report: "IdentifyReport") -> str:
    """Return how many sigmas 95 % are, and why."""
    freedom = report.identification.robust.degrees_of_freedom
    few = freedom >= _ENDLESS
    why = "what few rows leave open is in the sigmas" if few else f"{freedom:.0f} degrees of freedom"
    return f"95 % is {report.coverage:.2f} sigma ({why})."


def print_unknown(console: "Console", items: "Iterable[NotIdentified]") -> None:
    """Print what is not identified, by cure, each with what it hides behind; equal answers need no cure."""
    from rich.markup import escape
    from rich.padding import Padding

    for cure, behind in unknown_by_cure(items).items():
        console.print(f"[bold]not identified[/]; cure: {escape(cure)}")
        for partner, names in behind.items():
            hidden = f", hidden behind {partner}" if partner else ""
            console.print(Padding(escape(", ".join(names) + hidden), (0, 0, 0, 2)))


def _print_correlated(console: "Console", report: "IdentifyReport") -> None:
    unknown = {item.parameter for item in report.identification.not_identified}
    if report.dh is not None:
        pairs = list(report.dh.correlated)
    else:
        pairs = [(p.first, p.second, p.correlation) for p in report.identification.correlated]
    for first, second, rho in pairs[:MOST_ROWS_SHOWN]:
        if not {first, second} & unknown:
            console.print(
                f"[yellow]note[/] {first} and {second} can hardly be told apart (correlation {rho:+.3f}): trust "
                "what they do together, not each."
            )


def _print_verdicts(console: "Console", report: "IdentifyReport") -> None:
    verdicts = report.verdicts
    if verdicts.error is not None:
        found = verdicts.error
        console.print(
            f"[bold {COLOURS[found.verdict]}]{found.verdict.upper()}[/] RMSE of {verdicts.judged} "
            f"{found.value * 1e3:.3f} mm (u {found.standard_uncertainty * 1e3:.3f}), limit "
            f"{found.limit * 1e3:g} mm; {found.rule}."
        )
    if verdicts.offsets is not None:
        print_offsets(console, verdicts.offsets)


def print_offsets(console: "Console", accepted: "OffsetAcceptance", of: str = "") -> None:
    """Print the verdict about joint offsets, and what would help."""
    deg = DISPLAY_UNITS["rad"][1]
    console.print(
        f"[bold {COLOURS[accepted.verdict]}]{accepted.verdict.upper()}[/] {of}standard deviations of joint offsets, "
        f"limit {accepted.limit_rad * deg:g} deg; {accepted.rule}."
    )
    for item in accepted.offsets:
        more = f": {item.more}" if item.more else ""
        console.print(
            f"  [{COLOURS[item.verdict]}]{item.verdict}[/] {item.parameter} {item.sigma_rad * deg:.4f} deg{more}"
        )


def print_tips(console: "Console", tips: "TipsAt", target: str = "target") -> None:
    """Print what is expected of the target at some points."""
    from cellcal.service.cli.printing import PlainTable

    title = f"{target} in the frame of the {tips.frame} (mm)"
    table = PlainTable("point", "x", "y", "z", "sigma", "95 %", title=title)
    for i, place in enumerate(tips.positions_m[:MOST_ROWS_SHOWN]):
        mark = " *" if i in tips.far or i in tips.outside else ""
        sizes = (tips.sigma_m[i], tips.expanded_m[i])
        table.add_row(f"{i}{mark}", *(f"{v * 1e3:.3f}" for v in place), *(f"{v * 1e3:.4f}" for v in sizes))
    console.print(table)
    for sentence in tips.statement:
        console.print(sentence, markup=False)
    if len(tips.positions_m) > MOST_ROWS_SHOWN:
        console.print(f"… and {len(tips.positions_m) - MOST_ROWS_SHOWN} more (`--at-csv` writes all)")


def print_dh(console: "Console", found: "HayatiTable | None", robot: str) -> None:
    """Print an identified arm as DH, with Hayati's beta where axes are parallel."""
    from cellcal.service.cli.printing import PlainTable

    if found is None:
        console.print(f"{robot} has no DH table.", markup=False)
        return
    table = PlainTable(f"DH of {robot}", "nominal", "identified", "change", "sigma", "unit")
    for entry in found.entries:
        unit, scale = DISPLAY_UNITS[entry.unit]
        change = entry.value - entry.nominal
        numbers = (entry.nominal * scale, entry.value * scale)
        table.add_row(
            entry.name,
            *(f"{v:.4f}" for v in numbers),
            f"{change * scale:+.4f}",
            f"{entry.sigma * scale:.4f}",
            unit,
        )
    console.print(table)
    console.print("[dim]beta stands for d where axes are parallel; the last row ends in the tool.[/]")
