"""``cellcal mastering``: the mastering record in force, its sheet for the door, and its way to another computer."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from cellcal.service.cli.mastering_files import record, watch

if TYPE_CHECKING:
    from cellcal.calibration.mastering.counts import MasteringRecord

mastering = App(
    name="mastering", help="Take, watch, show, print, export and import the mastering record of a robot."
)
mastering.command(record)
mastering.command(watch)

CellFile = Annotated[Path, Parameter(name="--cell", help="The cell file (TOML).")]
RobotName = Annotated[
    str | None, Parameter(name="--robot", help="Which robot of the cell; the first if not said.")
]
Json = Annotated[
    bool, Parameter(name="--json", negative=(), help="Print one JSON object on standard output.")
]


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class BackupArm:
    """The arm of a controller's backup; its files do not say."""

    robot: RobotName = None
    group: Annotated[int, Parameter(name="--group", help="Motion group of the robot in the backup.")] = 1


_ANY = BackupArm()


@mastering.command
def show(*, cell: CellFile, robot: RobotName = None, as_json: Json = False) -> int:
    """Print the sheet for the robot's door: counts, reference pose, wire, hash."""
    import sys

    from cellcal.service.cli.printing import print_json
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.engineering.parameters.mastering_files import in_force
    from cellcal.service.engineering.parameters.mastering_sheet import as_sheet

    config = read_cell_file(cell)
    record = in_force(config, robot)
    if as_json:
        print_json(record.as_content(config.cell.name))
    else:
        sys.stdout.write(as_sheet(record, config.cell.name))
    return 0


@mastering.command
def export(*, cell: CellFile, robot: RobotName = None, out: Path = Path(), as_json: Json = False) -> int:
    """Write the record as a signed file that another computer can import, and its sheet as text.

    Parameters
    ----------
    out
        Folder to write to; this one when not said.
    """
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.engineering.parameters.mastering_files import export_record as write

    signed, sheet = write(read_cell_file(cell), robot, out)
    if as_json:
        print_json({"record": str(signed), "sheet": str(sheet)})
    STDERR_CONSOLE.print(f"record: {signed}", markup=False, soft_wrap=True)
    STDERR_CONSOLE.print(f"sheet:  {sheet}", markup=False, soft_wrap=True)
    return 0


@mastering.command(name="import")
def take_in(
    source: Path,
    /,
    *,
    cell: CellFile,
    key: str | None = None,
    whose: BackupArm = _ANY,
    replace: bool = False,
    as_json: Json = False,
) -> int:
    """Import an exported record, or what a FANUC controller's backup tells of its mastering.

    Parameters
    ----------
    source
        The signed JSON file: it must be unchanged, and of a robot of this cell by its serial number. Or a folder
        with SYSMAST.VA and SYMOTN.VA.
    key
        The public key that must have signed the file, or a file that holds it.
    whose
        Whose backup it is.
    replace
        Use it although another record of this robot is in force.
    """
    if source.is_dir():
        return _take_in_backup(source, cell, whose, replace=replace, as_json=as_json)
    return _take_in_file(source, cell, key=key, replace=replace, as_json=as_json)


def _take_in_file(file: Path, cell: Path, *, key: str | None, replace: bool, as_json: bool) -> int:
    from cellcal.drivers.operator.terminal_user import terminal_user
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.engineering.parameters.mastering_files import import_record
    from cellcal.service.record.signing import read_public_key

    config = read_cell_file(cell)
    expected = None if key is None else read_public_key(key)
    done = import_record(config, file, who=terminal_user(), expected_key=expected, replace=replace)
    if as_json:
        document = {"sha256": done.record.sha256, "public_key": done.public_key, "was_known": done.was_known}
        print_json({"robot": done.robot, "serial": done.record.robot_serial, **document})
    STDERR_CONSOLE.print(_in_force(done.robot, done.record, was_known=done.was_known), markup=False)
    if expected is None:
        STDERR_CONSOLE.print(
            f"It is signed by key {done.public_key}; whose key that is was not checked (--key).", markup=False
        )
    return 0


def _take_in_backup(folder: Path, cell: Path, whose: BackupArm, *, replace: bool, as_json: bool) -> int:
    from cellcal.drivers.operator.terminal_user import terminal_user
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.engineering.parameters.fanuc_backup import import_backup

    config = read_cell_file(cell)
    done = import_backup(config, folder, who=terminal_user(), of=whose, replace=replace)
    if as_json:
        document = {
            "sha256": done.record.sha256,
            "was_known": done.was_known,
            "not_in_backup": done.not_in_backup,
        }
        document |= {"findings": done.findings, "counts_at_zero": done.record.counts_at_zero}
        print_json({"robot": done.robot, "serial": done.record.robot_serial, **document})
    STDERR_CONSOLE.print(_in_force(done.robot, done.record, was_known=done.was_known), markup=False)
    for line in (*done.findings, *(f"The backup does not tell {missing}." for missing in done.not_in_backup)):
        STDERR_CONSOLE.print(line, markup=False)
    return 0


def _in_force(robot: str, record: "MasteringRecord", *, was_known: bool) -> str:
    state = "was in force already" if was_known else "is in force now"
    return f"{robot}: record {record.sha256[:12]} of serial {record.robot_serial} {state}."


@mastering.command
def edits(
    backup: Path,
    /,
    *,
    cell: CellFile,
    whose: BackupArm = _ANY,
    as_json: Json = False,
) -> int:
    """List what an operator types to give a FANUC controller the counts of the record in force.

    Parameters
    ----------
    backup
        Folder with the controller's present SYSMAST.VA; nothing is written to it.
    whose
        Whose backup it is.
    """
    import sys

    from cellcal.service.cli.printing import print_json
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.engineering.parameters.fanuc_backup import edits_to

    lines = edits_to(read_cell_file(cell), backup, whose)
    if as_json:
        print_json({"edits": lines})
    else:
        sys.stdout.write("".join(f"{line}\n" for line in lines or ("Nothing: the counts are equal.",)))
    return 0
