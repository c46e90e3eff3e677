"""Copies of positions that a motion goes to while another user frame or tool is in force.

A register holds numbers without a frame: a motion to it takes them in the frame that is in force. Where that is not
the frame of the position that was copied, the motion does not go to the position, and no change of the position's
numbers brings it where it belongs. With another tool the arm stands otherwise, and a correction is not its own.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from cellcal.drivers.fanuc.program_files.ls_computed import match_assignment, places_named
from cellcal.drivers.fanuc.program_files.ls_statements import Statement, motion_of, read_statements
from cellcal.drivers.programs.file_declarations import ExternalUses
from cellcal.drivers.programs.positions import CARTESIAN, Positions
from cellcal.drivers.programs.shifts import UNKNOWN_FRAME, ProgramShift, ShiftAxes


class _Selections(NamedTuple):
    """The forms in which a program selects a frame, or a tool."""

    by_number: re.Pattern[bytes]
    any_way: re.Pattern[bytes]
    is_tool: bool


def _selections_of(words: bytes, variable: bytes, *, is_tool: bool) -> _Selections:
    of_group = rb"[ \t]*+(?:\[ *+(?:GP *+)?+1 *+\][ \t]*+)?+=[ \t]*+(\d{1,5}+)"
    return _Selections(
        re.compile(rb"\A(?:" + words + rb"|\$" + variable + rb")" + of_group),
        re.compile(rb"\b(?:" + words + rb")\b|" + variable, re.IGNORECASE),
        is_tool,
    )


_OF_FRAME = _selections_of(rb"UFRAME_NUM|BENUTZER_NUM", b"MNUFRAMENUM", is_tool=False)
_OF_TOOL = _selections_of(rb"UTOOL_NUM|WKZ_NUM", b"MNUTOOLNUM", is_tool=True)
# Statements that the program may come to from elsewhere than from the line above.
_JOINED = re.compile(rb"(?:LBL|MARKE|FOR|ENDFOR|WHILE|ENDWHILE|ELSE|ELSEIF|ENDIF)\b")
_CALLED = re.compile(rb"\b(?:CALL|AUFRUF)[ \t]++([^\s;(,]{1,80}+)", re.IGNORECASE)
_STANDS = re.compile(rb"\bLPOS\b")
START = 0  # in place of a position: where the robot was before any
Copies = frozenset[tuple[int, str]]  # positions, and the user frame or tool whose numbers a register has


@dataclass
class _CopiedFrames:
    """Register contents, and the user frame and tool in force, statement by statement."""

    selections: _Selections
    taught: Mapping[int, str]  # by position
    frames_left: Mapping[str, frozenset[str]]  # by program that may be called: those that it chooses
    beside: frozenset[str] = frozenset()  # that other programs choose at any time
    frames: frozenset[str] = frozenset()  # that may be in force; none: what was chosen before the program
    are_callers: bool = False  # they are what callers chose, and the program has not chosen or told any
    copies: dict[int, Copies] = field(default_factory=dict)
    last: Copies = frozenset()  # where the robot stands

    def follow_statement(self, statement: Statement) -> None:
        """Take up a statement that is no motion."""
        if self.selections.any_way.search(statement.text):
            chosen = self.selections.by_number.fullmatch(statement.text)
            self.frames = frozenset([str(int(chosen[1])) if chosen else UNKNOWN_FRAME])
            self.are_callers = False
        self.follow_calls(statement)
        assigned = match_assignment(statement)
        if assigned is not None and not assigned[2]:
            self.store(int(assigned[1]), assigned[3])

    def follow_calls(self, statement: Statement) -> None:
        """Take up the frames that called programs choose: one that is chosen stays when its program has ended."""
        for name in _CALLED.findall(statement.text) if self.frames_left else ():
            frames_behind = self.frames_left.get(name.decode("cp437").upper(), frozenset[str]())
            self.frames |= frames_behind

    def follow_motion(self, statement: Statement) -> list[tuple[int, ProgramShift]]:
        """Take up a motion; return, by position, those of its registers that another frame holds for."""
        motion = motion_of(statement)
        found: list[tuple[int, ProgramShift]] = []
        reached = {(each, self.taught[each]) for each in motion.targets[-1:] if each in self.taught}
        for register in motion.register_targets:
            some = self.copies.get(register, frozenset())
            found += [
                (position, self._copy_elsewhere((statement.line, register), position, own, frame))
                for position, own in sorted(some)
                for frame in sorted((self.frames | self.beside) - {own})
            ]
            reached |= some
        self.last = frozenset(reached)
        if self.are_callers and not motion.register_targets and reached:  # the controller stops with another
            self.frames, self.are_callers = frozenset(own for _, own in reached), False
        self.follow_calls(statement)
        if motion.stored and (stored := match_assignment(Statement(motion.stored, statement.line))):
            self.store(int(stored[1]), stored[3])
        return found

    def store(self, register: int, value: bytes) -> None:
        """Take up that a register gets a whole value."""
        positions, registers = places_named(value)
        some = {(each, self.taught[each]) for each in positions if each in self.taught}
        some |= {each for other in registers for each in self.copies.get(other, ())}
        if _STANDS.search(value) and not self.are_callers:  # in the callers' frame it goes there again, too
            some |= {(each, frame) for each, taught in self.last for frame in self.frames or (taught,)}
            some |= {(START, frame) for frame in self.frames if not self.last}
        self.copies[register] = frozenset(some)

    def _copy_elsewhere(self, use: tuple[int, int], position: int, own: str, other: str) -> ProgramShift:
        """Return what the use of a register, by line and number, does in another frame than the position's own."""
        name = f"PR[{use[1]}]"
        shift = ProgramShift(use[0], name, ShiftAxes.USER_FRAME, quaternion=None)
        if self.selections.is_tool:
            return replace(shift, other_tool=other)
        shift = replace(shift, other_frame=other)
        return replace(shift, point=name if position == START else "", user_frame=own)

    def join(self, others: Sequence["_CopiedFrames"]) -> None:
        """Take up that the program may come here from other statements, too."""
        for other in others:
            self.frames |= other.frames
            for register, some in other.copies.items():
                self.copies[register] = self.copies.get(register, frozenset()) | some


def copies_in_other_frames(
    positions: Positions, data: bytes, external_uses: ExternalUses | None = None
) -> Iterator[tuple[int, ProgramShift]]:
    """Yield the motions to copies of positions (or of START) in another frame or with another tool than their own."""
    if b"PR[" not in data:
        return
    uses = external_uses
    none = frozenset[str]()
    frames = ({}, none, none) if uses is None else (uses.frames_left, uses.frames_before, uses.frames_beside)
    tools = ({}, none, none) if uses is None else (uses.tools_left, uses.tools_before, uses.tools_beside)
    for selections, (left, before, beside) in ((_OF_FRAME, frames), (_OF_TOOL, tools)):
        if selections.any_way.search(data) or before or beside or (left and _CALLED.search(data)):
            column = positions.tools if selections.is_tool else positions.user_frames
            taught = _numbers_taught(positions, column)
            now = _CopiedFrames(selections, taught, left, beside, before, are_callers=bool(before))
            yield from (
                (position, shift)
                for position, shift in _copies_elsewhere(now, data)
                if position != START or not selections.is_tool
            )


def _numbers_taught(positions: Positions, column: Sequence[str | None]) -> dict[int, str]:
    """Return by position the frame or the tool that it was taught with."""
    return {
        int(name[2:-1]): str(int(number))
        for name, number, kind, group in zip(
            positions.names, column, positions.kinds, positions.groups.tolist(), strict=True
        )
        if kind == CARTESIAN and group == 1 and number is not None and number.isdigit()
    }


def _copies_elsewhere(now: _CopiedFrames, data: bytes) -> Iterator[tuple[int, ProgramShift]]:
    statements = list(read_statements(data))
    anywhere = _state_of_all(replace(now, copies={}, frames=frozenset(), are_callers=False), statements)
    visited = set[tuple[int, str, str]]()
    for statement in statements:
        if _JOINED.match(statement.text):
            now.join([anywhere])
        if not statement.is_motion:
            now.follow_statement(statement)
            continue
        for position, shift in now.follow_motion(statement):
            key = (position, shift.what, shift.other_frame or shift.other_tool)
            if key not in visited:
                visited.add(key)
                yield position, shift


def _state_of_all(now: _CopiedFrames, statements: Sequence[Statement]) -> _CopiedFrames:
    """Return all frames that a program chooses, and all that its registers may get, in whatever order."""
    every = replace(now, copies={})
    for statement in statements:
        if not statement.is_motion:
            now.follow_statement(statement)
            every.join([now])
    return every
