"""RAPID modules: targets, tools and work objects that are declared, targets inside moves, and what changes them."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from cellcal.drivers.abb.program_files.collected import Collected
from cellcal.drivers.abb.program_files.displacements import USED, WORDS, Displacements, Move
from cellcal.drivers.abb.program_files.frames_declared import FramesDeclared
from cellcal.drivers.abb.program_files.instructions import MOVES, STAR, Instruction, Target, read_instruction
from cellcal.drivers.abb.program_files.literals import (
    AGGREGATES,
    NAME,
    TARGETS,
    LiteralError,
    W,
    after_blanks,
    end_of_element,
    spelled,
)
from cellcal.drivers.abb.program_files.shifted import ShiftsFound
from cellcal.drivers.abb.program_files.unread import LIKE_A_POSITION, unread_positions
from cellcal.drivers.abb.program_files.uses import Uses
from cellcal.drivers.abb.program_files.usual import USUAL
from cellcal.drivers.abb.program_files.written import Written
from cellcal.drivers.programs.spans import Source

_BYTE_ORDER_MARK = "\xef\xbb\xbf"  # of UTF-8, byte by byte
_TOKEN = re.compile(rf'![^\n]*+|"(?:[^"\n]++|"")*+"?+|{NAME}', re.ASCII)
_DECLARED = re.compile(rf"{W}([A-Za-z]\w*+){W}({NAME}){W}(?:\{{([^{{}};]*+)\}})?+{W}(:=)?+{W}", re.ASCII)
_ASSIGNED = re.compile(
    rf"{W}(?:\{{([^{{}};]*+)\}})?+{W}((?:\.{W}\w++{W}(?:\{{[^{{}};]*+\}})?+{W}){{0,6}}+):={W}", re.ASCII
)
_NAME = re.compile(rf"{W}({NAME})", re.ASCII)
_COPIED = re.compile(
    rf"(?:(?:Offs|RelTool){W}\({W}){{0,4}}+({NAME}){W}(?:\{{[^{{}};]*+\}}{W})?+[,;\]]",
    re.ASCII | re.IGNORECASE,
)
_PARAMETERS = re.compile(rf"{W}\(((?:[^()!]++|![^\n]*+){{0,1000}}+)\)", re.ASCII)
_PARAMETER = re.compile(rf"({NAME}){W}(?:\{{[^{{}}]*+\}}{W})?+(?=[,\\|]|\Z)", re.ASCII)
_FUNCTION_NAME = re.compile(rf"{W}[A-Za-z]\w*+{W}({NAME})", re.ASCII)
_SIZES = re.compile(r"\s*\d+\s*")
_MOST_DIGITS = 9  # of an array's size
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
_ASSIGNED_TEXT = "{} is set while the program runs; that value is not read."
_FILLED_TEXT = "{} is an array without values: it is filled while the program runs."
_COMPUTED_TEXT = "{} is computed; it is not read."
_INSIDE_TEXT = "A position stands inside this statement; it is not read, and stays as it is."
_INSIDE = "it stands inside other data, or is computed in part, and is not read"
_STAR_UNKNOWN = "its coordinates are not in the file"


@dataclass
class Module:
    """A file of modules while it is read."""

    found: Collected
    shifts: ShiftsFound
    uses: Uses
    frames: FramesDeclared
    name: str = ""
    assigned: list[tuple[int, str, str]] = field(default_factory=list)  # place, name, scope
    overwritten: list[tuple[int, str, str]] = field(
        default_factory=list
    )  # by what is neither read nor a copy
    declared_local: bool = False
    local: bool = False  # the declaration that follows is its module's only
    looked_at: int = 0  # up to where the text was searched for positions inside other data
    displaced: bool = False  # moves are noted one by one, for displacements
    routine_begins: int = 0
    set_names: set[str] = field(default_factory=set)  # what is assigned as a whole
    written: Written = field(default_factory=lambda: Written.nothing(0))

    def read(self) -> None:
        """Take the whole text.

        Raises
        ------
        ProgramFileError
            A position is not understood.
        """
        text = self.found.source.text
        place = len(_BYTE_ORDER_MARK) if text.startswith(_BYTE_ORDER_MARK) else 0
        while True:
            while (usual := USUAL.match(text, place)) is not None and self._usual(usual):
                place = usual.end()
            token = _TOKEN.search(text, place)
            if token is None:
                return
            word = token[0]
            self._look_inside(place, token.start())
            if word[0] == "!":
                if "[" in word and _HOLDS_A_POSITION.search(word):
                    self.found.remark(
                        token.start(), "comment", "A comment holds a position; it stays as it is."
                    )
                place = token.end()
            elif word[0] == '"':
                place = token.end()
            else:
                place = self._word(word.lower(), token.start(), token.end())

    def _usual(self, found: re.Match[str]) -> bool:
        """Take a statement as the controller writes it; tell whether it was."""
        if found["name"] is None:
            frame = found["frame"] or "wobj0"
            self.uses.use(found["to"], found["tool"], frame)
            if self.displaced:
                self._note_move(found.start("a_move"), found["to"], -1, frame)
            return True
        row = len(self.found.names)
        if not self.found.add_usual(found):
            return False
        self.local, local = False, self.local
        self.uses.declare(found["name"], row, local=local)
        return True

    def _look_inside(self, place: int, end: int) -> None:
        """Remark a position in a statement that is not read: in a record, a call, an array of another kind."""
        text = self.found.source.text
        if place < self.looked_at or text.find("[", place, end) < 0:
            return
        stop = text.find(";", place)
        self.looked_at = stop if stop >= 0 else len(text)
        found = LIKE_A_POSITION.search(text, place, self.looked_at)
        if found is not None:
            self.found.remark(found.start(), "computed", _INSIDE_TEXT)

    def _note_move(self, place: int, name: str, row: int, frame: str | None) -> None:
        self.shifts.displacements.moves.append(Move(place, self.uses.scope, name, row, frame))

    def finish(self) -> None:
        """Remark targets that the program sets, and take away those that are seen from the flange."""
        for place in unread_positions(self.found.source.text, set(self.found.starts)):
            self.found.add_unread(f"line {self.found.source.line_of(place)}", place, _INSIDE)
        self.written = self.found.reckon_usual()
        self.uses.set_while_running |= {
            name for name in self.set_names if name in self.frames.declared or name not in self.uses.shown
        }
        for place, name, scope in self.assigned:
            if self.uses.rows_of(name, scope):
                self.found.remark(place, "computed", _ASSIGNED_TEXT.format(name))
        self.frames.drop_several()
        self.uses.resolve(self.found)
        self.shifts.bar(self.found, self.uses)

    def _word(self, word: str, start: int, end: int) -> int:
        """Take a word at statement level; return where to go on."""
        handler = _HANDLERS.get(word)
        if handler is not None:
            return handler(self, word, end)
        if word in MOVES:
            return self._instruction(word, start, end)
        if word in _REMARKED:
            self.found.remark(start, *_REMARKED[word])
        if word in _REMARKED or word in WORDS:
            self.shifts.take_word(word, (start, end), self.uses.scope)
            return end
        assigned = _ASSIGNED.match(self.found.source.text, end)
        return end if assigned is None else self._assignment(start, end, assigned)

    def _declaration(self, word: str, end: int) -> int:
        text = self.found.source.text
        declared = _DECLARED.match(text, end)
        if declared is None:
            return end
        kind, name, sizes = declared[1].lower(), spelled(declared[2]), declared[3]
        self.local, local = False, self.local
        self.declared_local = local
        if kind in ("tooldata", "wobjdata"):
            self.frames.declare(name, shown=not local and self.uses.scope.endswith("/"))
        if kind not in AGGREGATES:
            return declared.end()
        if sizes is not None:
            return self._array(kind, name, sizes, declared)
        if kind not in TARGETS:
            return self.frames.take(kind, name, declared)
        if not declared[4]:
            self._declare(name, lambda: self.found.add_untaught(name, declared.start(2)))
            return declared.end()
        return self._target(kind, name, declared.end())

    def _array(self, kind: str, name: str, sizes: str, declared: re.Match[str]) -> int:
        if not declared[4] or kind not in TARGETS:
            if kind in TARGETS:
                self.found.remark(declared.start(2), "computed", _FILLED_TEXT.format(name))
            return declared.end()
        counts = [size.strip() if _SIZES.fullmatch(size) else None for size in sizes.split(",")]
        if any(count is not None and len(count) > _MOST_DIGITS for count in counts):
            raise self.found.source.error(
                declared.start(3), f"{name} has more elements than any array.", remedy="Correct its size."
            )
        known = [None if count is None else int(count) for count in counts]
        return self._elements(kind, name, known, declared.end())

    def _elements(self, kind: str, name: str, sizes: list[int | None], place: int) -> int:
        """Take the elements of an array of any dimension, in the order in which they are written.

        A size is None where a constant or an expression says it.
        """
        text, source = self.found.source.text, self.found.source
        index: list[int] = []
        while True:
            sign = text[place : place + 1]
            if sign == "[" and len(index) < len(sizes):
                index.append(1)
                place = after_blanks(text, place + 1)
                continue
            if not index:
                return self._computed(name, place)
            place = self._element(kind, f"{name}{{{','.join(map(str, index))}}}", place)
            while text[place : place + 1] == "]" and index:
                if index[-1] != (sizes[len(index) - 1] or index[-1]):
                    raise source.error(place, f"{name} does not have the elements that it declares.")
                index.pop()
                place = after_blanks(text, place + 1)
            if not index:
                return place
            if text[place : place + 1] != ",":
                raise source.error(place, f"here should be ',' or ']' of {name}.")
            index[-1] += 1
            place = after_blanks(text, place + 1)

    def _element(self, kind: str, name: str, place: int) -> int:
        """Take one element of an array; return where the sign behind it stands."""
        text = self.found.source.text
        literal = AGGREGATES[kind].pattern.match(text, place)
        if literal is None and (end := end_of_element(text, place)) > place:
            if text[place] == "[":
                self._not_a_target(name, place, AGGREGATES[kind].error(text, place))
            else:
                self._computed(name, place)
            return end
        return after_blanks(text, self._target(kind, name, place))

    def _target(self, kind: str, name: str, place: int) -> int:
        """Take a target's value; return where it ends."""
        try:
            found = AGGREGATES[kind].match(self.found.source.text, place)
        except LiteralError as error:
            return self._not_a_target(name, place, error)
        add = self.found.add_robtarget if kind == "robtarget" else self.found.add_jointtarget
        self._declare(name, lambda: add(name, found))
        return found.end()

    def _not_a_target(self, name: str, place: int, error: LiteralError) -> int:
        if not error.computed:
            raise self.found.source.error(
                error.place, str(error), remedy="Correct it on the controller, or leave this program out."
            ) from None
        return max(self._computed(name, place), error.place)

    def _computed(self, name: str, place: int) -> int:
        """Take a target whose value only the controller knows, or another target has."""
        self.found.remark(place, "computed", _COMPUTED_TEXT.format(name))
        self.uses.declare_without_row(name)
        self._note_copy(self.found.source.text, place, name)
        return place

    def _declare(self, name: str, add: Callable[[], None]) -> None:
        row = len(self.found.names)
        add()
        self.uses.declare(name, row, local=self.declared_local)

    def _assignment(self, start: int, end: int, assigned: re.Match[str]) -> int:
        text = self.found.source.text
        bare = spelled(text[start:end])
        name = bare + (f"{{{''.join(assigned[1].split())}}}" if assigned[1] else "")
        if text[assigned.end() : assigned.end() + 1] == "[" and not assigned[2]:
            for kind in TARGETS:
                found = AGGREGATES[kind].pattern.match(text, assigned.end())
                if found is not None:
                    add = self.found.add_robtarget if kind == "robtarget" else self.found.add_jointtarget
                    add(name, found)
                    return found.end()
        if assigned[2]:
            path = "".join(assigned[2].split())
            self.shifts.take_component(start, (name, self.uses.scope), path, assigned.end())
        elif not self._note_copy(text, assigned.end(), bare):
            self.shifts.overwritten.append((name, self.uses.scope))
        part = assigned[2].partition(".")[2].strip().lower()
        if not part or part.startswith(("uframe", "oframe", "tframe")):
            self.set_names.add(bare.lower())
        self.assigned.append((start, bare, self.uses.scope))
        return assigned.end()

    def _note_copy(self, text: str, place: int, to: str) -> bool:
        """Note a target that is assigned to another, which moves go to in its place; tell whether it is one."""
        copied = _COPIED.match(text, place)
        if copied is not None:
            self.uses.copied.add((self.uses.scope, spelled(copied[1]), to))
        return copied is not None

    def _instruction(self, word: str, start: int, end: int) -> int:
        if _ASSIGNED.match(self.found.source.text, end):
            return end
        instruction = read_instruction(self.found.source, word, end)
        for part, target in enumerate(instruction.targets):
            self._moved_to(instruction, part, target, start)
        return instruction.end

    def _moved_to(self, instruction: Instruction, part: int, target: Target, start: int) -> None:
        if target.remark:
            self.found.remark(target.place, *target.remark)
        word = self.found.source.text[start : start + len(instruction.word)]
        line = self.found.source.line_of(target.place)
        name = f"{word}@{line}" + (f".{part + 1}" if part else "")
        row = -1
        if target.literal is not None:
            row = len(self.found.names)
            add = self.found.add_jointtarget if target.axes else self.found.add_robtarget
            add(name, target.literal)
            self.uses.use_row(row, instruction.tool, instruction.frame)
        elif target.name:
            self.uses.use(target.name, instruction.tool, instruction.frame)
        elif target.remark == STAR:
            self.found.add_unread(name, target.place, _STAR_UNKNOWN)
        if self.displaced:
            self._note_move(start, target.name, row, instruction.frame)
        self.shifts.take_target(target, (name, row), self.uses.scope, instruction.frame)

    def _module(self, word: str, end: int) -> int:
        named = _NAME.match(self.found.source.text, end)
        if named is None:
            return end
        self.name = self.name or spelled(named[1])
        self.uses.enter_module(spelled(named[1]))
        return named.end()

    def _routine(self, word: str, end: int) -> int:
        pattern = _FUNCTION_NAME if word == "func" else _NAME
        named = pattern.match(self.found.source.text, end)
        if named is None:
            return end
        self.local = False
        self.uses.enter_routine(spelled(named[1]))
        self.routine_begins = named.end()
        parameters = _PARAMETERS.match(self.found.source.text, named.end())
        if parameters is None:
            return named.end()
        for parameter in _PARAMETER.finditer(parameters[1]):
            self.uses.declare_parameter(spelled(parameter[1]))
        return parameters.end()

    def _local(self, word: str, end: int) -> int:
        self.local = True
        return end

    def _leave(self, word: str, end: int) -> int:
        self.shifts.displacements.routines[self.uses.scope] = (self.routine_begins, end)
        self.uses.enter_routine("")
        return end


_HANDLERS: dict[str, Callable[[Module, str, int], int]] = {
    **dict.fromkeys(("const", "pers", "var"), Module._declaration),  # noqa: SLF001  # a table of its own methods
    **dict.fromkeys(("proc", "func", "trap"), Module._routine),  # noqa: SLF001
    **dict.fromkeys(("endproc", "endfunc", "endtrap"), Module._leave),  # noqa: SLF001
    "local": Module._local,  # noqa: SLF001
    "module": Module._module,  # noqa: SLF001
}


def read_module(source: Source) -> Module:
    """Read a module."""
    found, uses = Collected(source), Uses()
    module = Module(found, ShiftsFound(Displacements(source.text)), uses, FramesDeclared(found, uses))
    module.displaced = USED.search(source.text) is not None
    module.read()
    module.finish()
    return module
