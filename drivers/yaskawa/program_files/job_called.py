"""Jobs that a job calls."""

import re

from cellcal.drivers.programs.called_routines import CalledRoutine, LineNumbers, RoutineNames
from cellcal.drivers.yaskawa.program_files.job_text import in_capitals

_CALLED = re.compile(r"^[ \t]*(?:CALL|JUMP|PSTART)\b[^\n']*?\bJOB:[ \t]*(\S+)", re.MULTILINE)
_NAMED = re.compile(r"^//NAME[ \t]+(\S+)", re.MULTILINE)


def called_jobs(data: bytes) -> tuple[CalledRoutine, ...]:
    """Return the calls of all jobs of a file."""
    text = in_capitals(data.decode("latin-1"))
    lines = LineNumbers(text)
    return tuple(CalledRoutine(lines.line_at(each.start(1)), each[1]) for each in _CALLED.finditer(text))


def own_jobs(data: bytes) -> frozenset[str]:
    """Return the names of a file's jobs."""
    return frozenset(name.upper() for name in _NAMED.findall(data.decode("latin-1")))


NAMES = RoutineNames(called_jobs, own_jobs)
