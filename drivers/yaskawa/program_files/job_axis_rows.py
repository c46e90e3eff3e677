"""Which rows of base and station axes belong to a job's points: those that the motions there name.

``MOVL C00001 BC00001 V=50.0 +MOVJ EC00001`` is what controllers write, and another number than the point's is as
good. A motion that names none goes to its point with the rows of the point's own number.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from cellcal.calibration.message import make_message
from cellcal.drivers.yaskawa.program_files.job_text import JobRow, YaskawaJob, iterate_instructions

Key = tuple[str, int]  # C or P, and its number
BASE_ROWS, STATION_ROWS = ("BC", "BP"), ("EC", "EX", "EP")  # behind a C and behind a P
_GROUP_ROWS = {"BS": BASE_ROWS, "ST": STATION_ROWS}
_SEVERAL = "its motions name several rows of base or station axes ({})"
_NO_ROW = "its base or station axes are {} in line {}, whose values the file does not hold"
_COMPUTED = "its base or station axes are {}, with which line {} computes"
_NAMES_NONE = (
    "line {place} goes there without a row of base or station axes, which then stand where line {other} or another "
    "one left them"
)
_NAMED = re.compile(r"\b(BC|BP|EC|EX|EP)X?(\d{3,5}\b|\[[^\]]*\]?)")
_TARGET = re.compile(r"(?<!\$)\b([CP])X?(\d{3,5})\b")
_MOTION = re.compile(r"S?MOV[JLCS]?")
_NAMES_ROWS = re.compile(r"\b(?:BC|BP|EC|EX|EP)X?[\d\[]")


@dataclass
class AxisRows:
    """Rows of base and station axes that the motions of a job name, by their points."""

    named: dict[tuple[Key, tuple[str, ...]], str] = field(
        default_factory=dict
    )  # C00001 and BASE_ROWS: BC00001
    reasons: dict[Key, str] = field(default_factory=dict)  # why a point's axes are not certain
    alone: dict[str, int] = field(
        default_factory=dict
    )  # rows that axes go to without the robot, and the line
    naming_none: dict[tuple[Key, tuple[str, ...]], int] = field(
        default_factory=dict
    )  # points that a motion goes to without such a row, and the line
    lines: dict[str, int] = field(default_factory=dict)  # of the first motion that names each row


def groups_without_rows(job: YaskawaJob) -> str:
    """Return the base and station groups beside the only robot of a job whose rows are absent, after one another."""
    kinds = {row.kind for row in job.rows}
    groups = [
        part.strip() for _, word, rest in job.header if word.startswith("GROUP") for part in rest.split(",")
    ]
    if sum(group.startswith("RB") for group in groups) > 1:
        return ""  # which robot they carry, the header does not say
    return ", ".join(
        group
        for group in groups
        if any(group.startswith(name) and kinds.isdisjoint(rows) for name, rows in _GROUP_ROWS.items())
    )


def axis_rows_of(job: YaskawaJob) -> AxisRows:
    """Return the rows that a job's motions name."""
    found = AxisRows()
    if not _NAMES_ROWS.search(job.instructions):  # as in nearly all
        return found
    present = {_row_name(row.kind, int(row.number)): row for row in job.rows}
    computed: dict[str, int] = {}
    for line, word, rest in iterate_instructions(job):
        if not _MOTION.fullmatch(word):
            for kind, number in _NAMED.findall(rest):
                computed.setdefault(_named_row(kind, number), line)
            continue
        target = _TARGET.search(rest.partition("+")[0])
        if target is not None:
            _take_motion(found, (target[1], int(target[2])), (line, rest), present)
        else:
            alone = {_named_row(kind, number): line for kind, number in _NAMED.findall(rest)}
            found.alone = {**alone, **found.alone}
            found.lines = {**alone, **found.lines}
    for (key, _), name in found.named.items():
        if name in computed:
            found.reasons.setdefault(key, make_message(_COMPUTED, name, computed[name]))
    _take_standing_axes(found, present)
    return found


def select_rows_alone(jobs: Iterable[YaskawaJob], beside: Iterable[JobRow]) -> dict[str, int]:
    """Return the rows that axes go to without the robot, and that no point has beside it, with the line."""
    row_names = {_row_name(row.kind, int(row.number)) for row in beside}
    named = {name: line for job in jobs for name, line in axis_rows_of(job).alone.items()}
    return {name: line for name, line in named.items() if name not in row_names}


def _take_standing_axes(found: AxisRows, present: Mapping[str, JobRow]) -> None:
    """Leave points that a motion goes to wherever other motions left the axes."""
    for (key, kinds), line in found.naming_none.items():
        own = _row_name(kinds[key[0] != "C"], key[1])
        its = present.get(found.named.get((key, kinds), own))
        lines = {own: line, **found.lines} if own in present else found.lines
        for other, at in lines.items():
            row = present.get(other)
            held = row.text if row is not None else ""
            if other[:2] in kinds and held != (its.text if its is not None else ""):
                found.reasons.setdefault(key, make_message(_NAMES_NONE, place=line, other=at))


def _take_motion(found: AxisRows, key: Key, motion: tuple[int, str], present: dict[str, JobRow]) -> None:
    line, rest = motion
    kinds_named = {BASE_ROWS if kind in BASE_ROWS else STATION_ROWS for kind, _ in _NAMED.findall(rest)}
    for kinds in (BASE_ROWS, STATION_ROWS):
        if kinds not in kinds_named:
            found.naming_none.setdefault((key, kinds), line)
    for kind, number in _NAMED.findall(rest):
        kinds, name = BASE_ROWS if kind in BASE_ROWS else STATION_ROWS, _named_row(kind, number)
        found.lines.setdefault(name, line)
        before = found.named.setdefault((key, kinds), name)
        if before != name:
            found.reasons.setdefault(key, make_message(_SEVERAL, f"{before}, {name}"))
        elif name not in present:
            found.reasons.setdefault(key, make_message(_NO_ROW, name, line))


def _named_row(kind: str, number: str) -> str:
    return _row_name(kind, int(number)) if number.isdigit() else kind + number


def _row_name(kind: str, number: int) -> str:
    return f"{'EX' if kind == 'EP' else kind}{number:05d}"
