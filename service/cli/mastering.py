"""``cellcal mastering``: the mastering record in force, its sheet for the door, and its way to another computer."""

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

mastering = App(name="mastering", help="Show, print, export and import the mastering record of a robot.")

CellFile = Annotated[Path, Parameter(name="--cell", help="The cell file (TOML).")]
RobotName = Annotated[
    str | None, Parameter(name="--robot", help="Which robot of the cell; the first if not said.")
]
Json = Annotated[
    bool, Parameter(name="--json", negative=(), help="Print one JSON object on standard output.")
]


@mastering.command
def show(*, cell: CellFile, robot: RobotName = None, as_json: Json = False) -> int:
    """Print the sheet for the robot's door: counts, reference pose, wire, hash."""
    import sys

    from service.cli.printing import print_json
    from service.configuration.cell_file import read_cell_file
    from service.parameters.mastering_files import in_force
    from service.parameters.mastering_sheet import as_sheet

    config = read_cell_file(cell)
    kept = in_force(config, robot)
    if as_json:
        print_json(kept.as_content(config.cell.name))
    else:
        sys.stdout.write(as_sheet(kept, config.cell.name))
    return 0


@mastering.command
def export(*, cell: CellFile, robot: RobotName = None, out: Path = Path(), as_json: Json = False) -> int:
    """Write the record as a signed file that another computer can import, and its sheet as text.

    Parameters
    ----------
    out
        Folder to write to; this one when not said.
    """
    from service.cli.printing import EN_ROUTE, print_json
    from service.configuration.cell_file import read_cell_file
    from service.parameters.mastering_files import export as write

    signed, sheet = write(read_cell_file(cell), robot, out)
    if as_json:
        print_json({"record": str(signed), "sheet": str(sheet)})
    EN_ROUTE.print(f"record: {signed}", markup=False, soft_wrap=True)
    EN_ROUTE.print(f"sheet:  {sheet}", markup=False, soft_wrap=True)
    return 0


@mastering.command(name="import")
def take_in(
    file: Path, /, *, cell: CellFile, key: str | None = None, replace: bool = False, as_json: Json = False
) -> int:
    """Import an exported record: it must be unchanged, and of a robot of this cell by its serial number.

    Parameters
    ----------
    file
        The signed JSON file.
    key
        The public key that must have signed it, or a file that holds it.
    replace
        Use it although another record of this robot is in force.
    """
    import getpass

    from service.certificates.signing import read_public_key
    from service.cli.printing import EN_ROUTE, print_json
    from service.configuration.cell_file import read_cell_file
    from service.parameters.mastering_files import import_record

    config = read_cell_file(cell)
    expected = None if key is None else read_public_key(key)
    done = import_record(config, file, who=getpass.getuser(), expected_key=expected, replace=replace)
    if as_json:
        told = {"sha256": done.record.sha256, "public_key": done.public_key, "was_known": done.was_known}
        print_json({"robot": done.robot, "serial": done.record.robot_serial, **told})
    state = "was in force already" if done.was_known else "is in force now"
    words = f"{done.robot}: record {done.record.sha256[:12]} of serial {done.record.robot_serial} {state}."
    EN_ROUTE.print(words, markup=False)
    if expected is None:
        EN_ROUTE.print(
            f"It is signed by key {done.public_key}; whose key that is was not checked (--key).", markup=False
        )
    return 0
