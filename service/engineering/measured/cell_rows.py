"""A file of rows, read by the layout of a cell: each reading becomes series of one device and one target."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.cells.cell import (
    CalibrationCell,
    CellDevice,
    CellRobot,
    CellSeries,
    CellTarget,
    CellTool,
)
from cellcal.calibration.cells.contact_observations import (
    BarLengths,
    CellObservations,
    GuidedLengthObservations,
    PinTouches,
    PlaneContacts,
    SphereContacts,
)
from cellcal.calibration.cells.frame_priors import FramePrior
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import (
    LengthObservations,
    PointObservations,
    PoseObservations,
    Rows,
)
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import CONVENTIONS, rotation_from
from cellcal.service.engineering.measured.cells import CellLayoutFile, LayoutItem, LayoutReading
from cellcal.service.engineering.measured.headings import unit_of
from cellcal.service.engineering.measured.joint_coupling import controller_joints
from cellcal.service.engineering.measured.joint_units import refuse_typed_zeros
from cellcal.service.engineering.measured.no_readings import no_readings
from cellcal.service.engineering.measured.table import MeasurementError, MeasurementTable, read_table
from cellcal.service.engineering.measured.typed_columns import parse_columns
from cellcal.service.engineering.measured.units import ANGLE_UNITS, LENGTH_UNITS

_UNITS = {**ANGLE_UNITS, **LENGTH_UNITS}
_UNBELIEVABLE = 1e9


@dataclass(frozen=True, eq=False)
class CellMeasurements:
    """A cell from a file; ``lines`` of every series say where its rows stand in the file, counted from one."""

    cell: CalibrationCell
    lines: Mapping[str, Rows]
    read: int
    left_out: tuple[tuple[str, int], ...]  # reading, and how many rows it did not fill
    standings: Mapping[
        str, tuple[str, ...]
    ]  # of every device, what the layout calls it at each of its places


def read_cell(path: Path, layout: CellLayoutFile, robot: str) -> CellMeasurements:
    """Read the rows of a cell; ``robot`` is the model of every robot whose entry names none.

    Raises
    ------
    MeasurementError
        A column, or a name in one, that the file or the layout does not have.
    CalibrationError
        No such robot model; or what a `Cell` refuses.
    """
    table = read_table(path, sheet=layout.sheet)
    file = _CellTable(path, table, layout)
    robots = layout.robots or (LayoutItem("robot", None),)
    models = {entry.name: load_model(entry.words.get("model", robot)) for entry in robots}
    parts = [part for reading in layout.readings for part in file.read_parts(reading, models)]
    if not parts:
        raise MeasurementError(
            make_message("{path}: no reading of the layout fills a row.", path=path),
            remedy="Check columns and where.",
        )
    tools = {
        tool.name: CellTool(tool.name, tool.words.get("robot", robots[0].name), tool.place)
        for tool in layout.tools
    }
    targets = [CellTarget(t.name, t.words["tool"], t.place) for t in layout.targets if t.place is not None]
    carriers = {name: tool.robot for name, tool in tools.items()}
    carriers |= {target.name: carriers.get(target.tool, "") for target in targets}
    parts = _with_own_targets(path, parts, carriers)
    for part in parts:
        if part.target not in carriers:
            tools.setdefault(part.target, CellTool(part.target, part.robot))
    standings = _device_placements(path, layout, parts)
    owner = {name: device for device, names in standings.items() for name in names}
    entries = {device.name: device for device in layout.devices}
    cell = CalibrationCell(
        [CellRobot(entry.name, models[entry.name], entry.place) for entry in robots],
        list(tools.values()),
        [
            CellDevice(
                device,
                tuple(_find_place(name, entries.get(name), parts) for name in names),
                entries[device].numbers if device in entries else {},
            )
            for device, names in standings.items()
        ],
        [
            CellSeries(
                part.name,
                owner[part.device],
                part.target,
                _with_mounting_of(part.observations, standings[owner[part.device]].index(part.device)),
                groups=part.groups,
            )
            for part in parts
        ],
        targets,
    )
    return CellMeasurements(
        cell,
        {part.name: part.lines for part in parts},
        len(table),
        tuple(file.left_out.items()),
        standings,
    )


def _with_own_targets(
    path: Path, parts: list["_SeriesPart"], carriers: Mapping[str, str]
) -> list["_SeriesPart"]:
    """Give each robot a target of its own where rows of several name one that no table describes.

    Raises
    ------
    MeasurementError
        Rows of one robot name a target that a table fixes to another one.
    """
    robots_of: dict[str, set[str]] = {}
    for part in parts:
        robots_of.setdefault(part.target, set()).add(part.robot)
        carrier = carriers.get(part.target)
        if carrier and carrier != part.robot:
            raise MeasurementError(
                make_message(
                    "{path}: rows of robot {robot!r} name target {target!r}, which the layout fixes to {carrier!r}.",
                    path=path,
                    robot=part.robot,
                    target=part.target,
                    carrier=carrier,
                ),
                remedy="Give each robot's target a name of its own, and its tool the robot that carries it.",
            )
    return [
        replace(part, target=f"{part.target} ({part.robot})") if len(robots_of[part.target]) > 1 else part
        for part in parts
    ]


def _device_placements(
    path: Path, layout: CellLayoutFile, parts: list["_SeriesPart"]
) -> dict[str, tuple[str, ...]]:
    """Return the names under which every device stands somewhere: it and its moves, as far as rows use them."""
    entries = {device.name: device for device in layout.devices}
    found: dict[str, list[str]] = {}
    for name in dict.fromkeys(part.device for part in parts):
        device = entries[name].words.get("moved", name) if name in entries else name
        if device in entries and "moved" in entries[device].words:
            raise MeasurementError(
                make_message(
                    "{path}: device {name!r} is moved from {device!r}, which was moved itself.",
                    path=path,
                    name=name,
                    device=device,
                ),
                remedy=make_message("Write moved = {device!r}.", device=entries[device].words["moved"]),
            )
        found.setdefault(device, []).append(name)
    return {device: tuple(names) for device, names in found.items()}


def _with_mounting_of(observations: CellObservations, mounting: int) -> CellObservations:
    return replace(observations, mounting=np.full(len(observations), mounting, dtype=np.intp))


def _find_place(name: str, entry: LayoutItem | None, parts: list["_SeriesPart"]) -> FramePrior:
    """Return where a device stands; a place without attitude will do for a point, not for a frame or an axis."""
    if entry is None:
        return FramePrior.without_prior()
    turning = any(part.device == name and set(part.observations.place_axes) - {0, 1, 2} for part in parts)
    place = entry.place
    if place is not None and turning and not entry.turned:
        if np.isfinite(place.sigma[:3]).any():
            raise MeasurementError(
                make_message(
                    "device {name!r}: what it reads depends on its attitude, which is missing.", name=name
                ),
                remedy="Write quaternion = [w, x, y, z] beside place_mm, or leave known_to_mm out.",
            )
        place = None
    return place or FramePrior.without_prior()


@dataclass(frozen=True, eq=False)
class _SeriesPart:
    name: str
    device: str
    target: str
    robot: str
    observations: CellObservations
    lines: Rows
    groups: Rows | None


class _CellTable:
    """A table with its layout."""

    def __init__(self, path: Path, table: MeasurementTable, layout: CellLayoutFile) -> None:
        self._path, self._table, self._layout = path, table, layout
        self.left_out: dict[str, int] = {}

    def read_parts(self, reading: LayoutReading, models: Mapping[str, RobotModel]) -> Iterator[_SeriesPart]:
        """Yield one part for every device, target and robot that the rows of a reading name."""
        rows = self._filled_rows(reading)
        words = {key: self._read_words(key, rows) for key in ("robot", "device", "target")}
        named = {
            "robot": words["robot"] or [next(iter(models))] * len(rows),
            "device": [reading.device] * len(rows) if reading.device else words["device"],
            "target": [reading.target] * len(rows) if reading.target else words["target"],
        }
        labels = list(zip(named["robot"], named["device"], named["target"], strict=True))
        for label in dict.fromkeys(labels):
            robot, device, target = label
            if robot not in models:
                raise MeasurementError(
                    make_message(
                        "{path}: robot {robot!r} is not in the layout.", path=self._path, robot=robot
                    ),
                    remedy="Write a [[robot]] with its model.",
                )
            mine = rows[[other == label for other in labels]]
            name = reading.name
            if len(set(labels)) > 1:
                name += f": {device}, {target}"
            if any(other[0] != robot and other[1:] == label[1:] for other in labels):
                name += f", {robot}"
            mine = self._with_readings(reading, mine, models[robot])
            observations = self._build_observations(reading, mine, models[robot])
            yield _SeriesPart(
                name, device, target, robot, observations, self._table.lines[mine], self._read_groups(mine)
            )

    def _filled_rows(self, reading: LayoutReading) -> Rows:
        """Return the rows that the reading is about and that have all its numbers."""
        selected = np.ones(len(self._table), dtype=bool)
        for column, entry in reading.where.items():
            selected &= self._rows_equal(column, entry)
        names = (*self._layout.joints, *reading.columns, *reading.rotation, *reading.joints_to)
        with np.errstate(invalid="ignore"):
            filled = (np.abs(self._read_columns(names)) < _UNBELIEVABLE).all(axis=1)
        if bool((selected & ~filled).any()):
            self.left_out[reading.name] = int((selected & ~filled).sum())
        return np.flatnonzero(selected & filled)

    def _with_readings(self, reading: LayoutReading, rows: Rows, model: RobotModel) -> Rows:
        """Return the rows in which the device read something."""
        if reading.kind not in ("point", "pose", "length", "guided length") or not reading.columns:
            return rows
        flange = model.tip_positions(self._read_joints(self._layout.joints, model)[rows], np.zeros(3))
        silent = list(no_readings(self._read_columns(reading.columns)[rows], flange))
        if silent:
            self.left_out[reading.name] = self.left_out.get(reading.name, 0) + len(silent)
        return np.delete(rows, silent)

    def _rows_equal(self, column: str, entry: str | float) -> np.typing.NDArray[np.bool_]:
        self._require_columns((column,))
        if isinstance(entry, str):
            return np.array([word == entry for word in self._table.column_texts(column)], dtype=bool)
        return np.asarray(self._table.column_values(column) == entry)

    def _read_words(self, key: str, rows: Rows) -> list[str]:
        column = self._layout.names_in.get(key)
        if column is None:
            return []
        self._require_columns((column,))
        words = self._table.column_texts(column)
        return [words[row] for row in rows]

    def _read_groups(self, rows: Rows) -> Rows | None:
        words = self._read_words("group", np.arange(len(self._table)))
        return np.unique(words, return_inverse=True)[1].reshape(-1)[rows] if words else None

    def _read_columns(self, names: tuple[str, ...]) -> Array:
        """Return columns as they are typed, a turned sign included."""
        typed = parse_columns(self._table.names, names)
        return np.column_stack([column.sign * self._table.column_values(column.name) for column in typed])

    def _read_joints(self, names: tuple[str, ...], model: RobotModel) -> Array:
        """Return the joints of all rows as the controller counts them [rad], or [m] where they slide."""
        zeros = [column.zero_deg for column in parse_columns(self._table.names, names)]
        if len(names) != model.axis_count:
            raise MeasurementError(
                make_message(
                    "the layout names {count} joint columns, {robot} has {axes} joints.",
                    count=len(names),
                    robot=model.label,
                    axes=model.axis_count,
                ),
                remedy="Name one column a joint, in the order of the chain.",
            )
        of_kind = {True: "slides", False: "joints"}
        slides = [False] * model.axis_count if model.sliding is None else model.sliding.tolist()
        unit = np.array([_UNITS[self._layout.units[of_kind[slide]]] for slide in slides])
        for name, slide in zip(names, slides, strict=True):
            self._refuse_other_unit((name,), self._layout.units[of_kind[slide]])
        refuse_typed_zeros(np.array(zeros), model)
        angles = self._read_columns(names) * unit + np.deg2rad(zeros)
        return controller_joints(angles, model, self._layout.joint_coupling)

    def _refuse_other_unit(self, names: tuple[str, ...], unit: str) -> None:
        """Refuse columns whose headings or cells are in another unit than the layout says."""
        for column in parse_columns(self._table.names, names):
            found = unit_of(column.name)
            if found in _UNITS and found != unit:
                raise MeasurementError(
                    make_message(
                        "{path}: column {column!r} is in {found}, and the layout says {unit}.",
                        path=self._path,
                        column=column.name,
                        found=found,
                        unit=unit,
                    ),
                    remedy="Write the unit of the file under [units] of the layout.",
                )

    def _require_columns(self, names: tuple[str, ...]) -> None:
        for name in names:
            if name not in self._table.names:
                raise MeasurementError(
                    make_message("{path} has no column {name!r}.", path=self._path, name=name),
                    remedy=make_message("It has {names}.", names=", ".join(self._table.names)),
                )

    def _build_observations(  # noqa: PLR0911  # one for each kind
        self, reading: LayoutReading, rows: Rows, model: RobotModel
    ) -> CellObservations:
        layout, count = self._layout, len(rows)
        unit = _UNITS[layout.units["readings"]]
        self._refuse_other_unit(reading.columns, layout.units["readings"])
        joints = self._read_joints(layout.joints, model)[rows]
        sigma, once = np.full(count, reading.sigma_m), np.zeros(count, dtype=np.intp)
        values = np.full((count, 1), reading.nominal_m)
        if reading.columns:
            values = self._read_columns(reading.columns)[rows] * unit
        one = values[:, 0]
        if reading.kind == "point":
            return PointObservations(joints, values, sigma, once)
        if reading.kind == "pose":
            sigma_rad = np.full(count, reading.sigma_rad)
            return PoseObservations(
                joints, values, sigma, once, self._read_attitudes(reading, rows), sigma_rad
            )
        if reading.kind == "bar":
            return BarLengths(joints, one, sigma, once, self._read_joints(reading.joints_to, model)[rows])
        if reading.kind == "pin":
            return PinTouches.on_pin(joints, sigma, once)
        if reading.kind == "plane":
            return PlaneContacts(joints, one, sigma, once)
        if reading.kind == "sphere":
            return SphereContacts(joints, one, sigma, once)
        kind = GuidedLengthObservations if reading.kind == "guided length" else LengthObservations
        return kind(joints, one, sigma, once)

    def _read_attitudes(self, reading: LayoutReading, rows: Rows) -> Array:
        convention = CONVENTIONS[self._layout.convention]
        turns = self._read_columns(reading.rotation)[rows]
        if turns.shape[1] != len(convention.fields):
            raise MeasurementError(
                make_message(
                    "{path}: {convention} has {numbers} numbers, not {found}.",
                    path=self._path,
                    convention=self._layout.convention,
                    numbers=len(convention.fields),
                    found=turns.shape[1],
                )
            )
        if len(convention.fields) == 3:
            self._refuse_other_unit(reading.rotation, self._layout.units["rotation"])
            turns = turns * _UNITS[self._layout.units["rotation"]]
        else:
            turns = turns / np.linalg.norm(turns, axis=1, keepdims=True)
        return rotation_from(self._layout.convention, turns)
