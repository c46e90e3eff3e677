"""Copies of positions that a motion goes to while another user frame is in force.

A register holds numbers without a frame: a motion to it takes them in the frame that is in force. Where that is not
the frame of the position that was copied, the motion does not go to the position, and no change of the position's
numbers brings it where it belongs.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from cellcal.drivers.fanuc.program_files.ls_computed import match_assignment, places_named
from cellcal.drivers.fanuc.program_files.ls_statements import Statement, motion_of, read_statements
from cellcal.drivers.programs.file_declarations import ExternalUses
from cellcal.drivers.programs.positions import CARTESIAN, Positions
from cellcal.drivers.programs.shifts import UNKNOWN_FRAME, ProgramShift, ShiftAxes

_SELECTED = re.compile(
    rb"\A(?:UFRAME_NUM|BENUTZER_NUM|\$MNUFRAMENUM)[ \t]*+(?:\[ *+(?:GP *+)?+1 *+\][ \t]*+)?+=[ \t]*+(\d{1,5}+)"
)
_SELECTION = re.compile(rb"\b(?:UFRAME_NUM|BENUTZER_NUM)\b|MNUFRAMENUM", re.IGNORECASE)
# Statements that the program may come to from elsewhere than from the line above.
_JOINED = re.compile(rb"(?:LBL|MARKE|FOR|ENDFOR|WHILE|ENDWHILE|ELSE|ELSEIF|ENDIF)\b")
_CALLED = re.compile(rb"\b(?:CALL|AUFRUF)[ \t]++([^\s;(,]{1,80}+)", re.IGNORECASE)
_STANDS = re.compile(rb"\bLPOS\b")
START = 0  # in place of a position: where the robot was before any
Copies = frozenset[tuple[int, str]]  # positions, and the user frame whose numbers a register has


@dataclass
class _CopiedFrames:
    """What registers hold, and which user frame is in force, statement by statement."""

    taught: Mapping[int, str]  # by position
    frames_left: Mapping[str, frozenset[str]]  # by program that may be called: the frames that it chooses
    frames: frozenset[str] = frozenset()  # that may be in force; none: what was chosen before the program
    copies: dict[int, Copies] = field(default_factory=dict)
    last: Copies = frozenset()  # where the robot stands

    def follow_statement(self, statement: Statement) -> None:
        """Take up a statement that is no motion."""
        if _SELECTION.search(statement.text):
            chosen = _SELECTED.fullmatch(statement.text)
            self.frames = frozenset([str(int(chosen[1])) if chosen else UNKNOWN_FRAME])
        self.follow_calls(statement)
        assigned = match_assignment(statement)
        if assigned is not None and not assigned[2]:
            self.store(int(assigned[1]), assigned[3])

    def follow_calls(self, statement: Statement) -> None:
        """Take up the frames that called programs choose: one that is chosen stays when its program has ended."""
        for name in _CALLED.findall(statement.text) if self.frames_left else ():
            left = self.frames_left.get(name.decode("cp437").upper(), frozenset[str]())
            self.frames |= left

    def follow_motion(self, statement: Statement) -> list[tuple[int, ProgramShift]]:
        """Take up a motion; return, by position, those of its registers that another frame holds for."""
        motion = motion_of(statement)
        found: list[tuple[int, ProgramShift]] = []
        reached = {(each, self.taught[each]) for each in motion.targets[-1:] if each in self.taught}
        for register in motion.register_targets:
            some = self.copies.get(register, frozenset())
            found += [
                (position, _copy_elsewhere((statement.line, register), position, own, frame))
                for position, own in sorted(some)
                for frame in sorted(self.frames - {own})
            ]
            reached |= some
        self.last = frozenset(reached)
        self.follow_calls(statement)
        if motion.stored and (stored := match_assignment(Statement(motion.stored, statement.line))):
            self.store(int(stored[1]), stored[3])
        return found

    def store(self, register: int, value: bytes) -> None:
        """Take up that a register gets a whole value."""
        positions, registers = places_named(value)
        some = {(each, self.taught[each]) for each in positions if each in self.taught}
        some |= {each for other in registers for each in self.copies.get(other, ())}
        if _STANDS.search(value):
            some |= {(each, frame) for each, taught in self.last for frame in self.frames or (taught,)}
            some |= {(START, frame) for frame in self.frames if not self.last}
        self.copies[register] = frozenset(some)

    def join(self, others: Sequence["_CopiedFrames"]) -> None:
        """Take up that the program may come here from other statements, too."""
        for other in others:
            self.frames |= other.frames
            for register, some in other.copies.items():
                self.copies[register] = self.copies.get(register, frozenset()) | some


def copies_in_other_frames(
    positions: Positions, data: bytes, external_uses: ExternalUses | None = None
) -> Iterator[tuple[int, ProgramShift]]:
    """Yield, by position (or START), the motions to its copy in another user frame than its own."""
    frames_left = {} if external_uses is None else external_uses.frames_left
    if not (_SELECTION.search(data) or (frames_left and _CALLED.search(data))):
        return
    taught = {
        int(name[2:-1]): str(int(frame))
        for name, frame, kind, group in zip(
            positions.names, positions.user_frames, positions.kinds, positions.groups.tolist(), strict=True
        )
        if kind == CARTESIAN and group == 1 and frame is not None and frame.isdigit()
    }
    statements = list(read_statements(data))
    anywhere = _state_of_all(_CopiedFrames(taught, frames_left), statements)
    now, seen = _CopiedFrames(taught, frames_left), set[tuple[int, str, str]]()
    for statement in statements:
        if _JOINED.match(statement.text):
            now.join([anywhere])
        if not statement.is_motion:
            now.follow_statement(statement)
            continue
        for position, shift in now.follow_motion(statement):
            key = (position, shift.what, shift.other_frame)
            if key not in seen:
                seen.add(key)
                yield position, shift


def _copy_elsewhere(use: tuple[int, int], position: int, own: str, frame: str) -> ProgramShift:
    """Return what the use of a register, by line and number, does in another frame than the position's own."""
    name = f"PR[{use[1]}]"
    shift = ProgramShift(use[0], name, ShiftAxes.USER_FRAME, quaternion=None, other_frame=frame)
    return replace(shift, point=name, user_frame=own) if position == START else shift


def _state_of_all(now: _CopiedFrames, statements: Sequence[Statement]) -> _CopiedFrames:
    """Return all frames that a program chooses, and all that its registers may get, in whatever order."""
    every = _CopiedFrames(now.taught, now.frames_left)
    for statement in statements:
        if not statement.is_motion:
            now.follow_statement(statement)
            every.join([now])
    return every
