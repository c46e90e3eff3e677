"""The sentences of a report, the same on the screen, in English, and on the page."""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath

from cellcal.calibration.message import find_message
from cellcal.service.engineering.programs.files import RefusedProgram
from cellcal.service.engineering.programs.report import ProgramsReport, largest_finite
from cellcal.service.engineering.programs.report_texts import ReportLanguage, count_with_noun
from cellcal.service.engineering.programs.result import CHANGED, LEFT, UNCHANGED
from cellcal.service.engineering.programs.verdicts import place_in

SCREEN = ReportLanguage.for_locale("en")
_MOST_NAMED = 3  # programs of a sentence, lines of a program: the rest is counted
_LINE = "line {line}: {text}"  # template of a warning about a line


def heading_text(report: ProgramsReport, language: ReportLanguage = SCREEN) -> str:
    """Return what was done."""
    return language.say(report.title)


def verdict_text(report: ProgramsReport, language: ReportLanguage = SCREEN) -> str:
    """Return the whole in a sentence or two."""
    counts, texts = report.status_counts, language.texts
    counted_up = texts.counts.format(
        programs=count_with_noun(len(report.entries), texts.programs),
        points=count_with_noun(report.point_count, texts.points),
        changed=counts[CHANGED],
        unchanged=counts[UNCHANGED],
        left=counts[LEFT],
    )
    sentences = [counted_up]
    if counts[LEFT]:
        sentences.append(texts.left_means)
    sentences += describe_points_off(report, language)
    if report.refused:
        sentences.append(count_with_noun(len(report.refused), texts.files_refused))
    if report.unread:
        names = ", ".join(PurePath(file).name for file in report.unread[:_MOST_NAMED])
        more = ", …" if len(report.unread) > _MOST_NAMED else ""
        sentences.append(count_with_noun(len(report.unread), texts.programs_unread).format(names + more))
    return language.join(sentences)


def describe_points_off(report: ProgramsReport, language: ReportLanguage = SCREEN) -> list[str]:
    """Return how many points are off though they are changed; nothing where none is."""
    return [count_with_noun(report.finding_count, language.texts.points_off)] if report.finding_count else []


def accuracy_text(report: ProgramsReport, language: ReportLanguage = SCREEN) -> str:
    """Return the largest expected error, and what it would be without the robots' models; empty if unknown."""
    sentences = [
        sentence.format(language.number(f"{figure * 1e3:.2f}"))
        for sentence, figure in (
            (language.texts.expected_most, largest_finite(report.column_values("expected_m"))),
            (language.texts.without_most, largest_finite(report.column_values("uncorrected_m"))),
        )
        if math.isfinite(figure)
    ]
    return language.join(sentences)


def list_problems(report: ProgramsReport, language: ReportLanguage = SCREEN) -> list[str]:
    """Return what else a person must know before the programs run."""
    entries = report.programs_worst_first()
    notes = (
        ReportNote.from_warning(entry.program, warning) for entry in entries for warning in entry.warnings
    )
    return merge_notes(notes, language)


@dataclass(frozen=True, slots=True)
class ReportNote:
    """A sentence about a program, or a line of it."""

    program: str
    line: int  # 0: the whole
    text: str

    @classmethod
    def from_warning(cls, program: str, warning: str) -> "ReportNote":
        """Read a warning, which may begin with its line."""
        made = find_message(warning)
        if made is None or made.template != _LINE:
            return cls(program, 0, warning)
        return cls(program, int(made.arguments["line"]), made.arguments["text"])


def merge_notes(notes: Iterable[ReportNote], language: ReportLanguage = SCREEN) -> list[str]:
    """Return sentences that name the programs and lines they are about, each sentence once."""
    by_text: defaultdict[str, defaultdict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    for note in notes:
        by_text[note.text][note.program].append(note.line)
    return [f"{_name_places(programs, language)}: {language.say(text)}" for text, programs in by_text.items()]


def _name_places(programs: Mapping[str, Sequence[int]], language: ReportLanguage) -> str:
    named_lines = [
        name + _name_lines(lines, language) for name, lines in list(programs.items())[:_MOST_NAMED]
    ]
    named, more = ", ".join(named_lines), len(programs) - len(named_lines)
    return language.texts.more_programs[more != 1].format(named, more) if more else named


def _name_lines(lines: Sequence[int], language: ReportLanguage) -> str:
    numbers = [str(line) for line in lines if line]
    if not numbers:
        return ""
    named, more = ", ".join(numbers[:_MOST_NAMED]), len(numbers) - _MOST_NAMED
    shown = language.texts.more_lines.format(named, more) if more > 0 else named
    return f" ({language.texts.lines[len(numbers) > 1].format(shown)})"


def refusal_text(one: RefusedProgram, language: ReportLanguage = SCREEN) -> str:
    """Return a refusal in one piece: its place stays as an editor takes it, what is wrong is said."""
    place = place_in(one.message)
    where = f"{place.line}:{place.column}: " if place.line else ""
    return f"{one.file}: {where}{language.join(map(language.say, (place.sentence, one.remedy)))}".rstrip()


def pluralize(count: int, what: str) -> str:
    """Return a count with its noun."""
    return f"{count} {what}{'' if count == 1 else 's'}"
