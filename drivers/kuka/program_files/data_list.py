"""KUKA data lists (.dat): taught points with the tool and base they were taught in, tools and bases of the cell."""

import re
from dataclasses import dataclass, field
from functools import lru_cache

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.drivers.kuka.program_files.collected_positions import INSIDE, KrlPositions
from cellcal.drivers.kuka.program_files.lines import (
    DECLARING,
    KrlLine,
    NamedItem,
    find_declaration,
    find_item,
    first_word,
    line_at,
    without_strings,
)
from cellcal.drivers.kuka.program_files.literals import AXIS_TYPES, KrlLiteral
from cellcal.drivers.kuka.program_files.usual import DATA_LINE, DECLARATION
from cellcal.drivers.programs.positions import NO_NUMBER, ProgramFrames
from cellcal.drivers.programs.spans import ProgramText

_FDAT = re.compile(r"\{[^{}]*\}[ \t\r]*")
_MOST_DIGITS = 9  # of a tool's or a base's number, its sign counted
_NUMBER_OF = re.compile(r"\b(TOOL|BASE)_NO\s+([+-]?\d+)", re.IGNORECASE)
_IPO_FRAME = re.compile(r"\bIPO_FRAME\s+#(\w+)", re.IGNORECASE)
_LOOKS_LIKE_A_POSITION = re.compile(r"\{[^{}]*?\b(?:X|A1)[ \t]+[-+.\d]", re.IGNORECASE)
_STRUCT = re.compile(r"\{[^{}]*+\}")
_COORDINATE = re.compile(r"\b(?:[XYZ]|A[1-6])[ \t]+[-+.\d]", re.IGNORECASE)
_GLOBAL = re.compile(r"\bGLOBAL\b", re.IGNORECASE)
_OF_CONTROLLER = re.compile(r"^[ \t]*+DEFDAT[ \t]++\$\w", re.IGNORECASE | re.MULTILINE)
_NULL_FRAME = Pose((0.0, 0.0, 0.0))

_FRAME_TEXT = "{} is a FRAME: base, offset or point, this file does not tell. It is not read as a position."
FRAME_ALONE = "it is a FRAME: base, offset or point, this file does not tell"
FRAME_SET = "it is a FRAME without status and turn that the program sets while it runs"
_TCP_TEXT = (
    "{} is moved with an external tool (IPO_FRAME #TCP): its base is at the flange. "
    "It needs [held_work] in the project."
)


@dataclass(frozen=True, slots=True)
class FrameData:
    """The contents of a point's FDAT."""

    tool: str | None
    base: str | None
    external_tool: bool


@dataclass
class DataList:
    """A data list while it is read."""

    found: KrlPositions
    types: dict[str, str] = field(default_factory=dict)
    shown: dict[str, bool] = field(default_factory=dict)  # what is declared, and whether for all modules
    taught: set[int] = field(default_factory=set)  # rows with frame data
    frame_data: dict[str, FrameData] = field(default_factory=dict)
    known_data: dict[str, FrameData] = field(default_factory=dict)  # by text: most points have the same
    undecided: list[tuple[str, KrlLiteral]] = field(
        default_factory=list
    )  # FRAMEs, which may have an FDAT below
    of_controller: bool = False  # $CONFIG.DAT and its like: frames there are the cell's, not the work's
    bases: dict[str, Pose] = field(default_factory=lambda: {"0": _NULL_FRAME})
    tools: dict[str, Pose] = field(default_factory=lambda: {"0": _NULL_FRAME})

    def read_usual(self, found: re.Match[str]) -> bool:
        """Take a line if it is one as the controller itself writes it; tell whether it is."""
        if found.lastgroup == "a_point":
            upper = found["name"].upper()
            self.types[upper], self.shown[upper] = found["kind"], False
            self.found.add_usual(found)
            return True
        if found.lastgroup == "a_frame_data":
            upper, frame_data = found["data_name"].upper(), self.known_data.get(found["data"])
            if frame_data is None:
                return False
            self.types[upper], self.shown[upper] = "FDAT", False
            if self.frame_data.setdefault(upper, frame_data) is not frame_data:
                self._store_frame_data(upper, frame_data)
            return True
        return found.lastgroup == "a_motion_data" and not _holds_a_position(found["motion_data"])

    def read_line(self, line: KrlLine) -> None:
        """Take one line."""
        text = self.found.source.text
        declared = find_declaration(text, line) if first_word(text, line) in DECLARING else None
        if declared is not None:
            self._take_declared(declared[0], declared[1], line)
        else:
            assigned = find_item(text, line.start, line.end)
            if (
                assigned is not None
                and assigned.value is not None
                and text[assigned.value : line.end][:1] == "{"
            ):
                self._take_assigned(assigned, line)
            else:
                remark_hidden_positions(self.found, line, line.start)
        remark_comment(self.found, line)

    def to_frames(self) -> ProgramFrames:
        """Return the tools and bases that stand here; number 0 is the null frame of the language."""
        return ProgramFrames(base_frame=self.bases, flange_tip=self.tools)

    def frames_alone(self) -> dict[str, Pose | None]:
        """Return the FRAMEs that are no taught points, by their names in capitals."""
        return {name.upper(): self.found.pose_of(literal) for name, literal in self.undecided}

    def finish_reading(self) -> None:
        """Give points their tool and base, and drop declarations whose value came later."""
        for name, literal in self.undecided:
            if name_of_data(name) in self.frame_data:
                self.found.add_position(name, literal)
            else:
                self.found.add_remark(literal.start, "computed", make_message(_FRAME_TEXT, name))
                if not self.of_controller:
                    self.found.add_unread(name, literal.start, FRAME_ALONE)
        for row, name in enumerate(self.found.names):
            data = self.frame_data.get(name_of_data(name))
            if data is None:
                continue
            self.taught.add(row)
            self.found.user_frames[row], self.found.tools[row] = data.base, data.tool
            if data.external_tool and self.found.kinds[row] != "joints":
                self._external_tool(row, name, data)

    def _external_tool(self, row: int, name: str, data: FrameData) -> None:
        why = "it is moved with an external tool (IPO_FRAME #TCP)"
        if data.tool is None or data.base is None or self.found.kinds[row] != "cartesian":
            self.found.drop_coordinates(row, why)
        else:
            self.found.hold_work(row, why)
        self.found.add_remark(self.found.starts[row], "foreign", make_message(_TCP_TEXT, name))

    def _take_declared(self, kind: str, place: int, line: KrlLine) -> None:
        text = self.found.source.text
        shown = _GLOBAL.search(text, line.start, place) is not None
        while place < line.end:
            name = find_item(text, place, line.end)
            if name is None:
                return
            self.types[name.name.upper()] = kind
            self.shown[name.name.upper()] = shown
            place = name.end
            if name.value is not None:
                place = self._take_value(kind, name, line)
            elif name.index is None and kind not in ("FRAME", "FDAT"):
                self.found.add_untaught(name.full_name, line.start)

    def _take_value(self, kind: str, name: NamedItem, line: KrlLine) -> int:
        """Take the value of a declared name; return where the next name begins."""
        text = self.found.source.text
        assert name.value is not None
        if text[name.value : line.end][:1] != "{":
            raise self.found.source.error_at(name.value, "the value of a position opens with '{'.")
        if kind == "FDAT":
            self._frame_data(name, line)
            return line.end
        is_last = not self._is_nested(name.value, line)
        literal = self.found.read_literal(name.value, line.end, is_last=is_last)
        if (
            literal is None
        ):  # NaN where a computation went wrong, the name of a number, or no bracket at its end
            why = NO_NUMBER if not is_last else self.found.why_unread(name.value, line.end)
            self.found.add_unread(name.full_name, name.value, why)
            close = text.find("}", name.value, line.end)
            comma = text.find(",", max(close, name.value), line.end) if close >= 0 else -1
            return line.end if comma < 0 else comma + 1
        if literal.axes != (kind in AXIS_TYPES):
            raise self.found.source.error_at(
                name.value,
                make_message("{full_name} is declared as {kind}.", full_name=name.full_name, kind=kind),
            )
        self._take_literal(kind, name, literal)
        return self._offset_after(literal, line)

    def _offset_after(self, literal: KrlLiteral, line: KrlLine) -> int:
        rest = self.found.source.text[literal.end : line.end]
        bare = rest.lstrip(" \t\r")
        if bare and bare[0] != ",":
            place = line.end - len(bare)
            raise self.found.source.error_at(place, "after a position, the line should end.")
        return line.end if not bare else line.end - len(bare) + 1

    def _take_assigned(self, name: NamedItem, line: KrlLine) -> None:
        kind = self.types.get(name.name.upper(), "")
        is_frame_table = name.name.upper() in ("TOOL_DATA", "BASE_DATA")
        assert name.value is not None
        if kind == "FDAT":
            self._frame_data(name, line)
        elif name.name[0] == "$" and not kind:
            return  # work spaces and the like of the controller, with fields of their own
        elif (
            kind
            or is_frame_table
            or _LOOKS_LIKE_A_POSITION.match(self.found.source.text, name.value, line.end)
        ):
            if not kind and not is_frame_table and self._is_nested(name.value, line):
                self.found.add_remark(
                    line.start,
                    "computed",
                    make_message(
                        "{full_name} holds a position inside; it is not read.", full_name=name.full_name
                    ),
                )
                add_hidden_positions(self.found, line, name.value)
                return
            literal = self.found.read_literal(name.value, line.end)
            if literal is not None:
                self._take_literal(kind, name, literal)
                self._offset_after(literal, line)
            elif kind and not is_frame_table:
                self.found.add_unread(name.full_name, name.value, NO_NUMBER)
        else:
            remark_hidden_positions(self.found, line, name.value)

    def _is_nested(self, place: int, line: KrlLine) -> bool:
        return "{" in without_strings(self.found.source.text[place + 1 : line.end])

    def _take_literal(self, kind: str, name: NamedItem, literal: KrlLiteral) -> None:
        upper = name.name.upper()
        table = {"TOOL_DATA": self.tools, "BASE_DATA": self.bases}.get(upper)
        if table is not None:
            pose = self.found.pose_of(literal)
            if pose is not None and name.index is not None:
                table[name.index.strip()] = pose
        elif not literal.axes and (kind == "FRAME" or (not kind and not any(literal.state))):
            self.undecided.append((name.full_name, literal))
        else:
            self.found.add_position(name.full_name, literal)

    def _frame_data(self, name: NamedItem, line: KrlLine) -> None:
        source, place = self.found.source, name.value or line.start
        written = source.text[place : line.end]
        if (known_frames := self.known_data.get(written)) is not None:
            self._store_frame_data(name.full_name.upper(), known_frames)
            return
        code = without_strings(written)
        if _FDAT.fullmatch(code) is None:
            raise source.error_at(
                place,
                make_message("{full_name} is not understood.", full_name=name.full_name),
                remedy="It says tool and base of a point.",
            )
        frame_numbers = {which.upper(): number for which, number in _NUMBER_OF.findall(code)}
        if any(len(number) > _MOST_DIGITS for number in frame_numbers.values()):
            raise source.error_at(
                place, "no controller has a tool or base of this number.", remedy="Correct the number."
            )
        numbers = {which: int(number) for which, number in frame_numbers.items()}
        ipo_frame = _IPO_FRAME.search(code)
        mode = ipo_frame[1].upper() if ipo_frame else "BASE"
        if mode not in ("BASE", "TCP"):
            raise source.error_at(
                place,
                make_message("IPO_FRAME #{mode} is not known.", mode=mode),
                remedy="There are #BASE and #TCP.",
            )
        data = FrameData(_number_text(numbers.get("TOOL")), _number_text(numbers.get("BASE")), mode == "TCP")
        self.known_data[written] = data
        self._store_frame_data(name.full_name.upper(), data)

    def _store_frame_data(self, upper: str, data: FrameData) -> None:
        """Keep the data of a name; two that differ (lists copied together by hand) tell no tool and no base."""
        had = self.frame_data.setdefault(upper, data)
        if had != data:
            self.frame_data[upper] = FrameData(None, None, had.external_tool or data.external_tool)


def read_data_list(source: ProgramText) -> DataList:
    """Read a data list."""
    data = DataList(KrlPositions(source), of_controller=_OF_CONTROLLER.search(source.text) is not None)
    for found in DATA_LINE.finditer(source.text):
        if not data.read_usual(found) and (line := line_at(source.text, found.start())):
            data.read_line(line)
    data.finish_reading()
    return data


def declared_names(text: str) -> dict[str, bool]:
    """Return what a data list declares, and whether for all modules: all that other files need of it, quickly."""
    declares: dict[str, bool] = {}
    for found in DECLARATION.finditer(text):
        if name := found["point"] or found["data"]:
            declares[name.upper()] = False
        elif found["code"] and (line := line_at(text, found.start())):
            declares |= _declared_names(text, line)
    return declares


def _declared_names(text: str, line: KrlLine) -> dict[str, bool]:
    declares: dict[str, bool] = {}
    declared = find_declaration(text, line) if first_word(text, line) in DECLARING else None
    if declared is None:
        return declares
    kind, place = declared
    shown = _GLOBAL.search(text, line.start, place) is not None
    while place < line.end and (name := find_item(text, place, line.end)) is not None:
        declares[name.name.upper()] = shown
        place = name.end
        if name.value is not None:
            close = -1 if kind == "FDAT" else text.find("}", name.value, line.end)
            comma = -1 if close < 0 else text.find(",", close, line.end)
            place = line.end if comma < 0 else comma + 1
    return declares


def name_of_data(point: str) -> str:
    """Return the name of a point's FDAT: ``FP1`` of ``XP1``."""
    upper = point.upper()
    return "F" + upper[1:] if upper.startswith("X") else ""


def remark_hidden_positions(found: KrlPositions, line: KrlLine, place: int) -> None:
    """Remark a struct with coordinates where none is expected."""
    text = found.source.text
    brace = text.find("{", place, line.end)
    if brace >= 0 and _holds_a_position(text[brace : line.end]):
        found.add_remark(line.start, "computed", "A position stands inside this statement; it is not read.")
        add_hidden_positions(found, line, brace)


def add_hidden_positions(found: KrlPositions, line: KrlLine, place: int) -> None:
    """Take structs with coordinates inside other data as positions that are left."""
    code = without_strings(found.source.text[place : line.end])
    for struct in _STRUCT.finditer(code):
        if _COORDINATE.search(struct[0]):
            at = place + struct.start()
            found.add_unread(f"line {found.source.line_of(at)}", at, INSIDE)


@lru_cache(maxsize=64)  # the motion data of most points are the same
def _holds_a_position(code: str) -> bool:
    return _LOOKS_LIKE_A_POSITION.search(without_strings(code)) is not None


def remark_comment(found: KrlPositions, line: KrlLine) -> None:
    """Remark a comment that holds a position."""
    if "{" in line.comment and _LOOKS_LIKE_A_POSITION.search(line.comment):
        found.add_remark(line.end, "comment", "A comment holds a position; it stays as it is.")


def _number_text(number: int | None) -> str | None:
    return None if number is None or number < 0 else str(number)
