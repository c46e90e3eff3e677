"""``cellcal program``: inspect, move, clone and compensate robot programs, and see who runs which version."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from cellcal.calibration.message import make_message
from cellcal.service.cli import delivery
from cellcal.service.cli.idle_options import OptionRule, refuse_idle_options
from cellcal.service.cli.model_argument import ModelArgument
from cellcal.service.engineering.programs.joint_points import JointPoints
from cellcal.service.translation import Locale

if TYPE_CHECKING:
    from cellcal.drivers.programs.brands import ConfigurationRule
    from cellcal.drivers.programs.positions import ProgramFile
    from cellcal.service.engineering.programs.files import FoundPrograms
    from cellcal.service.engineering.programs.project import Project as CellProject
    from cellcal.service.engineering.programs.report import ProgramsReport
    from cellcal.service.engineering.programs.report_run import RunExtras, TransferPrograms
    from cellcal.service.engineering.programs.result import ProgramResult

program = App(
    name="program",
    help="Inspect robot programs; move, clone and compensate them; see which cell runs which version; copy, compare "
    "and replace those of controllers.",
)
for _command in (delivery.fetch, delivery.compare, delivery.deliver, delivery.restore):
    program.command(_command)

Json = Annotated[
    bool, Parameter(name="--json", negative=(), help="Print one JSON object on standard output.")
]
Project = Annotated[
    Path | None, Parameter(name="--project", help="The project file (TOML) of the programs' cell.")
]


ReportFile = Annotated[Path | None, Parameter(allow_leading_hyphen=True)]  # "-" is standard output


@dataclass(frozen=True)
class ProgramOutputs:
    """The places of new programs and reports; `-` is standard output, and the tables then go to standard error."""

    out: Path
    """Folder for the new programs, made if it is not there. A source is never written over."""
    replace: Annotated[bool, Parameter(negative=())] = False
    """Replace programs and reports of an earlier run."""
    json: ReportFile = None
    """Every point as JSON."""
    csv: ReportFile = None
    """Every point as a row."""
    html: ReportFile = None
    """A page with pictures of the points, coloured by shift and by expected error."""
    diff: ReportFile = None
    """A unified diff of all programs, as `patch` takes it."""
    language: Locale = "en"
    """Language of the page; all else is English."""
    top: int = 10
    """How many points the terminal lists, worst first."""


Out = Annotated[ProgramOutputs, Parameter(name="*")]
_OUTPUT_RULES = (OptionRule(("language",), needs=("html",)),)
_REGISTER_RULES = (
    OptionRule(("frame", "joints"), needs=("offset",)),
    OptionRule(("out",), needs=("clone", "offset")),
)


@program.command
def move(  # noqa: PLR0913  a command's options are its arguments
    *files: str,
    project: Annotated[Path, Parameter(name="--project", help="The project file (TOML) of the cell.")],
    outputs: Out,
    offset: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    frame: str | None = None,
    joints: JointPoints | None = None,
    before: Annotated[Path | None, Parameter(name="--from")] = None,
    after: Annotated[Path | None, Parameter(name="--to")] = None,
) -> int:
    """Move points with a workpiece or fixture that was moved.

    Example: cellcal program move programs/ --project cell.toml --offset 12,0,-3.5,0,0,1.5 --frame 2 --out moved

    Points with external axes, at a standing tool, or of poses only need [[track]], [[positioner]], [standing_tools]
    or a starting posture in the project, and are left without; a servo gun is a [[positioner]] with frames = [].
    With axes, --offset is seen at their zeros.

    Each point keeps its place at the work, to the robot's own accuracy. Exit codes: 0 all fine, 4 a point was
    left as it was or there is a finding (such as a shift while the program runs, in axes that the move turns), 10 a
    file was refused.

    Parameters
    ----------
    files
        Files, folders, or patterns in quotes; the project's own programs when none is named.
    offset
        How the work moved: x,y,z in mm, and turns about the fixed x, y and z axes in degrees (as FANUC's W,P,R).
        In the robot's base, or in the user frame of `--frame`.
    frame
        Move only the points of this user frame.
    joints
        What becomes of points in joint angles, such as a home position or all of a pulse job: `move` takes them
        along with the work, `keep` leaves them all as they are. Not said, those whose program names a frame move,
        and each other one is left and named.
    before
        Instead of an offset: the fixture's alignment file before the move, and with `--to` after it.
    after
        The fixture's alignment file after the move.
    """
    refuse_idle_options(move, locals(), _OUTPUT_RULES)
    from cellcal.service.cli.program_moves import base_change_of, print_frame_instead
    from cellcal.service.engineering.programs.calls_not_given import CallsNotGiven
    from cellcal.service.engineering.programs.move import move_transfer
    from cellcal.service.engineering.programs.project import read_project
    from cellcal.service.engineering.programs.report_run import RunExtras

    cell = read_project(project)
    change = base_change_of(cell, offset, frame, (before, after))
    carry = _of_each_brand(
        lambda rule: move_transfer(cell, change, rule, frame=frame, joints=joints).transfer_programs
    )
    report = _change_programs(
        _find_programs(files, cell, outputs),
        carry,
        outputs,
        make_message("Moved in {cell_name}", cell_name=cell.name),
        RunExtras(calls=CallsNotGiven.for_move(change, cell.programs_without_motion)),
    )
    if frame is not None:
        print_frame_instead(cell, frame, change)
    return report.exit_code


@program.command
def clone(master: Path, target: Path, /, *files: str, outputs: Out) -> int:
    """Bring programs of a master's cell to a clone of it, with both robots' identified models.

    Example: cellcal program clone cell_1/project.toml cell_7/project.toml --out cell_7/programs --html clone.html

    External axes go as far from their zeros as in the master's cell; both projects state them.

    Beside the new programs a record tells what they were made from; `cellcal program status` reads it. Exit codes:
    0 all fine, 4 a point was left as it was or there is a finding (such as a shift while the program runs, in axes
    that the change turns), 10 a file was refused.

    Parameters
    ----------
    master
        The project file of the cell in which the programs are proven.
    target
        The project file of the cell that gets them.
    files
        Files, folders, or patterns in quotes; the master's own programs when none is named.
    """
    refuse_idle_options(clone, locals(), _OUTPUT_RULES)
    from cellcal.service.engineering.programs.calls_not_given import CallsNotGiven
    from cellcal.service.engineering.programs.clone import clone_transfer
    from cellcal.service.engineering.programs.project import read_project
    from cellcal.service.engineering.programs.report_run import RunExtras
    from cellcal.service.engineering.programs.versions import CloneRecorder

    source, cell = read_project(master), read_project(target)
    recorder = CloneRecorder(source, cell)
    carry = _of_each_brand(lambda rule: clone_transfer(source, cell, rule).transfer_programs)
    report = _change_programs(
        _find_programs(files, source, outputs),
        carry,
        outputs,
        make_message("{source_name} cloned to {cell_name}", source_name=source.name, cell_name=cell.name),
        RunExtras(recorder, CallsNotGiven.for_clone(source.programs_without_motion)),
    )
    return report.exit_code


@program.command
def compensate(
    *files: str,
    project: Annotated[Path, Parameter(name="--project", help="The project file (TOML) of the cell.")],
    outputs: Out,
    download: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Correct every point for the errors of the robot that runs it, by its identified model.

    Example: cellcal program compensate "offline/*.ls" --project cell_7/project.toml --out corrected

    A controller computes with the nominal arm; with these points the real tip is where the program meant it to be.
    External axes stay where they are, and are believed as the project states them; the arm makes up for the rest.

    Exit codes: 0 all fine, 4 a point was left as it was or there is a finding, 10 a file was refused.

    Parameters
    ----------
    files
        Files, folders, or patterns in quotes; the project's own programs when none is named.
    download
        The other way round: points taught on the real robot, brought to the nominal world of a simulation.
    """
    refuse_idle_options(compensate, locals(), _OUTPUT_RULES)
    from cellcal.calibration.compensation.compensate import ProgramDirection
    from cellcal.service.engineering.programs.calls_not_given import CallsNotGiven
    from cellcal.service.engineering.programs.compensate import compensation_transfer
    from cellcal.service.engineering.programs.project import read_project
    from cellcal.service.engineering.programs.report_run import RunExtras

    cell = read_project(project)
    way = ProgramDirection.DOWNLOAD if download else ProgramDirection.UPLOAD
    carry = _of_each_brand(lambda rule: compensation_transfer(cell, way, rule).transfer_programs)
    title = (
        make_message("Taught in {cell_name}, for the nominal robot", cell_name=cell.name)
        if download
        else make_message("Compensated for {cell_name}", cell_name=cell.name)
    )
    extras = RunExtras(calls=CallsNotGiven.for_compensation(cell.programs_without_motion))
    return _change_programs(_find_programs(files, cell, outputs), carry, outputs, title, extras).exit_code


@program.command
def inspect(
    *files: str,
    project: Project = None,
    robot: ModelArgument | None = None,
    points: bool = False,
    roundtrip: Path | None = None,
    as_json: Json = False,
) -> int:
    """Show what programs hold: points, frames, tools, configurations, reach, expected errors, remarks.

    Example: cellcal program inspect "programs/*.ls" --project cell_7/project.toml

    Nothing is changed. Exit codes: 0 all could be read, 4 a point is out of reach, 10 a file was refused.

    Parameters
    ----------
    files
        Files, folders, or patterns in quotes; the project's own programs when none is named.
    robot
        Without a project: a robot as `cellcal models` takes it, for the reach of points whose tool and frame the
        file itself holds.
    points
        List every point; without it, where there is one file.
    roundtrip
        Write each file as it was read and printed to this folder, under its own name, and compare the bytes.
    """
    from cellcal.service.cli.program_screen import InspectionScreen, counting_bar, print_passed_over
    from cellcal.service.engineering.programs.inspect import InspectionRequest, inspect_programs, sources_of

    found, cell = sources_of(InspectionRequest(files, project, robot, roundtrip))
    screen = InspectionScreen(as_json=as_json, points=points or len(found.sources) == 1)
    with counting_bar("inspecting", len(found.sources)) as counted:
        totals = inspect_programs(found, cell, roundtrip, counted(screen.print_program))
    screen.print_totals(totals)
    print_passed_over(found)
    return totals.exit_code


@program.command
def status(*projects: str, as_json: Json = False) -> int:
    """Show which cell runs which version of its master's programs.

    Example: cellcal program status line/*/project.toml

    A version is the first figures of a program's SHA-256. Exit codes: 0 every cell runs what it should, 4 one does
    not, 10 a project cannot be used.

    Parameters
    ----------
    projects
        Projects of clones: files, or folders in which every project.toml of a clone is taken.
    """
    from cellcal.service.cli.printing import print_json
    from cellcal.service.cli.program_screen import print_status, status_as_object
    from cellcal.service.engineering.programs.versions import find_projects, status_of
    from cellcal.service.exit_codes import ExitCode

    found, refused = status_of(find_projects(projects))
    if as_json:
        print_json(status_as_object(found, refused))
    else:
        print_status(found, refused)
    if refused:
        return ExitCode.FILES_REFUSED
    return ExitCode.PASS if all(one.is_current for one in found) else ExitCode.REFUSED


@program.command
def registers(
    *files: str,
    project: Annotated[
        Path, Parameter(name="--project", help="The project file of the cell, with its backup.")
    ],
    clone: Path | None = None,
    offset: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    frame: str | None = None,
    joints: JointPoints | None = None,
    out: Path | None = None,
) -> int:
    """Show the position registers that FANUC programs use; move or clone those that are places.

    Example: cellcal program registers programs/ --project cell_1/project.toml --clone cell_7/project.toml

    Prints what to type into the controller. Exit codes: 0 all fine, 4 a register stays as it was.

    Parameters
    ----------
    files
        Files, folders, or patterns in quotes; the project's own programs when none is named.
    clone
        The project file of the cell that gets them.
    offset
        How the work moved, as for `cellcal program move`.
    frame
        The user frame that the offset is in; only places in it are moved.
    joints
        Whether registers in joint angles `move` with the work or are to `keep`; not said, each is left and named.
    out
        A new folder for POSREG.VA with the new numbers, of the controller that gets them.
    """
    refuse_idle_options(registers, locals(), _REGISTER_RULES)
    from cellcal.drivers.program_registry import read_program
    from cellcal.service.cli.program_registers import print_registers, transfer_of
    from cellcal.service.engineering.programs.files import find_programs, read_bytes
    from cellcal.service.engineering.programs.inspect import find_named_programs
    from cellcal.service.engineering.programs.project import read_project
    from cellcal.service.engineering.programs.registers import ProgramRegisters
    from cellcal.service.engineering.programs.siblings import with_siblings

    cell = read_project(project)
    target = cell if clone is None else read_project(clone)
    found = find_programs(files or find_named_programs(cell), out=out)
    programs = [
        with_siblings(one, read_program(str(one.path), read_bytes(one.path))) for one in found.sources
    ]
    program_transfer = transfer_of(cell, None if clone is None else target, offset, frame, joints)
    return print_registers(ProgramRegisters(programs, cell), program_transfer, target, out)


def _find_programs(files: Sequence[str], cell: "CellProject", outputs: ProgramOutputs) -> "FoundPrograms":
    from cellcal.service.engineering.programs.files import find_programs
    from cellcal.service.engineering.programs.inspect import find_named_programs

    return find_programs(files or find_named_programs(cell), out=outputs.out)


def _of_each_brand(make: Callable[["ConfigurationRule | None"], "TransferPrograms"]) -> "TransferPrograms":
    """Return what carries programs of any brand: one carrier a brand, made when its first program comes."""
    from cellcal.drivers.program_registry import brand_named

    made: dict[str, TransferPrograms] = {}

    def transfer(programs: "Sequence[ProgramFile]") -> "Sequence[ProgramResult]":
        brand = programs[0].brand
        if brand not in made:
            made[brand] = make(brand_named(brand).configurations)
        return made[brand](programs)

    make(None)  # what the projects lack is said once, and not of every file
    return transfer


def _change_programs(
    found: "FoundPrograms",
    carry: "TransferPrograms",
    outputs: ProgramOutputs,
    title: str,
    extras: "RunExtras",
) -> "ProgramsReport":
    from rich.console import Console

    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.cli.program_screen import counting_bar, print_passed_over, print_report
    from cellcal.service.engineering.programs.report_run import ReportOutputs, change_programs

    outputs_to_write = ReportOutputs(
        outputs.out, outputs.replace, outputs.json, outputs.csv, outputs.html, outputs.diff, outputs.language
    )
    with counting_bar("changing", len(found.sources)) as counted:
        report = change_programs(found, carry, outputs_to_write, title, counted(lambda _: None), extras)
    console = (
        STDERR_CONSOLE if outputs_to_write.fills_standard_output else Console(highlight=False, emoji=False)
    )
    print_report(report, most=outputs.top, console=console)
    print_passed_over(found)
    for path in (*([outputs.out] if report.entries else []), *outputs_to_write.report_paths):
        STDERR_CONSOLE.print(f"written: {path}", markup=False, soft_wrap=True)
    return report
