"""Which column of a table is which: joints, what the device read, what the controller printed."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from service.measured.table import MeasurementError

_MEASURED = {
    "measurement", "measured", "meas", "tracker", "laser", "camera", "optical", "mocap", "observed", "obs",
    "leica", "faro", "vicon", "ndi", "marker", "smr", "probe", "tmac", "optitrack", "instrument",
}  # fmt: skip
_CONTROLLER = {
    "goal", "cmd", "command", "commanded", "nominal", "nom", "set", "setpoint", "desired", "target", "robot",
    "controller", "tcp", "flange", "ctrl", "reported", "planned", "program", "programmed", "ref", "reference",
    "fk",
}  # fmt: skip
_SPREAD = {
    "std",
    "sigma",
    "sd",
    "stdev",
    "stddev",
    "uncertainty",
    "unc",
    "rms",
    "var",
    "error",
    "err",
    "residual",
}
_GROUP = {"group", "series", "session", "run", "block", "trial", "batch", "set_id", "path"}
_LENGTHS = {
    "l", "length", "len", "distance", "dist", "wire", "cable", "wire_length", "cable_length", "draw_wire",
    "rope", "rope_length", "range", "d",
}  # fmt: skip
_TURNS = (
    ("qw", "qx", "qy", "qz"), ("q1", "q2", "q3", "q4"), ("q0", "q1", "q2", "q3"),
    ("rx", "ry", "rz"), ("phix", "phiy", "phiz"), ("roll", "pitch", "yaw"),
    ("a", "b", "c"), ("w", "p", "r"), ("rotx", "roty", "rotz"), ("rvx", "rvy", "rvz"),
)  # fmt: skip
_STEMS = ("joint", "q", "j", "jnt", "joint_angle", "jointangle", "joint_position", "joint_pos", "axis", "a",
          "theta", "th", "ax", "achse", "angle", "rax", "jt", "gelenk", "axe", "eje")  # fmt: skip
_JOINT = re.compile(rf"^(?P<before>(?:.*_)?)(?P<stem>{'|'.join(_STEMS)})_?(?P<number>\d)(?P<after>\D.*)?$")
_UNIT = re.compile(r"[\[(]\s*(?P<unit>[^\])]*)\s*[\])]")
_TRAILING_UNIT = re.compile(r"_(mm|deg|rad|m|degrees|radians|cm)$")
_UNIT_NAMES = {
    "mm": "mm", "m": "m", "cm": "cm", "deg": "deg", "°": "deg", "degree": "deg", "degrees": "deg",
    "rad": "rad", "radian": "rad", "radians": "rad", "millimeter": "mm", "millimeters": "mm",
    "meter": "m", "meters": "m", "millimetre": "mm", "metre": "m", "grad": "deg", "in": "inch",
    "inch": "inch", "inches": "inch", "µm": "um", "um": "um",
}  # fmt: skip
_BY_MAKER = (
    ("base", "shoulder", "elbow", "wrist1", "wrist2", "wrist3"),
    ("base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3"),
    ("s", "l", "u", "r", "b", "t"),
)


@dataclass(frozen=True, slots=True)
class Layout:
    """Column names by meaning, and the units that the names themselves tell."""

    joints: tuple[str, ...]
    position: tuple[str, ...] = ()  # measured x, y, z
    spread: tuple[str, ...] = ()  # its standard deviations
    turn: tuple[str, ...] = ()  # measured attitude
    turn_fields: tuple[str, ...] = ()  # what the attitude's columns are called, without prefixes
    length: str = ""
    controller: tuple[str, ...] = ()  # the controller's own x, y, z
    temperature: str = ""
    group: str = ""
    units: Mapping[str, str] = field(default_factory=dict)  # meaning -> unit


def detect_layout(
    names: Sequence[str], joint_names: Sequence[str], columns: Mapping[str, Sequence[str]] | None = None
) -> Layout:
    """Find out what each column is; ``columns`` names those that the user knows better.

    Raises
    ------
    MeasurementError
        Joints or measurements are not found, with the option that names them.
    """
    given = _given(names, columns or {})
    plain = {name: _plain(name) for name in names}
    joints = given.get("joints") or _joints(names, plain, joint_names)
    rest = [name for name in names if name not in joints]
    length = "".join(given.get("length", ())) or _length(rest, plain)
    measured, controller = _positions(rest, plain, has_length=bool(length))
    measured = given.get("position") or measured
    controller = given.get("controller") or controller
    if length:
        measured = ()
    if not measured and not length:
        raise MeasurementError(
            f"no measurement found among the columns {', '.join(names)}.",
            remedy="Name it: `--columns position=X,Y,Z` or `--columns length=L`.",
        )
    turn, fields = _turn(rest, plain, measured) if measured else ((), ())
    chosen = given.get("rotation") or turn
    layout = {
        "joints": joints,
        "position": measured,
        "rotation": chosen,
        "controller": controller,
        "length": (length,) if length else (),
    }
    return Layout(
        joints=joints,
        position=measured,
        spread=_spread(rest, plain, measured or ((length,) if length else ())),
        turn=chosen,
        turn_fields=fields if chosen == turn else tuple(plain[name] for name in chosen),
        length=length,
        controller=controller,
        temperature=next((n for n in rest if "temp" in plain[n]), ""),
        group="".join(given.get("group", ())) or next((n for n in rest if plain[n] in _GROUP), ""),
        units={key: unit for key, found in layout.items() if (unit := _common_unit(found))},
    )


def _given(names: Sequence[str], columns: Mapping[str, Sequence[str]]) -> dict[str, tuple[str, ...]]:
    known = {"joints", "position", "length", "controller", "rotation", "group"}
    for meaning, wanted in columns.items():
        if meaning not in known:
            raise MeasurementError(
                f"--columns knows no {meaning!r}.", remedy=f"It knows {', '.join(sorted(known))}."
            )
        missing = [name for name in wanted if name not in names]
        if missing:
            raise MeasurementError(
                f"there is no column {missing[0]!r}.", remedy=f"Columns are: {', '.join(names)}."
            )
    return {meaning: tuple(wanted) for meaning, wanted in columns.items()}


def _plain(name: str) -> str:
    """Return a name in one spelling: lower case, words joined by underscores, without its unit."""
    text = _UNIT.sub("", name).strip().lower()
    text = re.sub(r"[\s.\-/:']+", "_", text).strip("_")
    return _TRAILING_UNIT.sub("", text)


def _unit(name: str) -> str:
    bracket = _UNIT.search(name)
    trailing = _TRAILING_UNIT.search(re.sub(r"[\s.\-]+", "_", name.strip().lower()))
    text = bracket["unit"] if bracket else trailing[1] if trailing else ""
    return _UNIT_NAMES.get(text.strip().lower(), "")


def _common_unit(names: Sequence[str]) -> str:
    units = {_unit(name) for name in names}
    return units.pop() if len(units) == 1 else ""


def _joints(names: Sequence[str], plain: Mapping[str, str], joint_names: Sequence[str]) -> tuple[str, ...]:
    by_plain = {text: name for name, text in plain.items()}
    for wanted in (joint_names, *_BY_MAKER):
        if len(wanted) == len(joint_names) and all(_plain(text) in by_plain for text in wanted):
            return tuple(by_plain[_plain(text)] for text in wanted)
    families: dict[tuple[str, str, str], dict[int, str]] = {}
    for name in names:
        match = _JOINT.match(plain[name])
        if match:
            key = (match["before"], match["stem"], match["after"] or "")
            families.setdefault(key, {})[int(match["number"])] = name
    full = [
        (key, numbered)
        for key, numbered in families.items()
        if _first_number(numbered, len(joint_names)) >= 0
    ]
    if not full:
        raise MeasurementError(
            f"no {len(joint_names)} joint columns found among {', '.join(names)}.",
            remedy="Name them in order: `--columns joints=q1,q2,…`, and check --robot.",
        )
    _, numbered = min(full, key=lambda item: _rank(item[0]))
    first = _first_number(numbered, len(joint_names))
    return tuple(numbered[first + i] for i in range(len(joint_names)))


def _first_number(numbered: Mapping[int, str], count: int) -> int:
    for first in (1, 0):
        if all(first + i in numbered for i in range(count)):
            return first
    return -1


def _rank(key: tuple[str, str, str]) -> int:
    """Prefer the joints that the arm really had to those that it was told, and positions to anything else."""
    words = set(f"{key[0]}_{key[2]}".split("_"))
    order = _STEMS.index(key[1])
    wrong = bool(
        words & (_SPREAD | {"vel", "qd", "velocity", "current", "torque", "temp", "speed", "moment", "acc"})
    )
    return (
        1000 * wrong
        + 100 * bool(words & _CONTROLLER)
        - 50 * bool(words & {"actual", "act", "measured"})
        + order
    )


def _triples(
    names: Sequence[str], plain: Mapping[str, str], axes: Sequence[str]
) -> dict[tuple[str, str], tuple[str, ...]]:
    """Return the columns that spell one word for each of the axes, by what surrounds it."""
    families: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        for axis in axes:
            match = re.match(rf"^(?P<before>(?:.*_)?(?:pos|p)?){axis}(?P<after>\d*(?:_.*)?)$", plain[name])
            if match:
                families.setdefault((match["before"], match["after"]), {}).setdefault(axis, name)
    return {
        key: tuple(found[axis] for axis in axes) for key, found in families.items() if len(found) == len(axes)
    }


def _words(key: tuple[str, str]) -> set[str]:
    return set(re.split(r"[_\d]+", "_".join(key))) - {""}


def _positions(
    names: Sequence[str], plain: Mapping[str, str], *, has_length: bool
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return measured and controller positions: called a measurement, else not called a command."""
    triples = {
        key: names for key, names in _triples(names, plain, "xyz").items() if not _words(key) & _SPREAD
    }
    measured = [found for key, found in triples.items() if _words(key) & _MEASURED]
    told = [found for key, found in triples.items() if _words(key) & _CONTROLLER and found not in measured]
    neutral = [found for found in triples.values() if found not in measured and found not in told]
    if has_length:
        return (), (*told, *neutral, ())[0]
    if not measured:
        measured, neutral = neutral[:1], neutral[1:]
    return (*measured, ())[0], (*told, *neutral, ())[0]


def _length(names: Sequence[str], plain: Mapping[str, str]) -> str:
    exact = [name for name in names if plain[name] in _LENGTHS]
    worded = [
        name
        for name in names
        if set(plain[name].split("_")) & {"length", "distance", "wire", "cable"}
        and not set(plain[name].split("_")) & (_SPREAD | _CONTROLLER)
    ]
    return (*exact, *worded, "")[0]


def _turn(
    names: Sequence[str], plain: Mapping[str, str], measured: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the attitude that belongs to the measured position: the one whose names are built alike."""
    wanted = next((key for key, found in _triples(names, plain, "xyz").items() if found == measured), None)
    for fields in _TURNS:
        for key, found in _triples(names, plain, fields).items():
            if key == wanted:
                return found, fields
    return (), ()


def _spread(names: Sequence[str], plain: Mapping[str, str], of: tuple[str, ...]) -> tuple[str, ...]:
    """Return the columns named like the measured ones with a word for standard deviation between."""
    by_words = {tuple(sorted(plain[name].split("_"))): name for name in names}
    for word in ("std", "sigma", "sd", "stdev", "stddev", "uncertainty", "unc"):
        keys = [tuple(sorted([*plain[name].split("_"), word])) for name in of]
        if all(key in by_words for key in keys):
            return tuple(by_words[key] for key in keys)
    return ()
