"""``cellcal identify``: kinematic identification from a file of measurements."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from calibration.cross_validation import Errors
    from service.identify import IdentifyReport
    from service.measurements import ReadOptions

_MOST_ROWS_SHOWN = 12
_WIDER = "these postures hardly show them: measure over a wider range of these joints"


def identify(  # noqa: PLR0913  # a command's options are its arguments
    measurements: Path,
    /,
    *,
    robot: str,
    level: int | None = None,
    check: Path | None = None,
    train_rows: int | None = None,
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
    plot: Path | None = None,
    columns: tuple[str, ...] = (),
    units: tuple[str, ...] = (),
    convention: str = "",
    sheet: str | None = None,
    layout: Path | None = None,
    show_layout: bool = False,
    save: Path | None = None,
    serial: str = "",
    by: str = "",
    urdf: Path | None = None,
    geometric_joints: bool = False,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> int:
    """Identify a robot from measurements, and say how far the result can be believed.

    Parameters
    ----------
    measurements
        CSV or Excel file as the instrument wrote it: joints, and a length, position or pose per row.
    robot
        Nominal model; `cellcal models` lists them.
    level
        0 base and tool only, 1 mastering offsets, 2 geometry, 3 and sag, 4 and gear ripple. Chosen by
        cross-validation if not given.
    check
        Another file, on which the finished model is evaluated.
    train_rows
        Fit this many rows, drawn at random; all other rows are held out.
    seed
        Of the draw and of the folds.
    plot
        Folder for plots of the residuals (PNG and SVG).
    columns
        What a column is, where guessing fails: joints=q1,q2,… position=X,Y,Z length=L controller=… rotation=…
        group=…
    units
        Units, where guessing fails: joints=deg position=mm length=m controller=mm rotation=rad.
    convention
        Orientation convention of the measured attitude, or none.
    sheet
        Sheet of an Excel file.
    layout
        TOML file that names columns, units, orientation convention, joint coupling and groups.
    show_layout
        Print how the file is understood, as such a layout file, and stop.
    save
        Folder of parameter sets, in which the result becomes the robot's newest version; needs `--serial`, `--by`.
    serial
        Of the robot, for `--save`.
    by
        Who measured, for `--save`.
    urdf
        Write the identified arm as a URDF file.
    geometric_joints
        In that file, where the controller couples joints: angles against the link before.
    as_json
        Print one JSON object on standard output.
    """
    # Before numpy is imported: on matrices of this size a second BLAS thread only waits for the first.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from rich.console import Console

    from service.cli.printing import EN_ROUTE, print_json
    from service.identify import IdentifyOptions, identify_file
    from service.measurement_layouts import overlaid, read_layout
    from service.measurements import ReadOptions

    named = {key: tuple(value.split(",")) for key, value in _pairs(columns, "--columns").items()}
    read = ReadOptions(named, _pairs(units, "--units"), convention, sheet)
    if layout is not None:
        read = overlaid(read_layout(layout), read)
    if show_layout:
        return _show_layout(measurements, robot, read, as_json=as_json)
    outputs = _Outputs(save, serial, by, urdf, geometric_joints)
    outputs.check()
    report = identify_file(measurements, robot, IdentifyOptions(level, check, train_rows, seed, read))
    outputs.write(report, measurements)
    if plot is not None:
        from service.identify_plots import draw_identification

        for path in draw_identification(report, plot):
            EN_ROUTE.print(f"wrote {path}")
    if as_json:
        print_json(report.as_document())
    else:
        _print_report(Console(highlight=False), report)
    return 0


def _show_layout(measurements: Path, robot: str, read: "ReadOptions", *, as_json: bool) -> int:
    from rich.console import Console

    from calibration.kinematics import load_model
    from service.cli.printing import EN_ROUTE, print_json
    from service.measurement_layouts import layout_document, layout_text
    from service.measurements import read_measurements

    found = read_measurements(measurements, load_model(robot), read)
    document = layout_document(found, read)
    if as_json:
        usable = {"rows": found.read, "usable": len(found.rows), "guesses": list(found.guesses)}
        print_json({**document, **usable})
        return 0
    EN_ROUTE.print(f"{len(found.rows)} of {found.read} rows are usable.")
    for guess in found.guesses:
        EN_ROUTE.print(guess, markup=False, soft_wrap=True)
    Console(highlight=False, soft_wrap=True).print(layout_text(document), end="", markup=False)
    return 0


@dataclass(frozen=True, slots=True)
class _Outputs:
    """Files to write when the identification is done."""

    save: Path | None
    serial: str
    by: str
    urdf: Path | None
    geometric_joints: bool

    def check(self) -> None:
        """Refuse before the work rather than after it."""
        from service.measurement_table import MeasurementError

        if self.save is not None and not (self.serial and self.by):
            raise MeasurementError(
                "a parameter set belongs to one robot and to the person who measured it.",
                remedy="Give `--serial` and `--by`.",
            )

    def write(self, report: "IdentifyReport", measurements: Path) -> None:
        """Write them."""
        import datetime

        from service.cli.printing import EN_ROUTE
        from service.identify_outputs import save_identification, write_identified_urdf
        from service.parameter_files import Who

        if self.save is not None:
            now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
            made = save_identification(report, measurements, self.save, Who(self.serial, self.by, now))
            EN_ROUTE.print(f"saved version {made.version} of robot {made.robot_serial}", markup=False)
        if self.urdf is not None:
            missing = write_identified_urdf(report, self.urdf, geometric_joints=self.geometric_joints)
            without = f", without {' and '.join(missing)}, which a description cannot hold" if missing else ""
            EN_ROUTE.print(f"wrote {self.urdf}{without}", markup=False)


def _pairs(words: tuple[str, ...], option: str) -> dict[str, str]:
    from service.measurement_table import MeasurementError

    wrong = [word for word in words if "=" not in word]
    if wrong:
        raise MeasurementError(f"{option} {wrong[0]} has no '='.", remedy=f"Write {option} joints=….")
    return dict(word.split("=", 1) for word in words)


def _print_report(console: "Console", report: "IdentifyReport") -> None:
    from rich.markup import escape
    from rich.table import Table

    from calibration.parameters import LEVEL_NAMES

    for guess in report.measurements.guesses:
        console.print(f"[dim]read: {escape(guess)}[/]")
    table = Table(
        "errors (mm)", "rows", "RMSE", "mean", "95 %", "max", title=f"{report.robot}: {report.rows} rows"
    )
    _add(table, "before: base and tool fitted to the nominal robot", report.before)
    _add(table, f"held out: level {report.level}, {LEVEL_NAMES[report.level]}", report.held_out)
    _add(table, "fit (residuals, not an accuracy)", report.fit)
    if report.check is not None:
        _add(table, "check file", report.check)
    console.print(table)
    console.print(f"Held out by {report.held_out_by}.")
    levels = [str(level) for level in report.identification.judgement.levels]
    if len(set(levels)) > 1:
        console.print(f"[dim]Without one fold each, the level would be {', '.join(levels)}.[/]")
    if report.breaks:
        rows = ", ".join(str(row) for row in report.breaks)
        console.print(f"[bold]The device was moved[/] before rows {rows} (data rows counted from 0).")
    for reason in (*report.identification.break_reasons, *report.identification.level_reasons):
        console.print(f"  {escape(reason)}")
    for lint in report.lints:
        console.print(f"[yellow]note[/] {escape(lint.message)}")
    _print_rejected(console, report)
    _print_parameters(console, report)
    console.print(f"{report.seconds:.1f} s")


def _add(table: "Table", title: str, errors: "Errors") -> None:
    sizes = (errors.rmse_m, errors.mean_m, errors.p95_m, errors.max_m)
    table.add_row(title, str(errors.n), *(f"{size * 1e3:.3f}" for size in sizes))


def _print_rejected(console: "Console", report: "IdentifyReport") -> None:
    from rich.markup import escape

    if not report.rejected:
        return
    console.print(f"[bold]{len(report.rejected)} rows rejected[/]")
    for item in report.rejected[:_MOST_ROWS_SHOWN]:
        console.print(f"  row {item.row}: {escape(item.reason)}")
    if len(report.rejected) > _MOST_ROWS_SHOWN:
        console.print(f"  … and {len(report.rejected) - _MOST_ROWS_SHOWN} more (`--json` lists all)")


def _print_parameters(console: "Console", report: "IdentifyReport") -> None:
    from rich.table import Table

    scales = {
        "rad": ("deg", 57.29577951308232),
        "m": ("mm", 1e3),
        "rad/m": ("deg/m", 57.29577951308232),
        "1": ("ppm", 1e6),
    }
    unknown = {item.parameter for item in report.identification.not_identified}
    known = [p for p in report.parameters if p.name not in unknown and " ripple " not in p.name]
    if known:
        table = Table("identified", "value", "sigma", "unit")
        for parameter in known:
            unit, scale = scales[parameter.unit]
            table.add_row(
                parameter.name, f"{parameter.value * scale:+.4f}", f"{parameter.sigma * scale:.4f}", unit
            )
        console.print(table)
    _print_unknown(console, report)


def _print_unknown(console: "Console", report: "IdentifyReport") -> None:
    from rich.table import Table

    together: dict[tuple[str, str], list[str]] = {}
    for item in report.identification.not_identified:
        where = item.cure if item.partner else _WIDER
        together.setdefault((item.partner or "-", where), []).append(item.parameter)
    if not together:
        return
    table = Table("not identified", "hidden behind", "cure")
    for (partner, cure), names in together.items():
        table.add_row(", ".join(names), partner, cure)
    console.print(table)
