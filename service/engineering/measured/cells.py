"""Layout files of several devices, targets or robots: what one file of rows says about a whole cell."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.cells.cell import DeviceScalar
from cellcal.calibration.cells.frame_priors import FramePrior
from cellcal.calibration.geometry import Array, homogeneous_matrix, rotation_from_quaternion
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import CONVENTIONS
from cellcal.service.engineering.measured.layouts import layout_data, refuse_unknown
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.measured.units import ANGLE_UNITS, LENGTH_UNITS

_PLACE = ("name", "place_mm", "quaternion", "known_to_mm", "known_to_deg")
_NUMBERS = ("zero_mm", "zero_known_to_mm", "scale", "scale_known_to", "radius_mm", "radius_known_to_mm")
_KEYS: Mapping[str, tuple[str, ...]] = {
    "robot": (*_PLACE, "model"),
    "tool": (*_PLACE, "robot"),
    "target": (*_PLACE, "tool"),
    "device": (*_PLACE, *_NUMBERS, "moved"),
    "reading": (
        *("name", "kind", "columns", "rotation", "joints_to", "device", "target"),
        *("sigma_mm", "sigma_deg", "nominal_mm", "where"),
    ),
}
_COLUMNS = ("joints", "robot", "device", "target", "group")
_UNITS = {
    "joints": tuple(ANGLE_UNITS),
    "slides": tuple(LENGTH_UNITS),
    "rotation": ("deg", "rad"),
    "readings": tuple(LENGTH_UNITS),
}
KINDS = {"point": 3, "pose": 3, "length": 1, "guided length": 1, "bar": 1, "plane": 0, "sphere": 0, "pin": 0}
_FRAME, _POINT = "frame", "point"


@dataclass(frozen=True, slots=True)
class LayoutItem:
    """A robot, tool, target or device of a layout."""

    name: str
    place: FramePrior | None
    words: Mapping[str, str] = field(default_factory=dict)  # model, robot, tool, moved
    numbers: Mapping[str, DeviceScalar] = field(default_factory=dict)
    turned: bool = True  # its attitude is given, too


@dataclass(frozen=True, slots=True)
class LayoutReading:
    """Columns that one device fills: which rows, of which target, and how well."""

    name: str
    kind: str
    columns: tuple[str, ...]
    rotation: tuple[str, ...]
    joints_to: tuple[str, ...]
    device: str  # empty: named by a column
    target: str  # empty: named by a column
    sigma_m: float
    sigma_rad: float
    nominal_m: float
    where: Mapping[str, str | float]


@dataclass(frozen=True, eq=False)
class CellLayoutFile:
    """All that a layout says about a cell."""

    joints: tuple[str, ...]
    names_in: Mapping[str, str]  # robot, device, target, group -> column
    units: Mapping[str, str]
    convention: str
    sheet: str | None
    joint_coupling: str  # empty, controller or geometric
    robots: tuple[LayoutItem, ...]
    tools: tuple[LayoutItem, ...]
    targets: tuple[LayoutItem, ...]
    devices: tuple[LayoutItem, ...]
    readings: tuple[LayoutReading, ...]


def describes_a_cell(path: Path) -> bool:
    """Return whether a layout names readings of a cell, rather than the columns of one device."""
    return "reading" in layout_data(path)


def read_cell_layout(path: Path) -> CellLayoutFile:
    """Read the layout of a cell.

    Raises
    ------
    MeasurementError
        No such file, no TOML, or an entry that no layout has; with what it may be.
    """
    data = layout_data(path)
    refuse_unknown(path, data, ("columns", "units", "convention", "sheet", "joint_coupling", *_KEYS))
    columns, units = dict(data.get("columns", {})), dict(data.get("units", {}))
    refuse_unknown(path, columns, _COLUMNS)
    for meaning, unit in units.items():
        if unit not in _UNITS.get(meaning, ()):
            valid_units = "; ".join(f"{key} in {', '.join(names)}" for key, names in _UNITS.items())
            raise MeasurementError(
                make_message(
                    "{path}: {meaning} cannot be in {unit!r}.", path=path, meaning=meaning, unit=unit
                ),
                remedy=make_message("Units: {valid_units}.", valid_units=valid_units),
            )
    if not columns.get("joints"):
        raise MeasurementError(
            make_message("{path} names no joints.", path=path),
            remedy='Write `[columns]`, `joints = ["q1", …]`.',
        )
    convention = str(data.get("convention", ""))
    if convention and convention not in CONVENTIONS:
        raise MeasurementError(
            make_message(
                "{path}: no orientation is called {convention!r}.", path=path, convention=convention
            ),
            remedy=make_message("There are {names}.", names=", ".join(CONVENTIONS)),
        )
    tables = {
        key: [_LayoutTable(path, key, entry) for entry in _table_list(path, data, key)] for key in _KEYS
    }
    readings = tuple(_read_reading(entry, columns, convention) for entry in tables["reading"])
    return CellLayoutFile(
        tuple(columns.pop("joints")),
        columns,
        {"joints": "deg", "slides": "mm", "rotation": "deg", "readings": "mm", **units},
        convention,
        data.get("sheet"),
        _joint_coupling(path, data),
        tuple(_read_item(entry, _FRAME, ("model",)) for entry in tables["robot"]),
        tuple(_read_item(entry, _POINT, ("robot",)) for entry in tables["tool"]),
        tuple(_read_target(entry) for entry in tables["target"]),
        tuple(_read_device(entry) for entry in tables["device"]),
        readings,
    )


def _joint_coupling(path: Path, data: Mapping[str, Any]) -> str:
    word = data.get("joint_coupling", "")
    if word not in ("", "controller", "geometric"):
        raise MeasurementError(
            make_message("{path}: joints cannot be {word!r}.", path=path, word=word),
            remedy="joint_coupling is controller (as on the pendant) or geometric.",
        )
    return str(word)


@dataclass(frozen=True, slots=True)
class _LayoutTable:
    """One table of a layout, such as a ``[[device]]``."""

    path: Path
    kind: str
    data: Mapping[str, Any]

    def make_error(self, what: str, remedy: str = "") -> MeasurementError:
        """Return an error that names the entry."""
        return MeasurementError(
            make_message(
                "{path}: {kind} {data!r}: {what}.",
                path=self.path,
                kind=self.kind,
                data=self.data.get("name", ""),
                what=what,
            ),
            remedy=remedy,
        )

    def text_value(self, key: str, *, needed: bool = False) -> str:
        """Return a text."""
        value = self.data.get(key, "")
        if not isinstance(value, str) or (needed and not value):
            raise self.make_error(
                make_message("{key} is no text", key=key), make_message('Write {key} = "…".', key=key)
            )
        return value

    def text_values(self, key: str) -> tuple[str, ...]:
        """Return a list of texts."""
        value = self.data.get(key, [])
        if not isinstance(value, list) or not all(isinstance(word, str) for word in value):
            raise self.make_error(make_message("{key} is no list of column names", key=key))
        return tuple(value)

    def read_number(self, key: str, otherwise: float) -> float:
        """Return a finite number."""
        value = self.data.get(key, otherwise)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.make_error(make_message("{key} is no number", key=key))
        if key in self.data and not np.isfinite(value):
            raise self.make_error(make_message("{text} is not finite", text=key))
        return float(value)

    def read_deviation(self, key: str, otherwise: float) -> float:
        """Return a number of zero or more."""
        value = self.read_number(key, otherwise)
        if value < 0:
            raise self.make_error(make_message("{key} is below zero", key=key))
        return value

    def read_vector(self, key: str, size: int) -> Array | None:
        """Return so many finite numbers, or None."""
        if key not in self.data:
            return None
        value = self.data[key]
        numbers = isinstance(value, list) and all(
            isinstance(v, int | float) and not isinstance(v, bool) for v in value
        )
        if not numbers or len(value) != size or not np.isfinite(value).all():
            raise self.make_error(make_message("{key} is no list of {size} numbers", key=key, size=size))
        return np.array(value, dtype=float)


def _table_list(path: Path, data: Mapping[str, Any], key: str) -> Sequence[Mapping[str, Any]]:
    found = data.get(key, [])
    if not isinstance(found, list) or not all(isinstance(entry, dict) for entry in found):
        raise MeasurementError(
            make_message("{path}: {key} is no list of tables.", path=path, key=key),
            remedy=make_message("Write `[[{key}]]`.", key=key),
        )
    for entry in found:
        refuse_unknown(path, entry, _KEYS[key])
    return found


def _read_reading(entry: _LayoutTable, columns: Mapping[str, Any], convention: str) -> LayoutReading:
    kind, names = entry.text_value("kind", needed=True), entry.text_values("columns")
    _refuse_unfit(entry, kind, convention)
    for key in ("device", "target"):
        if not entry.text_value(key) and key not in columns:
            raise entry.make_error(
                make_message("it names no {key}", key=key),
                make_message('Write {key} = "…", or name the column that does.', key=key),
            )
    where = entry.data.get("where", {})
    if not isinstance(where, dict) or not all(isinstance(v, str | int | float) for v in where.values()):
        raise entry.make_error("where is no table of column = entry")
    sigma = entry.read_deviation("sigma_mm", 0.0), entry.read_deviation("sigma_deg", 0.01)
    if not min(sigma) > 0:
        raise entry.make_error(
            "sigma_mm is missing", "Give one standard deviation of the device, from its certificate."
        )
    return LayoutReading(
        entry.text_value("name", needed=True),
        kind,
        names,
        entry.text_values("rotation"),
        entry.text_values("joints_to"),
        entry.text_value("device"),
        entry.text_value("target"),
        sigma[0] * 1e-3,
        float(np.deg2rad(sigma[1])),
        entry.read_number("nominal_mm", 0.0) * 1e-3,
        where,
    )


def _refuse_unfit(entry: _LayoutTable, kind: str, convention: str) -> None:
    """Refuse a reading that lacks what its kind needs."""
    if kind not in KINDS:
        raise entry.make_error(
            make_message("there is no kind {kind!r}", kind=kind),
            make_message("Kinds are {names}.", names=", ".join(KINDS)),
        )
    count, nominal = len(entry.text_values("columns")), "nominal_mm" in entry.data
    wants = {KINDS[kind]} | ({0} if nominal else set()) | ({1} if kind == "plane" else set())
    if count not in wants:
        raise entry.make_error(
            make_message(
                "a {kind} has {columns} columns, not {count}", kind=kind, columns=KINDS[kind], count=count
            )
        )
    needed = {
        "pose": (
            bool(entry.text_values("rotation")) and bool(convention),
            "rotation columns and a convention on top",
        ),
        "sphere": (nominal, "nominal_mm: the ball's radius plus that of the tip"),
        "bar": (bool(entry.text_values("joints_to")), "joints_to, the columns of the second posture"),
    }
    there, what = needed.get(kind, (True, ""))
    if not there:
        raise entry.make_error(make_message("a {kind} needs {what}", kind=kind, what=what))


def _read_item(entry: _LayoutTable, shape: str, words: tuple[str, ...]) -> LayoutItem:
    found = {key: entry.text_value(key) for key in words if key in entry.data}
    return LayoutItem(entry.text_value("name", needed=True), _read_place(entry, shape), found)


def _read_target(entry: _LayoutTable) -> LayoutItem:
    place = _read_place(entry, _POINT)
    if place is None:
        raise entry.make_error(
            "its place in the tool is missing", "Write place_mm = [x, y, z], or drop the entry."
        )
    if "known_to_mm" not in entry.data:
        place = FramePrior(place.pose, np.zeros(6))
    return LayoutItem(
        entry.text_value("name", needed=True), place, {"tool": entry.text_value("tool", needed=True)}
    )


def _read_device(entry: _LayoutTable) -> LayoutItem:
    numbers = {
        "zero_m": _read_scalar(entry, "zero_mm", 0.0, "zero_known_to_mm", 1e-3),
        "scale": _read_scalar(entry, "scale", 1.0, "scale_known_to", 1.0),
        # What is stated of a ball is in nominal_mm: the device holds what it is larger by.
        "radius_m": _read_scalar(entry, "radius_mm", 0.0, "radius_known_to_mm", 1e-3),
    }
    scalars = {key: scalar for key, scalar in numbers.items() if scalar is not None}
    words = {"moved": entry.text_value("moved", needed=True)} if "moved" in entry.data else {}
    if words and scalars:
        raise entry.make_error(
            make_message("its numbers are those of {device!r}", device=words["moved"]),
            make_message("Write {keys} there only.", keys=", ".join(_NUMBERS[::2])),
        )
    return LayoutItem(
        entry.text_value("name", needed=True),
        _read_place(entry, _POINT),
        words,
        scalars,
        "quaternion" in entry.data,
    )


def _read_scalar(
    entry: _LayoutTable, key: str, usual: float, spread: str, unit: float
) -> DeviceScalar | None:
    if key not in entry.data and spread not in entry.data:
        return None
    return DeviceScalar(entry.read_number(key, usual) * unit, entry.read_deviation(spread, 0.0) * unit)


def _read_place(entry: _LayoutTable, shape: str) -> FramePrior | None:
    """Return a place that is known to a deviation, or roughly; None if nothing is said of it."""
    position, quaternion = entry.read_vector("place_mm", 3), entry.read_vector("quaternion", 4)
    has_deviation = "known_to_mm" in entry.data
    if position is None:
        return None
    if quaternion is None:
        if shape == _FRAME and not has_deviation:
            return None  # without its attitude a rough frame is worse than the fit's own guess
        if shape == _FRAME:
            raise entry.make_error("a known frame needs its quaternion", "Write quaternion = [w, x, y, z].")
        point = position * 1e-3
        return (
            FramePrior.from_point(point, entry.read_deviation("known_to_mm", 0.0) * 1e-3)
            if has_deviation
            else FramePrior.point_without_prior(point)
        )
    if not abs(float(np.linalg.norm(quaternion)) - 1.0) < 1e-3:
        raise entry.make_error("its quaternion is not of unit length")
    pose = homogeneous_matrix(
        rotation_from_quaternion(quaternion / np.linalg.norm(quaternion)), position * 1e-3
    )
    if not has_deviation:
        return FramePrior.without_prior(pose)
    spread = (
        entry.read_deviation("known_to_mm", 0.0) * 1e-3,
        np.deg2rad(entry.read_deviation("known_to_deg", 0.0)),
    )
    return FramePrior.from_pose(pose, spread[0], float(spread[1]))
