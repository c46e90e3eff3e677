"""Which six numbers of a URScript program are recorded positions, and in which frame and with which tool.

A position is a literal that a move goes to, directly or by the name of a variable. PolyScope's ``Waypoint_1_p`` and
``Waypoint_1_q``, one after the other, are one position: its pose, and the joints it was taught with. A pose inside
``pose_trans(frame, …)`` is a position in that frame if the frame is itself a literal that no move goes to; if it is
a place of its own, the pose is a step from there, and is reported.
"""

from bisect import bisect_right
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.programs.positions import Remark
from drivers.universal_robots.script_text import Literal, Statements

BASE = "base"
_SHOWN = 6
_RELATIVE = ("pose_trans", "pose_add", "pose_sub", "interpolate_pose", "point_dist", "pose_inv")
_FREE = ("speedl", "speedj", "servoj", "servoc", "force_mode", "freedrive_mode", "path_offset_set")
_WIRES = ("socket_read_ascii_float", "socket_read_string", "socket_read_binary_integer", "rpc_factory", "get_var",
          "read_input_float_register", "read_port_register", "modbus_get_signal_status")  # fmt: skip


class Place(NamedTuple):
    """One recorded position: its pose, its joints, or both."""

    name: str
    pose: Literal | None
    joints: Literal | None
    frame: str
    used: tuple[int, ...]  # offsets of the moves to it


class Finder:
    """Sorts the literals of a program."""

    def __init__(self, found: Statements, lines: NDArray[np.intp]) -> None:
        self.found = found
        self.lines = lines  # offsets of line feeds
        self.given: dict[str, list[Literal]] = {}
        for literal in found.literals:
            if literal.role == "value":
                self.given.setdefault(literal.name, []).append(literal)
        self.reached = {
            name: offsets
            for name, uses in found.uses.items()
            if (offsets := [at for at, role, _ in uses if role in ("target", "in_frame")])
        }
        roles = [(name, role) for name, uses in found.uses.items() for _, role, _ in uses]
        self.near = {name for name, role in roles if role == "near"}
        self.tool_names = {name for name, role in roles if role == "tool"}
        frames = {name for name, role in roles if role == "frame"} - self.near - self.reached.keys()
        self.frame_names = {name for name in frames if self._known(name) and self.given[name][0].is_pose}
        self.left: list[Literal] = []  # poses that no move goes to
        self.steps: list[Literal] = []  # poses that are a step from a place

    def line(self, offset: int) -> int:
        """Return the line of an offset, from 1."""
        return int(np.searchsorted(self.lines, offset)) + 1

    def places(self) -> list[Place]:
        """Return the recorded positions in the order of the text."""
        found: list[Place] = []
        literals = self.found.literals
        i = 0
        while i < len(literals):
            first = literals[i]
            second = literals[i + 1] if i + 1 < len(literals) else None
            if second is not None and self._one_place(first, second):
                found.append(self._pair(first, second))
                i += 2
                continue
            place = self._single(first)
            if place is not None:
                found.append(place)
            i += 1
        return self._unique(found)

    def frames(self) -> dict[str, Literal]:
        """Return the variables that are frames: given one literal pose, and never a place to go to."""
        return {name: given[0] for name, given in self.given.items() if name in self.frame_names}

    def tools(self) -> list[tuple[int, str, Literal | None]]:
        """Return every ``set_tcp``: its offset, the tool's name, and the pose where it is a literal."""
        calls = self.found.calls.get("set_tcp", [])
        tools: dict[int, tuple[str, Literal | None]] = dict.fromkeys(calls, ("", None))
        for literal in self.found.literals:
            if literal.role == "tool" and literal.is_pose:
                tools[literal.call] = (f"line {self.line(literal.start)}", literal)
        for name, uses in self.found.uses.items():
            pose = self.given[name][0] if self._known(name) else None
            for offset, role, _ in uses:
                if role == "tool":
                    tools[calls[bisect_right(calls, offset) - 1]] = (name if pose else "", pose)
        return [(offset, *tools[offset]) for offset in calls]

    def remarks(self) -> Iterator[Remark]:
        """Yield what else holds or changes positions."""
        yield from self._grouped(
            "relative", [each.start for each in self.steps],
            "a pose is a step from another place; it is not changed, and follows that place",
        )  # fmt: skip
        yield from self._grouped(
            "computed", [each.start for each in self.left],
            "a pose is given that no move goes to directly; it is not changed",
        )  # fmt: skip
        for function in sorted({name for _, name in self.found.computed}):
            offsets = [offset for offset, name in self.found.computed if name == function]
            yield from self._grouped("computed", offsets, f"{function} goes where the program computes")
        unknown = [
            offset
            for name, uses in self.found.uses.items()
            if not self._known(name)
            for offset, role, _ in uses
            if role in ("target", "in_frame")
        ]
        yield from self._grouped(
            "computed", unknown, "a move goes to a variable that holds no recorded pose, or more than that"
        )
        yield from self._of_functions("relative", _RELATIVE, "poses are computed from others")
        yield from self._of_functions("computed", _FREE, "the arm moves without a recorded position")
        yield from self._of_functions(
            "foreign", _WIRES, "values come from elsewhere while the program runs, and may be positions"
        )

    def _of_functions(self, code: str, functions: Iterable[str], text: str) -> Iterator[Remark]:
        for function in functions:
            yield from self._grouped(code, self.found.calls.get(function, []), f"{function}: {text}")

    def _grouped(self, code: str, offsets: list[int], text: str) -> Iterator[Remark]:
        if offsets:
            lines = sorted({self.line(offset) for offset in offsets})
            more = f" and {len(lines) - _SHOWN} more" if len(lines) > _SHOWN else ""
            where = ", ".join(map(str, lines[:_SHOWN])) + more
            yield Remark(lines[0], code, f"{text} (line {where}).")

    def _known(self, name: str) -> bool:
        return len(self.given.get(name, ())) == 1 and name not in self.found.assigned

    def _one_place(self, first: Literal, second: Literal) -> bool:
        if not first.is_pose or second.is_pose:
            return False
        if first.role == "value" == second.role:
            together = (
                first.name[-2:] == "_p" and second.name[-2:] == "_q" and first.name[:-2] == second.name[:-2]
            )
            return together and first.name not in self.frame_names and first.name not in self.tool_names
        return first.role == "target" and second.role == "near" and first.call == second.call

    def _pair(self, pose: Literal, joints: Literal) -> Place:
        if not pose.name:
            return Place(f"line {self.line(pose.start)}", pose, joints, BASE, (pose.start,))
        used = (*self.reached.get(pose.name, ()), *self.reached.get(joints.name, ()))
        return Place(pose.name[:-2], pose, joints, BASE, used)

    def _single(self, literal: Literal) -> Place | None:
        pose, joints = (literal, None) if literal.is_pose else (None, literal)
        if literal.role == "target" or (literal.role == "near" and joints):
            return Place(f"line {self.line(literal.start)}", pose, joints, BASE, (literal.start,))
        if literal.role == "in_frame" and literal.is_pose:
            return self._in_frame(literal)
        if literal.role == "value":
            return self._variable(literal, pose, joints)
        if literal.is_pose and literal.role not in ("tool", "frame"):
            self.left.append(literal)
        return None

    def _in_frame(self, literal: Literal) -> Place | None:
        if literal.name in self.frame_names:
            return Place(f"line {self.line(literal.start)}", literal, None, literal.name, (literal.start,))
        self.steps.append(literal)
        return None

    def _variable(self, literal: Literal, pose: Literal | None, joints: Literal | None) -> Place | None:
        name = literal.name
        if name in self.frame_names or name in self.tool_names:
            return None
        frames = {where for _, role, where in self.found.uses.get(name, ()) if role == "in_frame"}
        used = tuple(self.reached.get(name, ()))
        if len(frames) == 1 and literal.is_pose and frames <= self.frame_names:
            return Place(name, literal, None, next(iter(frames)), used)
        if not frames and (name in self.reached or name in self.near):
            return Place(name, pose, joints, BASE, used)
        if literal.is_pose:
            self.left.append(literal)
        return None

    def _unique(self, places: list[Place]) -> list[Place]:
        seen: dict[str, int] = {}
        for i, place in enumerate(places):
            count = seen[place.name] = seen.get(place.name, 0) + 1
            literal = place.pose or place.joints
            if count > 1 and literal:
                where = "" if place.name.startswith("line ") else f"line {self.line(literal.start)}, "
                places[i] = place._replace(name=f"{place.name} ({where}{count})")
        return places
