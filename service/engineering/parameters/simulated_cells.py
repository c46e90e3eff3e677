"""Parts of a simulated cell calibrated from files of tags: settings that name files in, files out."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from pydantic import TypeAdapter
from pydantic_core import to_jsonable_python

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.urdf import read_urdf
from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import CONVENTIONS, values_from
from cellcal.calibration.points.tag_placement import PlacedTags
from cellcal.calibration.points.tag_points import TagPath
from cellcal.procedures.simulation_cell import CalibratedPart, CalibratedRobot, Description, SimulationCell
from cellcal.service.configuration.file_settings import file_settings, tag_settings
from cellcal.service.engineering.measured.embedded_files import file_of, is_embedded
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.measured.tag_files import read_description, tags_of_setting
from cellcal.service.engineering.parameters.calibrated_models import nominal_sha256
from cellcal.service.engineering.parameters.parameter_files import SetOrigin
from cellcal.service.engineering.parameters.parameter_set import ParameterSet, ParameterValue
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.files import SHARED_FILE, missing_file_words, replace_file

_ATTITUDE_FORMS = (
    "fanuc_wpr",
    "kuka_abc",
    "abb_quaternion",
    "ur_rotation_vector",
    "ros_rpy",
    "ros_quaternion",
)
_RESULT: TypeAdapter[CalibratedPart] = TypeAdapter(CalibratedPart)


def with_files(kind: type, settings: Mapping[str, object]) -> dict[str, object]:
    """Return a procedure's settings with the content of the files that they name.

    Raises
    ------
    MeasurementError
        A file cannot be read; one of tags that is missing is named before any is read.
    """
    for name in tag_settings(kind):
        file = _file_in(settings.get(name))
        if isinstance(file, str) and file and not Path(file).exists():
            why, cure = missing_file_words(Path(file))
            raise MeasurementError(why, remedy=cure)
    hints = get_type_hints(kind)
    read = dict(settings)
    for key, value in settings.items():
        if hints.get(key) is TagPath:
            read[key] = tags_of_setting(value, key)
        elif hints.get(key) is Description and value:
            with file_of(value, key) as path:
                read[key] = read_description(path)
    return read


def _file_in(value: Any) -> Any:
    """Return the file of a setting: a path, or one that it carries."""
    return value.get("file", value) if isinstance(value, dict) else value


def refuse_paths(kind: type, settings: Mapping[str, object]) -> None:
    """Refuse settings of a screen that name files of this computer: who looks from afar may not read them.

    Raises
    ------
    CellError
        A file is named and not carried.
    """
    for name in file_settings(kind):
        file = _file_in(settings.get(name))
        if file and not is_embedded(file):
            raise CellError(
                make_message("{name} names a file of the service's computer.", name=name),
                remedy="Choose the file on the page, or start the run there with `cellcal run`.",
                code="usage",
            )


def result_of_run(procedure: str, result: Any) -> CalibratedPart:
    """Return the result of a journalled run of `simulation_cell`.

    Raises
    ------
    CalibrationError
        Another procedure's run, or one without a result.
    """
    if procedure != "simulation_cell" or result is None:
        raise CalibrationError(
            f"this run of {procedure} has no calibrated part of a simulated cell.",
            remedy="Choose a finished run of simulation_cell from `cellcal runs`.",
            code="usage",
        )
    return _RESULT.validate_python(result)


def write_part(found: CalibratedPart, folder: Path) -> list[Path]:
    """Write a calibrated part as files: everything as JSON, frames as text, a robot's description."""
    folder.mkdir(parents=True, exist_ok=True)
    document = to_jsonable_python(found)
    files = {f"{found.part}.json": json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n"}
    if isinstance(found.found, CalibratedRobot):
        files["robot.urdf"] = found.found.description
        files["robot.txt"] = robot_text(found.found)
    else:
        files[f"{found.part}.txt"] = placed_text(found.part, found.found)
    for name, text in files.items():
        replace_file(folder / name, text, mode=SHARED_FILE)
    return [folder / name for name in sorted(files)]


def save_robot(found: CalibratedPart, spec: SimulationCell, folder: Path, who: SetOrigin) -> ParameterSet:
    """Save a robot's deviations as its newest parameter set.

    Raises
    ------
    CalibrationError
        The part is no robot.
    """
    if not isinstance(found.found, CalibratedRobot):
        raise CalibrationError(f"part {found.part} has no parameters of a robot to save.", code="usage")
    robot = found.found.found
    nominal = (
        read_urdf(spec.description, tip_link=spec.tip_link).model
        if spec.description
        else load_model(robot.model)
    )
    hidden = {one.name for one in robot.unknowable}
    values = tuple(
        ParameterValue(v.name, v.unit, v.value, v.standard_uncertainty, determined=v.name not in hidden)
        for v in robot.values
    )
    source = make_message(
        "tags: {simulated}, {measured}", simulated=spec.simulated.source, measured=spec.measured.source
    )
    draft = ParameterSet(
        who.robot_serial,
        robot.model,
        nominal_sha256(nominal),
        who.made_at,
        who.made_by,
        source,
        values,
        who.note,
    )
    return ParameterSets(folder).save_draft(draft)


def robot_text(robot: CalibratedRobot) -> str:
    """Return what was found of a robot, for people."""
    found = robot.found
    lines = [
        f"{found.model}: {found.tags} tags",
        f"before: {found.before.rmse_m * 1e3:.3f} mm RMS at tags that were not fitted",
        f"after:  {found.after.rmse_m * 1e3:.3f} mm RMS at tags that were not fitted",
        "tool:   "
        + " ".join(
            f"{axis} {v * 1e3:.3f}" for axis, v in zip("xyz", found.flange_tool.position_m, strict=True)
        )
        + f" mm from the flange, U {found.tool.expanded_uncertainty * 1e3:.3f} mm (95 %)",
        "device: the robot's base stands in its frame at",
        *(f"  {line}" for line in frame_lines(found.device_base.to_matrix())),
    ]
    hidden = {one.name for one in found.unknowable}
    for value in found.values:
        if value.name not in hidden:
            u = _format_deviation(found.coverage_factor * value.standard_uncertainty, value.unit)
            lines.append(f"{value.name}: {_format_deviation(value.value, value.unit)}, U {u.lstrip('+')}")
    lines += [f"not known: {one.name} (hidden behind {one.partner}); {one.cure}" for one in found.unknowable]
    lines += [f"left out: tag {name}" for name in found.rejected]
    return "\n".join((*lines, *found.remarks)) + "\n"


def placed_text(part: str, found: PlacedTags) -> str:
    """Return where a part is, for people, as each maker writes it."""
    what = "the robot's base in the fixture" if part == "base" else "the workpiece in the robot's base"
    lines = [f"{what}, by {found.method.replace('_', ' ')} on {len(found.tags)} tags"]
    lines += frame_lines(found.outer_inner.to_matrix())
    if part == "base":
        lines += ["the fixture in the robot's base"]
        lines += frame_lines(found.outer_inner.inverse().to_matrix())
    lines.append(
        f"U (95 %): origin {found.origin_uncertainty.expanded_uncertainty * 1e3:.4f} mm, "
        f"turn {math.degrees(found.angle_uncertainty.expanded_uncertainty):.5f} degrees"
    )
    before = found.before_m or (None,) * len(found.tags)
    for tag, was, after in zip(found.tags, before, found.after_m, strict=True):
        lines.append(
            f"tag {tag}: {'' if was is None else f'{was * 1e3:.3f} mm before, '}{after * 1e3:.3f} mm after"
        )
    lines += [f"not used, in one path only: tag {name}" for name in found.unpaired]
    return "\n".join(lines) + "\n"


def frame_lines(matrix: np.ndarray[Any, np.dtype[np.float64]]) -> list[str]:
    """Return a frame in millimetres and degrees, its attitude as each maker writes it."""
    x, y, z = (float(v) * 1e3 for v in matrix[:3, 3])
    lines = [f"x {x:.4f} y {y:.4f} z {z:.4f} mm"]
    for name in _ATTITUDE_FORMS:
        values, fields = values_from(name, matrix[:3, :3]), CONVENTIONS[name].fields
        angles = len(fields) == 3 and name != "ur_rotation_vector"
        numbers = np.degrees(values) if angles else values
        figures = " ".join(f"{key} {value:.6f}" for key, value in zip(fields, numbers, strict=True))
        lines.append(f"{name}: {figures}{' degrees' if angles else ''}")
    return lines


def _format_deviation(value: float, unit: str) -> str:
    return f"{math.degrees(value):+.5f} degrees" if unit == "rad" else f"{value * 1e3:+.4f} mm"
