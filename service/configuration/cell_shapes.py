"""The shapes of arm and cell from a TOML file, in millimetres and degrees as people measure them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.arm.model_references import is_known_model
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import describe_unreadable, read_plain_text
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.geometry import Pose, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.cell_shapes import CellShape, LinkCapsule, PlaneObstacle, SphereObstacle
from cellcal.calibration.motion.motion_check import WirePath
from cellcal.calibration.orientation import rotation_from
from cellcal.procedures.surroundings import BoxBlock, Surroundings, cell_shape, clearance_check

Place = tuple[float, float, float]
_TABLES = ("capsule", "box", "sphere", "plane")
_LENGTHS = ("link_radius_mm", "margin_mm", "wire_margin_mm")
_PLACES = ("tip_in_flange_mm", "box_low_mm", "box_high_mm")
_SINGLE = (*_LENGTHS, *_PLACES)


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
    """Read obstacles, margins and, where they were measured, the shapes of the links.

    ::

        link_radius_mm = 80                       # of every link, if no [[capsule]] tells better
        margin_mm = 20
        tip_in_flange_mm = [0, 0, 180]            # of the tool; adds a bar half as thick
        box_low_mm = [-900, -1200, 0]             # with box_high_mm: the workspace that arm and tool keep to
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
        data = parse_toml(read_plain_text(path))
    except (OSError, DocumentError) as broken:
        raise CellShapeError(describe_unreadable(path, broken)) from broken
    try:
        return cell_shape(model, surroundings_of(data, str(path)), wire, tip_in_flange_m)
    except CalibrationError as refused:
        raise CellShapeError(
            make_message("{path}: {refused_message}", path=path, refused_message=refused.message)
        ) from refused


def surroundings_of(data: Mapping[str, object], where: str) -> Surroundings:
    """Read the same keys from a table, ``[robot.space]`` of a cell file; ``where`` names it in errors.

    Raises
    ------
    CellShapeError
        A key that is missing, unknown, or of the wrong kind.
    """
    unknown = data.keys() - {*_TABLES, *_SINGLE}
    if unknown:
        raise CellShapeError(
            f"{where}: unknown {sorted(unknown)}.",
            remedy=make_message("Known: {conventions}.", conventions=", ".join((*_SINGLE, *_TABLES))),
        )
    lengths = {
        f"{key.removesuffix('_mm')}_m": _read_number(data, key, where) / 1e3
        for key in _LENGTHS
        if key in data
    }
    places = {f"{key.removesuffix('_mm')}_m": _read_place(data, key, where) for key in _PLACES if key in data}
    if ("box_low_m" in places) != ("box_high_m" in places):
        raise CellShapeError(f"{where}: box_low_mm and box_high_mm are given together")
    fields: dict[str, Any] = {**lengths, **places}
    return Surroundings(
        blocks=tuple(_read_box(table, where) for table in _read_tables(data, "box", where)),
        balls=tuple(_read_sphere(table, where) for table in _read_tables(data, "sphere", where)),
        planes=tuple(_read_plane(table, where) for table in _read_tables(data, "plane", where)),
        capsules=tuple(_read_capsule(table, where) for table in _read_tables(data, "capsule", where)),
        **fields,
    )


def check_shapes(model_name: str, surroundings: Surroundings) -> None:
    """Raise CalibrationError where shapes do not fit the arm; an unknown model is reported elsewhere."""
    if is_known_model(model_name):
        clearance_check(model_name, surroundings)


def _read_capsule(table: Mapping[str, object], where: str) -> LinkCapsule:
    _check_keys(table, {"name", "link", "start_mm", "end_mm", "radius_mm"}, set(), where)
    if type(table["link"]) is not int:
        raise CellShapeError(f"{where}: link is a whole number, 0 for the base")
    start, end = (_read_place(table, key, where) for key in ("start_mm", "end_mm"))
    return LinkCapsule(
        str(table["name"]), table["link"], start, end, _read_number(table, "radius_mm", where) / 1e3
    )


def _read_box(table: Mapping[str, object], where: str) -> BoxBlock:
    _check_keys(table, {"name", "centre_in_base_mm", "size_mm"}, {"rpy_deg"}, where)
    angles = np.deg2rad(_read_triple(table, "rpy_deg", where)) if "rpy_deg" in table else np.zeros(3)
    centre = np.array(_read_place(table, "centre_in_base_mm", where))
    size = _read_place(table, "size_mm", where)
    base_box = Pose.from_matrix(homogeneous_matrix(rotation_from("ros_rpy", angles), centre))
    return BoxBlock(str(table["name"]), base_box, size)


def _read_sphere(table: Mapping[str, object], where: str) -> SphereObstacle:
    _check_keys(table, {"name", "centre_in_base_mm", "radius_mm"}, set(), where)
    return SphereObstacle(
        str(table["name"]),
        _read_place(table, "centre_in_base_mm", where),
        _read_number(table, "radius_mm", where) / 1e3,
    )


def _read_plane(table: Mapping[str, object], where: str) -> PlaneObstacle:
    _check_keys(table, {"name", "point_in_base_mm", "normal_in_base"}, set(), where)
    x, y, z = _read_triple(table, "normal_in_base", where)
    return PlaneObstacle(str(table["name"]), _read_place(table, "point_in_base_mm", where), (x, y, z))


def _read_tables(data: Mapping[str, object], key: str, where: str) -> list[Mapping[str, object]]:
    tables = data.get(key, [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise CellShapeError(f"{where}: {key} is written as [[{key}]]")
    return tables


def _check_keys(table: Mapping[str, object], required: set[str], optional: set[str], where: str) -> None:
    missing, unknown = required - table.keys(), table.keys() - required - optional
    if missing or unknown:
        raise CellShapeError(
            f"{where}: {table.get('name', 'a table')} lacks {sorted(missing)}, does not know {sorted(unknown)}"
        )


def _read_place(table: Mapping[str, object], key: str, where: str) -> Place:
    x, y, z = (value / 1e3 for value in _read_triple(table, key, where))
    return x, y, z


def _read_triple(table: Mapping[str, object], key: str, where: str) -> list[float]:
    values = table[key]
    if not isinstance(values, list) or len(values) != 3 or not all(_is_number(v) for v in values):
        raise CellShapeError(f"{where}: {key} is three finite numbers")
    return [float(v) for v in values]


def _read_number(table: Mapping[str, object], key: str, where: str) -> float:
    value = table[key]
    if not _is_number(value):
        raise CellShapeError(f"{where}: {key} is a finite number")
    return float(value)


def _is_number(value: object) -> TypeGuard[float]:
    return type(value) in (int, float) and bool(np.isfinite(value))  # type: ignore[call-overload]  # type() checked
