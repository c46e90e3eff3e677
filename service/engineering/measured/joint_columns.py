"""Which columns of a table are the joints, in the order of the robot's joints."""

import re
from collections.abc import Mapping, Sequence

from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.column_words import CONTROLLER_WORDS, SPREAD_WORDS
from cellcal.service.engineering.measured.headings import (
    counts_pulses,
    plain_name,
    pulses_remedy,
    unit_of,
    without_unit,
)
from cellcal.service.engineering.measured.joints_remedy import joints_remedy
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.measured.table_heads import are_numbered
from cellcal.service.engineering.measured.units import LENGTH_UNITS

_STEMS = (
    "joint", "q", "j", "jnt", "joint_angle", "jointangle", "joint_position", "joint_pos", "axis", "a", "theta", "th",
    "ax", "achse", "angle", "rax", "jt", "gelenk", "axe", "eje", "joints", "joint_angles", "axes", "angles",
    "joint_positions", "jointtarget", "joint_target", "jpos", "position", "positions", "pos",
)  # fmt: skip
_TOLD = CONTROLLER_WORDS | {"des"}
_HAD = {"actual", "act", "measured", "meas", "real", "msr"}
_OF_JOINT = "|".join(sorted(_TOLD | _HAD))
_JOINT = re.compile(
    rf"^(?P<before>(?:.*_)?)(?P<stem>{'|'.join(_STEMS)})(?P<which>_(?:{_OF_JOINT}))?_?(?P<number>\d)(?P<after>\D.*)?$"
)
_ELEMENT = re.compile(r"\[\s*\d+\s*\]|positions?[_ .]?\d", re.IGNORECASE)  # of an array, which counts from 0
_BY_MAKER = (
    ("base", "shoulder", "elbow", "wrist1", "wrist2", "wrist3"),
    ("base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3"),
    ("s", "l", "u", "r", "b", "t"),
    ("s", "l", "e", "u", "r", "b", "t"),  # in the order of the chain; its pendant shows E last
    ("s_axis", "l_axis", "u_axis", "r_axis", "b_axis", "t_axis"),
)
_EXTERNAL = re.compile(r"^(?:e|ex|ext|extax|eax|external|external_axis)_?(\d|[a-f])$")  # eax_a of RAPID
_LONE_SLIDES = {"rail", "track", "slide", "lift", "linear", "linear_axis", "linearachse", "linear_track"}
_WORD_WITH_NUMBER = re.compile(r"^(?P<word>\D*[^\W\d_]\D*)(?P<number>\d)(?P<after>\D*)$")
_NEVER_JOINTS = {
    *"xyz", "column", "col", "var", "velocity", "vel", "speed", "v", "qd", "dq", "acceleration", "acc", "force",
    "torque", "tau", "current", "temperature", "temp", "t", "f", "i", "u", "pulse", "pulses", "counts", "encoder",
    "measured", "deviation", "error", "std", "sensor", "marker", "point", "time",
}  # fmt: skip
_DIGITS = re.compile(r"\d+")
_FEWEST_COUNTED = 4  # three are a place
_PLACE = {"x", "y", "z"}
_MOST_OUTSIDE = 3  # joints beside a numbered arm
_REDUNDANT = 7  # joints of an arm one of which is more than a pose needs
_SHORTEST_NAME = 3  # of a joint that is found among other words

Family = tuple[str, str, str]  # what stands before the stem, the stem, what stands behind the number


def find_joints(
    names: Sequence[str],
    plain: Mapping[str, str],
    joint_names: Sequence[str],
    slides: Sequence[bool] = (),
    numeric: Sequence[str] | None = None,
) -> tuple[str, ...]:
    """Return the columns of the joints, in the order of the robot's; ``plain`` is each name in one spelling.

    They are called as the robot's joints are, by a maker's words, or numbered. External axes that are numbered by
    themselves, or that the headings show to slide, go to the joints that slide.

    Raises
    ------
    MeasurementError
        They are not found.
    """
    every = names
    names = [name for name in names if not counts_pulses(name)]
    called = _called_joints(names, plain, joint_names)
    if called or not joint_names:  # a list of places has no joints
        return called
    families = _numbered_families(names, plain)
    count = len(joint_names)
    full = {key: numbered for key, numbered in families.items() if _first_number(numbered, count) >= 0}
    if full:
        numbered = full[min(full, key=_preference_rank)]
        first = _first_number(numbered, count)
        found = tuple(numbered[first + i] for i in range(count))
        return _with_slides_in_place(found, slides)
    external = _numbered_outside(names, plain, families, count) or _external_joints(
        names, plain, families, (joint_names, slides or (False,) * count)
    )
    if found := external or (() if families else _numbered_by_another_word(names, plain, count)):
        return found
    raise MeasurementError(
        make_message(
            "no {joint_name_count} joint columns found among {names}.",
            joint_name_count=count,
            names=", ".join(every),
        ),
        remedy=pulses_remedy([str(at) for at, name in enumerate(every, 1) if name not in names], count)
        if len(every) - len(names) >= count
        else _remedy_for(every if numeric is None else numeric, plain, joint_names),
    )


def like_joint_columns(
    names: Sequence[str], plain: Mapping[str, str], joints: Sequence[str]
) -> tuple[tuple[str, ...], ...]:
    """Return further numbered columns of as many joints that headings rank as they do these."""
    families = _numbered_families([name for name in names if not counts_pulses(name)], plain)
    count = len(joints)
    sets = {
        key: tuple(numbered[first + i] for i in range(count))
        for key, numbered in families.items()
        if (first := _first_number(numbered, count)) >= 0
    }
    own = next((key for key, found in sets.items() if found == tuple(joints)), None)
    if own is None:
        return ()
    rank = _preference_rank(own) - _STEMS.index(own[1])
    return tuple(
        found
        for key, found in sets.items()
        if key != own and _preference_rank(key) - _STEMS.index(key[1]) == rank
    )


def _called_joints(
    names: Sequence[str], plain: Mapping[str, str], joint_names: Sequence[str]
) -> tuple[str, ...]:
    """Return the columns that are called as the joints are, letter by letter or nearly; empty where none are."""
    by_heading = {without_unit(name): name for name in names}
    exact = tuple(by_heading[joint] for joint in joint_names if joint in by_heading)
    if len(exact) == len(joint_names) and _leaves_place(names, exact, plain):
        return exact
    by_plain = {text: name for name, text in plain.items()}
    # A joint called z is not meant by the z of a place.
    places = _PLACE if by_plain.keys() >= _PLACE else set()
    for candidate in (joint_names, *_BY_MAKER):
        called = [plain_name(text) for text in candidate]
        alike = len(set(called)) < len(called)  # joint_3 and Joint_3: a column could be either's
        if len(candidate) == len(joint_names) and not alike and set(called) <= by_plain.keys() - places:
            return tuple(by_plain[text] for text in called)
    return _surrounded_joints(names, plain, joint_names)


def _surrounded_joints(
    names: Sequence[str], plain: Mapping[str, str], joint_names: Sequence[str]
) -> tuple[str, ...]:
    """Return columns called as the joints are, all with the same words around them; empty where none are.

    A recording of messages writes ``/joint_states/elbow_joint/position``.
    """
    called = [plain_name(text) for text in joint_names]
    if not called or min(map(len, called)) < _SHORTEST_NAME or len(set(called)) < len(called):
        return ()
    families: dict[Family, dict[int, str]] = {}
    for at, joint in enumerate(called):
        pattern = re.compile(rf"^(?P<before>(?:.*_)?){re.escape(joint)}(?P<after>(?:_.*)?)$")
        for name in names:
            if match := pattern.match(plain[name]):
                families.setdefault((match["before"], _STEMS[0], match["after"]), {})[at] = name
    full = {key: found for key, found in families.items() if len(found) == len(called)}
    if not full:
        return ()
    found = full[min(full, key=_preference_rank)]
    return tuple(found[at] for at in range(len(called)))


def _leaves_place(names: Sequence[str], joints: Sequence[str], plain: Mapping[str, str]) -> bool:
    """Return whether joints that are called x, y or z leave the columns of a place."""
    if not _PLACE & {plain[name] for name in joints}:
        return True
    return {plain[name] for name in names if name not in joints} >= _PLACE


def _numbered_families(names: Sequence[str], plain: Mapping[str, str]) -> dict[Family, dict[int, str]]:
    """Return columns that are numbered alike, by what stands around the number.

    Where two columns have one number, such as joints q1 to q6 beside a quaternion Q0 to Q3, columns written with the
    same letters belong together.
    """
    columns: dict[Family, list[tuple[int, str]]] = {}
    for name in names:
        match = _JOINT.match(plain[name])
        if match:
            behind = "_".join(filter(None, [match["which"], match["after"]]))
            key = (match["before"], match["stem"], behind)
            columns.setdefault(key, []).append((int(match["number"]), name))
    families: dict[Family, dict[int, str]] = {}
    for (before, stem, behind), found in columns.items():
        once = len(dict(found)) == len(found)
        for number, name in found:
            letters = "" if once else _DIGITS.sub("", without_unit(name))
            families.setdefault((before, stem, "_".join(filter(None, [behind, letters]))), {})[number] = name
    return families


def _numbered_by_another_word(names: Sequence[str], plain: Mapping[str, str], count: int) -> tuple[str, ...]:
    """Return the one set of columns that are numbered from 0 or 1 to the last joint, whatever word counts them.

    Columns without a heading are not counted by a word. Whether these are joints is for the fit to say.
    """
    if are_numbered(list(plain)):
        return ()
    families: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        if match := _WORD_WITH_NUMBER.match(plain[name]):
            families.setdefault((match["word"], match["after"]), {})[int(match["number"])] = name
    full = [
        tuple(numbered[at] for at in sorted(numbered))
        for (word, _), numbered in families.items()
        if sorted(numbered) in (list(range(count)), list(range(1, count + 1)))
        and not _words_of(word) & _NEVER_JOINTS
    ]
    return full[0] if len(full) == 1 and count >= _FEWEST_COUNTED else ()


def _words_of(text: str) -> set[str]:
    return set(text.split("_"))


def _with_slides_in_place(joints: tuple[str, ...], slides: Sequence[bool]) -> tuple[str, ...]:
    """Return numbered columns with those in a unit of length where the robot slides: J1 to J6, and J7 of a track.

    The others keep their order. Only columns at one end are taken for a track that stands at the other.
    """
    shown = [unit_of(name) in LENGTH_UNITS for name in joints]
    count = sum(shown)
    if not count or count != sum(slides) or list(slides) == shown:
        return joints
    if list(slides)[:count] == [True] * count and shown[-count:] == [True] * count:
        return (*joints[-count:], *joints[:-count])
    if list(slides)[-count:] == [True] * count and shown[:count] == [True] * count:
        return (*joints[count:], *joints[:count])
    return joints


def _external_numbers(names: Sequence[str], plain: Mapping[str, str]) -> dict[int, str]:
    """Return the columns of external axes by their number: E1, extax_1, eax_a."""
    found = {match[1]: name for name in names if (match := _EXTERNAL.match(plain[name]))}
    return {int(text) if text.isdecimal() else "abcdef".index(text) + 1: name for text, name in found.items()}


def _numbered_outside(
    names: Sequence[str],
    plain: Mapping[str, str],
    families: Mapping[Family, Mapping[int, str]],
    count: int,
) -> tuple[str, ...]:
    """Return the axes of a positioner: E1 and E2, or J7 and J8 where no others are numbered so."""
    numbers = _external_numbers(names, plain)
    if sorted(numbers) == list(range(1, count + 1)) and not families:
        return tuple(numbers[at] for at in sorted(numbers))
    if len(families) != 1 or numbers:
        return ()
    (only,) = families.values()
    first = min(only)
    if sorted(only) != list(range(first, first + count)):
        return ()
    return tuple(only[at] for at in sorted(only))


def _external_joints(
    names: Sequence[str],
    plain: Mapping[str, str],
    families: Mapping[Family, Mapping[int, str]],
    joints: tuple[Sequence[str], Sequence[bool]],
) -> tuple[str, ...]:
    """Return the arm's numbered columns, and those of its other joints: called as they are, or E1, E2 … of slides."""
    joint_names, slides = joints
    outside = (
        _called_outside(names, plain, joint_names)
        or _sliding_outside(names, plain, slides)
        or _redundant_outside(names, plain, slides)
    )
    turning = len(joint_names) - len(outside)
    full = {key: numbered for key, numbered in families.items() if _first_number(numbered, turning) >= 0}
    if not outside or not full:
        return ()
    numbered = full[min(full, key=_preference_rank)]
    first = _first_number(numbered, turning)
    arm = iter(range(first, first + turning))
    return tuple(outside[at] if at in outside else numbered[next(arm)] for at in range(len(joint_names)))


def _called_outside(
    names: Sequence[str], plain: Mapping[str, str], joint_names: Sequence[str]
) -> dict[int, str]:
    """Return the columns of a few joints that are called as the robot's are: a rail beside J1 to J6."""
    by_plain = {text: name for name, text in plain.items() if name in names and not _JOINT.match(text)}
    called = {at: by_plain.get(plain_name(joint), "") for at, joint in enumerate(joint_names)}
    found = {at: name for at, name in called.items() if len(plain[name] if name else "") >= _SHORTEST_NAME}
    return found if 0 < len(found) <= _MOST_OUTSIDE and len(set(found.values())) == len(found) else {}


def _sliding_outside(
    names: Sequence[str], plain: Mapping[str, str], slides: Sequence[bool]
) -> dict[int, str]:
    """Return the columns of joints that slide: external axes as many as these, or the one that is called a rail."""
    at = [joint for joint, slide in enumerate(slides) if slide]
    numbers = _external_numbers(names, plain)
    if at and sorted(numbers) == list(range(1, len(at) + 1)):
        return {joint: numbers[number] for number, joint in enumerate(at, 1)}
    rails = [name for name in names if plain[name] in _LONE_SLIDES]
    return {at[0]: rails[0]} if len(at) == len(rails) == 1 else {}


def _redundant_outside(
    names: Sequence[str], plain: Mapping[str, str], slides: Sequence[bool]
) -> dict[int, str]:
    """Return the redundant joint of seven that turn: E1 of KUKA and eax_a of ABB stand third in the chain.

    The fit tells where it stands elsewhere.
    """
    numbers = _external_numbers(names, plain)
    return {2: numbers[1]} if len(slides) == _REDUNDANT and not any(slides) and list(numbers) == [1] else {}


def _remedy_for(names: Sequence[str], plain: Mapping[str, str], joint_names: Sequence[str]) -> str:
    some_joints = sum(_JOINT.match(plain[name]) is not None for name in names) > 1
    return joints_remedy(names, plain, joint_names, some_joints=some_joints)


def _first_number(numbered: Mapping[int, str], count: int) -> int:
    """Return from which number on a family has so many: from 0 in an array, which may have fingers behind the arm."""
    is_array = 0 in numbered and _ELEMENT.search(numbered[0]) is not None
    for first in (0, 1) if is_array else (1, 0):
        if all(first + i in numbered for i in range(count)):
            return first
    return -1


def _preference_rank(key: tuple[str, str, str]) -> int:
    """Prefer the joints that the arm really had to those that it was told, and positions to anything else."""
    words = set(f"{key[0]}_{key[2]}".split("_"))
    order = _STEMS.index(key[1])
    wrong = bool(
        words
        & (
            SPREAD_WORDS
            | {
                "vel",
                "qd",
                "velocity",
                "current",
                "torque",
                "temp",
                "speed",
                "moment",
                "acc",
                "effort",
                "quat",
                "quaternion",
            }
        )
    )
    return 1000 * wrong + 100 * bool(words & _TOLD) - 50 * bool(words & _HAD) + order
