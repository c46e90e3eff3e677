"""``[[track]]`` and ``[[positioner]]`` of a project: what an external axis moves, and how."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.service.engineering.programs.external.moving_axes import (
    ANY_FRAME,
    AxisKind,
    AxisMotion,
    CellAxes,
    ExternalAxis,
    axis_key,
)
from cellcal.service.engineering.programs.project_poses import (
    ProjectError,
    pose_keys,
    pose_of,
    read_numbers,
    read_text,
    refuse_keys,
    sub_table,
)
from cellcal.service.engineering.programs.robot_makes import RobotMake

TABLES = ("track", "positioner")
_UNIT_WITHIN = 1e-4
_MOST_SCALE = 0.1  # a factor farther from 1 is a mistake, not an error of the axis
_MOTION_KEYS = {*pose_keys(), "direction", "zero_mm", "zero_deg"}
_KEYS = {
    *_MOTION_KEYS, "name", "axis", "kind", "coordinated", "sign", "lower_mm", "upper_mm", "lower_deg", "upper_deg",
    "pulses_per_mm", "pulses_per_deg", "frames", "real", "identified",
}  # fmt: skip
_REAL_KEYS = {*_MOTION_KEYS, "scale"}
# By brand: what its programs call external axes, and an example of each.
_NAMES = {
    "fanuc": (re.compile(r"E[1-9]|GP[2-9]J[1-9]"), "E1 of the robot's group, or GP2 J1 of another"),
    "kuka": (re.compile(r"E[1-6]"), "E1 to E6"),
    "abb": (re.compile(r"EAX[A-F]"), "eax_a to eax_f"),
    "yaskawa": (re.compile(r"[BS][1-9]"), "B1 of the base (BC, BP) or S1 of a station (EC, EX)"),
}


def read_axes(
    data: Mapping[str, Any], folder: Path, make: RobotMake | None, known_frames: Sequence[str], where: str
) -> CellAxes:
    """Return the external axes of a project.

    Raises
    ------
    ProjectError
        A key that is missing, unknown or of the wrong kind, an axis that stands twice, limits that are reversed.
    """
    axes: list[ExternalAxis] = []
    for table_name in TABLES:
        tables = data.get(table_name, [])
        if not isinstance(tables, list) or not all(isinstance(each, dict) for each in tables):
            raise ProjectError(
                f"{where}: {table_name} is a list of tables.", remedy=f"Begin each with [[{table_name}]]."
            )
        for number, table in enumerate(tables, start=1):
            place = f"{where}: [[{table_name}]] {_describe_entry(table, number)}"
            axes.append(_read_axis(table, folder, make, place, is_track=table_name == "track"))
    _refuse_double(axes, where)
    for axis in axes:
        _refuse_frames(axis, known_frames, where)
    return CellAxes(tuple(axes))


def read_fixture_values(table: Mapping[str, Any], axes: CellAxes, where: str) -> dict[str, float]:
    """Return where external axes stood while the fixture was measured, by name [m or rad].

    Raises
    ------
    ProjectError
        An axis that the project does not state, or no number.
    """
    values = sub_table(table, "at", where)
    by_name = {axis.name: axis for axis in axes.axes}
    refuse_keys(values, set(by_name), f"{where} at")
    return {name: _finite(values, name, f"{where} at") * by_name[name].kind.per_unit for name in values}


def _describe_entry(table: Mapping[str, Any], number: int) -> str:
    name = table.get("name")
    return f"{number} ({name})" if isinstance(name, str) and name else str(number)


def _read_axis(
    table: Mapping[str, Any], folder: Path, make: RobotMake | None, where: str, *, is_track: bool
) -> ExternalAxis:
    refuse_keys(table, _KEYS, where)
    name, axis = _required_text(table, "name", where), _required_text(table, "axis", where)
    kind = _read_kind(table, where)
    _refuse_axis_name(axis, make, where)
    coordinated = table.get("coordinated")
    if not isinstance(coordinated, bool):
        raise ProjectError(
            f"{where}: coordinated is missing, or neither true nor false.",
            remedy="Write true where the controller computes with this axis, false where it only moves it.",
        )
    sign = table.get("sign", 1)
    if type(sign) is not int or sign not in (1, -1):
        raise ProjectError(f"{where}: sign is 1 or -1, not {sign!r}.")
    frame = pose_of({"position_mm": [0, 0, 0], **_pose_part(table)}, where)
    entered = _read_motion(table, kind, frame, float(sign), where)
    lower, upper = _read_range(table, kind, where)
    return ExternalAxis(
        name=name,
        axis=axis,
        carries_robot=is_track,
        coordinated=coordinated,
        entered=entered,
        real=_read_real(table, entered, frame, folder, where),
        frame=frame,
        lower=lower,
        upper=upper,
        pulses_per_unit=_read_pulses(table, kind, where),
        frames=_read_frames(table, where, is_track=is_track),
    )


def _required_text(table: Mapping[str, Any], key: str, where: str) -> str:
    found = read_text(table, key, where)
    if found is None:
        raise ProjectError(f"{where}: {key} is missing.", remedy=_MISSING[key])
    return found


_MISSING = {
    "name": 'Give the axis a name of your own, such as name = "rail".',
    "axis": 'Name it as programs do: axis = "E1", "eax_a", "GP2 J1" or "B1".',
}


def _read_kind(table: Mapping[str, Any], where: str) -> AxisKind:
    kind = read_text(table, "kind", where)
    if kind not in tuple(AxisKind):
        stated = "kind is missing" if kind is None else f"kind = {kind!r} is not known"
        raise ProjectError(
            make_message("{where}: {stated}.", where=where, stated=stated),
            remedy="Write prismatic for an axis that slides, revolute for one that turns.",
        )
    return AxisKind(kind)


def _refuse_axis_name(axis: str, make: RobotMake | None, where: str) -> None:
    if make is None:
        return
    if make.brand not in _NAMES:
        raise ProjectError(
            f"{where}: programs of this robot hold no external axes.", remedy="Leave the table out."
        )
    pattern, example = _NAMES[make.brand]
    if not pattern.fullmatch(axis_key(axis)):
        raise ProjectError(
            f"{where}: programs of this robot have no axis {axis!r}.", remedy=f"They name {example}."
        )


def _pose_part(table: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key in pose_keys()}


def _read_motion(
    table: Mapping[str, Any], kind: AxisKind, frame: Array, sign: float, where: str, scale: float = 1.0
) -> AxisMotion:
    if "direction" in table:
        direction = read_numbers(table, "direction", 3, where)
        length = float(np.linalg.norm(direction))
        if abs(length - 1.0) > _UNIT_WITHIN:
            raise ProjectError(
                f"{where}: direction has the length {length:.4g}, not 1.",
                remedy="Divide its three numbers by this length; a direction has no unit.",
            )
        direction = direction / length
    elif kind is AxisKind.REVOLUTE:
        direction = np.array([0.0, 0.0, 1.0])
    else:
        raise ProjectError(
            f"{where}: direction is missing.",
            remedy="Write the unit vector of its slide, such as [1, 0, 0].",
        )
    zero = _value_of(table, "zero", kind, where)
    return AxisMotion(
        kind, frame[:3, 3].copy(), frame[:3, :3] @ direction, 0.0 if zero is None else zero, sign, scale
    )


def _value_of(table: Mapping[str, Any], key: str, kind: AxisKind, where: str) -> float | None:
    """Return a value of an axis [m or rad]; the unit of the other kind is refused."""
    wrong = f"{key}_{'deg' if kind is AxisKind.PRISMATIC else 'mm'}"
    if wrong in table:
        raise ProjectError(
            f"{where}: {wrong} does not fit an axis of kind {kind}.",
            remedy=f"Write {key}_{kind.unit}, or correct its kind.",
        )
    full = f"{key}_{kind.unit}"
    return None if full not in table else _finite(table, full, where) * kind.per_unit


def _finite(table: Mapping[str, Any], key: str, where: str) -> float:
    found = table[key]
    if type(found) not in (int, float) or not np.isfinite(float(found)):
        raise ProjectError(f"{where}: {key} is a finite number, not {found!r}.")
    return float(found)


def _read_range(table: Mapping[str, Any], kind: AxisKind, where: str) -> tuple[float, float]:
    lower, upper = (_value_of(table, key, kind, where) for key in ("lower", "upper"))
    low, high = -np.inf if lower is None else lower, np.inf if upper is None else upper
    if low >= high:
        raise ProjectError(
            f"{where}: lower_{kind.unit} ({low / kind.per_unit:g}) is not below upper_{kind.unit} "
            f"({high / kind.per_unit:g}).",
            remedy="Exchange the two.",
        )
    return float(low), float(high)


def _read_pulses(table: Mapping[str, Any], kind: AxisKind, where: str) -> float | None:
    wrong = f"pulses_per_{'deg' if kind is AxisKind.PRISMATIC else 'mm'}"
    key = f"pulses_per_{kind.unit}"
    if wrong in table:
        raise ProjectError(
            f"{where}: {wrong} does not fit an axis of kind {kind}.",
            remedy=f"Write {key}, or correct its kind.",
        )
    if key not in table:
        return None
    found = _finite(table, key, where)
    if found == 0:
        raise ProjectError(f"{where}: {key} is zero.", remedy="Divide its pulses by its travel.")
    return found / kind.per_unit


def _read_frames(table: Mapping[str, Any], where: str, *, is_track: bool) -> tuple[str, ...]:
    found = table.get("frames", [] if is_track else None)
    if found is None:
        raise ProjectError(
            f"{where}: frames is missing: nothing tells which points are at the work that it carries.",
            remedy='Name their user frames, frames = ["*"] for all points, or frames = [] for none.',
        )
    if not isinstance(found, list) or not all(isinstance(item, str) and item for item in found):
        raise ProjectError(f'{where}: frames is a list of user frames, such as frames = ["3"].')
    if is_track and found:
        raise ProjectError(
            f"{where}: a track carries the robot, and no frames.",
            remedy="Leave frames out, or write [[positioner]].",
        )
    return tuple(found)


def _read_real(
    table: Mapping[str, Any], entered: AxisMotion, frame: Array, folder: Path, where: str
) -> AxisMotion:
    """Return the axis as it was identified: a table of its own, or a file with the same keys."""
    real, file = sub_table(table, "real", where), read_text(table, "identified", where)
    if real and file is not None:
        raise ProjectError(f"{where}: real and identified exclude each other.")
    if file is not None:
        where = str((folder / file).resolve())
        real = _load_identified((folder / file).resolve())
    if not real:
        return entered
    refuse_keys(real, _REAL_KEYS, f"{where} real" if file is None else where)
    scale = _finite(real, "scale", where) if "scale" in real else 1.0
    if abs(scale - 1.0) > _MOST_SCALE:
        raise ProjectError(
            f"{where}: scale {scale:g} is no error of an axis.",
            remedy="It is the travel for each unit of the value: near 1.",
        )
    pose = _pose_part(real)
    real_frame = pose_of({"position_mm": [0, 0, 0], **pose}, where) if pose else frame
    zero = {} if any(f"zero_{unit}" in real for unit in ("mm", "deg")) else _zero_of(entered)
    stated = {**zero, **real}
    if ("direction" not in stated and entered.kind is AxisKind.PRISMATIC) or (
        "direction" not in stated and not pose
    ):
        stated["direction"] = (frame[:3, :3].T @ entered.direction).tolist()
    return _read_motion(stated, entered.kind, real_frame, entered.sign, where, scale)


def _zero_of(entered: AxisMotion) -> dict[str, float]:
    return {f"zero_{entered.kind.unit}": entered.zero / entered.kind.per_unit}


def _load_identified(path: Path) -> dict[str, Any]:
    try:
        return parse_toml(read_plain_text(path))
    except (OSError, DocumentError) as broken:
        raise ProjectError(f"{path} cannot be read as an identified axis: {broken}") from broken


def _refuse_double(axes: Sequence[ExternalAxis], where: str) -> None:
    for what, names in (
        ("name", [axis.name for axis in axes]),
        ("axis", [axis_key(axis.axis) for axis in axes]),
    ):
        double = next((name for name in names if names.count(name) > 1), None)
        if double is not None:
            raise ProjectError(
                f"{where}: two external axes have the {what} {double}.",
                remedy="Give each axis a table of its own.",
            )


def frames_at_zero(frames: Mapping[str, Array], axes: CellAxes) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return user frames in the cell frame with all axes at zero, and the tables of those that an axis turns.

    A frame that a positioner turns is written as its controller has it, from the last of the axes that turn it.
    """
    found, tables = dict(frames), dict[str, Array]()
    for name, pose in frames.items():
        turning = [n for n in axes.carriers_of(name, caseless=False) if axes.axes[n].coordinated]
        if turning:
            tables[name] = axes.axes[turning[-1]].frame
            found[name] = tables[name] @ pose
    return found, tables


def _refuse_frames(axis: ExternalAxis, known_frames: Sequence[str], where: str) -> None:
    if not axis.coordinated or axis.carries_robot:
        return
    if ANY_FRAME in axis.frames:
        raise ProjectError(
            f'{where}: [[positioner]] {axis.name} turns user frames, and frames = ["*"] names none.',
            remedy="Name each frame that it turns; frames that stand still have coordinated = false.",
        )
    unknown = [name for name in axis.frames if name not in known_frames]
    if unknown:
        raise ProjectError(
            f"{where}: [[positioner]] {axis.name} turns the user frame {unknown[0]}, which no [frames.{unknown[0]}] "
            "states.",
            remedy="Write its pose on the table, as the controller has it; a fixed frame has coordinated = false.",
        )
