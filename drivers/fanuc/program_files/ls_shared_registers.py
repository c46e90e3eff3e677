"""Registers that a program fills from its positions and that another program of the controller may compute.

Position registers are the controller's: a program that is called between the copy and the motion may add to them, a
macro too, and a program that runs beside (``RUN``), watches (``MONITOR``) or recovers (``RESUME_PROG``)
at any time.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath

from cellcal.drivers.fanuc.program_files.ls_computed import ADDED, ANY_PLACE, ComputedRegisters
from cellcal.drivers.fanuc.program_files.ls_statements import (
    BEFORE_NAME,
    BESIDE_WORDS,
    Statement,
    macro_of,
    motion_of,
    read_statements,
)
from cellcal.drivers.programs.file_declarations import ExternalUses
from cellcal.drivers.programs.shifts import NO_TURN, ProgramShift, Quaternion, ShiftAxes

_FILLED = re.compile(rb"PR\[ *+(?:GP *+1 *+: *+)?+(\d{1,5}+) *+\] *+=")
_CALLED = re.compile(rb"\b(CALL|AUFRUF|" + BESIDE_WORDS + rb")" + BEFORE_NAME + rb"([^\s;(,]{1,80}+)")
_ENDED = re.compile(rb"\bMONITOR[ \t]++END\b[ \t]*+([^\s;(,]{0,80}+)")
_CALLS = ("", "CALL", "AUFRUF")  # what other words start goes on while the program does
# Statements that the program may come to from elsewhere than from the line above.
_JOINED = re.compile(rb"(?:LBL|MARKE|FOR|ENDFOR|WHILE|ENDWHILE|ELSE|ELSEIF|ENDIF)\b")


def shifts_by_other_programs(
    data: bytes, registers: ComputedRegisters, external_uses: ExternalUses | None
) -> Iterator[tuple[int, ProgramShift]]:
    """Yield shifts, by position, of positions whose copy another program computes, or one not given may compute."""
    filled = {number for number, origins in registers.origins.items() if origins}
    if not filled:
        return
    computed = {} if external_uses is None else external_uses.computed
    statements = list(read_statements(data))
    calls = _OpenCalls(filled, external_uses)
    anywhere = [name for statement in statements for name in calls.names_in(statement)]
    visited: set[tuple[int, str]] = set()
    for statement in statements:
        if statement.is_motion:
            for register in motion_of(statement).register_targets:
                reason, turn = _find_reason(register, computed, calls)
                turn = None if register in registers.joints else turn
                if reason and (register, reason) not in visited:
                    visited.add((register, reason))
                    what = " ".join((f"PR[{register}]", f"({reason})"))
                    shift = ProgramShift(statement.line, what, ShiftAxes.USER_FRAME, quaternion=turn)
                    yield from ((number, shift) for number in sorted(registers.origins.get(register, ())))
        calls.follow_statement(statement, anywhere)


@dataclass
class _OpenCalls:
    """The calls of programs that are not given, of which each may compute any register."""

    filled: set[int]
    external_uses: ExternalUses | None
    since: dict[int, str] = field(default_factory=dict)  # by register: what was called since it was filled
    beside: dict[str, str] = field(default_factory=dict)  # by program: what goes on beside this one

    def __post_init__(self) -> None:
        running = {} if self.external_uses is None else self.external_uses.running
        self.beside |= {f"{by} {name}": f"{PurePath(by).name}: {name}" for name, by in running.items()}

    def names_in(self, statement: Statement) -> list[tuple[str, str]]:
        """Return the calls of a statement, of programs that are not given or call such: the word and the name."""
        if macro := macro_of(statement):
            return [("", macro)]
        found = [
            (word.decode(), name.decode("cp437").upper()) for word, name in _CALLED.findall(statement.text)
        ]
        uses = self.external_uses
        return [
            (word, name)
            for word, name in found
            if uses is None or name not in uses.given or name in uses.open_calls
        ]

    def follow_statement(self, statement: Statement, anywhere: Sequence[tuple[str, str]]) -> None:
        """Take up a statement; ``anywhere`` are the calls of the whole program."""
        if (assigned := _FILLED.match(statement.text)) is not None:
            self.since.pop(int(assigned[1]), None)
        if (ended := _ENDED.search(statement.text)) is not None:
            self.beside.pop(ended[1].decode("cp437").upper(), None)
        # a jump may bring any of the calls with it, and a condition may have passed over the copy
        for word, name in anywhere if _JOINED.match(statement.text) else self.names_in(statement):
            text = self._text_of(word, name)
            if word not in _CALLS:
                self.beside[name] = text
            else:
                self.since |= dict.fromkeys(self.filled, text)

    def find_reason(self, register: int) -> str:
        """Return which call may have computed a register, "" for none."""
        return self.since.get(register) or next(iter(self.beside.values()), "")

    def _text_of(self, word: str, name: str) -> str:
        reached = "" if self.external_uses is None else self.external_uses.open_calls.get(name, "")
        text = f"{word} {name}".strip()
        return f"{text}: {reached}" if reached else text


def _find_reason(
    register: int, computed: Mapping[str, str], calls: _OpenCalls
) -> tuple[str, Quaternion | None]:
    """Return which program computes a register, "" for none, and the turn of what it does: None for any."""
    file = computed.get(f"PR[{register}]") or computed.get(ANY_PLACE)
    if file is None and (adding := computed.get(f"PR[{register}]{ADDED}")) is not None:
        return PurePath(adding).name, NO_TURN
    return (PurePath(file).name if file is not None else calls.find_reason(register)), None
