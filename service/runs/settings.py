"""A procedure's settings as the service completes them: what was typed, and what only it remembers."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass, replace
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import join_messages, make_message
from cellcal.procedures.arm.arm_bench import Method
from cellcal.procedures.catalogue import definition_named
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.surroundings import NOTHING_KNOWN, Surroundings
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.configuration.usual_settings import bool_became_number, is_finite
from cellcal.service.engineering.parameters.simulated_cells import with_files
from cellcal.service.record.healthy_counts import LastHealthyCounts
from cellcal.service.runs.named_axes import with_numbered_axes
from cellcal.service.runs.settings_description import label_of


def build_spec(config: CellConfig, robot: str, procedure: str, settings: Mapping[str, object]) -> Any:
    """Return the procedure's spec.

    Raises
    ------
    CellError
        A setting is unknown or out of its type; every fault is named.
    """
    valid = _settings_of(procedure, settings)
    names = config.robot_named(robot).capabilities.all_axis_names()
    settings = with_numbered_axes(procedure, settings, names)
    if "last_counts" in valid and "last_counts" not in settings:
        healthy = LastHealthyCounts(config.cell.data_dir).load_counts(robot)
        settings = {**settings, "last_counts": None if healthy is None else healthy.counts}
    settings = {**chosen_by_cell(config, robot, procedure), **settings}
    spec = spec_of(procedure, settings)
    try:
        return _in_the_cell(spec, config.motion_of(robot).surroundings)
    except ValueError as error:  # a corner of the workspace from here, the other one from the cell file
        raise _settings_error(procedure, [str(error)]) from error


def chosen_by_cell(config: CellConfig, robot: str, procedure: str) -> dict[str, object]:
    """Return the settings whose usual value follows from the cell: its devices, and what its file says."""
    takes = get_type_hints(definition_named(procedure).spec_type)
    wired, tracked = config.gauge_for(robot) is not None, config.tracker_for(robot) is not None
    chosen: dict[str, object] = {}
    if "evidence" in takes and not wired:
        chosen["evidence"] = "places"  # without a draw-wire, by touched points, a seat or targets
    if takes.get("method") == Method and wired != tracked:
        chosen["method"] = "wire" if wired else "tracker"
    return chosen | dict(config.usual.get(robot, {}).get(procedure, {}))


_BOUNDS = {  # as pydantic names them
    "less_than": "less than",
    "less_than_equal": "less than or equal to",
    "greater_than": "greater than",
    "greater_than_equal": "greater than or equal to",
}
_LIMITS = {"less_than": "lt", "less_than_equal": "le", "greater_than": "gt", "greater_than_equal": "ge"}


def spec_of(procedure: str, settings: Mapping[str, object]) -> Any:
    """Return a procedure's spec from settings alone; those that name files are read.

    Raises
    ------
    CellError
        A setting is unknown or out of its type, or a file cannot be read.
    """
    kind = definition_named(procedure).spec_type
    _settings_of(procedure, settings)
    settings = with_files(kind, settings)
    try:
        spec: Any = TypeAdapter(kind).validate_python(settings)
    except ValidationError as error:
        faults = [
            _labelled_fault(procedure, [str(each) for each in fault["loc"]], _fault_text(fault))
            for fault in error.errors()
        ]
        raise _settings_error(procedure, faults) from error
    became = asdict(spec)
    endless = [key for key, value in became.items() if not is_finite(value)]
    if endless:
        raise _settings_error(procedure, [_setting_fault(", ".join(endless), "not a finite number")])
    yes_or_no = [key for key, value in settings.items() if bool_became_number(value, became[key])]
    if yes_or_no:
        raise _settings_error(
            procedure, [_setting_fault(", ".join(yes_or_no), "true and false are no numbers")]
        )
    return spec


def _settings_of(procedure: str, settings: Mapping[str, object]) -> set[str]:
    """Return the settings that a procedure has; refuse others."""
    valid = {field.name for field in fields(definition_named(procedure).spec_type)}
    unknown = sorted(set(settings) - valid)
    if unknown:
        raise CellError(
            make_message(
                "{procedure} has no setting {unknown}.", procedure=procedure, unknown=", ".join(unknown)
            ),
            remedy=make_message("It has: {names}.", names=", ".join(sorted(valid)) or "none"),
            code="usage",
        )
    return valid


def _in_the_cell(spec: Any, surroundings: Surroundings) -> Any:
    """Return the spec with every room in it knowing what stands in the cell, unless it was told otherwise."""
    changed: dict[str, object] = {}
    for entry in fields(spec):
        value = getattr(spec, entry.name)
        if isinstance(value, MotionBounds):
            if value.surroundings == NOTHING_KNOWN:
                changed[entry.name] = replace(value, surroundings=surroundings)
        elif is_dataclass(value):
            changed[entry.name] = _in_the_cell(value, surroundings)
    return replace(spec, **changed) if changed else spec


def _settings_error(procedure: str, faults: Iterable[str]) -> CellError:
    remedy = make_message(
        "Correct --set; `cellcal procedures {procedure}` shows what each setting takes.", procedure=procedure
    )
    return CellError(
        make_message(
            "{procedure} cannot be run so: {faults}.",
            procedure=procedure,
            faults=join_messages("; ", faults),
        ),
        remedy=remedy,
        code="usage",
    )


def _setting_fault(setting: str, fault: str) -> str:
    return make_message("{setting}: {fault}", setting=setting, fault=fault)


def _labelled_fault(procedure: str, path: Sequence[str], fault: str) -> str:
    """Return what is wrong with a setting, which is named as pages call it and as ``--set`` does."""
    field_names = [name for name in path if not name.startswith("function-")]
    if not field_names:
        return fault
    return make_message(
        "{label} ({setting}): {fault}",
        label=label_of(procedure, field_names),
        setting=".".join(field_names),
        fault=fault,
    )


def _fault_text(fault: ErrorDetails) -> str:
    if fault["type"] == "value_error":  # our own words, without the word that pydantic puts before them
        return str(fault["ctx"]["error"])
    if fault["type"] in _BOUNDS:
        words, limit = _BOUNDS[fault["type"]], fault["ctx"][_LIMITS[fault["type"]]]
        return make_message("Input should be {bound} {limit:g}", bound=words, limit=limit)
    return "must be given" if fault["type"] == "missing" else fault["msg"]
