"""Joints and position of a table whose headings tell nothing: the columns that fit the robot, and no others do."""

import re
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, replace
from math import log

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.quick_fit import spread_rows, trimmed_point_scores
from cellcal.calibration.message import join_messages, make_message
from cellcal.service.engineering.measured.joint_units import joint_units
from cellcal.service.engineering.measured.place_choice import calculated_places
from cellcal.service.engineering.measured.table import MeasurementTable
from cellcal.service.engineering.measured.unit_choice import UnitChoice
from cellcal.service.engineering.measured.units import USUAL_LENGTH_UNITS

Places = tuple[tuple[str, ...], ...]

_TELLS_NOTHING = re.compile(
    r"(column|col|c|var|variable|unnamed|field|data|value|channel|ch|spalte|colonne|columna)?[ _:.]*\d+( \[.*\])?",
    re.IGNORECASE,
)
_FEWEST_ROWS = 12
_MOST_ROWS = 60
_MOST_COLUMNS = 40
_FILLED = 0.8  # of the rows of a column that takes part
_PLAUSIBLE = log(4.0)  # the spread of a target beside that of the flange
_MOST_LEFT = 0.04  # of the motion: zeros that are off by two degrees leave as much
_CLEAR = 3.0  # times as much must every other choice of joints leave
_SMALLEST_M = 1e-3
_ORTHONORMAL = 0.02
_ANGLES, _QUATERNION, _MATRIX = 3, 4, 9  # numbers of an attitude
_MATRIX_STEP = 4  # from x to y to z in a pose of rows of four


@dataclass(frozen=True, slots=True)
class _Choice:
    joints: tuple[int, ...]
    place: tuple[int, ...]
    left: float  # of the motion, by the unit that fits best


def tell_nothing(names: Sequence[str]) -> bool:
    """Return whether headings only count the columns: none at all, Var1 to Var9, or 0 to 8."""
    return all(_TELLS_NOTHING.fullmatch(name.strip()) for name in names)


def find_unnamed_columns(
    table: MeasurementTable, model: RobotModel
) -> tuple[MeasurementTable, dict[str, tuple[str, ...]], Places]:
    """Return the table with a word on it, joints and position by what fits the robot, and other places that do.

    Joints stand side by side in the robot's order, and so do x, y and z, or in the fourth column of a pose of rows of
    four. Base and target are fitted to each such choice. Without one that fits, and that fits clearly better than
    every other choice of joints, nothing is returned.
    """
    columns, values = _usable_numbers(table)
    if len(values) < _FEWEST_ROWS or not model.axis_count + 3 <= len(columns) <= _MOST_COLUMNS:
        return table, {}, ()
    found = sorted(_choices(model, values), key=lambda choice: choice.left)
    if not found or found[0].left > _MOST_LEFT:
        return table, {}, ()
    best = found[0]
    if any(each.joints != best.joints and each.left < _CLEAR * best.left for each in found):
        return table, {}, ()
    alike = sorted(
        (each.place for each in found if each.joints == best.joints and each.left <= _MOST_LEFT),
        key=lambda place: place[0],
    )
    joints = tuple(columns[at] for at in best.joints)
    named = _apart([tuple(columns[at] for at in place) for place in alike])
    read = _read_places(table, model, joints, named)
    turn = _turn_behind(read[0], columns, values, {*joints, *(name for place in read for name in place)})
    finding = make_message(
        "headings tell nothing: {joints} are the joints and {place} the position, for so they fit {model_name}, and "
        "in no other way; `--columns` names others",
        joints=", ".join(joints),
        place=", ".join(read[0]),
        model_name=model.label,
    )
    dialect = join_messages("; ", [each for each in (table.dialect, finding) if each])
    meanings = {"joints": joints, "position": read[0], **({"rotation": turn} if turn else {})}
    return replace(table, dialect=dialect), meanings, tuple(read[1:])


def _turn_behind(
    place: Sequence[str], columns: Sequence[str], values: Array, used: Set[str]
) -> tuple[str, ...]:
    """Return the columns of an attitude right behind a place, empty without any.

    Nine numbers of a rotation matrix, four of a unit quaternion, or three angles, if no other is left. Whether and
    how they are the attitude of the target is for the fit to say, which also tells where they are left out.
    """
    first = columns.index(place[-1]) + 1
    free = next((at for at, name in enumerate(columns[first:]) if name in used), len(columns) - first)
    if free >= _MATRIX:
        turn = values[:, first : first + _MATRIX].reshape(-1, 3, 3)
        if np.abs(turn @ np.swapaxes(turn, 1, 2) - np.eye(3)).max() < _ORTHONORMAL:
            return tuple(columns[first : first + _MATRIX])
    if free >= _QUATERNION:
        lengths = np.linalg.norm(values[:, first : first + _QUATERNION], axis=1)
        if np.abs(lengths - 1.0).max() < _ORTHONORMAL:
            return tuple(columns[first : first + _QUATERNION])
    return tuple(columns[first:]) if free == _ANGLES == len(columns) - first else ()


def find_unnamed_place(
    table: MeasurementTable, model: RobotModel, joints: Sequence[str], candidates: Sequence[str]
) -> tuple[MeasurementTable, tuple[str, ...], Places]:
    """Return the columns of the position by what fits the robot, where headings tell the joints alone.

    The table goes with it, with a word on that, and other places that fit. Without three of the candidates side by
    side that fit, nothing is returned.
    """
    columns, values = _usable_numbers(table, (*joints, *candidates))
    if len(values) < _FEWEST_ROWS or not set(joints) <= set(columns):
        return table, (), ()
    raw = values[:, [columns.index(name) for name in joints]]
    flanges = model.base_flange(raw * joint_units(UnitChoice({}, []), joints, raw, model))
    moved_m = _spread(flanges[None, :, :3, 3])[0]
    order = {name: at for at, name in enumerate(table.names)}
    triples = [
        names
        for names in zip(columns, columns[1:], columns[2:], strict=False)
        if not set(names) & set(joints) and order[names[2]] - order[names[0]] == len(names) - 1
    ]
    if moved_m < _SMALLEST_M or not triples:
        return table, (), ()
    places = np.array([values[:, [columns.index(name) for name in names]] for names in triples])
    residual_parts = _left_of(flanges, moved_m, places)
    fits = residual_parts <= _MOST_LEFT
    named = _apart([names for names, each in zip(triples, fits.tolist(), strict=True) if each])
    if not named:
        return table, (), ()
    read = _read_places(table, model, joints, named)
    finding = make_message(
        "no heading tells what was measured: {place} are the position, for so they fit {model_name}; `--columns` "
        "names others",
        place=", ".join(read[0]),
        model_name=model.label,
    )
    dialect = join_messages("; ", [each for each in (table.dialect, finding) if each])
    return replace(table, dialect=dialect), read[0], tuple(read[1:])


def _apart(places: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return places that share no column with one before: y, z and the next x are x, y, z turned round."""
    found: list[tuple[str, ...]] = []
    for place in places:
        if not any(set(place) & set(other) for other in found):
            found.append(place)
    return found


def _usable_numbers(table: MeasurementTable, among: Sequence[str] | None = None) -> tuple[list[str], Array]:
    """Return columns of numbers, and rows that are full in all of them (N, k), spread over the series."""
    often = np.isfinite(table.numbers).mean(axis=0) >= _FILLED if len(table) else np.zeros(len(table.names))
    at = [
        each
        for each in np.flatnonzero(often).tolist()
        if each not in table.doubts and (among is None or table.names[each] in among)
    ]
    values = table.numbers[:, at]
    full = values[np.isfinite(values).all(axis=1)]
    return [table.names[each] for each in at], full[spread_rows(len(full), _MOST_ROWS)] if len(full) else full


def _choices(model: RobotModel, values: Array) -> Iterator[_Choice]:
    count, width = model.axis_count, values.shape[1]
    places = list(_places(values))
    for first in range(width - count + 1):
        joints = tuple(range(first, first + count))
        raw = values[:, joints]
        joints_rad = raw * joint_units(UnitChoice({}, []), [str(at) for at in joints], raw, model)
        flanges = model.base_flange(joints_rad)
        moved_m = _spread(flanges[None, :, :3, 3])[0]
        apart = [place for place in places if not set(place) & set(joints)]
        if moved_m < _SMALLEST_M or not apart:
            continue
        residual_parts = _left_of(flanges, moved_m, np.array([values[:, place] for place in apart]))
        yield from (
            _Choice(joints, place, each) for place, each in zip(apart, residual_parts.tolist(), strict=True)
        )


def _places(values: Array) -> Iterator[tuple[int, ...]]:
    """Return which columns may be x, y and z: side by side, or the fourth of the rows of a pose."""
    width = values.shape[1]
    yield from ((at, at + 1, at + 2) for at in range(width - 2))
    for first in range(width - 3 * _MATRIX_STEP + 1):
        turn = values[:, [first + _MATRIX_STEP * row + column for row in range(3) for column in range(3)]]
        turn = turn.reshape(-1, 3, 3)
        if np.abs(turn @ np.swapaxes(turn, 1, 2) - np.eye(3)).max() < _ORTHONORMAL:
            yield tuple(first + 3 + _MATRIX_STEP * row for row in range(3))


def _left_of(flanges: Array, moved_m: float, places: Array) -> Array:
    """Return what fits of base and target leave of the motion, by the best unit, of each choice of places (P,)."""
    spread = _spread(places)
    residual_parts = np.full(len(places), np.inf)
    for metres in USUAL_LENGTH_UNITS.values():
        likely = np.flatnonzero(np.abs(np.log(np.maximum(spread * metres, 1e-12) / moved_m)) < _PLAUSIBLE)
        if not len(likely):
            continue
        frames = np.broadcast_to(flanges, (len(likely), *flanges.shape))
        try:
            scores = trimmed_point_scores(frames, places[likely] * metres, np.zeros(len(likely), dtype=bool))
        except (CalibrationError, np.linalg.LinAlgError):
            continue
        residual_parts[likely] = np.minimum(residual_parts[likely], scores / (spread[likely] * metres))
    return residual_parts


def _spread(points: Array) -> Array:
    """Return how far points (P, N, 3) stand about their mean (RMS), of each (P,)."""
    spread: Array = np.sqrt(((points - points.mean(axis=1, keepdims=True)) ** 2).sum(axis=2).mean(axis=1))
    return spread


def _read_places(
    table: MeasurementTable,
    model: RobotModel,
    joints: Sequence[str],
    places: Sequence[tuple[str, ...]],
) -> list[tuple[str, ...]]:
    """Return the places that a device read: those that the nominal arm calculates go last."""
    if len(places) == 1:
        return list(places)
    names = [*joints, *(name for place in places for name in place)]
    values = np.column_stack([table.column_values(name) for name in names])
    values = values[np.isfinite(values).all(axis=1)]
    raw, behind = values[:, : len(joints)], values[:, len(joints) :]
    unit = joint_units(UnitChoice({}, []), joints, raw, model)
    each = [behind[:, 3 * at : 3 * at + 3] for at in range(len(places))]
    calculated = calculated_places(model, raw, unit, each)
    return [place for _, place in sorted(zip(calculated, places, strict=True), key=lambda pair: pair[0])]
