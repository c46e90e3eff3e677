r"""Modules of RAPID: data, routines, and exactly the instructions that CellcalServer and CellcalStream use.

Imitates
    Loading of a module into a task of an ABB controller.
Source
    ABB 3HAC050946-001 (RAPID kernel), 3HAC050917-001 (instructions, functions and data types), as public copies and
    summaries give them; deploy/controller_setup/abb.
Modelled
    PERS and VAR of the kinds num, intnum, jointtarget and tooldata; PROC, TRAP, assignment, IF, WHILE, WaitUntil with
    \PollRate, MoveAbsJ with \NoEOffs, \T, fine and \WObj, CONNECT, IDelete, ITimer, StopMove, ClearPath,
    StartMove, ExitCycle, WaitTime, EGMReset, EGMGetId, EGMSetupUC of ROB_1 for joints, EGMStreamStart, calls without
    arguments.
Not modelled
    Every other instruction: a module with it is refused with file and line.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from cellcal.fake_devices.program_text.expressions import (
    RAPID,
    Expression,
    ProgramTextError,
    Reference,
    Value,
    parse_expression,
    parse_reference,
)
from cellcal.fake_devices.program_text.lines import SourceLines

KINDS = ("num", "intnum", "jointtarget", "tooldata", "egmident")
_DATA = re.compile(rf"(PERS|VAR)\s+({'|'.join(KINDS)})\s+(\w+)(?:\s*:=\s*(.*?))?\s*;\Z", re.IGNORECASE)
_MOVE = re.compile(
    r"MoveAbsJ\s+(\w+)\s+\\NoEOffs\s*,\s*v100\s+\\T\s*:=\s*(\w+)\s*,\s*fine\s*,\s*(\w+)\s+\\WObj\s*:=\s*wobj0\Z",
    re.IGNORECASE,
)
_FIRST = {
    "num": 0.0,
    "intnum": 0.0,
    "egmident": 0.0,
    "jointtarget": [[0.0] * 6, [0.0] * 6],
    "tooldata": None,
}


@dataclass(frozen=True)
class RapidInstruction:
    """One instruction. ``kind`` says what the other fields hold."""

    kind: str
    line: int
    expression: Expression | None = None
    target: Reference | None = None
    names: tuple[str, ...] = ()
    body: tuple["RapidInstruction", ...] = ()
    otherwise: tuple["RapidInstruction", ...] = ()


@dataclass(frozen=True)
class Datum:
    """Data of a module. PERS outlives the program; VAR gets its first value anew with the program pointer at main."""

    kind: str
    is_persistent: bool
    name: str  # as it is written
    first: Value


@dataclass(frozen=True)
class ExecutedModule:
    """Data and routines by their names in capitals."""

    file: str
    name: str
    data: dict[str, Datum]
    procedures: dict[str, tuple[RapidInstruction, ...]]
    traps: dict[str, tuple[RapidInstruction, ...]]


def read_module(path: Path) -> ExecutedModule:
    """Read a module; its refusals name file and line."""
    return parse_module(path.name, path.read_text(encoding="ascii"))


def parse_module(file: str, text: str) -> ExecutedModule:
    """Read the text of a module."""
    reader = _Reader(file, text)
    number, line = reader.take_line()
    head = re.fullmatch(r"MODULE\s+(\w+)", line, re.IGNORECASE)
    if head is None:
        raise reader.refusal(number, line)
    module = ExecutedModule(file, head[1], {}, {}, {})
    while True:
        number, line = reader.take_line()
        if line.upper() == "ENDMODULE":
            return module
        _read_declaration(reader, module, number, line)


def read_module_with_stream(path: Path, stream: Path) -> ExecutedModule:
    """Read a module with that of a stream, which its main calls before the loop, as the set-up page says."""
    lines = path.read_text(encoding="ascii").splitlines()
    loop = next(k for k, line in enumerate(lines) if line.strip().upper() == "WHILE TRUE DO")
    module = parse_module(path.name, "\n".join(["", *lines[:loop], "    StartCellcalStream;", *lines[loop:]]))
    beside = read_module(stream)
    return replace(module, data=module.data | beside.data, procedures=module.procedures | beside.procedures)


def _read_declaration(reader: "_Reader", module: ExecutedModule, number: int, line: str) -> None:
    declared = _DATA.match(line)
    procedure = re.fullmatch(r"PROC\s+(\w+)\s*\(\s*\)", line, re.IGNORECASE)
    trap = re.fullmatch(r"TRAP\s+(\w+)", line, re.IGNORECASE)
    if declared is not None:
        kind = declared[2].lower()
        first = _FIRST[kind] if declared[4] is None else parse_value(declared[4])
        if not fits(kind, first):
            raise reader.refusal(number, line, f"the value is no {kind}")
        persistent = declared[1].upper() == "PERS"
        module.data[declared[3].upper()] = Datum(kind, persistent, declared[3], first)
    elif procedure is not None:
        module.procedures[procedure[1].upper()] = reader.read_body("ENDPROC")[0]
    elif trap is not None:
        module.traps[trap[1].upper()] = reader.read_body("ENDTRAP")[0]
    else:
        raise reader.refusal(number, line)


def parse_value(text: str) -> Value:
    """Return a number, TRUE or FALSE, or a list of such values; None where the text is none."""
    word = text.strip()
    if word.startswith("[") and word.endswith("]"):
        parts = [parse_value(part) for part in _split_list(word[1:-1])]
        return None if any(part is None for part in parts) else parts
    if word.upper() in ("TRUE", "FALSE"):
        return word.upper() == "TRUE"
    return float(word) if re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", word) else None


def _split_list(text: str) -> list[str]:
    parts, depth = [""], 0
    for letter in text:
        depth += (letter == "[") - (letter == "]")
        if letter == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def write_value(value: Value) -> str:
    """Return a value as the controller writes it."""
    if isinstance(value, bool):
        return "TRUE" if value else "FALSE"
    if isinstance(value, list):
        return f"[{','.join(map(write_value, value))}]"
    return "9E+09" if value == 9e9 else f"{value:.7g}"


def fits(kind: str, value: Value) -> bool:
    """Return whether a value is of a kind of data."""
    if kind in ("num", "intnum", "egmident"):
        return isinstance(value, float)
    if kind == "jointtarget":
        return _has_shape(value, [6, 6])
    return (isinstance(value, list) and len(value) == 3 and isinstance(value[0], bool)) or value is None


def _has_shape(value: Value, sizes: list[int]) -> bool:
    return (
        isinstance(value, list)
        and len(value) == len(sizes)
        and all(
            isinstance(part, list) and len(part) == size and all(isinstance(each, float) for each in part)
            for part, size in zip(value, sizes, strict=True)
        )
    )


class _Reader(SourceLines):
    """Lines without remarks, and blocks of them; an instruction ends with its line."""

    def __init__(self, file: str, text: str) -> None:
        super().__init__(file, text, remark="!")

    def read_body(self, *ends: str) -> tuple[tuple[RapidInstruction, ...], str]:
        """Read instructions up to a line that closes them; return which one it was."""
        body: list[RapidInstruction] = []
        while True:
            number, line = self.take_line()
            if line.upper() in ends:
                return tuple(body), line.upper()
            try:
                body.append(self._read_instruction(number, line))
            except ProgramTextError as problem:
                raise self.locate_refusal(number, line, problem) from problem

    def _read_instruction(self, number: int, line: str) -> RapidInstruction:
        for pattern, make in _BLOCKS.items():
            if (found := pattern.fullmatch(line)) is not None:
                return make(self, number, found)
        if not line.endswith(";"):
            raise self.refusal(number, line)
        for pattern, build in _INSTRUCTIONS.items():
            if (found := pattern.fullmatch(line[:-1].strip())) is not None:
                return build(number, found)
        raise self.refusal(number, line)


def _read_if(reader: _Reader, number: int, found: re.Match[str]) -> RapidInstruction:
    body, end = reader.read_body("ELSE", "ENDIF")
    otherwise = reader.read_body("ENDIF")[0] if end == "ELSE" else ()
    return RapidInstruction("if", number, _expression(found[1]), body=body, otherwise=otherwise)


def _read_while(reader: _Reader, number: int, found: re.Match[str]) -> RapidInstruction:
    return RapidInstruction("while", number, _expression(found[1]), body=reader.read_body("ENDWHILE")[0])


def _expression(text: str) -> Expression:
    return parse_expression(text, RAPID)


def _capitals(found: re.Match[str]) -> tuple[str, ...]:
    return tuple(str(word).upper() for word in found.groups())


def _read_move(number: int, found: re.Match[str]) -> RapidInstruction:
    return RapidInstruction("move", number, names=_capitals(found))


def _read_wait(number: int, found: re.Match[str]) -> RapidInstruction:
    return RapidInstruction("wait", number, _expression(found[1]), names=(found[2] or "0.1",))


_BLOCKS: dict[re.Pattern[str], Callable[[_Reader, int, re.Match[str]], RapidInstruction]] = {
    re.compile(r"IF\s+(.*)\s+THEN", re.IGNORECASE): _read_if,
    re.compile(r"WHILE\s+(.*)\s+DO", re.IGNORECASE): _read_while,
}
_INSTRUCTIONS: dict[re.Pattern[str], Callable[[int, re.Match[str]], RapidInstruction]] = {
    re.compile(pattern, re.IGNORECASE): make
    for pattern, make in (
        (_MOVE.pattern.removesuffix(r"\Z"), _read_move),
        (r"WaitUntil\s+(.*?)(?:\s*\\PollRate\s*:=\s*(\d*\.?\d+))?", _read_wait),
        (
            r"CONNECT\s+(\w+)\s+WITH\s+(\w+)",
            lambda n, m: RapidInstruction("connect", n, names=(m[1].upper(), m[2].upper())),
        ),
        (r"IDelete\s+(\w+)", lambda n, m: RapidInstruction("delete", n, names=(m[1].upper(),))),
        (
            r"ITimer\s+(.+),\s*(\w+)",
            lambda n, m: RapidInstruction("timer", n, _expression(m[1]), names=(m[2].upper(),)),
        ),
        (r"WaitTime\s+(.*)", lambda n, m: RapidInstruction("pause", n, _expression(m[1]))),
        (
            r"(EGMReset|EGMGetId)\s+(\w+)",
            lambda n, m: RapidInstruction(m[1].lower(), n, names=(m[2].upper(),)),
        ),
        (
            r"EGMSetupUC\s+ROB_1\s*,\s*(\w+)\s*,\s*\"default\"\s*,\s*\"(\w+)\"\s+\\Joint",
            lambda n, m: RapidInstruction("egmsetupuc", n, names=(m[1].upper(), m[2])),
        ),
        (
            r"EGMStreamStart\s+(\w+)\s+\\SampleRate\s*:=\s*4",
            lambda n, m: RapidInstruction("egmstreamstart", n, names=(m[1].upper(),)),
        ),
        (r"(StopMove|ClearPath|StartMove|ExitCycle)", lambda n, m: RapidInstruction(m[1].lower(), n)),
        (
            r"(\w+(?:\.\w+)?)\s*:=\s*(.*)",
            lambda n, m: RapidInstruction("assign", n, _expression(m[2]), parse_reference(m[1], RAPID)),
        ),
        (r"(\w+)", lambda n, m: RapidInstruction("call", n, names=(m[1].upper(),))),
    )
}
