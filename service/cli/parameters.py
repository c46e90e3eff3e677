"""``cellcal parameters``: parameter sets of robots, their history, and files of makers."""

import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.message import make_message
from cellcal.service.cli.display_units import DISPLAY_UNITS
from cellcal.service.cli.model_argument import ModelArgument
from cellcal.service.cli.parameter_output import (
    change_to_json,
    number_or_dash,
    print_saved_set,
    print_with_notes,
    set_head_to_json,
)

if TYPE_CHECKING:
    from cellcal.service.engineering.parameters.parameter_sets import ParameterSets

parameters = App(name="parameters", help="Keep, compare, restore and exchange identified robot parameters.")

Folder = Annotated[Path, Parameter(name="--folder", help="Where the sets are kept.")]
Json = Annotated[bool, Parameter(name="--json", help="Print one JSON object on standard output.")]
_HERE = Path("parameter_sets")
_ASSUMED = "assumed: not determined"


@parameters.command(name="list")
def list_sets(robot_serial: str | None = None, /, *, folder: Folder = _HERE, as_json: Json = False) -> int:
    """List robots with their newest set, or every version of one robot.

    Parameters
    ----------
    robot_serial
        Show the history of this robot.
    """
    from rich.console import Console

    from cellcal.service.cli.printing import PlainTable, print_json

    _must_be_folder(folder.expanduser())
    sets = _open_sets(folder)
    found = (
        [sets.load_set(serial) for serial in sets.robot_serials()]
        if robot_serial is None
        else sets.load_history(robot_serial)
    )
    if as_json:
        print_json({"parameter_sets": [set_head_to_json(item) for item in found]})
        return 0
    table = PlainTable("robot", "version", "model", "made", "by", "from", "note")
    for item in found:
        note = f"back to version {item.rolls_back_to}. {item.note}" if item.rolls_back_to else item.note
        table.add_row(
            item.robot_serial,
            str(item.version),
            item.model,
            item.made_at,
            item.made_by,
            item.source.split(",")[0],
            note,
        )
    Console(highlight=False, emoji=False).print(table)
    return 0


@parameters.command
def show(
    robot_serial: str, /, *, version: int | None = None, folder: Folder = _HERE, as_json: Json = False
) -> int:
    """Show one set.

    Parameters
    ----------
    robot_serial
        Robot.
    version
        The newest if not given.
    """
    from rich.console import Console

    from cellcal.service.cli.printing import PlainTable, print_json

    item = _open_sets(folder).load_set(robot_serial, version)
    if as_json:
        values = [
            {
                "name": v.name,
                "unit": v.unit,
                "value": v.value,
                "standard_uncertainty": v.standard_uncertainty,
                "determined": v.determined,
            }
            for v in item.values
        ]
        print_json({**set_head_to_json(item), "parameters": values})
        return 0
    table = PlainTable(
        "parameter",
        "value",
        "standard uncertainty",
        "unit",
        title=f"{item.robot_serial}, version {item.version}",
    )
    for value in item.values:
        unit, scale = DISPLAY_UNITS[value.unit]
        u = number_or_dash(value.standard_uncertainty, scale) if value.determined else _ASSUMED
        table.add_row(value.name, f"{value.value * scale:+.5f}", u, unit)
    console = Console(highlight=False, emoji=False)
    console.print(table)
    console.print(f"Deviations from nominal {item.model}; {item.source}", markup=False)
    return 0


@parameters.command
def diff(
    robot_serial: str,
    /,
    *,
    before: int | None = None,
    after: int | None = None,
    folder: Folder = _HERE,
    as_json: Json = False,
) -> int:
    """Show what changed between two versions, in units and in standard uncertainties.

    Parameters
    ----------
    robot_serial
        Robot.
    before
        The version before `after` if not given.
    after
        The newest if not given.
    """
    from rich.console import Console

    from cellcal.service.cli.printing import PlainTable, print_json
    from cellcal.service.engineering.parameters.parameter_sets import compare_sets as changes_between

    sets = _open_sets(folder)
    new = sets.load_set(robot_serial, after)
    old = sets.load_set(robot_serial, new.version - 1 if before is None else before)
    changes = changes_between(old, new)
    if as_json:
        print_json(
            {
                "before": set_head_to_json(old),
                "after": set_head_to_json(new),
                "changes": [change_to_json(c) for c in changes],
            }
        )
        return 0
    console = Console(highlight=False, emoji=False)
    if not changes:
        console.print(f"{robot_serial}: versions {old.version} and {new.version} hold the same values.")
        return 0
    table = PlainTable(
        "parameter", "before", "after", "difference", "unit", "in uncertainties",
        title=f"{robot_serial}: version {old.version} to {new.version}",
    )  # fmt: skip
    for change in changes:
        unit, scale = DISPLAY_UNITS[change.unit]
        numbers = [number_or_dash(v.value if v else None, scale) for v in (change.before, change.after)]
        size = "-" if change.difference_in_sigmas is None else f"{change.difference_in_sigmas:.1f}"
        size = size if change.is_determined else _ASSUMED
        table.add_row(change.name, *numbers, f"{change.value_difference * scale:+.5f}", unit, size)
    console.print(table)
    return 0


@parameters.command
def keep(
    *,
    cell: Annotated[Path, Parameter(name="--cell", help="The cell file (TOML).")],
    by: str,
    robot: str | None = None,
    folder: Folder = _HERE,
    as_json: Json = False,
) -> int:
    """Save what the newest robot calibration of a cell found as the robot's next version.

    Parameters
    ----------
    cell
        The cell file whose journal holds the calibration.
    by
        Who keeps it.
    robot
        Which robot of the cell; the first if not said.
    """
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.engineering.parameters.calibrated_runs import save_calibration

    saved = save_calibration(read_cell_file(cell), robot, _open_sets(folder), by, _utc_now())
    return print_saved_set(saved, (), as_json=as_json)


@parameters.command
def rollback(
    robot_serial: str,
    version: int,
    /,
    *,
    by: str,
    note: str = "",
    folder: Folder = _HERE,
    as_json: Json = False,
) -> int:
    """Go back to an old version: its values become the newest version, and nothing is removed.

    Parameters
    ----------
    robot_serial
        Robot.
    version
        Whose values shall hold again.
    by
        Who decides so.
    note
        Why.
    """
    saved = _open_sets(folder).roll_back(robot_serial, version, made_by=by, made_at=_utc_now(), note=note)
    return print_saved_set(saved, (), as_json=as_json)


@parameters.command(name="import")
def import_parameters(  # noqa: PLR0913  # a command's options are its arguments
    file: Path,
    /,
    *,
    robot: ModelArgument,
    serial: str,
    by: str,
    note: str = "",
    folder: Folder = _HERE,
    as_json: Json = False,
) -> int:
    """Save what a file says about an arm as its newest version.

    Parameters
    ----------
    file
        JSON of `cellcal identify --json`, a parameter set, a UR controller's calibration.conf, recorded bytes of
        its port 30001, or the YAML of ur_calibration.
    robot
        Nominal model: a name of `cellcal models`, a model file (arm.toml), or 'arm.urdf?base=LINK&tip=LINK'.
    serial
        Of the robot.
    by
        Who says so.
    note
        Anything worth keeping.
    """
    from cellcal.calibration.arm.kinematics import load_model
    from cellcal.service.engineering.parameters.parameter_files import SetOrigin, import_file

    _must_exist(file)
    found = import_file(_open_sets(folder), file, load_model(robot), SetOrigin(serial, by, _utc_now(), note))
    return print_saved_set(found.parameter_set, found.notes, as_json=as_json)


@parameters.command
def export(  # noqa: PLR0913  # a command's options are its arguments
    robot_serial: str,
    to: Path,
    /,
    *,
    kind: Annotated[str, Parameter(name="--format")] = "urdf",
    version: int | None = None,
    template: Path | None = None,
    tip_link: str = "flange",
    base_link: str | None = None,
    geometric_joints: bool = False,
    folder: Folder = _HERE,
) -> int:
    """Write a set for others: URDF, a UR controller's table, ROS kinematics, or the set itself.

    Parameters
    ----------
    robot_serial
        Robot.
    to
        File to write; it must not exist.
    kind
        urdf, calibration-conf, primary, ros-yaml or toml.
    version
        The newest if not given.
    template
        URDF whose joints are corrected, with everything else kept; a bare one is written without it.
    tip_link
        The link of the template that is the flange.
    base_link
        The link of the template that is the robot's base, where it begins elsewhere (a world, a table).
    geometric_joints
        Allow a URDF of a robot that couples joints, driven by geometric angles.
    """
    from cellcal.calibration.arm.kinematics import load_model
    from cellcal.service.engineering.parameters.parameter_files import (
        DescriptionTemplate,
        FileKind,
        export_set,
    )
    from cellcal.service.engineering.parameters.parameter_set import ParameterSetError

    if kind not in list(FileKind):
        raise ParameterSetError(
            f"there is no format {kind}.", remedy=f"Formats: {', '.join(FileKind)}.", code="usage"
        )
    source = None
    if template is not None:
        _must_exist(template)
        source = DescriptionTemplate(read_plain_text(template), tip_link, base_link)
    item = _open_sets(folder).load_set(robot_serial, version)
    nominal = load_model(item.model)
    data, notes = export_set(
        item, nominal, FileKind(kind), template=source, geometric_joints=geometric_joints
    )
    try:
        with to.open("xb") as file:
            file.write(data)
    except FileExistsError as taken:
        raise ParameterSetError(
            make_message("{path} is there already.", path=to), remedy="Choose another name.", code="usage"
        ) from taken
    print_with_notes(f"wrote {to}: {item.robot_serial} version {item.version}", notes)
    return 0


def _open_sets(folder: Path) -> "ParameterSets":
    from cellcal.service.engineering.parameters.parameter_sets import ParameterSets

    return ParameterSets(folder.expanduser())


def _utc_now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def _must_exist(path: Path) -> None:
    from cellcal.service.engineering.parameters.parameter_set import ParameterSetError
    from cellcal.service.files import missing_file_words

    if not path.is_file():
        why, remedy = missing_file_words(path)
        raise ParameterSetError(why, remedy=remedy, code="usage")


def _must_be_folder(path: Path) -> None:
    from cellcal.service.engineering.parameters.parameter_set import ParameterSetError

    if not path.is_dir():
        raise ParameterSetError(
            make_message("there is no folder {path}.", path=path),
            remedy="Name the folder with the sets: --folder FOLDER.",
            code="usage",
        )
