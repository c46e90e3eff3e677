"""The sentences of a report, the same on the screen and on the page."""

from service.programs.files import Refused
from service.programs.report import ProgramEntry, Report
from service.programs.result import CHANGED, LEFT, UNCHANGED

_REMARKS_SHOWN = 6  # of one program: the rest is counted


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


def problems(report: Report) -> list[str]:
    """Return what else a person must know: warnings of programs, and what in them also carries positions."""
    lines = []
    for entry in report.programs_worst_first():
        lines += [f"{entry.program}: {warning}" for warning in entry.warnings]
        lines += remark_lines(entry)
    return lines


def remark_lines(entry: ProgramEntry) -> list[str]:
    """Return a program's remarks; many of them are counted."""
    shown = [f"{entry.program}, {_at(line)}{text}" for line, text in entry.remarks[:_REMARKS_SHOWN]]
    more = len(entry.remarks) - len(shown)
    return (
        [*shown, f"{entry.program}: {more} more such lines; the JSON file holds all."] if more > 0 else shown
    )


def refusal(one: Refused) -> str:
    """Return a refusal in one piece."""
    return f"{one.file}: {one.message} {one.remedy}".rstrip()


def plural(count: int, what: str) -> str:
    """Return a count with its noun."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def _at(line: int) -> str:
    return f"line {line}: " if line else "the whole: "
