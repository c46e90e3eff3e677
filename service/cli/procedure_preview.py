"""``cellcal procedures`` and ``cellcal run --dry-run``: what is possible here, and what a run would do."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.text import Text

from cellcal.service.cli.display_units import DEGREES_PER_RADIAN

if TYPE_CHECKING:
    from cellcal.procedures.catalogue_index import ProcedureEntry
    from cellcal.procedures.forecast import Forecast, Prediction
    from cellcal.procedures.procedure_definition import Phase
    from cellcal.service.configuration.cell_file import CellConfig
    from cellcal.service.runs.run_preview import DryRun

Json = Annotated[bool, Parameter(name="--json", negative=())]


def procedures(
    name: str | None = None, /, *, cell: Path | None = None, robot: str | None = None, as_json: Json = False
) -> int:
    """List the procedures, and for a cell what it lacks for each; or the settings of one. No device is touched.

    Parameters
    ----------
    name
        The procedure whose settings for ``cellcal run --set`` are shown; with a cell, as its file answers them.
    cell
        The cell file (TOML).
    robot
        Which robot of the cell; the first one when not said.
    as_json
        Print one JSON object on standard output.
    """
    if name is None and cell is None:
        return _print_catalogue(as_json=as_json)
    from pydantic_core import to_jsonable_python
    from rich.console import Console

    from cellcal.service.cli.printing import PlainTable, print_json
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.runs.run_preview import list_procedures
    from cellcal.service.watching.watch_coverage import describe_coverage

    config = None if cell is None else read_cell_file(cell)
    if name is not None:
        return _print_settings(name, config, robot, as_json=as_json)
    rows = list_procedures(config, robot)
    watched_by_robot = {
        entry.name: describe_coverage(entry.capabilities) for entry in (config.robots if config else ())
    }
    if as_json:
        print_json({"procedures": to_jsonable_python(rows), "watched": watched_by_robot})
        return 0
    table = PlainTable("procedure", "what it does", *(["this cell"] if cell else []))
    for row in rows:
        lacks = row.lacks
        state = [] if lacks is None else [f"lacks {'; '.join(lacks)}" if lacks else "possible"]
        if row.due is not None:
            state.append(f"due {row.due}")
        table.add_row(row.name, row.title, *(["; ".join(state)] if state else []))
    Console(emoji=False).print(table)
    for each, words in watched_by_robot.items():
        Console(emoji=False).print(f"`cellcal watch` sees of {each}: {words}.", markup=False)
    return 0


def _print_catalogue(*, as_json: bool) -> int:
    """List the procedures without a cell, which needs none of their code."""
    from rich.console import Console

    from cellcal.procedures.catalogue_index import CATALOGUE_INDEX
    from cellcal.procedures.procedure_guide import GUIDE
    from cellcal.service.cli.printing import PlainTable, print_json

    if as_json:
        rows = [_catalogue_row(entry) for entry in CATALOGUE_INDEX]
        print_json({"procedures": rows, "watched": {}})
        return 0
    table = PlainTable("procedure", "what it does", "when to use it")
    for entry in CATALOGUE_INDEX:
        table.add_row(entry.name, entry.title, GUIDE[entry.name].when)
    Console(emoji=False).print(table)
    return 0


def _catalogue_row(entry: "ProcedureEntry") -> dict[str, object]:
    """Return a procedure without a cell as `list_procedures` would, without loading any of them."""
    from dataclasses import asdict

    from cellcal.procedures.procedure_guide import GUIDE

    guide = GUIDE[entry.name]
    document = {
        "intention": guide.intention,
        "when": guide.when,
        "minutes": list(guide.minutes),
        "uses": guide.uses,
    }
    return {**asdict(entry), "lacks": None, "due": None, "remedies": [], **document}


def _print_settings(procedure: str, config: "CellConfig | None", robot: str | None, *, as_json: bool) -> int:
    from dataclasses import asdict

    from rich.console import Console

    from cellcal.service.cli.printing import PlainTable, print_json
    from cellcal.service.runs.settings import chosen_by_cell
    from cellcal.service.runs.settings_description import settings_of

    usual = {} if config is None else chosen_by_cell(config, config.robot_named(robot).name, procedure)
    settings = settings_of(procedure, usual)
    if as_json:
        print_json({"procedure": procedure, "settings": [asdict(setting) for setting in settings]})
        return 0
    table = PlainTable(
        "--set",
        "what it is",
        "takes (SI units)",
        "default",
        title=f"Settings of {procedure}",
        title_justify="left",
    )
    for each in settings:
        default = Text("must be given", style="bold") if each.default is None else Text(each.default)
        what = Text.assemble((each.label, "bold"), f"\n{each.help_text}")
        table.add_row(each.name, what, f"{each.takes} {each.unit.strip('1')}".strip(), default)
    Console(emoji=False).print(table)
    return 0


def print_dry_run(
    config: "CellConfig", procedure: str, robot: str | None, settings: Mapping[str, object], *, as_json: bool
) -> int:
    """Print a dry run; return 0 where the cell lacks nothing."""
    from pydantic_core import to_jsonable_python
    from rich.console import Console

    from cellcal.service.cli.printing import print_json
    from cellcal.service.exit_codes import ExitCode
    from cellcal.service.runs.run_preview import dry_run

    found = dry_run(config, procedure, settings, robot)
    if as_json:
        document = to_jsonable_python(found)
        for phase, entry in zip(found.phases, document["phases"], strict=True):
            entry["steps"] = len(phase.step_names)
        print_json(document)
    else:
        console = Console(highlight=False, soft_wrap=True, emoji=False)
        for line in _dry_run_lines(found):
            console.print(line, markup=False)
    return ExitCode.REFUSED if found.lacks or found.problem else ExitCode.PASS


def _dry_run_lines(found: "DryRun") -> list[str]:
    lines = [
        f"Dry run of {found.procedure} (version {found.version}) on {found.robot}, serial {found.serial}.",
        "No device was touched; what follows is from the cell file and the journal.",
        "",
        f"This cell lacks: {'; '.join(found.lacks)}" if found.lacks else "This cell lacks nothing for it.",
        "",
        f"Steps ({found.expected_steps} expected)",
        *(f"  {_describe_phase(phase)}" for phase in found.phases),
    ]
    if found.problem:
        lines += ["", f"No forecast: {found.problem}"]
    return lines + (_forecast_lines(found.forecast) if found.forecast else [])


def _describe_phase(phase: "Phase") -> str:
    if phase.repeats is None:
        return phase.name
    if phase.adaptive and not phase.repeats:
        return f"{phase.name} (only where needed)"
    about = ", the measurements decide" if phase.adaptive else ""
    return f"{phase.name} x {phase.repeats}{about}"


def _forecast_lines(forecast: "Forecast") -> list[str]:
    lines = ["", f"Duration: about {_format_duration(forecast.duration_s)}"] if forecast.duration_s else []
    if forecast.poses:
        lines += ["", "Poses (joints in degrees)"]
        width = max(len(pose.label) for pose in forecast.poses)
        lines += [f"  {pose.label:<{width}} {_format_degrees(pose.joints_rad)}" for pose in forecast.poses]
        if forecast.speed_rad_s is not None:
            lines.append(f"  at up to {57.29578 * forecast.speed_rad_s:.2f} deg/s per joint")
    else:
        lines += ["", "Poses: taught or chosen while measuring; none is known before."]
    if forecast.predictions:
        lines += ["", "Predicted, before measuring"]
        lines += [line for prediction in forecast.predictions for line in _prediction_lines(prediction)]
    for title, remarks in (("Assumed", forecast.assumed), ("Not checked", forecast.not_checked)):
        lines += ["", title, *(f"  * {line}" for line in remarks)] if remarks else []
    return lines


def _prediction_lines(prediction: "Prediction") -> list[str]:
    from cellcal.service.quantities import format_quantity

    lines = [f"  {prediction.name}: U = {format_quantity(prediction.expanded, prediction.unit)} (95 %)"]
    if prediction.sentence:
        lines.append(f"    {prediction.sentence}")
    if prediction.limits:
        limits = ", ".join(
            f"{name} {format_quantity(v, prediction.unit)}" for name, v in prediction.limits.items()
        )
        reach = ", ".join(prediction.classes_in_reach()) or "none"
        lines.append(f"    limits: {limits}; in reach (U at most a third of it): {reach}")
    return lines


def _format_degrees(joints_rad: tuple[float, ...]) -> str:
    return " ".join(f"{DEGREES_PER_RADIAN * q:8.2f}" for q in joints_rad)


def _format_duration(seconds: float) -> str:
    if seconds >= 7200:
        return f"{seconds / 3600.0:.1f} hours"
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60.0:.0f} minutes"
