"""Jobs that a job calls."""

import re

from cellcal.drivers.programs.called_routines import CalledRoutine, RoutineNames
from cellcal.drivers.programs.line_numbers import LineNumbers
from cellcal.drivers.yaskawa.program_files.job_capitals import in_capitals

_COMPUTED = re.compile(  # which job, a signal or a variable tells
    r"^[ \t]*(?:CALL|JUMP|PSTART)[ \t]+(IG#\([^)\n]*\)|L?[BIDS]\[?\d+\]?(?!\w))", re.MULTILINE
)
_MACRO = re.compile(
    r"^[ \t]*(MACRO\d*[ \t]+MJ#\([^)\n]*\))", re.MULTILINE
)  # only the controller's table says which
_CALLED = re.compile(r"^[ \t]*(?:CALL|JUMP|PSTART)\b[^\n']*?\bJOB:[ \t]*(\S+)", re.MULTILINE)
_NAMED = re.compile(r"^//NAME[ \t]+(\S+)", re.MULTILINE)


def called_jobs(data: bytes) -> tuple[CalledRoutine, ...]:
    """Return the calls of all jobs of a file."""
    text = in_capitals(data.decode("latin-1"))
    lines = LineNumbers(text)
    found = [CalledRoutine(lines.line_of(each.start(1)), each[1]) for each in _CALLED.finditer(text)]
    computed = (CalledRoutine(lines.line_of(each.end()), each[1], "*") for each in _COMPUTED.finditer(text))
    macros = (
        CalledRoutine(lines.line_of(each.start(1)), " ".join(each[1].split()))
        for each in _MACRO.finditer(text)
    )
    return tuple(sorted((*found, *computed, *macros)))


def own_jobs(data: bytes) -> frozenset[str]:
    """Return the names of a file's jobs."""
    return frozenset(name.upper() for name in _NAMED.findall(data.decode("latin-1")))


NAMES = RoutineNames(called_jobs, own_jobs, calls_itself=False)
