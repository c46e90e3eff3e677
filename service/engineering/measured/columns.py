"""Which column of a table is which: joints, what the device read, what the controller printed."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from cellcal.calibration.identification.column_options import TypedColumn, columns_option
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.column_words import (
    ATTITUDE_WORDS,
    CONTROLLER_WORDS,
    DIFFERENCE_WORDS,
    SPREAD_WORDS,
    find_triples,
    key_words,
)
from cellcal.service.engineering.measured.difference_words import find_differences
from cellcal.service.engineering.measured.headings import plain_name, unit_of
from cellcal.service.engineering.measured.joint_columns import find_joints
from cellcal.service.engineering.measured.matrix_columns import find_matrix
from cellcal.service.engineering.measured.measurement_remedy import measurement_remedy
from cellcal.service.engineering.measured.polar_readings import refuse_directions, with_survey_places
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.measured.typed_columns import typed_columns, written_as
from cellcal.service.engineering.measured.units import ANGLE_UNITS, LENGTH_UNITS

_MEASURED = {
    "measurement", "measured", "measure", "meas", "tracker", "laser", "camera", "optical", "mocap", "observed", "obs",
    "leica", "faro", "vicon", "ndi", "marker", "smr", "probe", "tmac", "optitrack", "instrument",
}  # fmt: skip
_PLACE = {
    "pos",
    "position",
    "p",
    "point",
    "location",
    "translation",
    "trans",
    "xyz",
    "coordinate",
    "coord",
    "t",
}
_GROUP = {"group", "series", "session", "run", "block", "trial", "batch", "set_id", "path"}
_LENGTHS = {
    "l", "length", "len", "distance", "dist", "wire", "cable", "wire_length", "cable_length", "draw_wire",
    "rope", "rope_length", "range", "d",
}  # fmt: skip
_QUATERNION = ("w", "x", "y", "z")
_TURNS = (
    ("qw", "qx", "qy", "qz"), ("q1", "q2", "q3", "q4"), ("q0", "q1", "q2", "q3"), ("q0", "qx", "qy", "qz"),
    ("e0", "e1", "e2", "e3"), ("qw", "qi", "qj", "qk"), ("q_w", "q_i", "q_j", "q_k"),
    ("rw", "rx", "ry", "rz"), ("rx", "ry", "rz"),
    ("phix", "phiy", "phiz"), ("roll", "pitch", "yaw"),
    ("a", "b", "c", "d"), ("a", "b", "c"), ("w", "p", "r"), ("rotx", "roty", "rotz"), ("rvx", "rvy", "rvz"),
)  # fmt: skip


class UnnamedPositionError(MeasurementError):
    """Joints are found, and no heading tells what was measured; ``candidates`` may be it."""

    def __init__(
        self, names: Sequence[str], joints: tuple[str, ...], candidates: tuple[str, ...], *, lone: bool
    ) -> None:
        super().__init__(
            make_message("no measurement found among the columns {names}.", names=", ".join(names)),
            remedy=_naming_remedy(names, candidates if lone else ()),
        )
        self.joints = joints
        self.candidates = candidates


@dataclass(frozen=True, slots=True)
class TableLayout:
    """Column names by meaning, and the units that the names themselves tell."""

    joints: tuple[str, ...]
    position: tuple[str, ...] = ()  # measured x, y, z
    spread: tuple[str, ...] = ()  # its standard deviations
    turn: tuple[str, ...] = ()  # measured attitude
    turn_fields: tuple[str, ...] = ()  # what the attitude's columns are called, without prefixes
    length: str = ""
    controller: tuple[str, ...] = ()  # the controller's own x, y, z
    further: tuple[tuple[str, ...], ...] = ()  # other places of a row, of which no name says what they are
    differences: tuple[str, ...] = ()  # columns of x, y, z that headings call a difference, beside a place
    is_named: bool = True  # a name or the user says that the position was measured
    temperature: str = ""
    group: str = ""
    units: Mapping[str, str] = field(default_factory=dict)  # meaning -> unit
    typed: Mapping[str, TypedColumn] = field(default_factory=dict)  # columns whose sign or zero was named
    written: Mapping[str, str] = field(default_factory=dict)  # what to type for a column

    def column_sign(self, name: str) -> float:
        """Return what a column is to be multiplied with."""
        return self.typed[name].sign if name in self.typed else 1.0

    def zero_deg(self, name: str) -> float:
        """Return what is to be added to a joint's column [deg]."""
        return self.typed[name].zero_deg if name in self.typed else 0.0

    def typed_columns(self, names: Sequence[str]) -> tuple[TypedColumn, ...]:
        """Return columns as ``--columns`` takes them in a terminal."""
        return tuple(
            replace(self.typed.get(name, TypedColumn(name)), written=self.written.get(name, ""))
            for name in names
        )

    def as_typed(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return columns as a layout takes them."""
        return tuple(self.typed[name].typed_text if name in self.typed else name for name in names)


def detect_layout(
    names: Sequence[str],
    joint_names: Sequence[str],
    columns: Mapping[str, Sequence[str]] | None = None,
    slides: Sequence[bool] = (),
    numeric: Sequence[str] | None = None,
) -> TableLayout:
    """Find out what each column is; ``columns`` names those that the user knows better.

    ``slides`` tells which joints are prismatic, if any are: their unit is one of length. ``numeric`` are the columns
    that hold numbers, where the caller knows.

    Raises
    ------
    MeasurementError
        Joints or measurements are not found, with the option that names them.
    """
    typed = typed_columns(names, columns or {}, len(joint_names))
    typed_names = {meaning: tuple(column.name for column in found) for meaning, found in typed.items()}
    plain = with_survey_places({name: plain_name(name) for name in names})
    joints = typed_names.get("joints") or find_joints(names, plain, joint_names, slides, numeric)
    rest = [name for name in names if name not in joints]
    length = "".join(typed_names.get("length", ()))
    if not length and not typed_names.get("position"):
        length = _find_length(rest, plain)
        if not _find_positions(rest, plain, has_length=False).measured:
            refuse_directions(rest, plain)
    places = _find_positions(rest, plain, has_length=bool(length))
    measured = typed_names.get("position") or places.measured
    controller = typed_names.get("controller") or (places.controller if places.controller != measured else ())
    place, matrix = ((), ()) if length else find_matrix(rest, plain)
    measured = measured or place
    if length:
        measured = ()
    if not measured and not length:
        if remedy := measurement_remedy(rest, plain, numeric):
            raise MeasurementError(
                make_message("no measurement found among the columns {names}.", names=", ".join(names)),
                remedy=remedy,
            )
        of_numbers = rest if numeric is None else [name for name in rest if name in numeric]
        candidates = tuple(name for name in of_numbers if _tells_no_role(plain[name]))
        raise UnnamedPositionError(names, joints, candidates, lone=len(candidates) == len(of_numbers))
    turn, fields = _find_rotation(rest, plain, measured) if measured else ((), ())
    if matrix and not turn and measured == (place or places.measured):
        turn, fields = matrix, matrix
    chosen = typed_names.get("rotation") or turn
    sliding = slides or (False,) * len(joints)
    layout = {
        "joints": _of_kind(joints, sliding, joint_names, slide=False),
        "slides": _of_kind(joints, sliding, joint_names, slide=True),
        "position": measured,
        "rotation": chosen,
        "controller": controller,
        "length": (length,) if length else (),
    }
    return TableLayout(
        joints=joints,
        position=measured,
        spread=_find_deviations(rest, plain, measured or ((length,) if length else ())),
        turn=chosen,
        turn_fields=fields if chosen == turn else tuple(plain[name] for name in chosen),
        length=length,
        controller=controller,
        further=tuple(found for found in places.further if found not in (measured, controller)),
        differences=() if typed_names.get("position") else find_differences(rest, plain),
        is_named=places.is_named or bool(typed_names.get("position")),
        temperature=next((n for n in rest if "temp" in plain[n]), ""),
        group="".join(typed_names.get("group", ())) or next((n for n in rest if plain[n] in _GROUP), ""),
        units={
            key: unit
            for key, found in layout.items()
            if (unit := _joint_units(found) if key == "joints" else _common_unit(found))
        },
        typed={column.name: column for found in typed.values() for column in found if column.is_modified},
        written={
            name: written_as(names, name) for each in (joints, measured, *places.further) for name in each
        },
    )


def _naming_remedy(names: Sequence[str], candidates: Sequence[str]) -> str:
    """Return how to name what was measured; with the columns themselves where there is no choice."""
    meaning = {1: "length", 3: "position"}.get(len(candidates))
    if meaning is None:
        return (
            "Name the three columns of its place, `--columns position=…,…,…`, or the one of its length, "
            "`--columns length=…`, by their headings or by their numbers counted from 1."
        )
    written = [TypedColumn(name, written=written_as(names, name)) for name in candidates]
    return make_message(
        "If the device read {columns}, say so: {columns_option}; else add what it read.",
        columns=", ".join(candidates),
        columns_option=columns_option(meaning, written),
    )


def _tells_no_role(plain: str) -> bool:
    """Return whether a heading leaves open that its column is a part of a measured place."""
    return not set(re.split(r"[_\d]+", plain)) & (
        CONTROLLER_WORDS | SPREAD_WORDS | DIFFERENCE_WORDS | ATTITUDE_WORDS
    )


def _of_kind(
    joints: Sequence[str], slides: Sequence[bool], joint_names: Sequence[str], *, slide: bool
) -> tuple[str, ...]:
    """Return the columns of joints that slide, or of those that turn; refuses a heading with a unit of the others."""
    found = tuple(name for name, slides_here in zip(joints, slides, strict=False) if slides_here == slide)
    wrong = [name for name in found if unit_of(name) in (ANGLE_UNITS if slide else LENGTH_UNITS)]
    if wrong:
        raise MeasurementError(
            make_message(
                "{wrong} is in {unit_of}, and the robot's joint there slides.",
                wrong=wrong[0],
                unit_of=unit_of(wrong[0]),
            )
            if slide
            else make_message(
                "{wrong} is in {unit_of}, and the robot's joint there turns.",
                wrong=wrong[0],
                unit_of=unit_of(wrong[0]),
            ),
            remedy=make_message(
                "If the columns stand in another order than the robot's joints ({joints}), name them in that order: "
                "`--columns joints=…`. If the order and the heading are right, the joint is described wrong: a joint "
                "that slides is prismatic, in metres (URDF) or millimetres (model file).",
                joints=", ".join(joint_names),
            ),
        )
    return found


def units_of_joints(names: Sequence[str]) -> dict[str, str]:
    """Return the units of joints that turn, as `TableLayout` has them; empty where their names tell none."""
    unit = _joint_units(names)
    return {"joints": unit} if unit else {}


def _joint_units(names: Sequence[str]) -> str:
    """Return the unit of joints that their names tell; where each tells its own, all of them with commas between."""
    each = [unit_of(name) for name in names]
    return ",".join(each) if all(each) and len(set(each)) > 1 else _common_unit(names)


def _common_unit(names: Sequence[str]) -> str:
    """Return the unit that the names tell; a column without one goes with the others."""
    units = {unit_of(name) for name in names} - {""}
    if len(units) > 1:
        raise MeasurementError(
            make_message(
                "the columns {names} are in different units: {units}.",
                names=", ".join(names),
                units=", ".join(sorted(units)),
            ),
            remedy="Write them in one unit, and say so in their headings.",
        )
    return units.pop() if units else ""


def _is_place(key: tuple[str, str]) -> bool:
    """Return whether a triple of x, y, z may be a place: no deviation, no uncertainty, no part of an attitude."""
    return not key_words(key) & (SPREAD_WORDS | DIFFERENCE_WORDS | ATTITUDE_WORDS)


@dataclass(frozen=True, slots=True)
class _Places:
    measured: tuple[str, ...] = ()
    controller: tuple[str, ...] = ()
    further: tuple[tuple[str, ...], ...] = ()
    is_named: bool = True


def _find_positions(names: Sequence[str], plain: Mapping[str, str], *, has_length: bool) -> _Places:
    """Return measured and controller positions: called a measurement, else not called a command.

    Of places that are alike in name, such as those of several targets, the first is the measured one, and no
    other is the controller's.
    """
    triples = {key: names for key, names in find_triples(names, plain, "xyz").items() if _is_place(key)}
    if len(triples) > 1:
        triples.pop(("s_", ""), None)  # sX, sY, sZ are standard deviations of X, Y, Z
    measured = [found for key, found in triples.items() if key_words(key) & _MEASURED]
    controller_triples = [
        found for key, found in triples.items() if key_words(key) & CONTROLLER_WORDS and found not in measured
    ]
    neutral = [
        found for found in triples.values() if found not in measured and found not in controller_triples
    ]
    actual = {found for key, found in triples.items() if key_words(key) & {"actual", "act"}}
    neutral.sort(key=lambda found: found not in actual)
    if has_length:
        return _Places(controller=(*controller_triples, *neutral, ())[0])
    is_named = bool(measured) or any(found in actual for found in neutral)
    chosen, *others = [*measured, *neutral] or [()]
    unnamed = [found for found in others if found not in measured]
    controller = (*controller_triples, *(unnamed if is_named else ()), ())[0]
    return _Places(chosen, controller, tuple(found for found in others if found != controller), is_named)


def _find_length(names: Sequence[str], plain: Mapping[str, str]) -> str:
    has_quaternion = {"a", "b", "c", "d"} <= {plain[name] for name in names}
    exact = [name for name in names if plain[name] in _LENGTHS - ({"d"} if has_quaternion else set())]
    worded = [
        name
        for name in names
        if set(plain[name].split("_")) & {"length", "distance", "wire", "cable"}
        and not set(plain[name].split("_")) & (SPREAD_WORDS | CONTROLLER_WORDS)
    ]
    return (*exact, *worded, "")[0]


def _find_rotation(
    names: Sequence[str], plain: Mapping[str, str], measured: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the attitude that belongs to the measured position: the one whose names are built alike."""
    places = find_triples(names, plain, "xyz")
    position_key = next((key for key, found in places.items() if found == measured), None)
    for fields in _TURNS:
        for key, found in find_triples(names, plain, fields).items():
            if key == position_key:
                return found, fields
    if position_key is None:
        return (), ()
    return _worded_turn(names, plain, key_words(position_key) - _PLACE)


def _worded_turn(
    names: Sequence[str], plain: Mapping[str, str], place: set[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return an attitude that is told by a word: ``rot_x`` to ``rot_w``, ``orientation.w``, ``quat x``."""
    for axes, fields in (
        (_QUATERNION, ("qw", "qx", "qy", "qz")),
        (_QUATERNION[1:], ("rx", "ry", "rz")),
        *((f, f) for f in _TURNS),
    ):
        found = {
            key: columns
            for key, columns in find_triples(names, plain, axes).items()
            if (key_words(key) & ATTITUDE_WORDS or axes == fields)
            and not key_words(key)
            & (SPREAD_WORDS | DIFFERENCE_WORDS | {"normal", "direction", "vector", "vec"})
        }
        alike = [
            columns for key, columns in found.items() if key_words(key) - ATTITUDE_WORDS - _PLACE == place
        ]
        alike = alike or _lone_turn(found, place)
        if alike:
            return alike[0], fields
    return (), ()


def _lone_turn(found: Mapping[tuple[str, str], tuple[str, ...]], place: set[str]) -> list[tuple[str, ...]]:
    """Return the one attitude of a table beside a place without words: X, Y, Z and ``pose.orientation.w``.

    Whether it belongs to the place is for the fit to say.
    """
    words = [key_words(key) for key in found]
    if place or len(words) != 1 or words[0] & CONTROLLER_WORDS or not words[0] & ATTITUDE_WORDS:
        return []
    return list(found.values())


def _find_deviations(names: Sequence[str], plain: Mapping[str, str], of: tuple[str, ...]) -> tuple[str, ...]:
    """Return the columns named like the measured ones with a word for standard deviation between."""
    by_words = {tuple(sorted(plain[name].split("_"))): name for name in names}
    for word in ("std", "sigma", "sd", "stdev", "stddev", "uncertainty", "unc"):
        keys = [tuple(sorted([*plain[name].split("_"), word])) for name in of]
        if all(key in by_words for key in keys):
            return tuple(by_words[key] for key in keys)
    return ()
