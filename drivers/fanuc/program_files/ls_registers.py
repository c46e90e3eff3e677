"""Position registers that a listing uses: as places to go to, and in any other way."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from cellcal.drivers.fanuc.program_files.ls_flow import ways_on
from cellcal.drivers.fanuc.program_files.ls_statements import (
    Statement,
    macro_of,
    motion_of,
    read_statements,
)
from cellcal.drivers.programs.file_declarations import ExternalUses
from cellcal.drivers.programs.positions import CARTESIAN, Positions

UNSURE = "?"
Numbers: TypeAlias = frozenset[str | None]  # of frames or tools; None: what was chosen before the program
_USED = re.compile(rb"PR(?<![A-Z]PR)\[[ \t]*+(?:GP\d[ \t]*+:[ \t]*+)?+(\d{1,5})")
_SETS = re.compile(
    rb"(UFRAME_NUM|BENUTZER_NUM|UTOOL_NUM|WKZ_NUM|MNUFRAMENUM|MNUTOOLNUM)"
    rb"[ \t]*+(?:\[ *+(?:GP *+)?+1 *+\][ \t]*+)?+=[ \t]*+(?:(\d{1,3}+)(?![ \t]*+[-+*/]))?"
)
_FRAME_WORDS = (b"UFRAME_NUM", b"BENUTZER_NUM", b"MNUFRAMENUM")
_CONDITION = re.compile(rb"(?:(?:IF|WENN|SELECT|ELSE|SONST)\b|=)(?:\[[^\]]*+\]|[^,\[])*+,", re.IGNORECASE)
_CALLED = re.compile(rb"\b(?:CALL|AUFRUF)[ \t]++([^\s;(,]{1,80}+)", re.IGNORECASE)
_CHOSEN = re.compile(rb"PR(?<![A-Z]PR)\[[ \t]*+(?:GP\d[ \t]*+:[ \t]*+)?+[A-Za-z]{1,3}+\[")
_STARTS = re.compile(rb"[JLCAS][ \t]++PR\[[ \t]*+(?:GP\d[ \t]*+:[ \t]*+)?+[A-Za-z]{1,3}+\[")


@dataclass(frozen=True, slots=True)
class RegisterUse:
    """One use of a position register."""

    number: int
    line: int  # of the file, from 1
    goes_there: bool  # a motion's target and nothing else: it is a place, not a shift or a value
    user_frame: str | None  # in force there; None where no line sets one, UNSURE where it cannot be told
    tool: str | None


def registers_used(
    data: bytes, positions: Positions | None = None, external_uses: ExternalUses | None = None
) -> tuple[RegisterUse, ...]:
    """Return the uses of PR[n] in a listing, in the order of its lines.

    The frame and the tool are those that may be in force there, by whatever way the program comes to the line. What
    a program that is not given chooses is not sure, until the program chooses again or goes to one of the
    ``positions``: there the frame and the tool are those that it was taught with. Where a program chooses one number
    only, programs that are not given are taken to choose none. ``external_uses`` says what the controller's other
    programs choose.
    """
    statements = list(read_statements(data))
    uses = [list(_USED.finditer(each.text)) for each in statements]
    if not any(uses):
        return ()
    flow = _SelectionFlow(statements, positions, external_uses)
    frames, tools = flow.find_all("frame"), flow.find_all("tool")
    found = []
    for at, statement in enumerate(statements):
        motion_registers = _motion_registers(statement, len(uses[at]))
        for use in uses[at]:
            line = statement.line + statement.text.count(b"\n", 0, use.start())
            found.append(
                RegisterUse(int(use[1]), line, int(use[1]) in motion_registers, frames[at], tools[at])
            )
    return tuple(found)


def indirect_line(data: bytes) -> int:
    """Return a line in which a register chooses the PR that is used otherwise than gone to; 0 where none does."""
    for statement in read_statements(data):
        if found := _CHOSEN.search(statement.text):
            goes_there = (
                statement.is_motion and _STARTS.match(statement.text) and motion_of(statement).is_place
            )
            if not goes_there or _CHOSEN.search(statement.text, found.end()):
                return statement.line
    return 0


def frames_in_force(
    data: bytes, positions: Positions, external_uses: ExternalUses | None
) -> dict[int, str | None]:
    """Return by the line of each statement the user frame in force, None where it cannot be told, as above."""
    statements = list(read_statements(data))
    frames = _SelectionFlow(statements, positions, external_uses).find_all("frame")
    return {
        each.line: None if frame == UNSURE else frame for each, frame in zip(statements, frames, strict=True)
    }


def _motion_registers(statement: Statement, use_count: int) -> tuple[int, ...]:
    """Return the registers that a statement goes to and uses no others beside: none of an increment or a shift."""
    if not (use_count and statement.is_motion):
        return ()
    motion = motion_of(statement)
    is_place = motion.is_place and not motion.tool_offset and use_count == len(motion.register_targets)
    return motion.register_targets if is_place else ()


class _Change(NamedTuple):
    """The effect of a statement on the frame or the tool in force."""

    chosen: Numbers
    conditional: bool
    left: Numbers  # by programs that it calls
    is_open: bool  # it calls a program that may choose any
    taught: str | None  # it goes to a position that was taught with this one

    def arriving(self, before: Numbers) -> Numbers:
        """Return what may be in force while the statement runs."""
        possible = before & {self.taught, None, UNSURE} if self.taught is not None else None
        return frozenset([self.taught]) if possible else before

    def leaving(self, before: Numbers, after_call: str) -> Numbers:
        """Return what may be in force behind it; ``after_call`` is what a program that may choose any leaves."""
        now = self.arriving(before)
        if self.chosen:
            now = now | self.chosen if self.conditional else self.chosen
        return now | self.left | ({after_call} if self.is_open and after_call else set())


@dataclass(frozen=True)
class _SelectionFlow:
    """The frames and tools that may be in force at each statement."""

    statements: Sequence[Statement]
    positions: Positions | None
    external_uses: ExternalUses | None

    def find_all(self, which: str) -> list[str | None]:
        """Return the one number in force at each statement, None for that of before the program, or UNSURE."""
        taught = self._numbers_taught(which)
        changes = [self._change_at(which, each, taught) for each in self.statements]
        if not any(change.chosen or change.taught for change in changes):
            return [None] * len(self.statements)
        numbers = {each for change in changes for each in change.chosen}
        before = self._follow_ways(changes, UNSURE if len(numbers) > 1 or UNSURE in numbers else "")
        arriving = [change.arriving(some) for change, some in zip(changes, before, strict=True)]
        return [next(iter(some)) if len(some) == 1 else UNSURE for some in arriving]

    def _follow_ways(self, changes: Sequence["_Change"], after_call: str) -> list[Numbers]:
        """Return what may be in force before each statement; ``after_call`` is what an open call leaves."""
        ways = ways_on(self.statements)
        before = [frozenset[str | None]() for _ in self.statements]
        for first in range(len(before)):
            if before[first]:
                continue
            before[first] = frozenset([UNSURE if first else None])  # no way is seen that comes there
            open_ = [first]
            while open_:
                at = open_.pop()
                behind_call = changes[at].leaving(before[at], after_call)
                for goal in ways[at] - {len(before)}:
                    if not behind_call <= before[goal]:
                        before[goal] |= behind_call
                        open_.append(goal)
        return before

    def _change_at(self, which: str, statement: Statement, taught: Mapping[int, str]) -> "_Change":
        """Return what a statement does to the frame or the tool in force."""
        text, condition = statement.text, b""
        targets = motion_of(statement).targets if taught and statement.is_motion else ()
        if (behind := _CONDITION.match(text)) is not None:
            condition, text = behind[0], text[behind.end() :]
        settings = [
            found for found in _SETS.finditer(text) if (found[1] in _FRAME_WORDS) is (which == "frame")
        ]
        chosen = [str(int(found[2])) if found[2] else UNSURE for found in settings]
        calls = [name.decode("cp437").upper() for name in _CALLED.findall(text)]
        set_numbers = {number for name in calls for number in self._left_by(which, name)}
        is_open = bool(macro_of(statement)) or any(which == "tool" or self._is_open(name) for name in calls)
        return _Change(
            frozenset(chosen[-1:]),
            bool(condition),
            frozenset(set_numbers),
            is_open,
            taught.get(targets[-1]) if targets else None,
        )

    def _left_by(self, which: str, name: str) -> Numbers:
        """Return what a program that is given may have chosen when it ends."""
        if self.external_uses is None or which == "tool":
            return frozenset()
        numbers = self.external_uses.frames_left.get(name, frozenset[str]())
        return frozenset(number if number.isdigit() else UNSURE for number in numbers)

    def _is_open(self, name: str) -> bool:
        uses = self.external_uses
        return uses is None or name not in uses.given or name in uses.open_calls

    def _numbers_taught(self, which: str) -> dict[int, str]:
        """Return with what each position was taught: the controller stops at a motion to it with any other."""
        if self.positions is None:
            return {}
        positions = self.positions
        numbers = positions.user_frames if which == "frame" else positions.tools
        rows = zip(positions.names, positions.kinds, numbers, positions.groups.tolist(), strict=True)
        return {
            int(name[2:-1]): number
            for name, kind, number, group in rows
            if kind == CARTESIAN and group == 1 and number is not None and number.isdigit()
        }
