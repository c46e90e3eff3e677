"""Sources of KRL: routines and their statements, for exactly the statements that CELLCAL and its parts use.

Imitates
    The translation of .SRC and of a data list on a KUKA controller.
Source
    KUKA KSS 8.x, programming in KRL; deploy/controller_setup/kuka.
Modelled
    DEF, DECL INT, assignment, IF, FOR, LOOP, WAIT FOR, WAIT SEC, PTP, BAS with #INITMOV and #TOOL, INTERRUPT DECL,
    ON and OFF, BRAKE, RESUME, RETURN, HALT, calls without arguments, RSI_CREATE with a file and TRUE, RSI_ON with
    #RELATIVE; GLOBAL variables of the kinds INT, BOOL and E6AXIS.
Not modelled
    Every other statement: a source with it is refused with file and line.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cellcal.fake_devices.program_text.expressions import (
    KRL,
    Expression,
    ProgramTextError,
    Reference,
    Value,
    parse_expression,
    parse_reference,
)
from cellcal.fake_devices.program_text.lines import SourceLines

_ASSIGNED = re.compile(r"(\$?[A-Za-z_][\w$.]*(?:\[[^\]]*\])?)\s*=(?!=)(.*)\Z")
_CALLED = re.compile(r"([A-Za-z_]\w*)\s*\(\s*\)\Z")
_GLOBAL = re.compile(r"(?:DECL\s+)?GLOBAL\s+(INT|BOOL|E6AXIS)\s+([A-Za-z_]\w*)\s*=\s*(.*)\Z", re.IGNORECASE)
_MEMBER = re.compile(r"([AE][1-6])\s+([-+]?\d+\.?\d*(?:[eE][-+]?\d+)?)\Z", re.IGNORECASE)
AXIS_MEMBERS = tuple(f"{letter}{axis}" for letter in "AE" for axis in range(1, 7))


@dataclass(frozen=True)
class KrlStatement:
    """One line. ``kind`` says what the other fields hold."""

    kind: str
    line: int
    expression: Expression | None = None
    target: Reference | None = None
    name: str = ""
    number: int = 0
    body: tuple["KrlStatement", ...] = ()


@dataclass(frozen=True)
class KrlSource:
    """The routines of one file by their names in capitals; the first is the program."""

    file: str
    routines: dict[str, tuple[KrlStatement, ...]]

    @property
    def main(self) -> str:
        """Name of the program."""
        return next(iter(self.routines))


@dataclass(frozen=True)
class GlobalVariable:
    """A variable of a data list."""

    kind: str
    value: Value


def read_source(path: Path) -> KrlSource:
    """Read a .SRC; its refusals name file and line."""
    return parse_source(path.name, path.read_text(encoding="ascii"))


def parse_source(file: str, text: str) -> KrlSource:
    """Read the text of a .SRC."""
    reader = _Reader(file, text)
    routines: dict[str, tuple[KrlStatement, ...]] = {}
    while reader.has_more:
        number, line = reader.take_line()
        found = re.fullmatch(r"DEF\s+([A-Za-z_]\w*)\s*\(\s*\)", line, re.IGNORECASE)
        if found is None:
            raise reader.refusal(number, line)
        routines[found[1].upper()] = reader.read_body("END")
    if not routines:
        raise ProgramTextError(f"{file} holds no DEF")
    return KrlSource(file, routines)


def read_source_with_sensor(path: Path, sensor: Path) -> KrlSource:
    """Read a .SRC with the lines of another that switch a sensor on, put together as the set-up page says.

    The lines from RSI_CREATE to the last ENDIF stand behind the first motion, with their declarations.
    """
    lines, added = (
        path.read_text(encoding="ascii").splitlines(),
        sensor.read_text(encoding="ascii").splitlines(),
    )
    words = [line.strip().upper() for line in added]
    first = next(k for k, word in enumerate(words) if "RSI_CREATE(" in word)
    last = len(words) - 1 - words[::-1].index("ENDIF")
    behind = next(k for k, line in enumerate(lines) if line.strip().upper() == "PTP $AXIS_ACT")
    head = next(k for k, line in enumerate(lines) if line.strip().upper().startswith("DEF "))
    declared = [line for line, word in zip(added, words, strict=True) if word.startswith("DECL ")]
    both = [*lines[: head + 1], *declared, *lines[head + 1 : behind + 1], *added[first : last + 1]]
    return parse_source(path.name, "\n".join([*both, *lines[behind + 1 :]]))


def read_lines(path: Path) -> KrlSource:
    """Read lines that stand within a routine of the controller, such as the submit interpreter's."""
    return parse_lines(path.name, path.read_text(encoding="ascii"))


def parse_lines(file: str, text: str) -> KrlSource:
    """Read the text of such lines."""
    return KrlSource(file, {"LINES": _Reader(file, f"{text}\nEND").read_body("END")})


def read_globals(path: Path) -> dict[str, GlobalVariable]:
    """Read the GLOBAL variables of a data list, by their names in capitals."""
    return parse_globals(path.name, path.read_text(encoding="ascii"))


def parse_globals(file: str, text: str) -> dict[str, GlobalVariable]:
    """Read the text of a data list."""
    found: dict[str, GlobalVariable] = {}
    reader = _Reader(file, text)
    while reader.has_more:
        number, line = reader.take_line()
        declared = _GLOBAL.match(line)
        value = None if declared is None else _first_value(declared[1].upper(), declared[3].strip())
        if declared is None or value is None:
            raise reader.refusal(number, line)
        found[declared[2].upper()] = GlobalVariable(declared[1].upper(), value)
    return found


def _first_value(kind: str, text: str) -> Value:
    if kind == "INT":
        return int(text) if re.fullmatch(r"-?\d+", text) else None
    if kind == "BOOL":
        return {"TRUE": True, "FALSE": False}.get(text.upper())
    return parse_axes(text)


def parse_axes(text: str) -> dict[str, float] | None:
    """Return the members of an E6AXIS that are written; None where it is none. The others have no value."""
    inside = re.fullmatch(r"\{(?:\s*E6AXIS\s*:)?\s*(.*?)\s*\}", text.strip(), re.IGNORECASE)
    members = [_MEMBER.match(part.strip()) for part in inside[1].split(",")] if inside else [None]
    if any(member is None for member in members):
        return None
    return {member[1].upper(): float(member[2]) for member in members if member is not None}


class _Reader(SourceLines):
    """Lines without remarks, and blocks of them."""

    def __init__(self, file: str, text: str) -> None:
        super().__init__(file, text, remark=";", unread="&")

    def read_body(self, end: str) -> tuple[KrlStatement, ...]:
        """Read statements up to the line that closes them."""
        body: list[KrlStatement] = []
        while self.has_more:
            number, line = self.take_line()
            if line.upper() == end:
                return tuple(body)
            try:
                body.append(self._read_statement(number, line))
            except ProgramTextError as problem:
                raise self.locate_refusal(number, line, problem) from problem
        raise ProgramTextError(f"{self.file}: {end} is missing")

    def _read_statement(self, number: int, line: str) -> KrlStatement:
        for pattern, make in _FORMS.items():
            found = pattern.match(line)
            if found is not None:
                return make(self, number, found)
        raise self.refusal(number, line)


def _expression(text: str) -> Expression:
    return parse_expression(text, KRL)


def _read_for(reader: _Reader, number: int, found: re.Match[str]) -> KrlStatement:
    first, last = int(found[2]), int(found[3])
    counted = Reference(found[1].upper(), _expression(str(first)), "")
    return KrlStatement("for", number, target=counted, number=last, body=reader.read_body("ENDFOR"))


def _read_interrupt(_reader: _Reader, number: int, found: re.Match[str]) -> KrlStatement:
    return KrlStatement("declare", number, _expression(found[2]), name=found[3].upper(), number=int(found[1]))


def _read_sensor_context(_reader: _Reader, number: int, found: re.Match[str]) -> KrlStatement:
    counted = parse_reference(found[3], KRL)
    numbered = KrlStatement("number", number, target=counted)  # which context it is
    return KrlStatement(
        "rsi_create", number, target=parse_reference(found[1], KRL), name=found[2], body=(numbered,)
    )


def _read_assignment(_reader: _Reader, number: int, found: re.Match[str]) -> KrlStatement:
    return KrlStatement("assign", number, _expression(found[2]), parse_reference(found[1], KRL))


_FORMS: dict[re.Pattern[str], Callable[[_Reader, int, re.Match[str]], KrlStatement]] = {
    re.compile(pattern, re.IGNORECASE): make
    for pattern, make in (
        (
            r"DECL\s+INT\s+([A-Z_]\w*(?:\s*,\s*[A-Z_]\w*)*)\Z",
            lambda _r, n, m: KrlStatement("local", n, name=m[1].upper()),
        ),
        (
            r"([A-Z_]\w*)\s*=\s*RSI_CREATE\(\"([^\"]+)\"\s*,\s*([A-Z_]\w*)\s*,\s*TRUE\)\Z",
            _read_sensor_context,
        ),
        (
            r"([A-Z_]\w*)\s*=\s*RSI_ON\(#RELATIVE\)\Z",
            lambda _r, n, m: KrlStatement("rsi_on", n, target=parse_reference(m[1], KRL)),
        ),
        (r"INTERRUPT\s+DECL\s+(\d+)\s+WHEN\s+(.*)\s+DO\s+([A-Z_]\w*)\s*\(\s*\)\Z", _read_interrupt),
        (r"INTERRUPT\s+(ON|OFF)\s+(\d+)\Z", lambda _r, n, m: KrlStatement(m[1].lower(), n, number=int(m[2]))),
        (r"BAS\s*\(\s*#INITMOV\s*,\s*0\s*\)\Z", lambda _r, n, _m: KrlStatement("initmov", n)),
        (r"BAS\s*\(\s*#TOOL\s*,(.*)\)\Z", lambda _r, n, m: KrlStatement("tool", n, _expression(m[1]))),
        (r"PTP\s+(\S+)\Z", lambda _r, n, m: KrlStatement("ptp", n, _expression(m[1]))),
        (r"WAIT\s+FOR\s+(.*)\Z", lambda _r, n, m: KrlStatement("wait for", n, _expression(m[1]))),
        (r"WAIT\s+SEC\s+(.*)\Z", lambda _r, n, m: KrlStatement("wait sec", n, _expression(m[1]))),
        (r"LOOP\Z", lambda r, n, _m: KrlStatement("loop", n, body=r.read_body("ENDLOOP"))),
        (
            r"IF\s+(.*)\s+THEN\Z",
            lambda r, n, m: KrlStatement("if", n, _expression(m[1]), body=r.read_body("ENDIF")),
        ),
        (r"FOR\s+([A-Z_]\w*)\s*=\s*(\d+)\s+TO\s+(\d+)\Z", _read_for),
        (r"(BRAKE|RESUME|RETURN|HALT)\Z", lambda _r, n, m: KrlStatement(m[1].lower(), n)),
        (_CALLED.pattern, lambda _r, n, m: KrlStatement("call", n, name=m[1].upper())),
        (_ASSIGNED.pattern, _read_assignment),
    )
}
