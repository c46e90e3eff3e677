"""Registers that a program fills from its positions and that another program of the controller may compute.

Position registers are the controller's: a program that is called between the copy and the motion may add to them.
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import PurePath

from cellcal.drivers.fanuc.program_files.ls_computed import ADDED, ANY_PLACE, ComputedRegisters
from cellcal.drivers.fanuc.program_files.ls_statements import motion_of, read_statements
from cellcal.drivers.programs.cross_file_uses import ExternalUses
from cellcal.drivers.programs.shifts import NO_TURN, ProgramShift, Quaternion, ShiftAxes

_FILLED = re.compile(rb"PR\[ *+(?:GP *+1 *+: *+)?+(\d{1,5}+) *+\] *+=")
_CALLED = re.compile(rb"\b(CALL|AUFRUF|RUN)[ \t]++(?!END\b)([^\s;(,]{1,80}+)")


def shifts_by_other_programs(
    data: bytes, registers: ComputedRegisters, external_uses: ExternalUses | None
) -> Iterator[tuple[int, ProgramShift]]:
    """Yield shifts, by position, of positions whose copy another program computes, or one not given may compute."""
    filled = {number for number, origins in registers.origins.items() if origins}
    if not filled:
        return
    computed = {} if external_uses is None else external_uses.computed
    given = frozenset[str]() if external_uses is None else external_uses.given
    calls: dict[int, str] = {}  # by register: what was called since it was filled, and is not given
    seen: set[tuple[int, str]] = set()
    for statement in read_statements(data):
        if not statement.is_motion:
            _follow_call(statement.text, filled, given, calls)
            continue
        for register in motion_of(statement).register_targets:
            reason, turn = _find_reason(register, computed, calls)
            if reason and (register, reason) not in seen:
                seen.add((register, reason))
                what = " ".join((f"PR[{register}]", f"({reason})"))
                shift = ProgramShift(statement.line, what, ShiftAxes.USER_FRAME, quaternion=turn)
                yield from ((number, shift) for number in sorted(registers.origins.get(register, ())))


def _follow_call(text: bytes, filled: set[int], given: frozenset[str], calls: dict[int, str]) -> None:
    if (assigned := _FILLED.search(text)) is not None:
        calls.pop(int(assigned[1]), None)
    for word, name in _CALLED.findall(text):
        called = name.decode("cp437").upper()
        if called not in given:
            calls |= dict.fromkeys(filled, f"{word.decode()} {called}")


def _find_reason(
    register: int, computed: Mapping[str, str], calls: Mapping[int, str]
) -> tuple[str, Quaternion | None]:
    """Return which program computes a register, "" for none, and the turn of what it does: None for any."""
    file = computed.get(f"PR[{register}]") or computed.get(ANY_PLACE)
    if file is None and (adding := computed.get(f"PR[{register}]{ADDED}")) is not None:
        return PurePath(adding).name, NO_TURN
    return (PurePath(file).name if file is not None else calls.get(register, "")), None
