"""Measurements from a file, in SI: joints, what the device read, and every guess that was made on the way."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibration.errors import CalibrationError
from calibration.first_guess import first_guess
from calibration.geometry import Array, log_rotation, mean_rotation
from calibration.kinematics import RobotModel
from calibration.observations import (
    LengthObservations,
    Observations,
    PointObservations,
    Rows,
    pose_from_points,
)
from calibration.orientation import CONVENTIONS, rotation_from
from calibration.unrounding import resolution
from service.measurement_columns import Layout, detect_layout
from service.measurement_table import MeasurementError, Table, read_table

_LENGTH_UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inch": 25.4e-3}
_ANGLE_UNITS = {"rad": 1.0, "deg": float(np.deg2rad(1.0))}
_MOST_RADIANS = 8.2  # a turn and a third: beyond, angles are degrees
_LEAST_SIGMA_M = 3e-4  # what an arm adds to any instrument: direction of approach, temperature
_SIGMA_RAD = 2e-3
_CONSISTENT_RAD = float(np.deg2rad(2.0))
_LIKELY = ("ur_rotation_vector", "ros_rpy", "instrument_xyz")  # of equal formulas, the first is named
_DISTINCT = 0.5  # the best orientation convention must be twice as consistent as the next


@dataclass(frozen=True, slots=True)
class RejectedRow:
    """A data row, counted from 0, that takes no part, and why."""

    row: int
    reason: str


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What the user knows better than any guess."""

    columns: Mapping[str, Sequence[str]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)  # joints, position, length, controller, rotation
    convention: str = ""  # of the measured attitude; "none" leaves it out
    sheet: str | None = None


@dataclass(frozen=True, eq=False)
class Measurements:
    """Usable rows of a file; ``rows`` are their numbers in the file, data rows counted from 0."""

    observations: Observations
    rows: Rows
    read: int
    rejected: tuple[RejectedRow, ...]
    joint_step_rad: Array  # (n,)
    controller_m: Array | None  # (N, 3)
    controller_step_m: float
    value_step_m: float  # resolution of what was measured
    temperature: Array | None
    groups: Rows | None
    guesses: tuple[str, ...]


def read_measurements(path: Path, model: RobotModel, options: ReadOptions | None = None) -> Measurements:
    """Read a file of measurements of this robot.

    Raises
    ------
    MeasurementError
        The file, its columns or its numbers cannot be understood; the remedy names the option that helps.
    """
    options = options or ReadOptions()
    table = read_table(path, sheet=options.sheet)
    layout = detect_layout(table.names, model.joint_names, options.columns)
    names = [name for name in (*layout.joints, *layout.position, *layout.turn, layout.length) if name]
    numbers = {name: _numbers(table, name) for name in (*names, *layout.spread, *layout.controller)}
    good, rejected = _usable(table, names, numbers)
    if not good.any():
        first = f"row {rejected[0].row}: {rejected[0].reason}" if rejected else "it has no rows"
        raise MeasurementError(
            f"{path} has no usable row; {first}.", remedy="Name the columns with `--columns`."
        )
    numbers = {name: values[good] for name, values in numbers.items()}
    return _assemble(table, layout, numbers, model, options, np.flatnonzero(good), rejected)


def _numbers(table: Table, name: str) -> Array:
    return np.array([cell if isinstance(cell, float) else np.nan for cell in table.column(name)], dtype=float)


def _usable(
    table: Table, names: Sequence[str], numbers: Mapping[str, Array]
) -> tuple[np.typing.NDArray[np.bool_], tuple[RejectedRow, ...]]:
    good = np.ones(len(table.rows), dtype=bool)
    rejected = []
    for row in range(len(table.rows)):
        bad = [name for name in names if np.isnan(numbers[name][row])]
        if bad:
            good[row] = False
            at = table.names.index(bad[0])
            cell = table.rows[row][at] if at < len(table.rows[row]) else ""
            what = f"holds {cell!r}, which is no number" if cell != "" else "is empty"
            rejected.append(RejectedRow(row, f"line {table.lines[row]}: column {bad[0]!r} {what}"))
    return good, tuple(rejected)


def _assemble(  # noqa: PLR0913  # the parts of one file; each is used once
    table: Table,
    layout: Layout,
    numbers: Mapping[str, Array],
    model: RobotModel,
    options: ReadOptions,
    rows: Rows,
    rejected: tuple[RejectedRow, ...],
) -> Measurements:
    guesses = [table.dialect] if table.dialect else []
    units = _Units({**layout.units, **options.units}, guesses)
    raw_joints = np.column_stack([numbers[name] for name in layout.joints])
    joint_unit = units.angle("joints", layout.joints, raw_joints)
    joints = raw_joints * joint_unit
    reach = model.tip_positions(joints, np.zeros(3))
    spread_m = float(np.sqrt(((reach - reach.mean(axis=0)) ** 2).sum(axis=1).mean()))
    controller, controller_step = None, 0.0
    if layout.controller:
        raw = np.column_stack([numbers[name] for name in layout.controller])
        unit = units.length("controller", layout.controller, raw, spread_m)
        controller, controller_step = raw * unit, max(resolution(column) for column in raw.T) * unit
    observations, value_step = _observations(layout, numbers, model, joints, units, spread_m, options)
    return Measurements(
        observations=observations,
        rows=rows,
        read=len(table.rows),
        rejected=rejected,
        joint_step_rad=np.array([resolution(column) for column in raw_joints.T]) * joint_unit,
        controller_m=controller,
        controller_step_m=controller_step,
        value_step_m=value_step,
        temperature=_numbers(table, layout.temperature)[rows] if layout.temperature else None,
        groups=_groups(table, layout.group, rows),
        guesses=tuple(guesses),
    )


def _observations(  # noqa: PLR0913  # see _assemble
    layout: Layout,
    numbers: Mapping[str, Array],
    model: RobotModel,
    joints: Array,
    units: "_Units",
    spread_m: float,
    options: ReadOptions,
) -> tuple[Observations, float]:
    once = np.zeros(len(joints), dtype=np.intp)
    if layout.length:
        raw = numbers[layout.length]
        unit = units.length("length", (layout.length,), raw[:, None], 0.0)
        sigma = _sigma([numbers[name] for name in layout.spread], unit, len(joints))
        return LengthObservations(joints, raw * unit, sigma, once), resolution(raw) * unit
    raw = np.column_stack([numbers[name] for name in layout.position])
    unit = units.length("position", layout.position, raw, spread_m)
    sigma = _sigma([numbers[name] for name in layout.spread], unit, len(joints))
    points = PointObservations(joints, raw * unit, sigma, once)
    step = max(resolution(column) for column in raw.T) * unit
    if not layout.turn or options.convention == "none":
        return points, step
    turns = np.column_stack([numbers[name] for name in layout.turn])
    return _with_attitudes(points, turns, layout, model, units, options.convention), step


def _sigma(spread: Sequence[Array], unit: float, count: int) -> Array:
    """Return one sigma a row [m]: the instrument's own and what an arm adds, where it was not stated that alone."""
    own = np.mean([np.nan_to_num(column) ** 2 for column in spread], axis=0) if spread else np.zeros(count)
    sigma: Array = np.sqrt(_LEAST_SIGMA_M**2 + own * unit**2)
    return sigma


def _groups(table: Table, name: str, rows: Rows) -> Rows | None:
    if not name:
        return None
    cells = [str(cell) for cell in table.column(name)]
    codes = np.unique([cells[row] for row in rows], return_inverse=True)[1].reshape(-1)
    count = int(codes.max()) + 1
    return codes if 2 < count <= len(rows) // 2 else None


@dataclass(frozen=True, slots=True)
class _Units:
    """Units that names or the user state, and guesses from magnitudes for the rest; each guess is written down."""

    known: Mapping[str, str]
    guesses: list[str]

    def angle(self, meaning: str, columns: Sequence[str], values: Array) -> float:
        """Return rad per unit: degrees if any angle is beyond a turn and a third."""
        if meaning in self.known:
            return self._stated(meaning, _ANGLE_UNITS)
        name = "deg" if float(np.abs(values).max()) > _MOST_RADIANS else "rad"
        self._note(meaning, columns, name)
        return _ANGLE_UNITS[name]

    def length(self, meaning: str, columns: Sequence[str], values: Array, spread_m: float) -> float:
        """Return m per unit: the unit in which the values spread as wide as the arm moved, if that is known."""
        if meaning in self.known:
            return self._stated(meaning, _LENGTH_UNITS)
        if spread_m > 0:
            spread = float(np.sqrt(((values - values.mean(axis=0)) ** 2).sum(axis=1).mean()))
            misfits = {
                n: abs(np.log(max(spread * _LENGTH_UNITS[n], 1e-12) / spread_m)) for n in ("m", "mm", "cm")
            }
            name = min(misfits, key=lambda n: misfits[n])
        else:
            name = "mm" if float(np.median(np.abs(values))) > 20.0 else "m"
        self._note(meaning, columns, name)
        return _LENGTH_UNITS[name]

    def _stated(self, meaning: str, table: Mapping[str, float]) -> float:
        unit = self.known[meaning]
        if unit not in table:
            raise MeasurementError(
                f"{meaning} cannot be in {unit!r}.",
                remedy=f"`--units {meaning}=UNIT` takes {', '.join(table)}.",
            )
        return table[unit]

    def _note(self, meaning: str, columns: Sequence[str], unit: str) -> None:
        self.guesses.append(f"{meaning} ({', '.join(columns)}) taken as {unit}")


def _with_attitudes(  # noqa: PLR0913  # see _assemble
    points: PointObservations, turns: Array, layout: Layout, model: RobotModel, units: _Units, wanted: str
) -> Observations:
    """Add attitudes if one convention makes the tool sit still in the flange; else leave them out and say so."""
    if len(layout.turn) == 4:
        turns = turns[:, [layout.turn_fields.index(f) for f in ("qw", "qx", "qy", "qz")]]
        names = ["abb_quaternion"]
        length = np.linalg.norm(turns, axis=1, keepdims=True)
        if (np.abs(length - 1.0) > 0.01).any():
            units.guesses.append("measured quaternions are not of unit length: attitudes left out")
            return points
        turns = turns / length
    else:
        turns = turns * units.angle("rotation", layout.turn, turns)
        names = [*_LIKELY, *(n for n, c in CONVENTIONS.items() if len(c.fields) == 3 and n not in _LIKELY)]
    if wanted and wanted not in CONVENTIONS:
        raise MeasurementError(
            f"no orientation is called {wanted!r}.",
            remedy=f"--convention takes none, {', '.join(CONVENTIONS)}.",
        )
    try:
        start = first_guess(model, points)[0]
    except CalibrationError:
        return points
    expected = start.devices[0].device_base[:3, :3] @ model.base_flange(points.joints_rad)[:, :3, :3]
    wobble = {
        name: _wobble_rad(expected, rotation_from(name, turns)) for name in ([wanted] if wanted else names)
    }
    best = min(wobble, key=lambda name: wobble[name])
    rivals = [v for v in wobble.values() if v > wobble[best] * 1.001]
    if wobble[best] > _CONSISTENT_RAD or (rivals and wobble[best] > _DISTINCT * min(rivals)):
        units.guesses.append(
            f"no orientation convention fits {', '.join(layout.turn)} (best {best}, "
            f"{np.rad2deg(wobble[best]):.2f} deg): attitudes left out; `--convention` names it"
        )
        return points
    units.guesses.append(f"attitude ({', '.join(layout.turn)}) read as {best}: {CONVENTIONS[best].formula}")
    return pose_from_points(points, rotation_from(best, turns), np.full(len(points), _SIGMA_RAD))


def _wobble_rad(expected: Array, measured: Array) -> float:
    """Return how much the tool turns in the flange, median over the rows [rad]."""
    relative = np.swapaxes(expected, 1, 2) @ measured
    try:
        mean = mean_rotation(relative)
    except CalibrationError:
        return float(np.pi)
    return float(np.median(np.linalg.norm(log_rotation(mean.T @ relative), axis=1)))
