"""The statements of a listing one by one: motions with their targets and options, and assignments of registers.

Nothing is executed. A statement ends at its semicolon and may go on over several lines.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from cellcal.drivers.fanuc.program_files.ls_remarks import statements_of

# Words alone are a macro, whose program only the controller's table names; those behind are statements.
MACRO_WORDS = rb"[A-Za-z]\w*+(?:[ \t]++\w++)*+"
MACRO_ARGUMENTS = rb"(?:\([^;\n]*\)[ \t]*+)?+"
NO_MACRO = re.compile(
    rb"(?:IF|WENN|WHILE|SELECT|TC_ONLINE|END|ENDE|ABORT|PAUSE|ELSE|ENDIF|ENDFOR|CONTINUE|COL|SOFTFLOAT|CLEAR_RESUME_PROG|LOCK|UNLOCK|MONITOR|CALL|AUFRUF|RUN"
    rb"|Weave|Track|Arc|WAIT|WARTEN|(?i:Search[ \t]++(?:Start|End)|Touch[ \t]++Offset|Weld[ \t]++(?:Start|End)))\b"
)
# Words that let a program run beside this one, or when an alarm has stopped it; and what stands before its name.
BESIDE_WORDS = rb"RUN|MONITOR|(?:RESUME|ERROR|MAINT)_PROG"
BEFORE_NAME = rb"(?:[ \t]*+(?:\[[^\]\n]*+\][ \t]*+)?+=[ \t]*+|[ \t]++(?!END\b))"
_MACRO = re.compile(rb"(" + MACRO_WORDS + rb")[ \t]*+" + MACRO_ARGUMENTS)
_START = re.compile(rb"\s*+(?:/MN\b[^\n]*+\n\s*+)?(?:\d++[ \t]*+)?(?::[ \t]*+)?")
_LOCAL = re.compile(
    rb"(?<![A-Za-z])LPR\[ *+(\d++)"
)  # a register of the program alone: which place, is not known
_MOTION = re.compile(rb"[JLCAS][ \t]++PR?\[")
_TARGET = re.compile(rb"P(?<![A-Za-z]P)\[ *+(?:(\d{1,5}+)|[A-Za-z])")
_GOES_TO_REGISTER = re.compile(rb"(?:^[JLCAS][ \t]++|:[ \t]*+)PR\[ *+(?:GP\d *+: *+)?+(\d{1,5}+|[A-Za-z])")
_CALLED = re.compile(rb"\b(?:CALL|AUFRUF|RUN)[ \t]++[^\s;,(]++(?:\([^;)]*+\))?")
_SKIP = re.compile(rb"\bSkip\b[^;]*?(?:PR\[[^\]]*+\] *= *[A-Z]PO[SN]\b|$)", re.I)
_STORED = re.compile(rb"PR\[[^\]]*+\] *+= *+[A-Z]PO[SN]\b", re.I)
_SEARCH = re.compile(rb"\bSearch[ \t]*+\[[^\]]{0,20}+\]", re.I)
_TOOL_OFFSET = re.compile(
    rb"\bTOOL_OFFSET\b(?:[ \t]*+,[ \t]*+PR\[[^\]]*+\](?:[ \t]*+,[ \t]*+UTOOL\[[^\]]*+\])?)?", re.I
)
_OFFSET = re.compile(rb"(?<![A-Za-z_])OFFSET\b(?:[ \t]*+,[ \t]*+PR\[ *+(?:GP\d *+: *+)?+(\d{1,5}+)?)?", re.I)
_REGISTER = re.compile(rb"PR(?<![A-Z]PR)\[ *+(?:GP\d *+: *+)?+(\d{1,5}+)?")
_CONDITION = re.compile(
    rb"(?:TOOL_)?+OFFSET[ \t]++[A-Z]{4,14}[ \t]++PR\[ *+(?:GP\d *+: *+)?+(\d{1,5}+)", re.I
)
_RELATIVE = re.compile(rb"(?<![A-Za-z_])INC(?:REMENTAL)?\b", re.I)
_LED = re.compile(rb"(?<![A-Za-z_])COORD\b(?:\[[^\]]*+\])?", re.I)
_STANDING_TOOL = re.compile(rb"(?<![A-Za-z_])RTCP\b", re.I)
_CAMERA = re.compile(rb"(?<![A-Za-z_])VOFFSET\b|VR(?<![A-Z]VR)\[", re.I)


@dataclass(frozen=True, slots=True)
class Statement:
    """One statement without its number, and where it stands."""

    text: bytes
    line: int  # of the file, from 1

    @property
    def is_motion(self) -> bool:
        """Return whether it is a motion."""
        return _MOTION.match(self.text) is not None


@dataclass(frozen=True, slots=True)
class MotionStatement:
    """The target of one motion, and the effect of its options on it."""

    line: int
    targets: tuple[int, ...]  # numbers of positions
    any_target: bool  # a register chooses a position
    register_targets: tuple[int, ...]
    any_register: bool  # a register chooses the register
    relative: str  # the option that makes the target an increment, "" where none does
    led: str  # the option by which another group leads the motion
    standing_tool: str  # the option for a tool that stands in the cell
    camera: str
    offset: bool  # a register shifts the motion along the axes of a frame
    tool_offset: bool  # a register shifts it along the axes of the tool
    shifting: tuple[int, ...]  # registers that shift the motion along axes of a frame or of the tool
    offset_registers: tuple[int, ...]  # those of them that shift it along axes of a frame
    search: str  # the option that lets it search along an axis of a frame of the touch sensor
    stored: bytes  # the assignment by which the option Skip stores where the robot is stopped

    @property
    def is_place(self) -> bool:
        """Return whether the robot goes to the target as it stands."""
        return not (self.relative or self.led or self.standing_tool or self.camera or self.offset)


def before_positions(data: bytes) -> bytes:
    """Return a listing up to its positions, often its larger part: none of them holds a statement to be found."""
    end = data.rfind(b"/POS")
    return data[:end] if end > max(data.find(b"/MN"), 0) else data


def read_statements(data: bytes) -> Iterator[Statement]:
    """Yield the statements of a listing; comments, remarks and disabled lines are blank."""
    line, text = statements_of(data)
    text = _LOCAL.sub(rb"PR[R[\1]", text)  # as one that a number chooses
    for piece in text.split(b";"):
        start = _START.match(piece)
        begin = start.end() if start else 0
        body = piece[begin:].strip()
        if body:
            yield Statement(body, line + piece.count(b"\n", 0, begin))
        line += piece.count(b"\n")


def motion_of(statement: Statement) -> MotionStatement:
    """Return what a motion goes to."""
    text = _SKIP.sub(b" ", _CALLED.sub(b" ", statement.text))
    registers = [found[1] for found in _GOES_TO_REGISTER.finditer(text)]
    rest = _GOES_TO_REGISTER.sub(b" ", text)
    along_tool = b" ".join(found[0] for found in _TOOL_OFFSET.finditer(rest))
    rest = _TOOL_OFFSET.sub(b" ", rest)
    targets = [found[1] for found in _TARGET.finditer(text)]
    skip = _SKIP.search(statement.text)
    stored = None if skip is None else _STORED.search(skip[0])
    of_frame, of_tool = (
        [int(found[1]) for found in _REGISTER.finditer(part) if found[1]] for part in (rest, along_tool)
    )
    # another register on the line shifts the motion, in whatever language the option is printed
    offset = _OFFSET.search(rest) is not None or _REGISTER.search(rest) is not None
    return MotionStatement(
        statement.line,
        targets=tuple(int(number) for number in targets if number),
        any_target=None in targets,
        register_targets=tuple(int(number) for number in registers if number.isdigit()),
        any_register=any(not number.isdigit() for number in registers),
        relative=_match_word(_RELATIVE, rest),
        led=_match_word(_LED, rest),
        standing_tool=_match_word(_STANDING_TOOL, rest),
        camera=_match_word(_CAMERA, rest),
        offset=offset,
        tool_offset=bool(along_tool),
        shifting=(*of_frame, *of_tool),
        offset_registers=tuple(of_frame),
        search=_match_word(_SEARCH, rest),
        stored=stored[0] if stored else b"",
    )


def macro_of(statement: Statement) -> str:
    """Return the name of the macro that a statement is, "" where it is none."""
    found = _MACRO.fullmatch(statement.text)
    return found[1].decode("cp437") if found is not None and NO_MACRO.match(statement.text) is None else ""


def condition_of(statement: Statement, *, tool: bool = True) -> tuple[int, ...]:
    """Return the registers that a condition makes the shift of motions below it, along the tool's axes or not."""
    found = _CONDITION.match(statement.text)
    return (int(found[1]),) if found and (tool or found[0][:1] not in b"Tt") else ()


def _match_word(pattern: re.Pattern[bytes], text: bytes) -> str:
    found = pattern.search(text)
    return found[0].rstrip(b"[").decode("cp437") if found else ""
