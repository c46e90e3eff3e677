"""KUKA programs (.src): points written into motion statements, and what changes points while the program runs."""

import re
from dataclasses import dataclass, field

from calibration.geometry import Pose
from drivers.kuka.collected import Collected
from drivers.kuka.data_list import remark_comment, remark_hidden_positions
from drivers.kuka.lines import Item, Line, declaration, item, lines, without_strings
from drivers.kuka.literals import Literal
from drivers.programs.positions import CARTESIAN, Frames
from drivers.programs.spans import Source

_B = r"[ \t\r]"
_MOTION = re.compile(
    rf"{_B}*+(PTP|LIN|CIRC|SPTP|SLIN|SCIRC|SPL)(_REL)?+(?![\w$.=\[(]){_B}*+(?!=)", re.ASCII | re.IGNORECASE
)
_WITH = re.compile(r"\bWITH\b", re.IGNORECASE)
_ROUTINE = re.compile(
    rf"{_B}*+(?:GLOBAL{_B}++)?+(?:DEF|DEFFCT{_B}++\w++)\b{_B}*+(\w*+)", re.ASCII | re.IGNORECASE
)
_STEP_INTO = re.compile(rf"{_B}*+([A-Za-z_]\w*+){_B}*+\(", re.ASCII)
_BAS = re.compile(
    rf"\bBAS{_B}*+\({_B}*+#(TOOL|BASE|PTP_PARAMS|CP_PARAMS|FRAMES|INITMOV){_B}*+,?+{_B}*+([^)]*+)",
    re.IGNORECASE,
)
_FRAME_SET = re.compile(rf"(?<![\w.])\$(TOOL|BASE|IPO_MODE)\b({_B}*+\.)?+{_B}*+=(?!=){_B}*+", re.IGNORECASE)
_FROM_TABLE = re.compile(rf"(?:TOOL|BASE)_DATA{_B}*+\[{_B}*+(\d++){_B}*+\]{_B}*+", re.IGNORECASE)
_NULL = re.compile(rf"\$NULLFRAME{_B}*+", re.IGNORECASE)
_COMPONENT = re.compile(
    rf"{_B}*+[$A-Za-z_][\w$]*+(?:{_B}*+\[[^\[\]\n]*+\])?+{_B}*+\.{_B}*+(?:[XYZABC]|A[1-6]|E[1-6]){_B}*+=(?!=)",
    re.ASCII | re.IGNORECASE,
)
_CALLED = re.compile(rf"[$A-Za-z_][\w$]*+{_B}*+\(", re.ASCII)
_POINT_VALUE = re.compile(r":|\$POS_|\$AXIS_|\bINVERSE\b|\bFORWARD\b", re.IGNORECASE)
_MOST_TARGETS = 3  # a circle has two
_UNKNOWN = "?"
_BARRED = {
    "several": "the program sets another tool or base for it at different places",
    "computed": "its tool or base is set while the program runs",
    "called": "a routine that its program calls sets another tool or base",
}
_SET_BY_POINTS = frozenset(("PTP_PARAMS", "CP_PARAMS", "FRAMES"))

_OFFSET = "The operator ':' adds a frame to this point while the program runs."
_RELATIVE = "A relative move: it goes on from where the robot is, and stays as it is."
_CALL = "The target of this move is computed."
_ASSIGNED = "{} is set while the program runs; that value is not read."
_FRAME_SET_TEXT = "${} is set while the program runs; points written into moves are in it."
_EXTERNAL_TEXT = (
    "$IPO_MODE is set here: with #TCP, the tool stands in the cell, and the points are not changed."
)


@dataclass
class FrameUse:
    """What a routine sets ``$TOOL`` or ``$BASE`` to, and where first."""

    values: set[str] = field(default_factory=set)
    first: int = -1

    def take(self, place: int, value: str) -> None:
        """Note a value."""
        self.first = place if self.first < 0 else self.first
        self.values.add(value)

    def at(self, place: int) -> str | None:
        """Return what is set at a place: known only where the routine sets one thing, and before."""
        if len(self.values) != 1 or self.first > place:
            return None
        (value,) = self.values
        return None if value == _UNKNOWN else value

    def barred(self, called: set[str]) -> str:
        """Return why nobody can tell what holds, with what called routines set; "" where nothing is in the way."""
        if called - self.values:
            return _BARRED["called"]
        if _UNKNOWN in self.values:
            return _BARRED["computed"]
        return _BARRED["several"] if len(self.values) > 1 else ""


@dataclass
class Routine:
    """One DEF ... END."""

    number: int
    name: str = ""
    calls: set[str] = field(default_factory=set)
    tool: FrameUse = field(default_factory=FrameUse)
    base: FrameUse = field(default_factory=FrameUse)


@dataclass
class Program:
    """A program while it is read."""

    found: Collected
    routines: list[Routine] = field(default_factory=lambda: [Routine(0)])
    rows: list[tuple[int, int, bool]] = field(
        default_factory=list
    )  # row, routine, frames known from the routine
    types: dict[str, str] = field(default_factory=dict)
    set_frames: dict[str, list[Pose | None]] = field(default_factory=lambda: {"TOOL": [], "BASE": []})
    external_tool: bool = False
    called: dict[int, list[Routine]] = field(default_factory=dict)  # by a routine's number, when all is read

    def read(self, line: Line) -> None:
        """Take one line."""
        text = self.found.source.text
        begun = _ROUTINE.match(text, line.start, line.end)
        if begun is not None:
            self.routines.append(Routine(len(self.routines), begun[1].upper()))
        motion = _MOTION.match(text, line.start, line.end)
        if motion is not None:
            self._motion(motion, line)
        else:
            self._statement(line)
        remark_comment(self.found, line)

    def finish(self) -> None:
        """Give points their tool and base."""
        names = {which: self._name_of_set(which) for which in ("TOOL", "BASE")}
        for row, number, known in self.rows:
            place = self.found.starts[row]
            if self.external_tool and self.found.kinds[row] == CARTESIAN:
                self.found.forget(row, "the program works with an external tool ($IPO_MODE)")
            elif known:
                routine = self.routines[number]
                self.found.tools[row] = _resolved(routine.tool.at(place), names["TOOL"])
                self.found.user_frames[row] = _resolved(routine.base.at(place), names["BASE"])
                self._bar(row, routine)
            elif self.found.names[row].find("@") > 0:
                self.found.barred[row] = _BARRED["computed"]

    def _bar(self, row: int, routine: Routine) -> None:
        """Leave a point whose tool or base cannot be told from this file, though it is set here."""
        if routine.number not in self.called:
            self.called[routine.number] = self._called(routine)
        called = self.called[routine.number]
        uses = [(routine.tool, {v for one in called for v in one.tool.values})]
        if self.found.kinds[row] == CARTESIAN:
            uses.append((routine.base, {v for one in called for v in one.base.values}))
        for use, values in uses:
            if why := use.barred(values):
                self.found.barred[row] = why

    def _called(self, routine: Routine) -> list[Routine]:
        """Return the routines of this file that a routine calls, and those that they call."""
        by_name = {one.name: one for one in self.routines if one.name}
        found: dict[str, Routine] = {}
        open_ = [routine]
        while open_:
            for name in sorted(open_.pop().calls & by_name.keys() - found.keys()):
                found[name] = by_name[name]
                open_.append(by_name[name])
        return list(found.values())

    def frames(self) -> Frames:
        """Return ``$BASE`` and ``$TOOL`` where the program writes them once, as numbers."""
        poses = {which: {"0": Pose((0.0, 0.0, 0.0))} for which in ("TOOL", "BASE")}
        for which, given in self.set_frames.items():
            if len(given) == 1 and given[0] is not None:
                poses[which][f"${which}"] = given[0]
        return Frames(base_frame=poses["BASE"], flange_tip=poses["TOOL"])

    def _name_of_set(self, which: str) -> str | None:
        given = self.set_frames[which]
        return f"${which}" if len(given) == 1 and given[0] is not None else None

    def _motion(self, motion: re.Match[str], line: Line) -> None:
        if motion[2]:
            self.found.remark(line.start, "relative", _RELATIVE)
            return
        text = self.found.source.text
        code = without_strings(text[motion.end() : line.end])
        cut = _WITH.search(code)
        own_frames = cut is not None and _FRAME_SET.search(code, cut.end()) is not None
        code = code[: cut.start()] if cut else code
        begin, end = motion.end(), motion.end() + len(code)
        place, part = begin, 0
        for _ in range(_MOST_TARGETS):
            if place >= end:
                return
            if text[place] == "{":
                literal = self.found.literal(place, end)
                if literal is None:
                    return
                part += 1
                place = self._target(motion[1].upper(), part, literal, end, known=not own_frames)
            else:
                place = begin + self._named(code, place - begin, begin)
            if place >= end or text[place] != ",":
                return
            place = _skip_blanks(text, place + 1, end)

    def _target(self, keyword: str, part: int, literal: Literal, end: int, *, known: bool) -> int:
        """Take a position written into a move; return where what follows begins."""
        text = self.found.source.text
        after = _skip_blanks(text, literal.end, end)
        if text[after:end][:1] == ":":
            self.found.remark(literal.start, "offset", _OFFSET)
            return end
        if after < end and after == literal.end and text[after] != ",":
            raise self.found.source.error(after, "after a position, a blank or a comma should stand.")
        name = f"{keyword}@{self.found.source.line_of(literal.start)}" + (f".{part}" if part > 1 else "")
        self._add(name, literal, known=known)
        return after

    def _named(self, code: str, place: int, begin: int) -> int:
        """Pass a target that is named or computed; return where it ends, all of the rest for a computed one."""
        comma = code.find(",", place)
        comma = len(code) if comma < 0 else comma
        target = code[place:comma]
        if ":" in target:
            self.found.remark(begin + place, "offset", _OFFSET)
        elif _CALLED.match(target):
            self.found.remark(begin + place, "computed", _CALL)
        else:
            return comma
        return len(code)

    def _add(self, name: str, literal: Literal, *, known: bool) -> None:
        self.rows.append((len(self.found.names), len(self.routines) - 1, known))
        self.found.add(name, literal)

    def _statement(self, line: Line) -> None:
        text = self.found.source.text
        code = without_strings(text[line.start : line.end])
        if (step := _STEP_INTO.match(code)) is not None:
            self.routines[-1].calls.add(step[1].upper())
        declared = declaration(text, line)
        if declared is not None:
            self._declared(declared[0], declared[1], line)
            return
        bas = _BAS.search(code)
        if bas is not None:
            self._bas(line.start + bas.start(), bas[1].upper(), bas[2].strip())
        elif (frame := _FRAME_SET.search(code)) is not None:
            self._frame_set(frame, line)
        elif _COMPONENT.match(code):
            self.found.remark(line.start, "computed", _ASSIGNED.format(code.partition("=")[0].strip()))
        else:
            self._assignment(line)

    def _declared(self, kind: str, place: int, line: Line) -> None:
        name = item(self.found.source.text, place, line.end)
        while name is not None:
            self.types[name.name.upper()] = kind
            if name.value is not None or name.end >= line.end:
                break
            name = item(self.found.source.text, name.end, line.end)
        if name is not None and name.value is not None:
            self._value(name, line)

    def _bas(self, place: int, command: str, argument: str) -> None:
        routine = self.routines[-1]
        if command in _SET_BY_POINTS:  # taken from the point's own data, which is not in this file
            routine.tool.take(place, _UNKNOWN)
            routine.base.take(place, _UNKNOWN)
        elif command != "INITMOV":
            use = routine.tool if command == "TOOL" else routine.base
            use.take(place, argument if argument.isdigit() else _UNKNOWN)

    def _frame_set(self, frame: re.Match[str], line: Line) -> None:
        text, place = self.found.source.text, line.start + frame.end()
        which = frame[1].upper()
        if which == "IPO_MODE":
            self.external_tool |= "#TCP" in text[place : line.end].upper()
            self.found.remark(line.start, "foreign", _EXTERNAL_TEXT)
            return
        routine = self.routines[-1]
        (routine.tool if which == "TOOL" else routine.base).take(place, self._frame_value(which, frame, line))
        self.found.remark(line.start, "computed", _FRAME_SET_TEXT.format(which))

    def _frame_value(self, which: str, frame: re.Match[str], line: Line) -> str:
        """Return the number of a tool or base, ``$`` for one written out here, or that it is not known."""
        text, place = self.found.source.text, line.start + frame.end()
        table = _FROM_TABLE.fullmatch(text, place, line.end)
        if table is not None and not frame[2]:
            return table[1]
        if _NULL.fullmatch(text, place, line.end) and not frame[2]:
            return "0"
        literal = self.found.literal(place, line.end) if text[place : line.end][:1] == "{" else None
        alone = literal is not None and not text[literal.end : line.end].strip()
        pose = self.found.pose(literal) if literal is not None and alone else None
        self.set_frames[which].append(pose)
        return "$" if pose is not None else _UNKNOWN

    def _assignment(self, line: Line) -> None:
        text = self.found.source.text
        name = item(text, line.start, line.end)
        if name is not None and name.value is not None:
            self._value(name, line)
        else:
            remark_hidden_positions(self.found, line, line.start)

    def _value(self, name: Item, line: Line) -> None:
        source = self.found.source
        kind = self.types.get(name.name.upper(), "")
        value = without_strings(source.text[name.value : line.end])
        if not value.startswith("{"):
            if kind or _POINT_VALUE.search(value):
                self.found.remark(line.start, "computed", _ASSIGNED.format(name.full))
            else:
                remark_hidden_positions(self.found, line, line.start)
            return
        if "{" in value[1:] or ":" in value.partition("}")[2] or not _POINT_STRUCT.match(value):
            remark_hidden_positions(self.found, line, line.start)
            return
        literal = self.found.literal(name.value or 0, line.end)
        if literal is None:
            return
        if not literal.axes and (kind == "FRAME" or literal.type == "FRAME" or not any(literal.state)):
            self.found.remark(line.start, "computed", _ASSIGNED.format(name.full))
        else:
            self._add(name.full, literal, known=False)


_POINT_STRUCT = re.compile(r"\{[^{}]*?(?:\b[XYZABC]|\bA[1-6])[ \t]+[-+.\d]", re.IGNORECASE)


def read_program(source: Source) -> Program:
    """Read a program."""
    program = Program(Collected(source))
    for line in lines(source.text):
        program.read(line)
    program.finish()
    return program


def _resolved(value: str | None, name_of_set: str | None) -> str | None:
    return name_of_set if value == "$" else value


def _skip_blanks(text: str, place: int, end: int) -> int:
    while place < end and text[place] in " \t\r":
        place += 1
    return place
