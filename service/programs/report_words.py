"""The sentences of a report, the same on the screen and on the page."""

from collections import Counter

from service.programs.files import Refused
from service.programs.report import Report
from service.programs.result import CHANGED, LEFT, UNCHANGED

_MOST_OF_ONE = 6  # lines of one program: the rest is counted


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
    """Return what else a person must know, what many programs share first and once."""
    shared = Counter(
        warning for entry in report.entries for warning in entry.warnings if not _of_line(warning)
    )
    lines = [f"{plural(count, 'program')}: {warning}" for warning, count in shared.items() if count > 1]
    for entry in report.programs_worst_first():
        own = [f"{entry.program}: {warning}" for warning in entry.warnings if shared[warning] < 2]
        lines += own[:_MOST_OF_ONE]
        if len(own) > _MOST_OF_ONE:
            lines.append(
                f"{entry.program}: {len(own) - _MOST_OF_ONE} more such lines; the JSON file holds all."
            )
    return lines


def refusal(one: Refused) -> str:
    """Return a refusal in one piece."""
    return f"{one.file}: {one.message} {one.remedy}".rstrip()


def plural(count: int, what: str) -> str:
    """Return a count with its noun."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def _of_line(warning: str) -> bool:
    return warning.startswith("line ")
