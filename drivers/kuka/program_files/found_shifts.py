"""What shifts points of KRL in the axes of the base: relative moves, ``:``, components that are set."""

import re
from dataclasses import dataclass, field
from math import nan, radians

import numpy as np

from cellcal.calibration.geometry import quaternion_from_rotation
from cellcal.calibration.orientation import rotation_from
from cellcal.drivers.kuka.program_files.collected_positions import KrlPositions
from cellcal.drivers.kuka.program_files.literals import POSE_FIELDS, KrlLiteral
from cellcal.drivers.kuka.program_files.point_uses import PointMove, PointUses
from cellcal.drivers.programs.shifts import NO_TURN, UNREADABLE, ProgramShift, Quaternion, ShiftAxes, Triple

_B = r"[ \t\r]"
_NAME = rf"[A-Za-z_]\w*+{_B}*+(?:\[[^\[\]]*+\])?+"
_PAIR = re.compile(rf"(?<![\w.$#\]}}])(\$?{_NAME}|\{{[^{{}}]*+\}}){_B}*+:{_B}*+({_NAME}|\{{)", re.ASCII)
_OF_AXES = re.compile(r"A[1-6]", re.IGNORECASE)
_COMPONENT = re.compile(
    rf"{_B}*+([A-Za-z_]\w*+)({_B}*+\[[^\[\]\n]*+\])?+{_B}*+\.{_B}*+([XYZABC]|A[1-6]){_B}*+=(?!=)(.*)",
    re.ASCII | re.IGNORECASE | re.DOTALL,
)
_SUM = re.compile(r"([^+\-]*+)([+-])(.*)", re.DOTALL)
_NUMBER = re.compile(rf"{_B}*+(\d++(?:\.\d*+)?+|\.\d++){_B}*+", re.ASCII)
_CALL = re.compile(rf"(?<![\w.$])[A-Za-z_]\w*+{_B}*+\(", re.ASCII)
_POINTS = ("E6POS", "POS")
COMPUTED_PLACE = "a computed place"


@dataclass(frozen=True, slots=True)
class _FoundShift:
    place: int
    what: str
    point: str
    translation_m: Triple = UNREADABLE
    quaternion: Quaternion | None = None
    each_time: bool = False
    used: PointMove | None = None  # the move, whose base counts
    sets: bool = False  # a component gets a value of its own


@dataclass
class ShiftNotes:
    """The shifts of points in a program, collected while it is read."""

    found: KrlPositions
    notes: list[_FoundShift] = field(default_factory=list)
    guided: list[ProgramShift] = field(default_factory=list)  # motions that a sensor guides

    def note_relative(self, place: int, word: str, literal: KrlLiteral | None, used: PointMove) -> None:
        """Note a relative move along the axes of the base; a literal of None is computed."""
        name = f"{word.upper()}@{self.found.source.line_of(place)}"
        size = (UNREADABLE, None) if literal is None else _size_of(literal)
        self.notes.append(_FoundShift(place, word.upper(), name, *size, used=used))

    def note_computed(self, place: int, word: str, used: PointMove | None) -> None:
        """Note a move to a place that the program computes."""
        name = f"{word.upper()}@{self.found.source.line_of(place)}"
        self.notes.append(_FoundShift(place, name, COMPUTED_PLACE, used=used))

    def note_value(self, name: str, value: str, place: int, kind: str) -> None:
        """Note a position that gets what a function returns."""
        if kind in (*_POINTS, "FRAME") and _CALL.search(value) is not None:
            self.notes.append(_FoundShift(place, "the program", name))

    def note_correction(self, name: str, place: int) -> None:
        """Note that the points that follow are shifted in axes that do not turn with them."""
        self.notes.append(_FoundShift(place, name, COMPUTED_PLACE))

    def note_operators(self, code: str, place: int, types: dict[str, str], used: PointMove | None) -> None:
        """Note points that the operator ``:`` puts behind a frame: the frame's axes stay while the point turns."""
        for pair in _PAIR.finditer(code):
            left_operand, right_operand = pair[1].strip(), pair[2].strip()
            if right_operand == "{" or _is_point(left_operand, types):
                continue
            translation, quaternion = UNREADABLE, None
            if left_operand[0] == "{":
                literal = self.found.literal_or_none(place + pair.start(1), place + pair.end(1))
                translation, quaternion = (UNREADABLE, None) if literal is None else _size_of(literal)
            self.notes.append(
                _FoundShift(place, "the operator ':'", right_operand, translation, quaternion, used=used)
            )

    def note_component(self, code: str, place: int, used: PointMove) -> None:
        """Note that a component of a point is set."""
        found = _COMPONENT.match(code)
        if found is None or _OF_AXES.fullmatch(found[3]):  # an angle is in no frame
            return
        name = found[1] + "".join((found[2] or "").split())
        translation, quaternion = UNREADABLE, None
        added, axis = _SUM.match(found[4]), found[3].upper()
        path = f"{name}.{axis}".upper()
        if axis in "XYZ" and added is not None and "".join(added[1].split()).upper() == path:
            number = _NUMBER.fullmatch(added[3])
            size = float(number[1]) * (1e-3 if added[2] == "+" else -1e-3) if number else nan
            x, y, z = (size if axis == one else 0.0 for one in "XYZ")
            translation, quaternion = (x, y, z), NO_TURN
        what, sets = " ".join(code.split())[:80], quaternion is None
        if sets and axis in "XYZ":  # the others stay, and so does the orientation
            x, y, z = (nan if axis == one else 0.0 for one in "XYZ")
            translation, quaternion = (x, y, z), NO_TURN
        self.notes.append(
            _FoundShift(place, what, name, translation, quaternion, each_time=not sets, used=used, sets=sets)
        )

    def to_shifts(self, points: PointUses) -> tuple[ProgramShift, ...]:
        """Return the shifts, with the base of the move that each belongs to."""
        return (*(self._make_shift(one, points) for one in self.notes), *self.guided)

    def _make_shift(self, one: _FoundShift, points: PointUses) -> ProgramShift:
        base = None if one.used is None else points.frames_of_move(one.used, joints=False).frame
        return ProgramShift(
            self.found.source.line_of(one.place),
            one.what,
            ShiftAxes.USER_FRAME,
            (),
            one.point,
            base,
            one.translation_m,
            one.quaternion,
            one.each_time,
            one.sets,
        )


def _is_point(operand: str, types: dict[str, str]) -> bool:
    """Return whether what stands before ``:`` is the point itself, so that the frame behind it goes along with it."""
    upper = operand.partition("[")[0].strip().upper()
    return (
        types.get(upper) in _POINTS or (upper.startswith("X") and upper not in types) or upper == "$POS_ACT"
    )


def _size_of(literal: KrlLiteral) -> tuple[Triple, Quaternion | None]:
    """Return translation and rotation of a frame that is written out; fields that are missing are zero."""
    if literal.axes:
        return UNREADABLE, None
    values = dict(zip(POSE_FIELDS, (float(text or 0.0) for text in literal.main), strict=True))
    angles = [radians(values[name]) for name in "ABC"]
    turn = quaternion_from_rotation(rotation_from("kuka_abc", np.array([angles])))[0].tolist()
    w, x, y, z = turn
    return (values["X"] * 1e-3, values["Y"] * 1e-3, values["Z"] * 1e-3), (w, x, y, z)
