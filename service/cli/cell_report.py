"""What ``cellcal identify`` prints of a cell: every series, the frames found, the arms, what stays unknown."""

from typing import TYPE_CHECKING

from cellcal.service.cli.display_units import DEGREES_PER_RADIAN, DISPLAY_UNITS
from cellcal.service.cli.identify_report import (
    COLOURS,
    HEADING,
    MOST_ROWS_SHOWN,
    print_dh,
    print_offsets,
    print_unknown,
)

if TYPE_CHECKING:
    from rich.console import Console

    from cellcal.service.cli.printing import PlainTable
    from cellcal.service.engineering.identification.cell_identify import IdentifiedCellReport


def print_cell_report(console: "Console", report: "IdentifiedCellReport") -> None:
    """Print the whole report but for what is asked for separately."""
    from rich.markup import escape

    found = report.identification
    _print_series(console, report)
    console.print(HEADING)
    for reason in found.level_reasons:
        console.print(f"  {escape(reason)}")
    for name, count in report.measurements.left_out:
        console.print(f"[yellow]note[/] {escape(name)}: {count} rows of the file lack its numbers")
    for effect in found.group_effects:
        console.print(f"[yellow]note[/] {escape(effect)}")
    for line in report.rejected[:MOST_ROWS_SHOWN]:
        console.print(f"[yellow]rejected[/] {escape(line.series)}, line {line.line}: {escape(line.reason)}")
    if len(report.rejected) > MOST_ROWS_SHOWN:
        console.print(f"… and {len(report.rejected) - MOST_ROWS_SHOWN} more rejected lines (see --json)")
    _print_frames(console, report)
    _print_parameters(console, report)
    freedom = found.robust.degrees_of_freedom
    console.print(f"[dim]95 % is {report.coverage_factor:.2f} sd ({freedom:.0f} degrees of freedom).[/]")
    print_unknown(console, found.not_identified)
    unknown = {item.parameter for item in found.not_identified}
    for pair in found.correlated[:MOST_ROWS_SHOWN]:
        if not {pair.first, pair.second} & unknown:
            console.print(
                f"[yellow]note[/] {escape(pair.first)} and {escape(pair.second)} can hardly be told apart "
                f"(correlation {pair.correlation:+.3f}): trust what they do together, not each."
            )
    _print_verdicts(console, report)
    console.print(f"{report.seconds:.1f} s")


def print_tables(console: "Console", report: "IdentifiedCellReport") -> None:
    """Print every arm as DH."""
    for arm in report.arms:
        print_dh(console, arm.dh, arm.name)


def _print_series(console: "Console", report: "IdentifiedCellReport") -> None:
    from cellcal.calibration.identification.parameters import LEVEL_NAMES
    from cellcal.service.cli.printing import PlainTable

    title = f"level {report.level}, {LEVEL_NAMES[report.level]}; RMSE in mm"
    table = PlainTable("series", "kind", "rows", "before", "held out", "fit", "sigma x", title=title)
    for series in report.series:
        judged = series.held_out.n > 0
        scales = ", ".join(f"{scale:.2f}" for scale in series.scale)
        table.add_row(
            series.name,
            series.kind,
            f"{series.rows - series.rejected} of {series.rows}",
            f"{series.before.rmse_m * 1e3:.3f}" if judged else "-",
            f"{series.held_out.rmse_m * 1e3:.3f}" if judged else "-",
            f"{series.fit.rmse_m * 1e3:.3f}",
            scales,
        )
    console.print(table)
    folds = any(series.held_out.n for series in report.series)
    if folds:
        console.print(
            "before: places fitted, arms nominal; held out: level and fit made anew without each fold of rows "
            "measured together; fit: residuals, not an accuracy; sigma x: what the device scatters, in stated sigmas."
        )


def _print_frames(console: "Console", report: "IdentifiedCellReport") -> None:
    from cellcal.service.cli.printing import PlainTable

    table = PlainTable("frame", "seen from", "x y z (mm)", "sd (mm)", "w x y z", "sd (deg)")
    for frame in report.frames:
        turned = any(frame.sigma[3:]) or frame.quaternion[0] < 1.0
        table.add_row(
            frame.name,
            frame.seen_from,
            " ".join(f"{value * 1e3:.3f}" for value in frame.position_m),
            " ".join(f"{value * 1e3:.3f}" for value in frame.sigma[:3]),
            " ".join(f"{value:.5f}" for value in frame.quaternion) if turned else "(a point)",
            " ".join(f"{value * DEGREES_PER_RADIAN:.4f}" for value in frame.sigma[3:]) if turned else "-",
        )
    console.print(table)


def _print_parameters(console: "Console", report: "IdentifiedCellReport") -> None:
    from cellcal.service.cli.printing import PlainTable
    from cellcal.service.engineering.identification.cell_findings import identified_numbers

    table = PlainTable("identified", "off nominal", "sd", "unit")
    rows, ripple_count = identified_numbers(report)
    for row in rows:
        _add_number_row(table, row.name, (row.deviation, row.sigma), row.unit)
    if table.row_count:
        console.print(table)
    if ripple_count:
        console.print(f"and {ripple_count} coefficients of ripple (`--json` lists them)")


def _add_number_row(table: "PlainTable", name: str, numbers: tuple[float, float], kind: str) -> None:
    unit, scale = DISPLAY_UNITS[kind]
    table.add_row(name, f"{numbers[0] * scale:+.4f}", f"{numbers[1] * scale:.4f}", unit)


def _print_verdicts(console: "Console", report: "IdentifiedCellReport") -> None:
    from rich.markup import escape

    for series in report.series:
        if series.verdict is not None:
            found = series.verdict
            console.print(
                f"[bold {COLOURS[found.verdict]}]{found.verdict.upper()}[/] held-out RMSE of "
                f"{escape(series.name)} {found.value * 1e3:.3f} mm (u {found.standard_uncertainty * 1e3:.3f}), "
                f"limit {found.limit * 1e3:g} mm; {found.rule}."
            )
    for arm in report.arms:
        if arm.offsets is not None:
            print_offsets(console, arm.offsets, f"{arm.name}: " if len(report.arms) > 1 else "")
