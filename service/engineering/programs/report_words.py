"""The sentences of a report, the same on the screen, in English, and on the page."""

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from cellcal.service.engineering.programs.files import Refused
from cellcal.service.engineering.programs.report import Report, largest
from cellcal.service.engineering.programs.report_texts import Language, counted
from cellcal.service.engineering.programs.result import CHANGED, LEFT, UNCHANGED
from cellcal.service.engineering.programs.verdicts import place_in

SCREEN = Language.of("en")
_MOST_NAMED = 3  # programs of a sentence, lines of a program: the rest is counted
_LINE = re.compile(r"line (\d+): (.*)", re.DOTALL)


def heading(report: Report, language: Language = SCREEN) -> str:
    """Return what was done."""
    return language.say(report.title)


def verdict(report: Report, language: Language = SCREEN) -> str:
    """Return the whole in a sentence or two."""
    counts, texts = report.counts, language.texts
    counted_up = texts.counts.format(
        programs=counted(len(report.entries), texts.programs),
        points=counted(report.points, texts.points),
        changed=counts[CHANGED],
        unchanged=counts[UNCHANGED],
        left=counts[LEFT],
    )
    told = [counted_up]
    if counts[LEFT]:
        told.append(texts.left_means)
    told += points_off(report, language)
    if report.refused:
        told.append(counted(len(report.refused), texts.files_refused))
    return language.join(told)


def points_off(report: Report, language: Language = SCREEN) -> list[str]:
    """Return how many points are off though they are changed; nothing where none is."""
    return [counted(report.findings, language.texts.points_off)] if report.findings else []


def accuracy(report: Report, language: Language = SCREEN) -> str:
    """Return the largest expected error, and what it would be without the robots' models; empty if unknown."""
    told = [
        sentence.format(language.number(f"{figure * 1e3:.2f}"))
        for sentence, figure in (
            (language.texts.expected_most, largest(report.column("expected_m"))),
            (language.texts.without_most, largest(report.column("uncorrected_m"))),
        )
        if math.isfinite(figure)
    ]
    return language.join(told)


def problems(report: Report, language: Language = SCREEN) -> list[str]:
    """Return what else a person must know before the programs run."""
    entries = report.programs_worst_first()
    notes = (Note.of(entry.program, warning) for entry in entries for warning in entry.warnings)
    return said_once(notes, language)


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


def said_once(notes: Iterable[Note], language: Language = SCREEN) -> list[str]:
    """Return sentences that name the programs and lines they are about, each sentence once."""
    by_text: defaultdict[str, defaultdict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    for note in notes:
        by_text[note.text][note.program].append(note.line)
    return [f"{_where(programs, language)}: {language.say(text)}" for text, programs in by_text.items()]


def _where(programs: Mapping[str, Sequence[int]], language: Language) -> str:
    told = [name + _lines(lines, language) for name, lines in list(programs.items())[:_MOST_NAMED]]
    named, more = ", ".join(told), len(programs) - len(told)
    return language.texts.more_programs[more != 1].format(named, more) if more else named


def _lines(lines: Sequence[int], language: Language) -> str:
    known = [str(line) for line in lines if line]
    if not known:
        return ""
    named, more = ", ".join(known[:_MOST_NAMED]), len(known) - _MOST_NAMED
    told = language.texts.more_lines.format(named, more) if more > 0 else named
    return f" ({language.texts.lines[len(known) > 1].format(told)})"


def refusal(one: Refused, language: Language = SCREEN) -> str:
    """Return a refusal in one piece: its place stays as an editor takes it, what is wrong is said."""
    place = place_in(one.message)
    where = f"{place.line}:{place.column}: " if place.line else ""
    return f"{one.file}: {where}{language.join(map(language.say, (place.sentence, one.remedy)))}".rstrip()


def plural(count: int, what: str) -> str:
    """Return a count with its noun."""
    return f"{count} {what}{'' if count == 1 else 's'}"
