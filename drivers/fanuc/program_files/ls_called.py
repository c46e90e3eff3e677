"""Programs that a listing calls: by CALL and RUN, and macros whose name tells of motion."""

import re

from cellcal.drivers.fanuc.program_files.ls_remarks import statements_of
from cellcal.drivers.fanuc.program_files.ls_statements import macro_of, read_statements
from cellcal.drivers.programs.called_routines import CalledRoutine, RoutineNames, tells_of_motion
from cellcal.drivers.programs.line_numbers import LineNumbers

_CALLED = re.compile(
    r"(?<![A-Za-z_])(?:(?:CALL|AUFRUF|RUN)[ \t]++"
    r"|(?:RESUME|ERROR|MAINT)_PROG[ \t]*+(?:\[[^\];]*+\][ \t]*+)?+=[ \t]*+)"
    r"(?:([A-Za-z_][\w\-]*+)(?!\[)|(S?R\[[^\];]*+\]))",
    re.I,
)
_PROGRAM = re.compile(rb"/PROG[ \t]++([^\s;]{1,80}+)")


def called_programs(data: bytes) -> tuple[CalledRoutine, ...]:
    """Return the calls of a listing, in the order of its lines."""
    line, statements = statements_of(data)
    text = statements.decode("latin-1")  # a character a byte
    lines = LineNumbers(text)
    found = [
        CalledRoutine(
            line + lines.line_of(each.start()) - 1,
            each[1] or each[2],
            "" if each[1] else "*",
        )
        for each in _CALLED.finditer(text)
    ]
    for statement in read_statements(data):
        macro = macro_of(statement)
        if macro and tells_of_motion(macro):
            found.append(CalledRoutine(statement.line, macro))
    return tuple(sorted(found))


def own_programs(data: bytes) -> frozenset[str]:
    """Return the program's name, and as a macro writes it."""
    found = _PROGRAM.search(data)
    if found is None:
        return frozenset()
    name = found[1].decode("cp437").upper()
    return frozenset((name, name.replace("_", " ")))


NAMES = RoutineNames(called_programs, own_programs, calls_itself=False)
