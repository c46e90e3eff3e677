"""``cellcal simulate-cell``: a simulated cell made like the real one, from files of tag points; no device needed."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

if TYPE_CHECKING:
    from cellcal.procedures.simulation_cell import CalibratedPart, SimulationCell

simulate_cell = App(
    name="simulate-cell", help="Make a simulated cell like the real one, from tag points of both."
)

Json = Annotated[
    bool, Parameter(name="--json", negative=(), help="Print one JSON object on standard output.")
]
Out = Annotated[Path | None, Parameter(help="Folder for the results: JSON, text, a robot's URDF.")]
Units = Annotated[tuple[str, ...], Parameter(help="Units, where guessing fails: position=mm joints=deg.")]
Columns = Annotated[tuple[str, ...], Parameter(help="Columns: name=TAG position=X,Y,Z joints=q1,q2,…")]


@simulate_cell.command
def robot(  # noqa: PLR0913  a command's options are its arguments
    simulated: Path,
    measured: Path,
    /,
    *,
    model: str = "",
    urdf: Path | None = None,
    tip_link: str = "",
    level: int = 1,
    columns: Columns = (),
    units: Units = (),
    out: Out = None,
    save: Path | None = None,
    serial: str = "",
    by: str = "",
    accuracy_class: str = "B",
    as_json: Json = False,
) -> int:
    """Zero positions and tool of a robot, from what it thinks and what a device measured.

    Parameters
    ----------
    simulated
        The robot's path: joints at each tag.
    measured
        The device's path: places of the same tags.
    model
        A robot that ships (`cellcal models`), or
    urdf
        the description of the simulation's robot; needs `--tip-link`.
    tip_link
        Its link at the flange, such as tool0.
    level
        1 zero positions, 2 the whole geometry.
    save
        Folder of parameter sets, in which the result becomes the robot's newest; needs `--serial`, `--by`.
    serial
        Of the robot, for `--save`.
    by
        Who measured, for `--save`.
    accuracy_class
        Of the limits: A, B or C.
    """
    settings: dict[str, object] = {
        "model": model, "tip_link": tip_link, "level": level, "accuracy_class": accuracy_class,
    }  # fmt: skip
    if urdf is not None:
        settings["description"] = str(urdf)
    if save is not None:
        _refuse_nameless(serial, by)
    found, spec = _calibrate_part("robot", (simulated, measured), settings, (columns, units))
    if save is not None:
        _save_parameters(found, spec, save, (serial, by))
    return _print_part(found, spec, out, as_json=as_json)


@simulate_cell.command
def base(  # noqa: PLR0913  a command's options are its arguments
    in_base: Path,
    in_fixture: Path,
    /,
    *,
    sigma_mm: float | None = None,
    columns: Columns = (),
    units: Units = (),
    out: Out = None,
    accuracy_class: str = "B",
    as_json: Json = False,
) -> int:
    """Where a robot's base stands in a calibration fixture.

    Parameters
    ----------
    in_base
        The tags in the robot's base.
    in_fixture
        The same tags in the fixture's frame.
    sigma_mm
        Standard uncertainty of one coordinate of a tag; the residuals tell when not said.
    accuracy_class
        Of the limits: A, B or C.
    """
    settings = {"sigma_m": None if sigma_mm is None else sigma_mm / 1e3, "accuracy_class": accuracy_class}
    found, spec = _calibrate_part("base", (in_base, in_fixture), settings, (columns, units))
    return _print_part(found, spec, out, as_json=as_json)


@simulate_cell.command
def workpiece(  # noqa: PLR0913  a command's options are its arguments
    drawn: Path,
    touched: Path,
    /,
    *,
    method: str = "least_squares",
    sigma_mm: float | None = None,
    columns: Columns = (),
    units: Units = (),
    out: Out = None,
    accuracy_class: str = "B",
    as_json: Json = False,
) -> int:
    """Where a workpiece or table stands in the robot's base.

    Parameters
    ----------
    drawn
        The tags on the model of the workpiece.
    touched
        The same tags touched with the robot.
    method
        least_squares; three_points (origin, on x, on the plane); six_points (three on a plane, two on a line, one).
    sigma_mm
        Standard uncertainty of one coordinate of a tag; three and six points need it.
    accuracy_class
        Of the limits: A, B or C.
    """
    settings = {
        "method": method, "sigma_m": None if sigma_mm is None else sigma_mm / 1e3, "accuracy_class": accuracy_class,
    }  # fmt: skip
    found, spec = _calibrate_part("workpiece", (drawn, touched), settings, (columns, units))
    return _print_part(found, spec, out, as_json=as_json)


@simulate_cell.command
def export(
    run_id: str,
    /,
    *,
    cell: Annotated[Path, Parameter(name="--cell", help="The cell file (TOML).")],
    out: Path,
) -> int:
    """Write the result of a journalled run of simulation_cell as files.

    Parameters
    ----------
    run_id
        A run from `cellcal runs`, or `last`.
    out
        Folder to write to.
    """
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.engineering.parameters.simulated_cells import result_of_run
    from cellcal.service.record.journal_files import open_journal
    from cellcal.service.record.run_store import RunStore

    with open_journal(read_cell_file(cell)) as journal:
        store = RunStore(journal)
        view = store.find_run(store.resolve_run_id(run_id))
    _write_part(result_of_run(view.procedure, view.result), out)
    return 0


def _calibrate_part(
    part: str,
    files: tuple[Path, Path],
    settings: Mapping[str, object],
    options: tuple[tuple[str, ...], tuple[str, ...]],
) -> "tuple[CalibratedPart, SimulationCell]":
    from cellcal.procedures.simulation_cell import calibrate_part
    from cellcal.service.runs.settings import spec_of

    columns, units = (_parse_pairs(option) for option in options)
    paths = {
        key: {"file": str(path), "columns": columns, "units": units}
        for key, path in zip(("simulated", "measured"), files, strict=True)
    }
    spec = spec_of("simulation_cell", {"part": part, **paths, **settings})
    return calibrate_part(spec), spec


def _parse_pairs(pairs: tuple[str, ...]) -> dict[str, str]:
    from cellcal.calibration.errors import CellError

    wrong = [pair for pair in pairs if not all(pair.partition("="))]
    if wrong:
        raise CellError(f"{wrong[0]!r} is not KEY=VALUE.", remedy="For example position=mm.", code="usage")
    return {key: value for key, _, value in (pair.partition("=") for pair in pairs)}


def _refuse_nameless(serial: str, by: str) -> None:
    """Refuse, before the work, a parameter set of no robot or of no person."""
    from cellcal.calibration.errors import CellError

    if not (serial and by):
        raise CellError(
            "--save needs --serial and --by.", remedy="Say whose robot it is and who says so.", code="usage"
        )


def _save_parameters(
    found: "CalibratedPart", spec: "SimulationCell", folder: Path, who: tuple[str, str]
) -> None:
    from datetime import UTC, datetime

    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.engineering.parameters.parameter_files import SetOrigin
    from cellcal.service.engineering.parameters.simulated_cells import save_robot

    made_at = datetime.now(UTC).isoformat(timespec="seconds")
    saved = save_robot(found, spec, folder, SetOrigin(*who, made_at))
    STDERR_CONSOLE.print(f"version {saved.version} of robot {saved.robot_serial} in {folder}", markup=False)


def _write_part(found: "CalibratedPart", folder: Path) -> None:
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.engineering.parameters.simulated_cells import write_part

    for path in write_part(found, folder):
        STDERR_CONSOLE.print(f"wrote {path}", markup=False, soft_wrap=True)


def _print_part(found: "CalibratedPart", spec: "SimulationCell", out: Path | None, *, as_json: bool) -> int:
    import sys

    from pydantic_core import to_jsonable_python

    from cellcal.procedures.simulation_cell import CalibratedRobot, verdict_on_part
    from cellcal.service.cli.printing import print_json
    from cellcal.service.cli.run_end import print_judgement
    from cellcal.service.engineering.parameters.simulated_cells import placed_text, robot_text
    from cellcal.service.exit_codes import exit_code_of_word

    if out is not None:
        _write_part(found, out)
    judgement = verdict_on_part(spec, found).to_json()
    if as_json:
        print_json({"result": to_jsonable_python(found), "judgement": judgement})
    else:
        result = found.found
        text = robot_text(result) if isinstance(result, CalibratedRobot) else placed_text(found.part, result)
        sys.stdout.write(text)
        print_judgement(judgement)
    return exit_code_of_word(judgement["word"])
