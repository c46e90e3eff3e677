"""RAPID modules: targets, tools and work objects that are declared, targets inside moves, and what changes them."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

from cellcal.calibration.message import make_message
from cellcal.drivers.abb.program_files.collected_positions import NO_COORDINATES, RapidPositions
from cellcal.drivers.abb.program_files.computed_targets import ComputedTargets
from cellcal.drivers.abb.program_files.declared_frames import DeclaredFrames
from cellcal.drivers.abb.program_files.displacements import USED, WORDS, Displacements, TargetMove
from cellcal.drivers.abb.program_files.found_shifts import FoundShifts
from cellcal.drivers.abb.program_files.frame_facts import FRAME_PARTS
from cellcal.drivers.abb.program_files.instructions import (
    BROKEN,
    COMPUTED,
    EXTENDED_MOVE,
    FINDS,
    FORCE_REFERENCES,
    GUIDES,
    MOVES,
    STAR,
    TURNS_AXES,
    MoveInstruction,
    MoveTarget,
    read_instruction,
)
from cellcal.drivers.abb.program_files.literal_frames import LiteralFrames, find_literal_frames
from cellcal.drivers.abb.program_files.literals import (
    AGGREGATES,
    NAME,
    NOT_CODE,
    TARGETS,
    W,
    decode_name,
)
from cellcal.drivers.abb.program_files.measured_places import measured_name, name_of_found
from cellcal.drivers.abb.program_files.passed_targets import (
    RoutineParameters,
    pass_targets,
    routine_calls,
)
from cellcal.drivers.abb.program_files.rapid_declarations import RapidDeclarations
from cellcal.drivers.abb.program_files.target_uses import TargetUses
from cellcal.drivers.abb.program_files.unread import INSIDE, LIKE_A_POSITION, unread_positions
from cellcal.drivers.abb.program_files.usual import USUAL
from cellcal.drivers.abb.program_files.written_arguments import find_written
from cellcal.drivers.abb.program_files.written_numbers import WrittenTargets
from cellcal.drivers.programs.guided_motions import AXIS_BY_ITSELF
from cellcal.drivers.programs.positions import NO_NUMBER
from cellcal.drivers.programs.spans import ProgramText

_BYTE_ORDER_MARK = "\xef\xbb\xbf"  # of UTF-8, byte by byte
_TOKEN = re.compile(rf"{NOT_CODE}|{NAME}", re.ASCII)
_ASSIGNED = re.compile(
    rf"{W}(?:\{{([^{{}};]*+)\}})?+{W}((?:\.{W}\w++{W}(?:\{{[^{{}};]*+\}})?+{W}){{0,6}}+):={W}", re.ASCII
)
_NAME = re.compile(rf"{W}({NAME})", re.ASCII)
_PARAMETERS = re.compile(rf"{W}\(((?:[^()!]++|![^\n]*+){{0,1000}}+)\)", re.ASCII)
_FUNCTION_NAME = re.compile(rf"{W}[A-Za-z]\w*+{W}({NAME})", re.ASCII)
_HOLDS_A_POSITION = re.compile(r"\[\s*\[\s*[-+.\d]")
_REMARKED = {
    "offs": ("offset", "Offs shifts this target while the program runs."),
    "reltool": ("offset", "RelTool shifts this target along the tool while the program runs."),
    "pdispon": ("offset", "PDispOn shifts every target that follows."),
    "pdispset": ("offset", "PDispSet shifts every target that follows."),
    "eoffson": ("offset", "EOffsOn shifts external axes of every target that follows."),
    "eoffsset": ("offset", "EOffsSet shifts external axes of every target that follows."),
    "crobt": ("computed", "CRobT takes a target from where the robot is."),
    "cjointt": ("computed", "CJointT takes a target from where the robot is."),
    "calcrobt": ("computed", "CalcRobT computes a target."),
    "orobt": ("computed", "ORobT computes a target without displacement."),
    "mirpos": ("computed", "MirPos computes a mirrored target."),
}
_COPY_TEXT = "{} is set to another target while the program runs."
_ASSIGNED_TEXT = "{} is set while the program runs; that value is not read."
_INSIDE_TEXT = "A position stands inside this statement; it is not read, and stays as it is."
_SET_LATER = "it gets its coordinates while the program runs"
_ASSIGNED_TO_UNKNOWN = "it is given to a name that this file does not declare: what goes to it is not known"
_STAR_UNKNOWN = "its coordinates are not in the file"


@dataclass
class RapidModule(RapidDeclarations):
    """A file of modules while it is read."""

    shifts: FoundShifts
    name: str = ""
    assigned: list[tuple[int, str, str]] = field(default_factory=list)  # place, name, scope
    assigned_here: list[tuple[str, str]] = field(
        default_factory=list
    )  # name, scope: the value is written here
    copies: set[int] = field(default_factory=set)  # places of assignments from another target
    looked_at: int = 0  # up to where the text was searched for positions inside other data
    set_whole: list[tuple[str, str]] = field(default_factory=list)  # name, scope
    moves: bool = False  # an instruction of the file moves a robot
    extended_moves: list[tuple[int, str, str]] = field(default_factory=list)  # place, target, scope
    displaced: bool = False  # moves are noted one by one, for displacements
    routine_begins: int = 0
    set_names: set[str] = field(default_factory=set)  # what is assigned as a whole
    parameters: RoutineParameters = field(default_factory=RoutineParameters)
    written: WrittenTargets = field(default_factory=lambda: WrittenTargets.without_rows(0))
    literal: LiteralFrames = field(default_factory=LiteralFrames)

    @cached_property
    def computed(self) -> ComputedTargets:
        """Return the targets that functions compute."""
        return ComputedTargets(self.found.source.text, self.uses)

    def read_module(self) -> None:
        """Take the whole text.

        Raises
        ------
        ProgramFileError
            A position is not understood.
        """
        text = self.found.source.text
        place = len(_BYTE_ORDER_MARK) if text.startswith(_BYTE_ORDER_MARK) else 0
        while True:
            while (usual := USUAL.match(text, place)) is not None and self._take_usual(usual):
                place = usual.end()
            token = _TOKEN.search(text, place)
            if token is None:
                return
            word = token[0]
            self._remark_inside(place, token.start())
            if word[0] == "!":
                if "[" in word and _HOLDS_A_POSITION.search(word):
                    self.found.add_remark(
                        token.start(), "comment", "A comment holds a position; it stays as it is."
                    )
                place = token.end()
            elif word[0] == '"':
                place = token.end()
            else:
                place = self._take_word(word.lower(), token.start(), token.end())

    def _take_usual(self, found: re.Match[str]) -> bool:
        """Take a statement as the controller writes it; tell whether it was."""
        if found["name"] is None:
            frame = found["frame"] or "wobj0"
            self.moves = True
            tool = found["tool"]
            if self.literal:
                tool, frame = self._with_numbers(found.start("a_move"), tool, frame)
            self.uses.note_use(found["to"], tool, frame)
            if self.displaced:
                self._note_move(found.start("a_move"), found["to"], -1, frame)
            return True
        row = len(self.found.names)
        if not self.found.add_usual(found):
            return False
        self.local, local = False, self.local
        self.uses.declare_target(found["name"], row, local=local)
        return True

    def _with_numbers(self, place: int, tool: str | None, frame: str | None) -> tuple[str | None, str | None]:
        """Return the tool and work object of a move, with their numbers where the module surely sets them so."""
        scope, hidden = self.uses.scope, self.uses.parameters
        of_tool, of_frame = (
            name if name is None or (scope, name.lower()) in hidden else self.literal.name_at(place, name)
            for name in (tool, frame)
        )
        return of_tool, of_frame

    def _remark_inside(self, place: int, end: int) -> None:
        """Remark a position in a statement that is not read: in a record, a call, an array of another kind."""
        text = self.found.source.text
        if place < self.looked_at or text.find("[", place, end) < 0:
            return
        stop = text.find(";", place)
        self.looked_at = stop if stop >= 0 else len(text)
        found = LIKE_A_POSITION.search(text, place, self.looked_at)
        if found is not None:
            self.found.add_remark(found.start(), "computed", _INSIDE_TEXT)

    def _note_move(self, place: int, name: str, row: int, frame: str | None) -> None:
        self.shifts.displacements.moves.append(TargetMove(place, self.uses.scope, name, row, frame))

    def finish_reading(self) -> None:
        """Remark targets that the program sets, and take away those that are seen from the flange."""
        self._leave_extended_moves()
        for place in unread_positions(self.found.source.text, set(self.found.starts)):
            self.found.add_unread(f"line {self.found.source.line_of(place)}", place, INSIDE)
        self.written = self.found.compute_usual()
        self.uses.facts.set_while_running |= {
            name for name in self.set_names if name in self.frames.declared or name not in self.uses.shown
        }
        for name, scope in [*(one[1:] for one in self.assigned), *self.assigned_here]:
            for row in self.uses.rows_of(name, scope):
                if self.found.fixed.get(row) == NO_COORDINATES:
                    self.found.fixed[row] = _SET_LATER
        for place, name, scope in self.assigned:
            if self.uses.rows_of(name, scope):
                text = _COPY_TEXT if place in self.copies else _ASSIGNED_TEXT
                self.found.add_remark(place, "computed", make_message(text, name))
        self.frames.drop_ambiguous()
        self.frames.tools |= self.literal.tools
        self.frames.bases |= self.literal.bases
        self._take_written_arguments()
        self.computed.finish_reading()
        self._pass_targets()
        self.uses.resolve_uses(self.found)
        self.shifts.bar_targets(self.found, self.uses)

    def _leave_extended_moves(self) -> None:
        """Leave moves of external axes alone to what this file does not hold."""
        for place, name, scope in self.extended_moves:
            if not self.uses.rows_of(name, scope):
                self.found.add_unread(f"MoveExtJ@{self.found.source.line_of(place)}", place, AXIS_BY_ITSELF)

    def _take_written_arguments(self) -> None:
        """Count what instructions and routines give a value which it is passed to as if it were assigned."""
        assigned_names = {(scope, name.partition("{")[0].lower()) for _, name, scope in self.assigned}
        assigned_names |= {(scope, name.partition("{")[0].lower()) for name, scope in self.assigned_here}
        text, routines = self.found.source.text, self.shifts.displacements.routines
        for one in find_written(text, routines, self.parameters, assigned_names):
            bare = one.name.partition("{")[0].lower()
            if bare in self.frames.declared or bare not in self.uses.shown:
                self.uses.facts.set_while_running.add(bare)
            if one.part:
                self.shifts.set_component(one.place, one.name, one.scope, one.part)
            else:
                self.shifts.overwritten.append((one.name, one.scope))

    def _pass_targets(self) -> None:
        whole_names = {(name.partition("{")[0].lower(), scope) for name, scope in self.set_whole}
        self.parameters.routines |= {scope.partition("/")[2] for scope in self.shifts.displacements.routines}
        calls = list(routine_calls(self.found.source.text, self.shifts.displacements.routines))
        pass_targets(self.uses, self.parameters, calls, whole_names, self.frames.all_tools())

    def _take_word(self, word: str, start: int, end: int) -> int:
        """Take a word at statement level; return where to go on."""
        handler = _HANDLERS.get(word)
        if handler is not None:
            return handler(self, word, end)
        if word in MOVES:
            return self._take_instruction(word, start, end)
        if word in GUIDES or word in FORCE_REFERENCES or word in TURNS_AXES:
            self._take_motion_without_place(word, start, end)
            return end
        if word in _REMARKED:
            self.found.add_remark(start, *_REMARKED[word])
        if word in _REMARKED or word in WORDS:
            self.shifts.take_word(word, (start, end), self.uses.scope)
            return end
        assigned = _ASSIGNED.match(self.found.source.text, end)
        if assigned is None or self.found.source.text[start - 1 : start] == "\\":  # an option of a call
            return end
        return self._take_assignment(start, end, assigned)

    def _take_motion_without_place(self, word: str, start: int, end: int) -> None:
        """Take an instruction that moves the robot, or an axis beside it, to what is no target of the file."""
        text, line = self.found.source.text, self.found.source.line_of(start)
        if word in TURNS_AXES:
            target = _NAME.match(text, end) if word == EXTENDED_MOVE else None
            if target is not None:  # most are declared, and their axes stated
                self.extended_moves.append((start, decode_name(target[1]), self.uses.scope))
            elif word != EXTENDED_MOVE:
                self.found.add_unread(f"{text[start:end]}@{line}", start, AXIS_BY_ITSELF)
        else:
            self.shifts.take_guided(word, (start, end), line, self.uses.scope)

    def _take_assignment(self, start: int, end: int, assigned: re.Match[str]) -> int:
        text = self.found.source.text
        bare = decode_name(text[start:end])
        if not assigned[2]:
            self.set_whole.append((bare, self.uses.scope))
        name = bare + (f"{{{''.join(assigned[1].split())}}}" if assigned[1] else "")
        if text[assigned.end() : assigned.end() + 1] == "[" and not assigned[2]:
            for kind in TARGETS:
                found = AGGREGATES[kind].pattern.match(text, assigned.end())
                if found is not None:
                    add = self.found.add_robtarget if kind == "robtarget" else self.found.add_jointtarget
                    self._assigned_here(bare, name, partial(add, name, found))
                    return found.end()
        if assigned[2]:
            path = "".join(assigned[2].split())
            self.shifts.take_component(start, (name, self.uses.scope), path, assigned.end())
            self.note_copy(text, assigned.end(), bare)  # to a component of a record
        elif self.note_copy(text, assigned.end(), bare):
            self.copies.add(start)
        else:
            self.shifts.overwrite(start, (name, self.uses.scope), assigned.end())
        part = assigned[2].partition(".")[2].strip().lower()
        if not part or part.startswith(FRAME_PARTS):
            self.set_names.add(bare.lower())
        self.assigned.append((start, bare, self.uses.scope))
        return assigned.end()

    def _assigned_here(self, bare: str, name: str, add: Callable[[], None]) -> None:
        """Take a target that is written into an assignment: moves to the name go to it."""
        row = len(self.found.names)
        add()
        if not self.uses.assign(name, row):
            self.uses.barred[row] = _ASSIGNED_TO_UNKNOWN
        self.assigned_here.append((bare, self.uses.scope))

    def _take_instruction(self, word: str, start: int, end: int) -> int:
        if _ASSIGNED.match(self.found.source.text, end):
            return end
        instruction = read_instruction(self.found.source, word, end)
        if instruction.frame_pose is not None and instruction.frame is not None:
            self.frames.bases[self.uses.spell_name(instruction.frame)] = instruction.frame_pose
        if self.literal:
            tool, frame = self._with_numbers(start, instruction.tool, instruction.frame)
            instruction = replace(instruction, tool=tool, frame=frame)
        self.moves = True
        for part, target in enumerate(instruction.targets):
            self._moved_to(instruction, part, target, start)
        if word in FINDS and instruction.targets:
            found, scope = instruction.targets[0].name.partition("{")[0], self.uses.scope
            self.assigned_here.append((found, scope))
            self.uses.copied.add((scope, name_of_found(start, instruction.frame), found))
        return instruction.end

    def _moved_to(self, instruction: MoveInstruction, part: int, target: MoveTarget, start: int) -> None:
        if target.remark:
            self.found.add_remark(target.place, *target.remark)
            self.computed.note_move(target, instruction)
        word = self.found.source.text[start : start + len(instruction.word)]
        line = self.found.source.line_of(target.place)
        name = f"{word}@{line}" + (f".{part + 1}" if part else "")
        row, measured = -1, measured_name(self.found.source.text, target.place)
        if target.literal is not None:
            row = len(self.found.names)
            add = self.found.add_jointtarget if target.axes else self.found.add_robtarget
            add(name, target.literal)
            self.uses.use_row(row, instruction.tool, instruction.frame)
        elif target.name:
            self.uses.note_use(target.name, instruction.tool, instruction.frame)
        elif measured:
            self.uses.note_use(measured, instruction.tool, instruction.frame)
        elif target.remark in (STAR, BROKEN):
            why = NO_NUMBER if target.remark == BROKEN else _STAR_UNKNOWN
            self.found.add_unread(name, target.place, why)
        if self.displaced:
            self._note_move(start, target.name, row, instruction.frame)
        if not (measured and target.remark == COMPUTED):
            self.shifts.take_target(target, (name, row), self.uses.scope, instruction.frame)

    def _take_module(self, word: str, end: int) -> int:
        named = _NAME.match(self.found.source.text, end)
        if named is None:
            return end
        self.name = self.name or decode_name(named[1])
        self.uses.enter_module(decode_name(named[1]))
        return named.end()

    def _take_routine(self, word: str, end: int) -> int:
        pattern = _FUNCTION_NAME if word == "func" else _NAME
        named = pattern.match(self.found.source.text, end)
        if named is None:
            return end
        self.local, self.computed.is_local = False, self.local
        self.uses.enter_routine(decode_name(named[1]))
        self.routine_begins = named.end()
        parameters = _PARAMETERS.match(self.found.source.text, named.end())
        if parameters is None:
            return named.end()
        for name in self.parameters.declare_routine(self.uses.scope, parameters[1]):
            self.uses.declare_parameter(name)
        return parameters.end()

    def _take_local(self, word: str, end: int) -> int:
        self.local = True
        return end

    def _take_return(self, word: str, end: int) -> int:
        self.computed.note_return(end)
        return end

    def _leave_routine(self, word: str, end: int) -> int:
        self.shifts.displacements.routines[self.uses.scope] = (self.routine_begins, end)
        self.uses.enter_routine("")
        return end


_HANDLERS: dict[str, Callable[[RapidModule, str, int], int]] = {
    **dict.fromkeys(("const", "pers", "var"), RapidModule.take_declaration),
    **dict.fromkeys(("proc", "func", "trap"), RapidModule._take_routine),  # noqa: SLF001  # a table of its own methods
    **dict.fromkeys(("endproc", "endfunc", "endtrap"), RapidModule._leave_routine),  # noqa: SLF001
    "return": RapidModule._take_return,  # noqa: SLF001
    "local": RapidModule._take_local,  # noqa: SLF001
    "module": RapidModule._take_module,  # noqa: SLF001
}


def read_module(source: ProgramText) -> RapidModule:
    """Read a module."""
    found, uses = RapidPositions(source), TargetUses()
    frames, shifts = DeclaredFrames(found, uses), FoundShifts(Displacements(source.text))
    module = RapidModule(found, uses, frames, shifts)
    module.literal = find_literal_frames(source.text)
    module.displaced = USED.search(source.text) is not None
    module.read_module()
    module.finish_reading()
    return module
