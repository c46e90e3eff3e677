"""Motion statements of KUKA programs: targets that are written out, named or computed."""

import re
from dataclasses import dataclass, field

from cellcal.calibration.message import make_message
from cellcal.drivers.kuka.program_files import patterns
from cellcal.drivers.kuka.program_files.collected_positions import INSIDE, KrlPositions
from cellcal.drivers.kuka.program_files.found_shifts import ShiftNotes
from cellcal.drivers.kuka.program_files.frame_data import FramesInForce, data_taken
from cellcal.drivers.kuka.program_files.frame_uses import (
    BARRED,
    UNKNOWN,
    Branches,
)
from cellcal.drivers.kuka.program_files.lines import (
    KrlLine,
    point_key,
    skip_blanks,
    without_field_names,
    without_strings,
)
from cellcal.drivers.kuka.program_files.literals import KrlLiteral
from cellcal.drivers.kuka.program_files.passed_points import (
    call_of,
    calls_of,
    first_filled_argument,
    is_by_value,
)
from cellcal.drivers.kuka.program_files.point_uses import PointMove, PointUses
from cellcal.drivers.kuka.program_files.table_settings import TableSettings
from cellcal.drivers.programs.barred import OVERWRITTEN
from cellcal.drivers.programs.guided_motions import guided_motion


@dataclass
class KrlMotions:
    """The motions of a program while it is read."""

    found: KrlPositions
    points: PointUses
    shifts: ShiftNotes
    branches: Branches = ()
    force: FramesInForce = field(default_factory=FramesInForce)  # of the moves that are read next
    types: dict[str, str] = field(default_factory=dict)
    tables: TableSettings = field(default_factory=TableSettings)

    def take_motion(self, motion: re.Match[str], line: KrlLine) -> None:
        """Take a motion statement: its targets, and the frame data that it states itself."""
        self.points.routines[-1].moves = True
        text = self.found.source.text
        code = without_strings(text[motion.end() : line.end])
        if motion[2]:
            self._take_relative(motion, code, line)
            return
        cut = patterns.WITH.search(code)
        own = "" if cut is None else code[cut.end() :]
        own_frames = patterns.FRAME_SET.search(own) is not None
        code = code[: cut.start()] if cut else code
        if "(" in code or patterns.CALLED_IN_WITH.search(own):
            self.take_calls(code + patterns.READING_CALL.sub(" ", own), line)
        begin, end = motion.end(), motion.end() + len(code)
        place, part = begin, 0
        for _ in range(patterns.MOST_TARGETS):
            if place >= end:
                return
            if text[place] == "{":
                literal = self.found.read_literal(place, end)
                if literal is None:
                    self._note_unread(motion[1], place, line, self.found.why_unread(place, end))
                    return
                part += 1
                place = self._take_target(motion[1].upper(), part, literal, end, is_constant=not own_frames)
            else:
                place = begin + self._pass_named(code, place - begin, begin, own if own_frames else "")
            if place >= end or text[place] != "," or patterns.CIRCULAR_ANGLE.match(text, place, end):
                return
            place = skip_blanks(text, place + 1, end)

    def _take_relative(self, motion: re.Match[str], code: str, line: KrlLine) -> None:
        """Take a relative move: it goes along with the work only as far as its axes do."""
        self.found.add_remark(line.start, "relative", patterns.RELATIVE)
        word = motion[1] + motion[2]
        structs = [
            self.found.literal_or_none(motion.end() + one.start(), line.end)
            for one in patterns.STRUCT.finditer(code)
        ]
        for literal in structs or [None]:
            if literal is not None and (literal.axes or any(literal.external)):
                name = f"{word.upper()}@{self.found.source.line_of(line.start)}"
                self.found.add_unread(name, literal.start, patterns.RELATIVE_AXES)
            elif patterns.TOOL_AXES.search(code) is None:
                self.shifts.note_relative(line.start, word, literal, self.move_here(line.start))

    def move_here(self, place: int) -> PointMove:
        """Return a move that stands here, of no position of the file."""
        return PointMove(-1, len(self.points.routines) - 1, place, self.branches)

    def _take_target(
        self, keyword: str, part: int, literal: KrlLiteral, end: int, *, is_constant: bool
    ) -> int:
        """Take a position written into a move; return where what follows begins."""
        text = self.found.source.text
        after = skip_blanks(text, literal.end, end)
        if text[after:end][:1] == ":":
            self.found.add_remark(literal.start, "offset", patterns.OFFSET)
            self._take_behind_frame(keyword, literal, after, end)
            return end
        if after < end and after == literal.end and text[after] != ",":
            raise self.found.source.error_at(after, "after a position, a blank or a comma should stand.")
        name = f"{keyword}@{self.found.source.line_of(literal.start)}" + (f".{part}" if part > 1 else "")
        self.add_position(name, literal, is_constant=is_constant)
        return after

    def _take_behind_frame(self, keyword: str, literal: KrlLiteral, colon: int, end: int) -> None:
        """Take a target behind a frame that is written out."""
        code = self.found.source.text[literal.start : end]
        name = patterns.NAMES_POINT.match(code, colon + 1 - literal.start)
        if name is None:
            self.found.add_unread(
                f"{keyword}@{self.found.source.line_of(literal.start)}", literal.start, INSIDE
            )
            return
        self.shifts.note_operators(code, literal.start, self.types, self.move_here(literal.start))
        if self.types.get(name[1].upper()) == "FRAME":  # which of the two is the point, nothing tells
            self._written_inside(code[: colon - literal.start], literal.start)
        self._use_point(name, literal.start, "")

    def _note_unread(self, keyword: str, place: int, line: KrlLine, why: str) -> None:
        self.found.add_unread(f"{keyword.upper()}@{self.found.source.line_of(line.start)}", place, why)

    def _pass_named(self, code: str, place: int, begin: int, own: str) -> int:
        """Pass a target that is named or computed; return where it ends, all of the rest for a computed one."""
        target = code[place : patterns.end_of_target(code, place)]
        comma = place + len(target)
        first = patterns.NAMES_POINT.match(target)
        if patterns.CALLED.match(target):
            self.found.add_remark(begin + place, "computed", patterns.CALL)
            self.shifts.note_computed(begin + place, "move", self.move_here(begin + place))
            self._written_inside(code[place:], begin + place)
            self._use_all_words(code[place:], begin + place, BARRED["source"])
            return len(code)
        if ":" in target:
            self.found.add_remark(begin + place, "offset", patterns.OFFSET)
            self.shifts.note_operators(target, begin + place, self.types, self.move_here(begin + place))
            self._point_behind(code[place:], begin + place)
            self._use_all_words(target[first.end() :] if first else target, begin + place, BARRED["source"])
        if first is not None:
            self._use_point(first, begin + place, own)
        return len(code) if ":" in target else comma

    def _point_behind(self, target: str, place: int) -> None:
        """Take positions that are written out behind a frame with a name, and in what follows it."""
        frame = patterns.NAMES_POINT.match(target)
        of_frame = frame is not None and self.types.get(frame[1].upper()) == "FRAME"
        self._written_inside(target, place, any_frame=of_frame)

    def _written_inside(self, code: str, place: int, *, any_frame: bool = True) -> None:
        """Leave positions that are written into a computed target; a frame alone may be a shift of a point."""
        line = self.found.source.line_of(place)
        for struct in patterns.STRUCT.finditer(code):
            if any_frame or patterns.OF_POINT.search(struct[0]):
                self.found.add_unread(f"line {line}", place + struct.start(), INSIDE)

    def _use_point(self, name: re.Match[str], place: int, own: str) -> None:
        """Note a move to a named point, unless it is done with the point's own frame data."""
        taken = data_taken(own) if own else self.force.data
        if own and not taken:
            self._use_match(name, place, BARRED["computed"])
        elif taken != f"F{name[1][1:]}".upper():
            self._use_match(name, place, "", taken)
        else:
            self.points.moved_as_taught.add(point_key(name[1], name[2]))
            self.tables.note_taught(taken, self.points.routines[-1], place, self.branches)

    def _use_all_words(self, code: str, place: int, why: str) -> None:
        for name in patterns.WORD.finditer(without_field_names(code)):
            self._use_match(name, place, why)

    def _use_match(self, name: re.Match[str], place: int, why: str, data: str = "") -> None:
        self.note_use(name[1], name[2], place, why, data)

    def note_use(self, name: str, index: str | None, place: int, why: str, data: str = "") -> None:
        """Note that a name is moved to, copied or written over, and why that keeps it from being changed."""
        self.points.note_use(point_key(name, index), place, self.branches, why, data)

    def add_position(self, name: str, literal: KrlLiteral, *, is_constant: bool) -> None:
        """Take a position; one that the program fills in part is left."""
        why = "" if is_constant else BARRED["computed"]
        if "@" in name:
            row = len(self.found.names)
            self.points.rows.append(
                PointMove(row, len(self.points.routines) - 1, literal.start, self.branches, why)
            )
        self.found.add_position(name, literal)

    def take_calls(self, code: str, line: KrlLine) -> None:
        """Take the routines that a statement calls."""
        names = {name.upper() for name in patterns.CALLS.findall(code)} - patterns.KNOWN_CALLS
        self.points.routines[-1].calls |= names
        self._take_arguments(code, line)
        if names:  # it may move, and what it sets stays
            self.force.forget()
            self.points.routines[-1].calls_at.append(line.start)
            self.points.routines[-1].triggers |= patterns.TRIGGER.match(code) is not None
        for name in sorted(names):
            if name.startswith(patterns.SENSOR):
                self.found.add_remark(line.start, "vision", make_message(patterns.FOUND, name))
            if name in patterns.GUIDES:
                self.shifts.guided.append(guided_motion(self.found.source.line_of(line.start), name))

    def _take_arguments(self, code: str, line: KrlLine) -> None:
        """Take the data that calls pass, and what functions of the language give a value."""
        routine = self.points.routines[-1]
        for name, arguments in calls_of(code):
            if name in patterns.KNOWN_CALLS:
                continue
            for argument in arguments[first_filled_argument(name) :]:
                self._give_value(argument, line)
            for number, argument in enumerate(arguments):
                if (frame := patterns.FRAME_PASSED.fullmatch(argument)) is not None:
                    self._pass_frame(frame[1].upper(), (name, number), line)
                self._pass_data(argument, (name, number))
            call = call_of(routine.name, name, arguments)
            if call is not None and first_filled_argument(name) >= len(arguments):
                self.points.calls.append(call)

    def _pass_frame(self, which: str, parameter: tuple[str, int], line: KrlLine) -> None:
        """Take ``$BASE`` or its like that a call passes: it comes back set, unless the parameter is ``:IN``."""
        if not is_by_value(self.found.source.text, *parameter):
            routine = self.points.routines[-1]
            if f"${which}" in patterns.ROOTS:
                self.points.sets_root = True
                return
            use = routine.tool if which == "TOOL" else routine.base
            use.take_value(line.start, UNKNOWN, self.branches)

    def _pass_data(self, argument: str, parameter: tuple[str, int]) -> None:
        """Take frame data that a call passes: a routine may give it another tool or base."""
        found = patterns.DATA.fullmatch(argument)
        if (
            found is None
            or found[3]
            or found[1].upper()[0] != "F"
            or parameter[0] in patterns.TAKING_FRAME_DATA
        ):
            return
        if not is_by_value(self.found.source.text, *parameter):
            self.points.set_data.add(found[1].upper())

    def _give_value(self, argument: str, line: KrlLine) -> None:
        """Take data that a function of the language gives a value."""
        found = patterns.DATA.fullmatch(argument)
        if found is None or patterns.OF_PLACE.fullmatch(found[3] or "") is None:
            return
        upper = found[1].upper()
        self.points.routines[-1].assigned.add(upper)
        if upper in patterns.TABLES:
            self.points.set_tables.add(f"{patterns.TABLES[upper]} {(found[2] or '').strip() or '*'}")
        elif upper in patterns.ROOTS:
            self.points.sets_root = True
        elif upper[0] != "$":
            self.note_use(found[1], found[2], line.start, OVERWRITTEN)
