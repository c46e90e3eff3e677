"""KUKA programs (.src): points written into motion statements, and what changes points while the program runs."""

import re
from dataclasses import dataclass, field, replace

from cellcal.calibration.message import make_message
from cellcal.drivers.kuka.program_files import patterns
from cellcal.drivers.kuka.program_files.collected_positions import KrlPositions
from cellcal.drivers.kuka.program_files.data_list import (
    FRAME_SET,
    remark_comment,
    remark_hidden_positions,
)
from cellcal.drivers.kuka.program_files.found_shifts import ShiftNotes
from cellcal.drivers.kuka.program_files.frame_data import FramesInForce, data_taken
from cellcal.drivers.kuka.program_files.frame_uses import (
    RESET,
    TURNED,
    TURNED_BY_AXIS,
    UNKNOWN,
    WRITTEN_OUT,
    KrlRoutine,
)
from cellcal.drivers.kuka.program_files.krl_motions import KrlMotions
from cellcal.drivers.kuka.program_files.lines import (
    DECLARING,
    KrlLine,
    NamedItem,
    find_declaration,
    find_item,
    first_word,
    line_at,
    point_key,
    without_field_names,
    without_strings,
)
from cellcal.drivers.kuka.program_files.literals import POSE_FIELDS, KrlLiteral
from cellcal.drivers.kuka.program_files.measured_points import MEASURED
from cellcal.drivers.kuka.program_files.passed_points import parameters_of
from cellcal.drivers.kuka.program_files.point_uses import PointUses
from cellcal.drivers.kuka.program_files.set_by_text import MAY_SET, take_set_by_text
from cellcal.drivers.kuka.program_files.usual import TAUGHT_MOVE
from cellcal.drivers.programs.barred import OVERWRITTEN
from cellcal.drivers.programs.file_declarations import COPIED
from cellcal.drivers.programs.guided_motions import AXIS_BY_ITSELF
from cellcal.drivers.programs.spans import ProgramText


@dataclass
class KrlProgram(KrlMotions):
    """A program while it is read."""

    frames_set: list[tuple[NamedItem, KrlLiteral]] = field(default_factory=list)  # names that get a FRAME

    def read_line(self, line: KrlLine) -> None:
        """Take one line."""
        text = self.found.source.text
        if line.start == line.end:
            remark_comment(self.found, line)
            return
        prepared = patterns.PREPARED.fullmatch(text, line.start, line.end)
        if prepared is not None:
            if prepared[1]:
                self._take_data(prepared[1])
            remark_comment(self.found, line)
            return
        word = first_word(text, line)  # it rules most patterns out: a large program has a million lines
        begun = patterns.ROUTINE.match(text, line.start, line.end) if word in patterns.BEGIN_ROUTINE else None
        if begun is not None:
            name = begun[1].upper()
            shown = len(self.points.routines) == 1 or "GLOBAL" in begun[0].upper()
            number, passed = len(self.points.routines), parameters_of(text[begun.end() : line.end])
            self.points.routines.append(KrlRoutine(number, name, shown, parameters=passed))
            self.branches, self.force = (), FramesInForce()
        motion = patterns.MOTION.match(text, line.start, line.end) if word in patterns.MOVE else None
        if motion is not None:
            self.take_motion(motion, line)
        else:
            self._take_statement(line, word)
        remark_comment(self.found, line)

    def read_taught_move(self, found: re.Match[str]) -> None:
        """Take a move as the inline forms write it, with all that stands around it."""
        self.points.routines[-1].set_both_frames(found.start("bas"), UNKNOWN, self.branches)
        self._take_data(f"F{found['point']}")
        self.force.set_data()
        self.points.moved_as_taught.add(f"X{found['point']}".upper())
        routine = self.points.routines[-1]
        self.tables.note_taught(f"F{found['point']}", routine, found.start("bas"), self.branches)

    def _take_data(self, name: str) -> None:
        """Take frame data that an inline form sets; "" for such that no point has."""
        self.force.take_data(name)
        if name:
            self.points.routines[-1].data_taken.add(name.upper())

    def _take_statement(self, line: KrlLine, word: str) -> None:
        text = self.found.source.text
        code = without_strings(text[line.start : line.end])
        self._take_flow(code, line, word)
        if "(" in code and MAY_SET.search(text, line.start, line.end):
            take_set_by_text(self, line)
        declared = find_declaration(text, line) if word in DECLARING else None
        if declared is not None:
            self._take_declared(declared[0], declared[1], line)
            return
        bas = patterns.BAS.search(code) if "(" in code else None
        if bas is not None:
            self._take_bas(line.start + bas.start(), bas[1].upper(), bas[2].strip())
        elif "(" in code and patterns.BAS_CHOSEN.search(code):
            self.points.routines[-1].set_both_frames(line.start, UNKNOWN, self.branches)
        elif "$" in code and (frame := patterns.FRAME_SET.search(code)) is not None:
            self.points.routines[-1].interrupted |= word in patterns.BESIDE
            if patterns.WITH.search(code, 0, frame.start()) is None:
                self._take_frame_setting(frame, line)
                self.force.forget()
            else:  # of a spline block, whose segments may have their own
                self.points.routines[-1].set_both_frames(line.start, UNKNOWN, self.branches)
                self.force.data = data_taken(code[frame.start() :])
        elif "." in code and patterns.COMPONENT.match(code):
            self._take_component(code, line)
        else:
            self._take_assignment(line)

    def _take_flow(self, code: str, line: KrlLine, word: str) -> None:
        """Take calls, branches, and the frame data that the next move is done with."""
        begins = word in patterns.BEGIN_ROUTINE and patterns.ROUTINE.match(code) is not None
        if "(" in code and not begins and word not in patterns.CALLS_NOTHING:
            self.take_calls(code, line)
        if word in patterns.BESIDE:
            self._take_beside(code, line)
        if word in patterns.ASYNCHRONOUS:
            name = f"{word}@{self.found.source.line_of(line.start)}"
            self.found.add_unread(name, line.start, AXIS_BY_ITSELF)
        elif word in patterns.BRANCHES:
            self._take_branch(word, line.start)
        elif word == patterns.FRAME_DATA_ACTIVE:
            data = patterns.FRAME_DATA_SET.match(code)  # a part of it, or all written out, is of no point
            self._take_data(data[1] if data is not None else "")
        elif word in ("SPLINE", "PTP_SPLINE"):
            self.force.begin_block()
        elif word == "ENDSPLINE":
            self.force.end_block()
        else:
            self._take_jump(code, line, word)

    def _take_jump(self, code: str, line: KrlLine, word: str) -> None:
        jumps = self.points.routines[-1].jumps
        if word in ("GOTO", "EXIT"):
            jumps.first = line.start if jumps.first is None else jumps.first
        elif word in patterns.JUMP_TARGETS or code.rstrip().endswith(":"):
            jumps.jump_targets.append(line.start)
            if word in patterns.JUMP_TARGETS:
                jumps.flow.end_block(line.start)
            else:
                jumps.flow.labels.append(line.start)
            self.force.forget()
        elif word in patterns.LOOPS:
            jumps.flow.begin_block(line.start, repeats=True)
            self.force.forget()

    def _take_beside(self, code: str, line: KrlLine) -> None:
        """Take the routine of an interrupt, and an entry of a table that a trigger sets at another time."""
        routine = self.points.routines[-1]
        if (declared := patterns.INTERRUPT.match(code)) is not None:
            handlers = routine.shown_handlers if declared[1] else routine.handlers
            handlers |= {declared[2].upper()} - patterns.KNOWN_CALLS
        for table in patterns.TABLE_SET_BESIDE.findall(code):
            which = patterns.TABLES[table.upper()]
            self.tables.note_setting(which, "*", routine, line.start, self.branches, UNKNOWN)
            self.points.set_tables.add(f"{which} *")
        behind = patterns.BEHIND_DO.search(self.found.source.text, line.start, line.end)
        if behind is not None:
            self._take_beside_assignment(KrlLine(behind.end(), line.end, ""))

    def _take_beside_assignment(self, line: KrlLine) -> None:
        """Take what gets a value at another time: a point, frame data, or a component of either."""
        name = find_item(self.found.source.text, line.start, line.end)
        if name is not None and name.name[0] != "$" and name.name.upper() not in patterns.TABLES:
            self.points.routines[-1].assigned.add(name.name.upper())
            self.points.set_data.add(name.name.upper())
            self.note_use(name.name, name.index, line.start, OVERWRITTEN)

    def _take_branch(self, word: str, place: int) -> None:
        self.force.take_branch(word)
        flow = self.points.routines[-1].jumps.flow
        if word in ("WHILE", "FOR"):
            flow.begin_block(place, repeats=True)
        elif word in ("ENDWHILE", "ENDFOR"):
            flow.end_block(place)
        if word not in ("IF", "SWITCH", "WHILE", "FOR"):
            self.branches = self.branches[:-1]
        if not word.startswith("END"):
            self.branches = (*self.branches[: patterns.DEEPEST], place)

    def _take_declared(self, kind: str, place: int, line: KrlLine) -> None:
        name = find_item(self.found.source.text, place, line.end)
        while name is not None:
            self.types[name.name.upper()] = kind
            self.points.routines[-1].declared.add(name.name.upper())
            if name.value is not None or name.end >= line.end:
                break
            name = find_item(self.found.source.text, name.end, line.end)
        if name is not None and name.value is not None:
            self._take_value(name, line)

    def _take_bas(self, place: int, command: str, argument: str) -> None:
        routine = self.points.routines[-1]
        if command in patterns.SET_BY_POINTS:  # taken from the point's own data, which is not in this file
            self.points.routines[-1].set_both_frames(place, UNKNOWN, self.branches)
            self.force.set_data()
        elif command == "INITMOV":
            self.force.forget()
            routine.resets = True
            routine.held_tool |= routine.is_at_beginning(self.branches)
            routine.reset_at.append(place)
            if routine.reset_from is None and not self.branches:
                routine.reset_from = place
            for use in (routine.tool, routine.base):
                if use.values:
                    use.take_value(place, RESET, self.branches)
        else:
            self.force.forget()
            use = routine.tool if command == "TOOL" else routine.base
            number = argument if argument.isdigit() else UNKNOWN
            use.take_value(place, TURNED_BY_AXIS if command == "EX_BASE" else number, self.branches)

    def _take_frame_setting(self, frame: re.Match[str], line: KrlLine) -> None:
        text, place = self.found.source.text, line.start + frame.end()
        which, routine = frame[1].upper(), self.points.routines[-1]
        if which == "ACT_EX_AX":
            if text[place : line.end].strip() != "0":
                routine.base.take_value(place, TURNED_BY_AXIS, self.branches)
            self.found.add_remark(line.start, "foreign", patterns.COUPLED_TEXT)
            return
        if which == "IPO_MODE":
            is_held = patterns.HELD_TOOL.match(text, place, line.end) is not None
            own = (
                f"{patterns.FRAME_DATA_ACTIVE}."  # which is read with the point; any other value may be #TCP
            )
            is_external = not is_held and not text[place : line.end].strip().upper().startswith(own)
            self.points.external_tool |= is_external
            routine.external_tool |= is_external
            routine.held_tool |= is_held and routine.is_at_beginning(self.branches)
            self.found.add_remark(line.start, "foreign", patterns.EXTERNAL_TEXT)
            return
        use = routine.tool if which == "TOOL" else routine.base
        use.take_value(place, self._frame_value(which, frame, line), self.branches)
        self.found.add_remark(line.start, "computed", make_message(patterns.FRAME_SET_TEXT, which))

    def _frame_value(self, which: str, frame: re.Match[str], line: KrlLine) -> str:
        """Return the number of a tool or base, the numbers of one written out here, or that it is not known."""
        text, place = self.found.source.text, line.start + frame.end()
        table = patterns.FROM_TABLE.fullmatch(text, place, line.end)
        if table is not None and not frame[2]:
            return table[1]
        turned = patterns.FROM_KINEMATICS.fullmatch(text, place, line.end)
        if turned is not None and which == "BASE" and not frame[2]:
            return f"{TURNED}{turned[1]}"
        is_null = patterns.NULL.fullmatch(text, place, line.end) or (
            which == "BASE" and patterns.WORLD.fullmatch(text, place, line.end)
        )
        if is_null and not frame[2]:
            return "0"
        literal = self.found.read_literal(place, line.end) if text[place : line.end][:1] == "{" else None
        return self._value_of_numbers(which, literal, line)

    def _value_of_numbers(self, which: str, literal: KrlLiteral | None, line: KrlLine) -> str:
        """Return the value of a tool or base that is written out, alone up to the end of its line."""
        alone = literal is not None and not self.found.source.text[literal.end : line.end].strip()
        pose = self.found.pose_of(literal) if literal is not None and alone else None
        if literal is None or pose is None:
            return UNKNOWN
        numbers = (f"{name} {float(text or 0)}" for name, text in zip(POSE_FIELDS, literal.main, strict=True))
        value = f"{WRITTEN_OUT}{{{', '.join(numbers)}}}"
        self.points.set_frames[which][value] = pose
        return value

    def _take_assignment(self, line: KrlLine) -> None:
        text = self.found.source.text
        name = find_item(text, line.start, line.end)
        if name is not None and name.value is not None:
            self.points.routines[-1].assigned.add(name.name.upper())
            self._take_value(name, line)
            return
        if name is not None and (record := patterns.RECORD_SET.match(text, name.end, line.end)) is not None:
            value = without_strings(text[record.end() : line.end])
            self._take_copy(replace(name, value=record.end()), value, line)
        part = patterns.FRAME_DATA_COMPONENT.match(text, line.start, line.end)
        if part is not None:
            self.points.set_data.add(part[1].upper())
        remark_hidden_positions(self.found, line, line.start)

    def _take_value(self, name: NamedItem, line: KrlLine) -> None:
        upper = name.name.upper()
        self.points.sets_root |= upper in patterns.ROOTS
        value = without_strings(self.found.source.text[name.value : line.end])
        if upper in patterns.CORRECTIONS and value.strip().upper() != "FALSE":
            self.shifts.note_correction(name.name, line.start)
        if value[:1] == "{" or patterns.NAME_VALUE.match(value):
            self.points.set_data.add(upper)
        if upper in patterns.TABLES:
            self._take_table_setting(name, line)
        elif value.startswith("{"):
            self._take_struct(name, value, self.types.get(upper, ""), line)
        else:
            if upper not in patterns.MOTION_DATA:
                self._take_copy(name, value, line)
                self._take_overwrite(name, value, line)
                self.shifts.note_value(name.full_name, value, line.start, self.types.get(upper, ""))
            if upper in self.types or patterns.POINT_VALUE.search(value):
                self.found.add_remark(line.start, "computed", make_message(patterns.ASSIGNED, name.full_name))
            else:
                remark_hidden_positions(self.found, line, line.start)

    def _take_struct(self, name: NamedItem, value: str, kind: str, line: KrlLine) -> None:
        alone = (
            "{" not in value[1:] and ":" not in value.partition("}")[2] and patterns.POINT_STRUCT.match(value)
        )
        literal = self.found.read_literal(name.value or 0, line.end) if alone else None
        is_frame = kind == "FRAME" or (
            literal is not None and (literal.type == "FRAME" or not any(literal.state))
        )
        if literal is not None and (literal.axes or not is_frame):
            self.add_position(name.full_name, literal, is_constant=False)
        elif literal is not None:
            self.found.add_remark(line.start, "computed", make_message(patterns.ASSIGNED, name.full_name))
            self.frames_set.append((name, literal))
        elif not alone and ":" not in value.partition("}")[2]:
            remark_hidden_positions(self.found, line, line.start)
        if ":" in value.partition("}")[2] and name.name[0] != "$":
            self._take_copy(name, value, line)
        if literal is None or not literal.is_whole or (is_frame and not literal.axes):
            self._take_overwrite(name, value, line)

    def add_frames(self) -> None:
        """Take FRAMEs that moves go to as positions that are left."""
        for name, literal in self.frames_set:
            key = point_key(name.name, name.index)
            if {key, name.name.upper(), f"{name.name.upper()}[]"} & self.points.uses.keys():
                self.found.add_unread(name.full_name, literal.start, FRAME_SET)

    def _take_copy(self, name: NamedItem, value: str, line: KrlLine) -> None:
        """Note that a name is given what stands in others, which may be points."""
        if ":" in value and name.name[0] != "$":
            self.shifts.note_operators(value, name.value or line.start, self.types, None)
        to = point_key(name.name, name.index)
        if MEASURED.search(value) is not None:
            key = f"$POS@{line.start}"
            self.points.measured[key] = self.move_here(line.start)._replace(data=self.force.data)
            self.points.copies[key] = {to}
        for source in patterns.WORD.finditer(without_field_names(value)):
            self.note_use(source[1], source[2], line.start, COPIED)
            self.points.copies.setdefault(point_key(source[1], source[2]), set()).add(to)

    def _take_overwrite(self, name: NamedItem, value: str, line: KrlLine) -> None:
        """Note that a name, which may be a point of a data list, gets a value that is not written here."""
        if name.name[0] != "$" and (value[:1] == "{" or patterns.NAME_VALUE.match(value)):
            self.note_use(name.name, name.index, line.start, OVERWRITTEN)

    def _take_component(self, code: str, line: KrlLine) -> None:
        self.shifts.note_component(code, line.start, self.move_here(line.start))
        self.found.add_remark(
            line.start, "computed", make_message(patterns.ASSIGNED, code.partition("=")[0].strip())
        )
        name = find_item(self.found.source.text, line.start, line.end)
        if name is not None:
            self.points.routines[-1].assigned.add(name.name.upper())
        if name is not None and name.name.upper() in patterns.TABLES:
            self._take_table_setting(name, line)
        elif name is not None:
            self.points.sets_root |= name.name.upper() in patterns.ROOTS
            self._take_overwrite(name, "{", line)

    def _take_table_setting(self, name: NamedItem, line: KrlLine) -> None:
        index = (name.index or "").strip()
        number = str(int(index)) if index.isdigit() and len(index) < patterns.MOST_DIGITS else "*"
        which = patterns.TABLES[name.name.upper()]
        self.points.set_tables.add(f"{which} {number}")
        value = UNKNOWN
        if name.value is not None and self.found.source.text[name.value : line.end][:1] == "{":
            value = self._value_of_numbers(which, self.found.literal_or_none(name.value, line.end), line)
        self.tables.note_setting(which, number, self.points.routines[-1], line.start, self.branches, value)
        if name.value is not None:  # a component's is told already
            self.found.add_remark(line.start, "computed", make_message(patterns.ASSIGNED, name.full_name))


def read_program(source: ProgramText) -> KrlProgram:
    """Read a program."""
    found = KrlPositions(source)
    program = KrlProgram(found, PointUses(found), ShiftNotes(found))
    for part in TAUGHT_MOVE.finditer(source.text):
        if part["point"] is not None:
            program.read_taught_move(part)
        elif line := line_at(source.text, part.start()):
            program.read_line(line)
    program.add_frames()
    program.tables.settle_uses(program.points.routines)
    program.points.finish_reading()
    return program
