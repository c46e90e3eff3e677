"""What a URScript program adds to its poses while it runs, in axes of the base or of the pose's own frame."""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from math import nan

from cellcal.drivers.programs.shifts import NO_TURN, UNREADABLE, ProgramShift, Quaternion, ShiftAxes, Triple
from cellcal.drivers.universal_robots.program_files.script_numbers import without_comments
from cellcal.drivers.universal_robots.program_files.script_positions import BASE, PositionFinder, ScriptPlace
from cellcal.drivers.universal_robots.program_files.script_text import NUMBER, SIX, SIX_OVER_LINES, ElementSet

COMPUTED_PLACE = "a computed place"
ELEMENT_SET = "the program sets an element of it while it runs"
_B = r"[ \t]*+"
_ARGUMENT = rf"((?!p\[)[A-Za-z_]\w*+(?!\())?{_B}(p\[{SIX}\])?"
_BOTH = re.compile(rf"\({_B}{_ARGUMENT}{_B}(?:,{_B}{_ARGUMENT}{_B}(\))?)?", re.ASCII)
_TO_WHERE_IT_STANDS = re.compile(  # what is added to the place where the robot is
    rf"\({_B}get_(?:actual|target)_tcp_pose{_B}\({_B}\){_B},{_B}{_ARGUMENT}{_B}\)", re.ASCII
)
_ADDED = re.compile(
    rf"(?P<name>[A-Za-z_]\w*+){_B}\[{_B}(?P<index>\w++){_B}\]{_B}(?:"
    rf"(?P<sign>[-+])={_B}(?P<more>[^\r\n#]*+)"
    rf"|={_B}(?P=name){_B}\[{_B}(?P=index){_B}\]{_B}(?P<plus>[-+])(?P<term>[^\r\n#]*+))",
    re.ASCII,
)
_SIZE = re.compile(rf"{_B}({NUMBER}){_B}", re.ASCII)
_FOLLOWING = (  # what these return goes along with the poses that it is computed from, or is noted as a shift
    "pose_add", "pose_sub", "pose_trans", "interpolate_pose", "get_actual_tcp_pose", "get_target_tcp_pose",
    "get_actual_joint_positions", "get_target_joint_positions",
)  # fmt: skip
_FOLLOWS = re.compile(  # but for a pose of which a number is computed
    rf"\s*+(?:{'|'.join(_FOLLOWING)}){_B}\(|\s*+get_(?:inverse|forward)_kin{_B}\(\s*+"
    rf"(?:[xq]\s*+=\s*+)?+(?:p?\[{SIX_OVER_LINES}\]|(?!p?\[))",
    re.ASCII,
)
_OF_TIP = re.compile(rf"{_B}(?:pose_\w++|interpolate_pose|get_(?:actual|target)_tcp_pose|p\[)", re.ASCII)
_FRAME_BEFORE = re.compile(r"\bpose_trans[ \t]*+\([ \t]*+\Z", re.ASCII)
_LONGEST_GAP = 80
_VALUE = re.compile(
    r"^[ \t]*+(?:(?:global|local)[ \t]++)?(?P<name>[A-Za-z_]\w*+)[ \t]*+=(?!=)[ \t]*+(?P<value>[^\r\n#]*+)",
    re.ASCII | re.MULTILINE,
)
_PLAIN = re.compile(rf"(?:[A-Za-z_]\w*+|p?\[{SIX}\]){_B}", re.ASCII)
_NO_NUMBER = re.compile(r"\][ \t]*+=(?!=)[ \t]*+(?:True|False|\"[^\"\n]*+\")[ \t\r]*+(?:#[^\n]*+)?$")
_NEVER_SIX = re.compile(rf"{_B}(?:integer_to_binary_list|struct|str_\w++|to_str){_B}\(", re.ASCII)
_FLAT_LIST = re.compile(r"\[[^\[\]()\n]*+\]")
_COMMAS_OF_SIX = 5
_IN_BASE_AXES = ("speedl", "force_mode", "path_offset_set", "track_conveyor_linear")
_BY_ANY_CHANGE = ("pose_inv", "speedj", "track_conveyor_circular")  # any change may cost something


class ScriptShifts:
    """The shifts of one script."""

    def __init__(self, text: str, finder: PositionFinder, places: Sequence[ScriptPlace]) -> None:
        self.text = text
        self.finder = finder
        self.rows: dict[str, list[int]] = {}  # of places, by variable
        self.frames: dict[str, str] = {}
        for row, place in enumerate(places):
            for literal in (place.pose, place.joints):
                if literal is not None and literal.name and not place.unread and literal.role == "value":
                    self.rows.setdefault(literal.name, []).append(row)
                    self.frames[literal.name] = place.frame
        self.holding_joints = {
            name
            for name, literals in finder.literals_by_name.items()
            if any(not literal.is_pose for literal in literals)
        }
        self.parameters = finder.parameters

    def barred_places(self) -> Mapping[int, str]:
        """Return the places of which an element is set to something, and not only added to."""
        found: dict[int, str] = {}
        for one in self.finder.found.elements:
            if self._added_translation(one) is None or one.name in self.holding_joints:
                found |= dict.fromkeys(self.rows.get(one.name, ()), ELEMENT_SET)
        return found

    def all_shifts(self) -> tuple[ProgramShift, ...]:
        """Return all shifts in the order of the text."""
        found = [
            *self._sum_shifts(),
            *self._element_shifts(),
            *self._computed_moves(),
            *self._unknown_variables(),
            *(
                self._make_shift(at, "qnear", COMPUTED_PLACE, UNREADABLE, None)
                for at in self.finder.found.computed_near
            ),
        ]
        for function in (*_IN_BASE_AXES, *_BY_ANY_CHANGE):
            turn = None if function in _BY_ANY_CHANGE else NO_TURN
            found += [
                self._make_shift(offset, function, COMPUTED_PLACE, UNREADABLE, turn)
                for offset in self.finder.found.calls.get(function, ())
            ]
        return tuple(sorted(found, key=lambda one: (one.line, one.point)))

    def _make_shift(
        self,
        offset: int,
        what: str,
        point: str,
        translation: Triple,
        quaternion: Quaternion | None = NO_TURN,
        *,
        each_time: bool = False,
    ) -> ProgramShift:
        rows = tuple(self.rows.get(point, ()))
        frame = self.frames.get(point, BASE)
        line = self.finder.line_of(offset)
        return ProgramShift(
            line, what, ShiftAxes.USER_FRAME, rows, point, frame, translation, quaternion, each_time=each_time
        )

    def _sum_shifts(self) -> Iterator[ProgramShift]:
        """Yield what pose_add and pose_sub add: places in the axes of the base, turns in those of the first pose."""
        for function, sign in (("pose_add", 1.0), ("pose_sub", -1.0)):
            for offset in self.finder.found.calls.get(function, ()):
                yield self._sum_shift(offset, function, sign)

    def _sum_shift(self, offset: int, function: str, sign: float) -> ProgramShift:
        relative = _TO_WHERE_IT_STANDS.match(self.text, offset)
        if relative is not None and (relative[1] or relative[2]):
            six = self._six_numbers(relative[2], relative[1])
            added = UNREADABLE if six is None else _place_of(six, sign)
            return self._make_shift(offset, function, COMPUTED_PLACE, added)
        found = _BOTH.match(self.text, offset)
        if found is None or found[5] is None:
            point = (found and (found[1] or found[3])) or COMPUTED_PLACE
            return self._make_shift(offset, function, point, UNREADABLE, None)
        first, second = found[1], found[3]
        if first in self.rows or (first and second not in self.rows):
            if second in self.rows:  # the difference of two places, or a sum of them
                return self._make_shift(offset, function, first, UNREADABLE, None)
            six = self._six_numbers(found[4], second)
            return self._make_shift(
                offset, function, first, UNREADABLE if six is None else _place_of(six, sign)
            )
        six = self._six_numbers(found[2], first) if sign > 0 else None
        turn = NO_TURN if six is not None and not any(six[3:]) else None
        translation = UNREADABLE if six is None else _place_of(six, sign)
        return self._make_shift(offset, function, second or COMPUTED_PLACE, translation, turn)

    def _six_numbers(self, literal: str | None, name: str | None) -> list[float] | None:
        """Return six numbers that are written out, or that a variable holds and nothing else."""
        if literal:
            return [float(number) for number in literal[2:-1].split(",")]
        if not name or not self.finder.is_known(name):
            return None
        literal_of_name = self.finder.literals_by_name[name][0]
        text = self.text[literal_of_name.start : literal_of_name.end]
        return [float(number) for number in without_comments(text).split(",")]

    def _element_shifts(self) -> Iterator[ProgramShift]:
        for one in self.finder.found.elements:
            if self._is_no_place(one):
                continue
            what = " ".join(self.text[one.offset : self._end_of_line(one.offset)].split())[:80]
            added = (
                None
                if one.name in self.holding_joints or not self._holds_pose(one.name)
                else self._added_translation(one)
            )
            translation, turn = (UNREADABLE, None) if added is None else (added, NO_TURN)
            yield self._make_shift(one.offset, what, one.name, translation, turn, each_time=True)

    def _is_no_place(self, one: ElementSet) -> bool:
        """Return whether an element is set to a truth or a text, or belongs to what no move goes to."""
        if _NO_NUMBER.search(self.text, one.offset, self._end_of_line(one.offset)) is not None:
            return True
        if self._is_never_gone_to(one.name):
            return True
        values = self._assigned_values(one.name)
        return bool(values) and one.name not in self.parameters and all(map(_is_other_list, values))

    def _is_never_gone_to(self, name: str) -> bool:
        """Return whether a variable holds six numbers without a p, as written, that nothing moves to."""
        literals = self.finder.literals_by_name.get(name, ())
        return (
            bool(literals)
            and name not in self.parameters
            and name not in self.finder.found.assigned
            and name not in self.finder.reached
            and name not in self.finder.near
            and not any(
                literal.is_pose or self.finder.may_be_gone_to(name, literal.start) for literal in literals
            )
        )

    def _holds_pose(self, name: str) -> bool:
        values = self._assigned_values(name)
        return bool(values) and all(_OF_TIP.match(value) or _PLAIN.fullmatch(value) for value in values)

    def _added_translation(self, one: ElementSet) -> Triple | None:
        """Return what is added to the place of a pose, None where something else happens to an element."""
        found = _ADDED.match(self.text, one.offset)
        if found is None or found["index"] not in ("0", "1", "2"):
            return None
        size = _SIZE.fullmatch(found["more"] if found["sign"] else found["term"])
        sign = -1.0 if "-" in (found["sign"], found["plus"]) else 1.0
        value = nan if size is None else sign * float(size[1])
        x, y, z = (value if found["index"] == str(k) else 0.0 for k in range(3))
        return x, y, z

    def _computed_moves(self) -> Iterator[ProgramShift]:
        for offset, function in self.finder.found.computed:
            if _FOLLOWS.match(self.text, offset + 1) is None:
                yield self._make_shift(offset, function, COMPUTED_PLACE, UNREADABLE, None)

    def _unknown_variables(self) -> Iterator[ProgramShift]:
        """Yield moves to variables that may or may not move with the work."""
        for name, uses in self.finder.found.uses.items():
            values = self._assigned_values(name)
            roles = ("target", "in_frame", "near", *(("frame",) if values else ()))
            offsets = [offset for offset, role, _ in uses if role in roles]
            if values:  # a frame that is computed, and a place from it
                offsets += [offset for offset, role, _ in uses if role == "other" and self._is_frame(offset)]
            if not offsets or self.finder.is_known(name) or name in self.parameters:
                continue
            if not self._follows_the_work(name):
                yield self._make_shift(offsets[0], "the program", name, UNREADABLE, None)

    def _is_frame(self, offset: int) -> bool:
        """Return whether a name is the first argument of pose_trans."""
        return _FRAME_BEFORE.search(self.text, max(offset - _LONGEST_GAP, 0), offset) is not None

    def _follows_the_work(self, name: str) -> bool:
        """Return whether what is assigned to a variable goes along with the poses of the program, or is a shift."""
        values = list(self._assignments_of(name))
        return bool(values) and all(
            _FOLLOWS.match(self.text, value.start("value")) or _PLAIN.fullmatch(value["value"])
            for value in values
        )

    def _assigned_values(self, name: str) -> list[str]:
        return [found["value"] for found in self._assignments_of(name)]

    def _assignments_of(self, name: str) -> Sequence[re.Match[str]]:
        return self._assignments.get(name, ())

    @cached_property
    def _assignments(self) -> Mapping[str, Sequence[re.Match[str]]]:
        found: dict[str, list[re.Match[str]]] = defaultdict(list)
        for one in _VALUE.finditer(self.text):
            found[one["name"]].append(one)
        return found

    def _end_of_line(self, offset: int) -> int:
        end = self.text.find("\n", offset)
        return len(self.text) if end < 0 else end


def _is_other_list(value: str) -> bool:
    """Return whether a value is a list that cannot be six numbers; elements are counted where nothing is nested."""
    if _NEVER_SIX.match(value) is not None:
        return True
    found = _FLAT_LIST.fullmatch(value.strip())
    return found is not None and found[0].count(",") != _COMMAS_OF_SIX


def _place_of(six: Sequence[float], sign: float) -> Triple:
    x, y, z = (sign * value for value in six[:3])
    return x, y, z
