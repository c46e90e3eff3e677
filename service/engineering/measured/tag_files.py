"""Tag points from files as simulations, controllers and instruments export them: CSV or Excel, columns found out."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, quaternion_from_rotation
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import CONVENTIONS, rotation_from
from cellcal.calibration.points.tag_points import TagPath
from cellcal.service.engineering.measured.columns import TableLayout, detect_layout
from cellcal.service.engineering.measured.embedded_files import file_of, is_embedded
from cellcal.service.engineering.measured.headings import plain_name
from cellcal.service.engineering.measured.table import MeasurementError, MeasurementTable, read_table
from cellcal.service.engineering.measured.table_heads import are_numbered
from cellcal.service.engineering.measured.typed_columns import parse_columns
from cellcal.service.engineering.measured.units import ANGLE_UNITS as _ANGLES
from cellcal.service.engineering.measured.units import LENGTH_UNITS as LENGTHS

_BY_NUMBER = (
    "It has no heading: say which columns are which by their numbers, such as `--columns name=1` "
    "`--columns position=2,3,4`."
)
WRITTEN = {  # what a screen may tell of a file
    "lengths": list(LENGTHS),
    "angles": list(_ANGLES),
    "conventions": {name: " ".join(each.fields) for name, each in CONVENTIONS.items()},
}
_NAMES = ("name", "tag", "tag_name", "tagname", "point", "point_name", "label", "id", "target")
_MOST_METRES = 20.0  # from a cell's frames; beyond, coordinates are millimetres
_MOST_RADIANS = 8.2  # a turn and a third; beyond, angles are degrees
_MOST_AXES = 7
_FEWEST_AXES = 5


@dataclass(frozen=True, slots=True)
class TagOptions:
    """Options that override what would be detected in a file of tag points."""

    columns: Mapping[str, str] = field(default_factory=dict)  # joints, position, rotation, name: with commas
    units: Mapping[str, str] = field(default_factory=dict)  # position, joints, rotation
    convention: str = ""  # of the attitude; without it only quaternions are read
    sheet: str | None = None


@dataclass(frozen=True, slots=True)
class TagFileContent:
    """A path, and what was guessed about its file."""

    path: TagPath
    guesses: tuple[str, ...]


def tags_of_setting(value: Any, what: str) -> TagPath:
    """Return the path that a setting names: a file, or ``{"file": …, "units": {…}, "columns": {…}, …}``.

    ``file`` may also be carried whole, see ``carried.file_of``.

    Raises
    ------
    MeasurementError
        The setting names no file, or the file cannot be understood.
    """
    setting: dict[str, Any] = {"file": value} if isinstance(value, str) else {}
    if isinstance(value, dict):
        setting = {"file": value} if is_embedded(value) else dict(value)
    valid_keys = {"file", "columns", "units", "convention", "sheet"}
    if "file" not in setting or setting.keys() - valid_keys:
        raise MeasurementError(
            make_message(
                "{what} names no file of tags: {value}.", what=what, value=json.dumps(value, default=str)[:80]
            ),
            remedy=make_message(
                'Write {what}=tags.csv, or {what}={{"file": "tags.csv", "units": {{"position": "mm"}}}}.',
                what=what,
            ),
        )
    with file_of(setting.pop("file"), what) as path:
        return read_tags(path, TagOptions(**setting)).path


def read_tags(path: Path, options: TagOptions | None = None) -> TagFileContent:
    """Read one path of tags.

    Raises
    ------
    MeasurementError
        The file, its columns or its numbers cannot be understood; the remedy names what helps.
    CalibrationError
        Two tags of one name, or numbers that are not finite.
    """
    options = options or TagOptions()
    table = read_table(path, sheet=options.sheet)
    guesses = [table.dialect] if table.dialect else []
    name = _find_name_column(table, options) or _name_column(table)
    layout = _detect_tag_layout(table, options, name)
    numbers = {c: table.column_values(c) for c in (*layout.joints, *layout.position, *layout.turn)}
    _refuse_gaps(path, table, numbers)
    units = {**layout.units, **options.units}
    joints = _scale_numbers(
        layout.joints, numbers, _unit_factor("joints", units, _ANGLES, _MOST_RADIANS, guesses)
    )
    positions = _scale_numbers(
        layout.position, numbers, _unit_factor("position", units, LENGTHS, _MOST_METRES, guesses)
    )
    joints = _as_typed(layout.joints, joints, layout, joints=True)
    positions = _as_typed(layout.position, positions, layout)
    return TagFileContent(
        TagPath(
            source=path.name,
            positions_m=_to_tuples(positions) if positions.shape[1] else ((0.0, 0.0, 0.0),) * len(table),
            names=tuple(table.column_texts(name)) if name else (),
            quaternions=_read_attitudes(layout, numbers, units, options, guesses),
            joints_rad=_to_tuples(joints) if joints.shape[1] else (),
        ),
        tuple(guesses),
    )


def _find_name_column(table: MeasurementTable, options: TagOptions) -> str:
    typed_name = options.columns.get("name", "")
    return parse_columns(table.names, (typed_name,))[0].name if typed_name else ""


def _name_column(table: MeasurementTable) -> str:
    plain = {plain_name(name): name for name in table.names}
    found = next((plain[word] for word in _NAMES if word in plain), "")
    if found:
        return found
    first = table.names[0]
    texts = [(row, 0) in table.texts for row in range(len(table))]
    return first if texts and all(texts) else ""


def _detect_tag_layout(table: MeasurementTable, options: TagOptions, name: str) -> TableLayout:
    """Find joints where there are any, and places; a robot's path may have joints alone."""
    names = [column for column in table.names if column != name]
    column_names = {
        key: tuple(part.strip() for part in text.split(","))
        for key, text in options.columns.items()
        if key != "name"
    }
    typed = {key: parse_columns(table.names, found) for key, found in column_names.items()}
    column_names = {key: tuple(column.name for column in found) for key, found in typed.items()}
    changed = {column.name: column for found in typed.values() for column in found if column.is_modified}
    joints = column_names.pop("joints", ()) or _joint_columns(names, column_names)
    rest = [column for column in names if column not in joints]
    if not table.has_heading and "position" not in column_names:
        column_names |= _only_numbers(table, rest)
    try:
        found = detect_layout(rest, (), column_names)
    except MeasurementError as error:
        if not joints and are_numbered(rest):
            raise MeasurementError(error.message, remedy=_BY_NUMBER) from error
        if not joints or column_names:
            raise
        return TableLayout(joints=joints, units=_joint_unit(names, joints), typed=changed)
    return TableLayout(
        joints=joints,
        position=found.position,
        turn=found.turn,
        turn_fields=found.turn_fields,
        units={**_joint_unit(names, joints), **found.units},
        typed=changed,
    )


def _only_numbers(table: MeasurementTable, names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the three columns of numbers of a list without heading, if it has no more: x, y and z."""
    if _triples_named(names):
        return {}
    numbers = tuple(name for name in names if np.isfinite(table.column_values(name)).all())
    return {"position": numbers} if len(numbers) == 3 else {}


def _triples_named(names: Sequence[str]) -> bool:
    return {"x", "y", "z"} <= {plain_name(name) for name in names}


def _joint_columns(names: list[str], typed_names: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    for count in range(_MOST_AXES, _FEWEST_AXES - 1, -1):
        try:
            return detect_layout([*names, "x", "y", "z"], [f"j{k + 1}" for k in range(count)]).joints
        except MeasurementError:
            continue
    del typed_names
    return ()


def _joint_unit(names: list[str], joints: tuple[str, ...]) -> dict[str, str]:
    if not joints:
        return {}
    found = detect_layout(
        [*names, "x", "y", "z"], [f"j{k + 1}" for k in range(len(joints))], {"joints": joints}
    )
    return {"joints": found.units["joints"]} if "joints" in found.units else {}


def _refuse_gaps(path: Path, table: MeasurementTable, numbers: Mapping[str, Array]) -> None:
    for column, values in numbers.items():
        gaps = np.flatnonzero(~np.isfinite(values))
        if len(gaps):
            row = int(gaps[0])
            cell = table.texts.get((row, table.names.index(column)), "")
            raise MeasurementError(
                make_message(
                    "{path_name}, line {lines}: column {column!r} holds {cell!r}, which is no number.",
                    path_name=path.name,
                    lines=table.lines[row],
                    column=column,
                    cell=cell,
                ),
                remedy="Remove that tag from the file, or name the right columns.",
            )


def _scale_numbers(columns: tuple[str, ...], numbers: Mapping[str, Array], unit: Any) -> Array:
    if not columns:
        return np.empty((0, 0))
    values = np.column_stack([numbers[column] for column in columns])
    scaled: Array = values * unit(values)
    return scaled


def _as_typed(columns: tuple[str, ...], values: Array, layout: TableLayout, *, joints: bool = False) -> Array:
    """Return values (N, k) with the signs, and the zeros of joints, that were typed with their columns."""
    if not values.shape[1]:
        return values
    zeros = np.deg2rad([layout.zero_deg(column) for column in columns]) if joints else 0.0
    typed: Array = values * np.array([layout.column_sign(column) for column in columns]) + zeros
    return typed


def _unit_factor(
    meaning: str, units: Mapping[str, str], table: Mapping[str, float], most: float, guesses: list[str]
) -> Any:
    def to_factor(values: Array) -> float:
        unit = units.get(meaning, "")
        if unit and unit not in table:
            raise MeasurementError(
                make_message("{meaning} cannot be in {unit!r}.", meaning=meaning, unit=unit),
                remedy=make_message("Units: {valid_units}.", valid_units=", ".join(table)),
            )
        if not unit:
            small, large = ("m", "mm") if "mm" in table else ("rad", "deg")
            unit = large if float(np.abs(values).max()) > most else small
            guesses.append(make_message("{meaning} taken as {unit}", meaning=meaning, unit=unit))
        return table[unit]

    return to_factor


def _read_attitudes(
    layout: TableLayout,
    numbers: Mapping[str, Array],
    units: Mapping[str, str],
    options: TagOptions,
    guesses: list[str],
) -> tuple[tuple[float, float, float, float], ...]:
    if not layout.turn:
        return ()
    four = len(layout.turn) == 4
    convention = options.convention or ("abb_quaternion" if four else "")
    if not convention:
        guesses.append(
            make_message(
                "attitudes ({names}) left out: no convention was named", names=", ".join(layout.turn)
            )
        )
        return ()
    if convention not in CONVENTIONS or len(CONVENTIONS[convention].fields) != len(layout.turn):
        raise MeasurementError(
            make_message(
                "{turn} cannot be {convention!r}.", turn=", ".join(layout.turn), convention=convention
            ),
            remedy=make_message("Known: {conventions}.", conventions=", ".join(CONVENTIONS)),
        )
    if four:
        turns = np.column_stack([numbers[c] for c in layout.turn])
        length = np.linalg.norm(turns, axis=1, keepdims=True)
        turns = np.where(np.abs(length - 1.0) < 0.01, turns / np.maximum(length, 0.01), turns)
    else:
        turns = _scale_numbers(
            layout.turn, numbers, _unit_factor("rotation", units, _ANGLES, _MOST_RADIANS, guesses)
        )
    quaternions = [quaternion_from_rotation(rotation) for rotation in rotation_from(convention, turns)]
    return tuple((float(w), float(x), float(y), float(z)) for w, x, y, z in quaternions)


def _to_tuples(values: Array) -> Any:
    return tuple(tuple(float(v) for v in row) for row in values)


def read_description(path: Path) -> str:
    """Return the text of a URDF.

    Raises
    ------
    CalibrationError
        No such file, or one that is no text.
    """
    try:
        return read_plain_text(path)
    except (OSError, DocumentError) as broken:
        raise CalibrationError(
            make_message("the description {path} cannot be read: {broken}", path=path, broken=broken),
            remedy="Name a URDF file with xacro expanded.",
        ) from broken
