"""The sentences of a report, the same on the screen and on the page."""

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from service.programs.files import Refused
from service.programs.report import Report, largest
from service.programs.result import CHANGED, LEFT, UNCHANGED

_MOST_NAMED = 3  # programs of a sentence, lines of a program: the rest is counted
_LINE = re.compile(r"line (\d+): (.*)", re.DOTALL)


def heading(report: Report) -> str:
    """Return what was done."""
    return report.title


def verdict(report: Report) -> str:
    """Return the whole in a sentence or two."""
    counts = report.counts
    told = (
        f"{plural(len(report.entries), 'program')}, {plural(report.points, 'point')}: {counts[CHANGED]} changed, "
        f"{counts[UNCHANGED]} unchanged, {counts[LEFT]} left as they were."
    )
    if counts[LEFT]:
        told += " A point that is left is not fit for this cell: teach it there."
    if report.refused:
        told += f" {plural(len(report.refused), 'file')} refused."
    return told


def accuracy(report: Report) -> str:
    """Return the largest expected error, and what it would be without the robots' models; empty if unknown."""
    expected, without = (largest(report.column(name)) for name in ("expected_m", "uncorrected_m"))
    told = []
    if math.isfinite(expected):
        told.append(f"Expected error at most {expected * 1e3:.2f} mm (k = 2).")
    if math.isfinite(without):
        told.append(f"Without the robots' models points would miss by up to {without * 1e3:.2f} mm.")
    return " ".join(told)


def problems(report: Report) -> list[str]:
    """Return what else a person must know before the programs run."""
    entries = report.programs_worst_first()
    return said_once(Note.of(entry.program, warning) for entry in entries for warning in entry.warnings)


@dataclass(frozen=True, slots=True)
class Note:
    """A sentence about a program, or a line of it."""

    program: str
    line: int  # 0: the whole
    text: str

    @classmethod
    def of(cls, program: str, warning: str) -> "Note":
        """Read a warning, which may begin with its line."""
        found = _LINE.match(warning)
        return cls(program, 0, warning) if found is None else cls(program, int(found[1]), found[2])


def said_once(notes: Iterable[Note]) -> list[str]:
    """Return sentences that name the programs and lines they are about, each sentence once."""
    by_text: defaultdict[str, defaultdict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    for note in notes:
        by_text[note.text][note.program].append(note.line)
    return [f"{_where(programs)}: {text}" for text, programs in by_text.items()]


def _where(programs: Mapping[str, Sequence[int]]) -> str:
    told = [name + _lines(lines) for name, lines in programs.items()]
    if len(told) <= _MOST_NAMED:
        return ", ".join(told)
    return f"{', '.join(told[:_MOST_NAMED])} and {plural(len(told) - _MOST_NAMED, 'more program')}"


def _lines(lines: Sequence[int]) -> str:
    known = [str(line) for line in lines if line]
    if not known:
        return ""
    more = f" and {len(known) - _MOST_NAMED} more" if len(known) > _MOST_NAMED else ""
    return f" (line{'s' if len(known) > 1 else ''} {', '.join(known[:_MOST_NAMED])}{more})"


def refusal(one: Refused) -> str:
    """Return a refusal in one piece."""
    return f"{one.file}: {one.message} {one.remedy}".rstrip()


def plural(count: int, what: str) -> str:
    """Return a count with its noun."""
    return f"{count} {what}{'' if count == 1 else 's'}"
