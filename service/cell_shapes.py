"""The shapes of arm and cell from a TOML file, in millimetres and degrees as people measure them."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from calibration.collision import (
    Box,
    Capsule,
    CellShape,
    Obstacle,
    Plane,
    Sphere,
    arm_shape,
    assumed_shape,
)
from calibration.errors import CalibrationError, CellError
from calibration.geometry import homogeneous
from calibration.kinematics import RobotModel
from calibration.motion_check import WirePath
from calibration.orientation import rotation_from

Place = tuple[float, float, float]
_TABLES = ("capsule", "box", "sphere", "plane")
_SINGLE = ("link_radius_mm", "margin_mm", "wire_margin_mm")


class CellShapeError(CellError):
    """The file of shapes cannot be understood; the user can mend it."""

    code = "usage"


def read_cell_shape(
    path: Path,
    model: RobotModel,
    *,
    tip_in_flange_m: Place | None = None,
    wire: WirePath | None = None,
) -> CellShape:
    """Read obstacles, margins and, where somebody measured them, the shapes of the links.

    ::

        link_radius_mm = 80                       # of every link, if no [[capsule]] tells better
        margin_mm = 20
        [[box]]
        name = "table"
        centre_in_base_mm = [600, 0, -50]
        size_mm = [800, 1200, 40]
        rpy_deg = [0, 0, 15]                      # optional
        [[sphere]]                                # name, centre_in_base_mm, radius_mm
        [[plane]]                                 # name, point_in_base_mm, normal_in_base: solid behind
        [[capsule]]                               # name, link, start_mm, end_mm, radius_mm: frame of that link

    Raises
    ------
    CellShapeError
        Not such a file; a key that is missing, unknown, or of the wrong kind.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as broken:
        raise CellShapeError(f"{path} cannot be read: {broken}") from broken
    unknown = data.keys() - {*_TABLES, *_SINGLE}
    if unknown:
        raise CellShapeError(
            f"{path}: unknown {sorted(unknown)}.", remedy=f"Known: {', '.join((*_SINGLE, *_TABLES))}."
        )
    obstacles: list[Obstacle] = [
        build(table, path) for key, build in _BUILDERS.items() for table in _list(data, key, path)
    ]
    capsules = [_capsule(table, path) for table in _list(data, "capsule", path)]
    margin = _number(data, "margin_mm", path) / 1e3 if "margin_mm" in data else 0.02
    wire_margin = _number(data, "wire_margin_mm", path) / 1e3 if "wire_margin_mm" in data else 0.05
    try:
        assumed: tuple[str, ...] = ()
        arm = tuple(capsules)
        if not capsules and "link_radius_mm" in data:
            radius = _number(data, "link_radius_mm", path) / 1e3
            arm = arm_shape(model, radius_m=radius, tip_in_flange_m=tip_in_flange_m)
            assumed = (f"links are taken as {radius * 1e3:.0f} mm round about the kinematic skeleton",)
        elif not capsules:
            shape = assumed_shape(model, tip_in_flange_m=tip_in_flange_m)
            arm, assumed = shape.arm, shape.assumed
        return CellShape(arm, tuple(obstacles), wire, margin, wire_margin, assumed)
    except CalibrationError as refused:
        raise CellShapeError(f"{path}: {refused.message}") from refused


def _capsule(table: dict[str, Any], path: Path) -> Capsule:
    _keys(table, {"name", "link", "start_mm", "end_mm", "radius_mm"}, set(), path)
    if type(table["link"]) is not int:
        raise CellShapeError(f"{path}: link is a whole number, 0 for the base")
    start, end = (_place(table, key, path) for key in ("start_mm", "end_mm"))
    return Capsule(str(table["name"]), table["link"], start, end, _number(table, "radius_mm", path) / 1e3)


def _box(table: dict[str, Any], path: Path) -> Box:
    _keys(table, {"name", "centre_in_base_mm", "size_mm"}, {"rpy_deg"}, path)
    angles = np.deg2rad(_three(table, "rpy_deg", path)) if "rpy_deg" in table else np.zeros(3)
    centre = np.array(_place(table, "centre_in_base_mm", path))
    size = _place(table, "size_mm", path)
    return Box(str(table["name"]), homogeneous(rotation_from("ros_rpy", angles), centre), size)


def _sphere(table: dict[str, Any], path: Path) -> Sphere:
    _keys(table, {"name", "centre_in_base_mm", "radius_mm"}, set(), path)
    return Sphere(
        str(table["name"]), _place(table, "centre_in_base_mm", path), _number(table, "radius_mm", path) / 1e3
    )


def _plane(table: dict[str, Any], path: Path) -> Plane:
    _keys(table, {"name", "point_in_base_mm", "normal_in_base"}, set(), path)
    x, y, z = _three(table, "normal_in_base", path)
    return Plane(str(table["name"]), _place(table, "point_in_base_mm", path), (x, y, z))


_BUILDERS: dict[str, Callable[[dict[str, Any], Path], Obstacle]] = {
    "box": _box,
    "sphere": _sphere,
    "plane": _plane,
}


def _list(data: dict[str, Any], key: str, path: Path) -> list[dict[str, Any]]:
    tables = data.get(key, [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise CellShapeError(f"{path}: {key} is written as [[{key}]]")
    return tables


def _keys(table: dict[str, Any], wanted: set[str], optional: set[str], path: Path) -> None:
    missing, unknown = wanted - table.keys(), table.keys() - wanted - optional
    if missing or unknown:
        raise CellShapeError(
            f"{path}: {table.get('name', 'a table')} lacks {sorted(missing)}, does not know {sorted(unknown)}"
        )


def _place(table: dict[str, Any], key: str, path: Path) -> Place:
    x, y, z = (value / 1e3 for value in _three(table, key, path))
    return x, y, z


def _three(table: dict[str, Any], key: str, path: Path) -> list[float]:
    values = table[key]
    if not isinstance(values, list) or len(values) != 3 or not all(_is_number(v) for v in values):
        raise CellShapeError(f"{path}: {key} is three finite numbers")
    return [float(v) for v in values]


def _number(table: dict[str, Any], key: str, path: Path) -> float:
    if not _is_number(table[key]):
        raise CellShapeError(f"{path}: {key} is a finite number")
    return float(table[key])


def _is_number(value: object) -> bool:
    return type(value) in (int, float) and bool(np.isfinite(value))  # type: ignore[call-overload]  # type() checked
