"""``cellcal identify``: kinematic identification from a file of measurements."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from cellcal.service.cli.idle_options import OptionRule, refuse_idle_options
from cellcal.service.cli.model_argument import ModelArgument

if TYPE_CHECKING:
    from cellcal.service.engineering.identification.at_points import AtOptions, AtPoints
    from cellcal.service.engineering.identification.identify import IdentifyReport
    from cellcal.service.engineering.identification.row_fit import IdentifyOptions
    from cellcal.service.engineering.measured.measurements import ReadOptions

_MM = {"mm": 1e-3, "um": 1e-6, "m": 1.0}
_DEG = {"deg": 0.017453292519943295, "mrad": 1e-3, "rad": 1.0}
_AT = ("at_csv", "at_convention", "at_identified")
_OF_FIT = (  # what only a fit, or what it leaves behind, has a use for
    "level", "check", "train_rows", "seed", "start", "free", "residual_model", "limit", "accept_offset_sd",
    "accept_offsets", "at", *_AT, "dh", "plot", "save", "serial", "by", "urdf", "geometric_joints", "project_axes",
)  # fmt: skip
_RULES = (
    OptionRule(_OF_FIT, not_with=("show_layout",)),
    OptionRule(_AT, needs=("at",)),
    OptionRule(("serial", "by"), needs=("save", "project_axes")),
    OptionRule(("accept_offsets",), needs=("accept_offset_sd",)),
    OptionRule(("geometric_joints",), needs=("urdf",)),
)


def identify(  # noqa: PLR0913  # a command's options are its arguments
    measurements: Path,
    /,
    *,
    robot: ModelArgument,
    mounting: str = "",
    level: int | None = None,
    check: Path | None = None,
    train_rows: int | None = None,
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
    start: str = "nominal",
    free: tuple[str, ...] = (),
    residual_model: bool = False,
    limit: str = "",
    accept_offset_sd: str = "",
    accept_offsets: tuple[str, ...] = (),
    at: Path | None = None,
    at_csv: Path | None = None,
    at_convention: str = "",
    at_identified: bool = False,
    dh: bool = False,
    plot: Path | None = None,
    columns: tuple[str, ...] = (),
    units: tuple[str, ...] = (),
    convention: str = "",
    sheet: str | None = None,
    joints: Path | None = None,
    joint_coupling: str = "",
    layout: Path | None = None,
    show_layout: bool = False,
    save: Path | None = None,
    serial: str = "",
    by: str = "",
    urdf: Path | None = None,
    geometric_joints: bool = False,
    project_axes: Path | None = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> int:
    """Identify a robot from measurements, and say how far the result can be believed.

    Parameters
    ----------
    measurements
        CSV or Excel file as the instrument wrote it: joints, and a length, position or pose per row.
    robot
        Nominal model: a name of `cellcal models`, a model file (arm.toml), or 'arm.urdf?base=LINK&tip=LINK'.
    mounting
        Where weight pulls, if the robot does not stand upright: wall (the base's x points up), ceiling, tilt:x=30,
        tilt:y=-15 (degrees), or the direction of gravity in its base such as 0,-1,0. The same as `--robot ur10@wall`,
        which is the name under which everything is kept.
    level
        0 base and tool only, 1 mastering offsets, 2 geometry, 3 and sag, 4 and gear ripple, 5 and gear ratios.
        Chosen by cross-validation if not given.
    check
        Another file, on which the finished model is evaluated.
    train_rows
        Fit this many rows, drawn at random; all other rows are held out.
    seed
        Of the draw and of the folds.
    start
        Where values and priors stand: nominal; previous (the newest set of `--serial` in `--save`); or a file, a
        parameter set or the `--json` of an earlier identification. A set that holds its covariance is the prior as
        it is: five rows add to it, and an offset that they contradict is named.
    free
        What may move, if not all of a level: offsets, geometry, gravity, ripple, gear, wire, base, tool, J3 (its
        offset and geometry), or parameters such as "J2 offset", with commas. The rest is held. Base and tool are
        free unless an earlier `--json` tells where they are.
    residual_model
        Try a smooth function of the joints for what the arm leaves over; used only if held-out groups gain.
    limit
        Judge the RMSE of rows that were not fitted (of the check file, if there is one): 0.5mm.
    accept_offset_sd
        Judge the standard deviation of joint offsets: 0.01deg.
    accept_offsets
        Only these offsets count, such as "J2 offset".
    at
        CSV: how surely the target's place is known there. Columns q1_deg, q2_deg …; or flange poses in the robot's
        base, x_mm, y_mm, z_mm, qw, qx, qy, qz. A cell of several targets needs a column target.
    at_csv
        Write that as CSV.
    at_convention
        Poses are written as this maker does, in columns such as W_deg, P_deg, R_deg for fanuc_wpr.
    at_identified
        Poses are where the identified robot shall stand; else what its controller is told, which believes the
        nominal robot.
    dh
        Show the arm as DH, with Hayati's beta where axes are parallel.
    plot
        Folder for pictures (PNG and SVG): an overview page, residuals by row and by joint, the error map over
        the workspace, correlations, distributions.
    columns
        What a column is, where guessing fails: joints=q1,q2,… position=X,Y,Z length=L controller=… rotation=…
        group=…; by name, or by its number counted from 1. -J2 turns a sign, J2+90 adds to a joint's zero [deg].
    units
        Units, where guessing fails: joints=deg slides=mm position=mm length=m controller=mm rotation=rad; slides
        are joints that slide.
    convention
        Orientation convention of the measured attitude, or none; with _inverse_pose behind it where each row is the
        pose of the device seen from the target, as by a camera on the flange.
    sheet
        Sheet of an Excel file.
    joints
        Another file that holds the joints of the rows: joined by a column that both files have, else row by row.
    joint_coupling
        controller: joints as on the pendant; geometric: every angle against the link before (FANUC J3 against J2).
    layout
        TOML file that names columns, units, orientation convention, joint coupling and groups; or the readings
        of several devices, targets and robots, which are then fitted together: level, seed, free, limit,
        accept-offset-sd, at, dh, plot, save and urdf mean the same there, the others are refused with the reason.
    show_layout
        Print how the file is understood, as such a layout file, and stop.
    save
        Folder of parameter sets, in which the result becomes the robot's newest version; needs `--serial`, `--by`.
    serial
        Of the robot, for `--save`; of a cell of several left=4711,right=4712.
    by
        Who measured, for `--save`.
    urdf
        Write the identified arm as a URDF file; of several robots one each, with its name.
    geometric_joints
        In that file, where the controller couples joints: angles against the link before.
    project_axes
        Folder for what a project of programs needs of a track or positioner that was identified: its tables, and for
        a track the parameter set of the arm on it; then needs `--serial`, `--by`.
    as_json
        Print one JSON object on standard output.
    """
    refuse_idle_options(identify, locals(), _RULES)
    # Before numpy is imported: on matrices of this size a second BLAS thread only waits for the first.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from cellcal.service.cli.identify_outputs import IdentifyOutputs
    from cellcal.service.engineering.identification.identify_start import StartOptions
    from cellcal.service.engineering.identification.identify_verdicts import IdentificationLimits
    from cellcal.service.engineering.identification.row_fit import IdentifyOptions
    from cellcal.service.engineering.measured.cells import describes_a_cell
    from cellcal.service.engineering.measured.layouts import overlay_options, read_layout
    from cellcal.service.engineering.measured.measurements import ReadOptions

    robot = _apply_mounting(robot, mounting)
    limits = IdentificationLimits(
        _parse_quantity(limit, "--limit", _MM),
        _parse_quantity(accept_offset_sd, "--accept-offset-sd", _DEG),
        accept_offsets,
    )
    outputs = IdentifyOutputs(save, serial, by, urdf, geometric_joints, project_axes)
    outputs.refuse_unwritable(robot, residual_model=residual_model)
    at_options = _at_options(at, at_convention, at_csv, identified=at_identified)
    if layout is not None and describes_a_cell(layout):
        from cellcal.calibration.cells.levels import CellOptions
        from cellcal.service.cli.identify_cell import CellCommand, identify_cell, refuse_for_a_cell

        refuse_for_a_cell({
            "check": check, "train_rows": train_rows, "start": start != "nominal", "columns": columns,
            "residual_model": residual_model, "units": units, "convention": convention, "sheet": sheet,
            "joints": joints, "show_layout": show_layout, "joint_coupling": joint_coupling,
            "project_axes": project_axes,
        })  # fmt: skip
        command = CellCommand(
            measurements, layout, robot, limits, at_options, at_csv, plot, save, serial, by, urdf, geometric_joints,
            dh, as_json,
        )  # fmt: skip
        return identify_cell(command, CellOptions(level=level, seed=seed, free=_split_words(free)))
    named = {key: tuple(value.split(",")) for key, value in _parse_pairs(columns, "--columns").items()}
    read = ReadOptions(named, _parse_pairs(units, "--units"), convention, sheet, joint_coupling, joints)
    if layout is not None:
        read = overlay_options(read_layout(layout), read)
    if show_layout:
        return _show_layout(measurements, robot, read, as_json=as_json)
    options = IdentifyOptions(
        level, check, train_rows, seed, read, StartOptions(start, save, serial, free), residual_model, limits
    )
    points = None if at_options is None else _read_points(at_options, robot)
    report = _identify_on_all_processors(measurements, robot, options)
    _print_identification(
        report, _ReportViews(plot, points, at_csv, at_identified=at_identified, dh=dh), as_json=as_json
    )
    outputs.write_files(report, measurements)  # at last: what cannot be written loses no result
    return _exit_code(report)


def _split_words(texts: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(word.strip() for text in texts for word in text.split(","))


def _at_options(
    at: Path | None, convention: str, out: Path | None, *, identified: bool
) -> "AtOptions | None":
    """Return the points to predict; what they would be written over is refused before the work."""
    from cellcal.service.engineering.identification.at_points import AtOptions
    from cellcal.service.files import refuse_existing

    if out is not None:
        refuse_existing(out)
    return None if at is None else AtOptions(at, convention, identified)


def _read_points(options: "AtOptions", robot: str) -> "AtPoints":
    """Read the points to predict before the work, which a file that cannot be used is not worth."""
    from cellcal.calibration.arm.kinematics import load_model
    from cellcal.service.engineering.identification.at_points import read_points

    return read_points(options, load_model(robot))


def _identify_on_all_processors(
    measurements: Path, robot: str, options: "IdentifyOptions"
) -> "IdentifyReport":
    from cellcal.service.cli.identify_display import work_display
    from cellcal.service.engineering.identification.forked_parts import share_parts
    from cellcal.service.engineering.identification.identify import identify_file

    with work_display() as display, share_parts(display) as runner:
        return identify_file(measurements, robot, options, runner)


@dataclass(frozen=True, slots=True)
class _ReportViews:
    """The views shown beside the report."""

    plot: Path | None
    at: "AtPoints | None"
    at_csv: Path | None
    at_identified: bool
    dh: bool


def _print_identification(report: "IdentifyReport", views: _ReportViews, *, as_json: bool) -> None:
    from dataclasses import asdict

    from rich.console import Console

    from cellcal.service.cli.identify_report import print_dh, print_report, print_tips
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.engineering.identification.identify_at import tips_at, write_tips

    tips = None if views.at is None else tips_at(views.at, report, identified=views.at_identified)
    if as_json:
        at = {} if tips is None else {"at": tips.as_document()}
        dh = {"dh": asdict(report.dh)} if views.dh and report.dh is not None else {}
        print_json({**report.as_document(), **at, **dh})
    else:
        console = Console(highlight=False, emoji=False)
        print_report(console, report)
        if views.dh:
            print_dh(console, report.dh, report.robot)
        if tips is not None:
            print_tips(console, tips)
    # At last: what cannot be written loses no result.
    if tips is not None and views.at_csv is not None:
        write_tips(tips, views.at_csv)
        STDERR_CONSOLE.print(f"wrote {views.at_csv}", markup=False)
    if views.plot is not None:
        _draw_plots(report, views.plot)


def _draw_plots(report: "IdentifyReport", folder: Path) -> None:
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.engineering.plots.identify_plots import draw_identification

    for path in draw_identification(report, folder):
        STDERR_CONSOLE.print(f"wrote {path}", markup=False)


def _exit_code(report: "IdentifyReport") -> int:
    from cellcal.service.exit_codes import ExitCode

    return ExitCode.PASS if report.verdicts.is_proved else ExitCode.OUT_OF_TOLERANCE


def _apply_mounting(robot: str, mounting: str) -> str:
    from cellcal.calibration.arm.mounting import mounted_name

    return mounted_name(robot, mounting)


def _parse_quantity(text: str, option: str, units: dict[str, float]) -> float | None:
    """Return a positive number with its unit in SI; None if nothing was said."""
    import math
    import re

    from cellcal.service.engineering.measured.table import MeasurementError

    if not text:
        return None
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*([a-z]+)\s*", text)
    try:
        value = float(match[1]) * units[match[2]] if match else math.nan
    except (KeyError, ValueError):
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise MeasurementError(
            f"{option} {text} is no positive number with a unit.",
            remedy=f"Write it as {option} 0.5{next(iter(units))}; units: {', '.join(units)}.",
        )
    return value


def _show_layout(measurements: Path, robot: str, read: "ReadOptions", *, as_json: bool) -> int:
    from rich.console import Console

    from cellcal.calibration.arm.kinematics import load_model
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.engineering.measured.layouts import layout_document, layout_text
    from cellcal.service.engineering.measured.measurements import read_measurements

    found = read_measurements(measurements, load_model(robot), read)
    document = layout_document(found, read)
    if as_json:
        usable = {"rows": found.read, "usable": len(found.rows), "guesses": list(found.guesses)}
        print_json({**document, **usable})
        return 0
    STDERR_CONSOLE.print(f"{len(found.rows)} of {found.read} rows are usable.")
    for guess in found.guesses:
        STDERR_CONSOLE.print(guess, markup=False, soft_wrap=True)
    Console(highlight=False, soft_wrap=True, emoji=False).print(layout_text(document), end="", markup=False)
    return 0


def _parse_pairs(words: tuple[str, ...], option: str) -> dict[str, str]:
    from cellcal.service.engineering.measured.table import MeasurementError

    wrong = [word for word in words if "=" not in word]
    if wrong:
        raise MeasurementError(f"{option} {wrong[0]} has no '='.", remedy=f"Write {option} joints=….")
    return dict(word.split("=", 1) for word in words)
