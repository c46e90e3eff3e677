"""``cellcal identify`` with a layout of several readings: one fit of all of them, and what it leaves behind."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cellcal.calibration.cells.levels import CellOptions
    from cellcal.service.engineering.identification.at_points import AtOptions
    from cellcal.service.engineering.identification.cell_identify import IdentifiedCellReport
    from cellcal.service.engineering.identification.identify_at import TipsAt
    from cellcal.service.engineering.identification.identify_verdicts import IdentificationLimits

_WHY_NOT = {
    "check": "a second file would need its own layout: hold rows out instead, as is done by itself",
    "train_rows": "every row is held out once, by groups over all series",
    "start": "a cell starts from nominal arms; hold what is known with --free",
    "residual_model": "it is a function of one arm's joints: identify that robot by itself",
    "columns": "the layout names them",
    "units": "the layout names them",
    "convention": "the layout names it",
    "sheet": "the layout names it",
    "joints": "each file of a cell holds its joints",
    "joint_coupling": "rows of a cell are what the controller counts",
    "show_layout": "the layout is complete as it is",
    "project_axes": "the tables of a project are of one chain: identify that chain by itself",
}


@dataclass(frozen=True, slots=True)
class CellCommand:
    """The command's arguments, beside the options of the fit."""

    measurements: Path
    layout: Path
    robot: str
    limits: "IdentificationLimits"
    at: "AtOptions | None"
    at_csv: Path | None
    plot: Path | None
    save: Path | None
    serial: str
    by: str
    urdf: Path | None
    geometric_joints: bool
    dh: bool
    as_json: bool


def refuse_for_a_cell(options: Mapping[str, object]) -> None:
    """Refuse options that say nothing about a cell of several devices, each with its reason."""
    from cellcal.service.engineering.measured.table import MeasurementError

    for name, why in _WHY_NOT.items():
        if options.get(name):
            raise MeasurementError(
                f"--{name.replace('_', '-')} is for one device, and the layout describes several readings: {why}.",
                remedy="Leave it out.",
            )


def identify_cell(command: CellCommand, options: "CellOptions") -> int:
    """Fit, show the report, and write what was asked for."""
    from rich.console import Console

    from cellcal.service.cli.cell_report import print_cell_report, print_tables
    from cellcal.service.cli.identify_report import print_tips
    from cellcal.service.cli.printing import print_json
    from cellcal.service.engineering.identification.cell_identify import identify_cell_file
    from cellcal.service.engineering.identification.cell_outputs import cell_tips
    from cellcal.service.exit_codes import ExitCode

    report = identify_cell_file(command.measurements, command.layout, command.robot, options, command.limits)
    tips = {} if command.at is None else cell_tips(command.at, report)
    if command.as_json:
        at = {"at": {name: found.as_document() for name, found in tips.items()}} if tips else {}
        print_json({**report.as_document(), **at})
    else:
        console = Console(highlight=False, emoji=False)
        print_cell_report(console, report)
        if command.dh:
            print_tables(console, report)
        for name, found in tips.items():
            print_tips(console, found, name)
    # At last: what cannot be written loses no result.
    if command.at_csv is not None:
        _write_tips(tips, command.at_csv)
    _write_outputs(command, report)
    return ExitCode.PASS if report.is_proved else ExitCode.OUT_OF_TOLERANCE


def _write_outputs(command: CellCommand, report: "IdentifiedCellReport") -> None:
    import datetime

    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.engineering.identification.cell_outputs import (
        save_cell,
        serials_of,
        write_cell_urdfs,
    )
    from cellcal.service.engineering.parameters.parameter_files import SetOrigin

    if command.save is not None:
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        serials = serials_of(command.serial, tuple(arm.name for arm in report.arms))
        who = SetOrigin("", command.by, now)
        for made in save_cell(report, command.measurements, command.save, serials, who):
            STDERR_CONSOLE.print(f"saved version {made.version} of robot {made.robot_serial}", markup=False)
    if command.urdf is not None:
        for one in write_cell_urdfs(report, command.urdf, geometric_joints=command.geometric_joints):
            lost = f", without {' and '.join(one.missing)}, which a description cannot hold"
            STDERR_CONSOLE.print(f"wrote {one.path}{lost if one.missing else ''}", markup=False)
    if command.plot is not None:
        from cellcal.service.engineering.plots.cell_plots import draw_cell

        for path in draw_cell(report, command.plot):
            STDERR_CONSOLE.print(f"wrote {path}", markup=False)


def _write_tips(tips: "Mapping[str, TipsAt]", path: Path) -> None:
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.engineering.identification.identify_at import write_tips

    for name, found in tips.items():
        one = path if len(tips) == 1 else path.with_stem(f"{path.stem}_{name.replace(' ', '_')}")
        write_tips(found, one)
        STDERR_CONSOLE.print(f"wrote {one}", markup=False)
