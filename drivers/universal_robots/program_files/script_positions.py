"""Which six numbers of a URScript program are recorded positions, and in which frame and with which tool.

A position is a literal that a move goes to, directly or by the name of a variable. PolyScope's ``Waypoint_1_p`` and
``Waypoint_1_q``, one after the other, are one position: its pose, and the joints it was taught with. A pose inside
``pose_trans(frame, …)`` is a position in that frame if the frame is itself a literal that no move goes to; if it is
a place of its own, the pose is a step from there, and is reported.
"""

import re
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

from cellcal.drivers.programs.barred import COMPUTED
from cellcal.drivers.programs.line_numbers import LineNumbers
from cellcal.drivers.programs.positions import NO_NUMBER
from cellcal.drivers.universal_robots.program_files.script_arguments import PassedArguments
from cellcal.drivers.universal_robots.program_files.script_calls import NUMBER_TAKERS
from cellcal.drivers.universal_robots.program_files.script_frames import settle_assigned_frames
from cellcal.drivers.universal_robots.program_files.script_heads import heads_in
from cellcal.drivers.universal_robots.program_files.script_numbers import LARGEST_RAD, without_comments
from cellcal.drivers.universal_robots.program_files.script_origins import StepOrigins
from cellcal.drivers.universal_robots.program_files.script_set_frames import settle_set_frames
from cellcal.drivers.universal_robots.program_files.script_text import ScriptLiteral, ScriptStatements

BASE = "base"
NOT_READ = "no move that is understood goes to it, and it is not changed"
CONFLICTS = "the program goes to it in different frames"
_LONGEST_NAME, _LONGEST_LIST = 60, 100_000
_FUNCTION = re.compile(r"^[ \t]*+def[ \t]++(\w++)", re.ASCII | re.MULTILINE)
_NEAR_PAIR = re.compile(
    r"\bget_inverse_kin[ \t]*\(\s*([A-Za-z_]\w*)\s*,\s*qnear\s*=\s*([A-Za-z_]\w*)\s*\)", re.ASCII
)
_CALLED = re.compile(r"(\w+)[ \t]*\Z", re.ASCII)
_OPENED = re.compile(r"\(\s*p\[\Z", re.ASCII)
_NAME_BEHIND = re.compile(r"\]\s*,\s*[A-Za-z_]", re.ASCII)
_FRAME_BEFORE = re.compile(r"\bpose_trans[ \t]*\(\s*(?:([A-Za-z_]\w*)|p\[[^\[\]]*\])\s*,\s*\Z", re.ASCII)
_LONGEST_FRAME = 400
_FRAME_WRITTEN = re.compile(r"\(\s*p\[", re.ASCII)
_LIST = re.compile(r"=[ \t]*\[[^=()]*\Z", re.ASCII)
_NO_POSITION = frozenset(
    ("force_mode", "set_payload", "set_target_payload", "set_tcp", "path_offset_set", "set_gravity", "speedl")
)


class ScriptPlace(NamedTuple):
    """One recorded position: its pose, its joints, or both."""

    name: str
    pose: ScriptLiteral | None
    joints: ScriptLiteral | None
    frame: str
    used: tuple[int, ...]  # offsets of the moves to it
    unread: str = ""  # why it is not changed; "" where it may be
    is_hint: bool = False  # its joints may only choose the posture: qnear of get_inverse_kin
    offset: int = 0  # where it stands, if it has no numbers

    @property
    def start_offset(self) -> int:
        """Return where its first numbers stand."""
        literal = self.pose or self.joints
        return literal.start if literal else self.offset

    @property
    def reached_offset(self) -> int:
        """Return where a move first goes to it: points declared at the top come behind the way to them."""
        return min(self.used, default=self.start_offset)


class PositionFinder:
    """Sorts the literals of a program."""

    def __init__(self, found: ScriptStatements, text: str, lines: LineNumbers) -> None:
        parameters = {name for head in heads_in(text) for name in head.parameters if name}
        changed = found.assigned.keys() | {one.name for one in found.elements} | parameters
        settle_set_frames(found, text, frozenset(changed))
        self.moves_to = settle_assigned_frames(found, text)  # literals that another name stands for in moves
        self.found = found
        self.set_names = {one.name for one in found.literals if one.role in ("value", "frame")}
        self.lines = lines  # of the text as it is written
        self.functions = frozenset(_FUNCTION.findall(text))  # of the script itself
        self.parameters = parameters
        self.in_parts = frozenset(one.name for one in found.elements)
        self.literals_by_name: dict[str, list[ScriptLiteral]] = {}
        for literal in found.literals:
            if literal.role == "value":
                self.literals_by_name.setdefault(literal.name, []).append(literal)
        self.reached = {
            name: offsets
            for name, uses in found.uses.items()
            if (offsets := [at for at, role, _ in uses if role in ("target", "in_frame")])
        }
        roles = [(name, role) for name, uses in found.uses.items() for _, role, _ in uses]
        self.hint_of = self._find_hints(text)
        self.near = {name for name, role in roles if role == "near"}
        self.tool_names = {name for name, role in roles if role == "tool"}
        frames = {name for name, role in roles if role == "frame"} - self.near - self.reached.keys()
        frames -= {name for name, role in roles if role == "other"}  # a place that is gone to otherwise, too
        self.frame_names = {
            name for name in frames if self._is_constant(name) and self.literals_by_name[name][0].is_pose
        }
        self.text = text
        self.unused_poses: list[ScriptLiteral] = []  # poses that no move goes to
        self.steps: list[ScriptLiteral] = []  # poses that are a step from a place

    def _find_hints(self, text: str) -> dict[str, ScriptLiteral]:
        """Return the joints that choose the posture of a named pose, where they do so for this pose only."""
        pairs = set(_NEAR_PAIR.findall(text))
        poses, hints = Counter(pose for pose, _ in pairs), Counter(near for _, near in pairs)
        found = {}
        for pose, near in pairs:
            is_constant = self._is_constant(pose) and self._is_constant(near)
            if not is_constant or poses[pose] + hints[near] > 2 or near in self.reached:
                continue
            if pose[-2:] == "_p" and near == f"{pose[:-2]}_q":  # PolyScope's pair: taught together
                continue
            literal = self.literals_by_name[near][0]
            if self.literals_by_name[pose][0].is_pose and not literal.is_pose and pose in self.reached:
                found[pose] = literal
        return found

    def line_of(self, offset: int) -> int:
        """Return the line of an offset, from 1."""
        return self.lines.line_of(offset)

    def list_places(self) -> list[ScriptPlace]:
        """Return the recorded positions in the order in which the text goes to them."""
        found: list[ScriptPlace] = []
        hints = {literal.start for literal in self.hint_of.values()}
        literals = [literal for literal in self.found.literals if literal.start not in hints]
        i = 0
        while i < len(literals):
            first = literals[i]
            second = literals[i + 1] if i + 1 < len(literals) else None
            if second is not None and self._one_place(first, second):
                found.append(self._pair_place(first, second))
                i += 2
                continue
            place = self._single_place(first)
            if place is not None:
                found.append(place)
            i += 1
        found += [self._unread_place(literal) for literal in self._not_read()]
        found += [
            ScriptPlace(name or f"line {self.line_of(at)}", None, None, BASE, (), NO_NUMBER, offset=at)
            for at, name in self.found.broken
        ]
        return self._unique_places(sorted(found, key=lambda place: place.reached_offset))

    def _not_read(self) -> Iterator[ScriptLiteral]:
        """Yield literals that are positions, and that no move goes to in a way that is understood."""
        for literal in (*self.unused_poses, *self.steps):
            if not self._is_offset(literal):
                yield literal
        taken = {literal.start for literal in (*self.unused_poses, *self.steps)}
        for literal in self.found.literals:
            if (
                not literal.is_pose
                and literal.start not in taken
                and self._is_posture(literal)
                and not self._is_beyond_joints(literal)
            ):
                yield literal

    def _is_beyond_joints(self, literal: ScriptLiteral) -> bool:
        """Return whether six numbers that no move goes to are gains or forces: no joint turns as far."""
        try:
            numbers = [
                float(text) for text in without_comments(self.text[literal.start : literal.end]).split(",")
            ]
        except ValueError:
            return False
        return any(abs(number) > LARGEST_RAD for number in numbers)

    def _unread_place(self, literal: ScriptLiteral) -> ScriptPlace:
        name = literal.name if literal.role == "value" else f"line {self.line_of(literal.start)}"
        pose, joints = (literal, None) if literal.is_pose else (None, literal)
        in_set_frame = literal.role == "in_frame" and literal.name in self.set_names
        return ScriptPlace(name, pose, joints, BASE, (), COMPUTED if in_set_frame else NOT_READ)

    def _is_offset(self, literal: ScriptLiteral) -> bool:
        """Return whether a pose is only added to others, or a step from a place that goes along with the work."""
        if literal.role == "value":
            uses = self.found.uses.get(literal.name, ())
            return bool(uses) and all(self._is_added(at, role, where) for at, role, where in uses)
        if literal.role == "in_frame":
            return self._is_place(literal.call, literal.name)
        function = self._function_at(literal.call)
        first = _OPENED.search(self.text, 0, literal.start) is not None
        if function in ("pose_add", "pose_sub", "pose_trans"):
            if function == "pose_trans":
                return not first and self._is_place(literal.call, "")
            return not first or self._is_added_to_name(literal)
        return function in _NO_POSITION

    def _is_added(self, at: int, role: str, where: str) -> bool:
        second = self.text[:at].rstrip()[-1:] == ","
        if role == "in_frame":
            return self._is_place(self.text.rfind("(", 0, at), where)
        if where == "pose_trans" and second:
            return not self._behind_frame(at)
        return (where in ("pose_add", "pose_sub") and second) or where in _NO_POSITION

    def _behind_frame(self, at: int) -> bool:
        """Return whether a pose stands behind a named or written frame that is no place of its own."""
        found = _FRAME_BEFORE.search(self.text, max(0, at - _LONGEST_FRAME), at)
        if found is None:
            return False
        return found[1] is None or not self._is_place(found.start(), found[1])

    def _is_added_to_name(self, literal: ScriptLiteral) -> bool:
        return _NAME_BEHIND.match(self.text, literal.end) is not None

    def _is_place(self, call: int, name: str) -> bool:
        """Return whether a pose is a step from a place: a variable that a move goes to, or the arm's own."""
        if name:
            return name in self.reached or (name in self.found.assigned and self._origins.is_place(name))
        if _FRAME_WRITTEN.match(self.text, call) is not None:
            return False
        return self._origins.is_place(self.text[call + 1 : call + _LONGEST_FRAME])

    @cached_property
    def _origins(self) -> StepOrigins:
        return StepOrigins(self.text, self.reached.keys(), self.parameters)

    def _function_at(self, call: int) -> str:
        found = _CALLED.search(self.text, max(0, call - _LONGEST_NAME), call)
        return found[1] if found else ""

    def _is_posture(self, literal: ScriptLiteral) -> bool:
        """Return whether six numbers without p are joints of a list or copy, or given to a function that may move."""
        if literal.role == "other":
            return self._in_list(literal.start) or self._may_move(self._function_at(literal.call))
        if literal.role != "value" or literal.name in self.reached or literal.name in self.near:
            return False
        return self.may_be_gone_to(literal.name, literal.start)

    def may_be_gone_to(self, name: str, at: int) -> bool:
        """Return whether joints that a variable gets at an offset may be moved to, by a copy, a list or a function.

        Its numbers one by one are joints only where a list or a function that may move takes them up.
        """
        uses = self.found.uses.get(name, ())
        if any(
            self._in_list(place) or self._may_move(self._taker_of(place, where)) for place, _, where in uses
        ):
            return True
        return bool(uses) and bool(self.passed.moves_to_copies(name, at))

    def _taker_of(self, at: int, where: str) -> str:
        """Return the function that a use is an argument of; of one number of a list also the list that is written."""
        return self.passed.taker_of_element(at) if where == "[" else where

    def _may_move(self, function: str) -> bool:
        """Return whether a function of this script, or one that nothing here tells of, may go to what it is given."""
        return function in self.functions or (bool(function) and function not in NUMBER_TAKERS)

    def _in_list(self, at: int) -> bool:
        before = self.text[:at].rstrip(" \t\r\n[")
        return (
            before[-1:] in ("=", ",") and _LIST.search(self.text, max(0, at - _LONGEST_LIST), at) is not None
        )

    def is_known(self, name: str) -> bool:
        """Return whether a variable holds one literal and nothing else."""
        return self._is_constant(name)

    def has_conflict(self, place: ScriptPlace) -> bool:
        """Return whether moves go to a variable's pose both in a frame and without it."""
        literal = place.pose
        if literal is None or literal.role != "value" or place.unread:
            return False
        roles = {
            (role, where if role == "in_frame" else "")
            for _, role, where in self.found.uses.get(literal.name, ())
        }
        gone_to = {one for one in roles if one[0] in ("target", "in_frame")}
        # ``over = pose_trans(frame, pick)`` goes to it in a frame, too, when a move goes to ``over``.
        computed = any(
            role == "other" and where == "pose_trans" and self._behind_frame(at)
            for at, role, where in self.found.uses.get(literal.name, ())
        )
        if len(gone_to) + computed > 1 or self.passed.is_brought_into_a_frame(literal.name, literal.start):
            return True
        own = {at for at, _, _ in self.found.uses.get(literal.name, ())}
        return place.frame != BASE and bool(self.passed.moves_to_copies(literal.name, literal.start) - own)

    @cached_property
    def passed(self) -> PassedArguments:
        """Return what the script's functions, and copies, make of its places."""
        return PassedArguments(self.text, self.found.uses, self._behind_frame)

    def frame_literals(self) -> dict[str, ScriptLiteral]:
        """Return the variables that are frames: given one literal pose, and never a place to go to."""
        return {
            name: literals[0] for name, literals in self.literals_by_name.items() if name in self.frame_names
        }

    def tool_settings(self) -> list[tuple[int, str, ScriptLiteral | None]]:
        """Return every ``set_tcp``: its offset, the tool's name, and the pose where it is a literal."""
        calls = self.found.calls.get("set_tcp", [])
        tools: dict[int, tuple[str, ScriptLiteral | None]] = dict.fromkeys(calls, ("", None))
        for literal in self.found.literals:
            if literal.role == "tool" and literal.is_pose:
                tools[literal.call] = (f"line {self.line_of(literal.start)}", literal)
        for name, uses in self.found.uses.items():
            pose = self.literals_by_name[name][0] if self._is_constant(name) else None
            for offset, role, _ in uses:
                if role == "tool":
                    tools[calls[bisect_right(calls, offset) - 1]] = (name if pose else "", pose)
        return [(offset, *tools[offset]) for offset in calls]

    def _is_constant(self, name: str) -> bool:
        return len(self.literals_by_name.get(name, ())) == 1 and not self._is_changed(name)

    def _is_changed(self, name: str) -> bool:
        """Return whether a variable gets another value, an element gets one, or a function has it as a parameter."""
        return name in self.found.assigned or name in self.in_parts or name in self.parameters

    def _one_place(self, first: ScriptLiteral, second: ScriptLiteral) -> bool:
        if not first.is_pose or second.is_pose:
            return False
        if first.role == "value" == second.role:
            together = (
                first.name[-2:] == "_p" and second.name[-2:] == "_q" and first.name[:-2] == second.name[:-2]
            )
            return together and first.name not in self.frame_names and first.name not in self.tool_names
        return first.role == "target" and second.role == "near" and first.call == second.call

    def _pair_place(self, pose: ScriptLiteral, joints: ScriptLiteral) -> ScriptPlace:
        if not pose.name:
            name = f"line {self.line_of(pose.start)}"
            return ScriptPlace(name, pose, joints, BASE, (pose.start,), is_hint=True)
        used = (*self._moves_to(pose), *self._moves_to(joints))
        return ScriptPlace(pose.name[:-2], pose, joints, BASE, used)

    def _moves_to(self, literal: ScriptLiteral) -> list[int]:
        """Return where moves go to a variable and to its copies; none where no move goes to the variable itself."""
        own = self.reached.get(literal.name, [])
        if not (own and self.found.calls.get("set_tcp")):  # only the tool asks for the others
            return own
        return sorted({*own, *self.passed.moves_to_copies(literal.name, literal.start)})

    def _near_offsets(self, name: str) -> list[int]:
        """Return where joints of this name choose a posture."""
        return [at for at, role, _ in self.found.uses.get(name, ()) if role == "near"]

    def _single_place(self, literal: ScriptLiteral) -> ScriptPlace | None:
        pose, joints = (literal, None) if literal.is_pose else (None, literal)
        if literal.role == "target" or (literal.role == "near" and joints):
            return ScriptPlace(f"line {self.line_of(literal.start)}", pose, joints, BASE, (literal.start,))
        if literal.role == "in_frame" and literal.is_pose:
            return self._in_frame(literal)
        if literal.role == "value":
            return self._variable_place(literal, pose, joints)
        if literal.is_pose and literal.role not in ("tool", "frame"):
            self.unused_poses.append(literal)
        return None

    def _in_frame(self, literal: ScriptLiteral) -> ScriptPlace | None:
        if literal.name in self.frame_names:
            used = self.moves_to.get(literal.start, (literal.start,))
            return ScriptPlace(f"line {self.line_of(literal.start)}", literal, None, literal.name, used)
        self.steps.append(literal)
        return None

    def _variable_place(
        self, literal: ScriptLiteral, pose: ScriptLiteral | None, joints: ScriptLiteral | None
    ) -> ScriptPlace | None:
        name = literal.name
        if name in self.frame_names or name in self.tool_names:
            return None
        frames = {where for _, role, where in self.found.uses.get(name, ()) if role == "in_frame"}
        used = tuple(self._moves_to(literal) or self._near_offsets(name))
        if len(frames) == 1 and literal.is_pose and frames <= self.frame_names:
            return ScriptPlace(name, literal, None, next(iter(frames)), used)
        if not frames and (name in self.reached or name in self.near):
            hint = self.hint_of.get(name) if pose else None
            chooses = hint is not None or (joints is not None and name not in self.reached)
            return ScriptPlace(name, pose, joints or hint, BASE, used, is_hint=chooses)
        if literal.is_pose:
            self.unused_poses.append(literal)
        return None

    def _unique_places(self, places: list[ScriptPlace]) -> list[ScriptPlace]:
        counts: dict[str, int] = {}
        for i, place in enumerate(places):
            count = counts[place.name] = counts.get(place.name, 0) + 1
            literal = place.pose or place.joints
            if count > 1 and literal:
                where = "" if place.name.startswith("line ") else f"line {self.line_of(literal.start)}, "
                places[i] = place._replace(name=f"{place.name} ({where}{count})")
        return places
