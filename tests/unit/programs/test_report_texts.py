"""A report's page in every language: its own words, and what judges, drivers and refusals say of programs."""

import re
from dataclasses import astuple, fields, replace
from itertools import product

import pytest

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.ls_remarks import remarks_of
from cellcal.drivers.yaskawa.program_files.job_edits import RATIOS_NEEDED
from cellcal.service.engineering.programs import postures
from cellcal.service.engineering.programs.files import RefusedProgram
from cellcal.service.engineering.programs.report import ProgramsReport
from cellcal.service.engineering.programs.report_html import as_html
from cellcal.service.engineering.programs.report_sentences import accuracy_text, list_problems, verdict_text
from cellcal.service.engineering.programs.report_texts import ENGLISH, TEXTS, ReportLanguage, ReportTexts
from cellcal.service.translation import LOCALES, Locale, Translations
from tests.service.source_sentences import ROOT
from tests.unit.programs.test_report import LineProgram, make_result, report_of

TABLES = ROOT / "web/src/locales"  # what the built pages hold a copy of
FOREIGN: tuple[Locale, ...] = ("de", "es", "zh")
# As judges say them, with figures in; verdicts.py and its test hold how each begins.
REASONS = (
    make_message("unreachable: the arm ends {found:.1f} mm away", found=12.3),
    postures.UNREACHABLE,
    make_message(postures.OTHER_CONFIGURATION, text="N U T, 0, 0, 0"),
    make_message(postures.OTHER_TURNS, text="F L T, 0, 0, -1"),
    postures.NO_POSTURE,
    make_message("joint {joint} would pass its limit by {by:.1f} deg", joint=4, by=3.2),
    make_message(
        "joints {joints} together would pass their limit by {by_deg:.1f} deg", joints="J2+J3", by_deg=3.2
    ),
    make_message(
        "near a singularity: {found:.4f} m/rad, at least {least:g} is wanted", found=0.0021, least=0.01
    ),
    make_message(
        "the wrist would flip or the arm change its posture: {a} would become {b}", a="N U T", b="F U T"
    ),
    make_message("collides: {first} and {second}", first="joint 5", second="fence"),
    make_message(
        "comes too close: {clearance_mm:.0f} mm between {first} and {second}",
        clearance_mm=4.0,
        first="tool",
        second="table",
    ),
    make_message(
        "no tool {name} in {project}: state it there as [tools.{key}]",
        name=3,
        project="project.toml",
        key="3",
    ),
)
STATEMENTS = b"""/MN
   1:  J PR[1] 100% FINE ;
   2:  CALL OTHER ;
   3:  L P[1] 100mm/sec FINE Offset,PR[2] ;
/POS
/END
"""


def report_language(locale: Locale) -> ReportLanguage:
    return ReportLanguage.for_locale(locale, Translations.read_tables(locale, TABLES))


def placeholders_in(text: object) -> list[list[str]]:
    return [
        sorted(re.findall(r"\{\w*\}", form)) for form in (text if isinstance(text, tuple) else (str(text),))
    ]


@pytest.mark.parametrize("locale", FOREIGN)
def test_every_language_has_every_word_with_its_holes_and_its_columns(locale: Locale) -> None:
    assert set(TEXTS) == set(LOCALES)
    for word in fields(ReportTexts):
        english, translated = (getattr(texts, word.name) for texts in (ENGLISH, TEXTS[locale]))
        assert placeholders_in(translated) == placeholders_in(english), word.name
        assert all(
            form.strip() for form in (translated if isinstance(translated, tuple) else (translated,))
        ), word.name
        if word.name.endswith("heads"):
            assert [head.endswith("#") for head in translated] == [head.endswith("#") for head in english]
    assert sum(a == b for a, b in zip(astuple(ENGLISH), astuple(TEXTS[locale]), strict=True)) <= 2  # of axes


@pytest.mark.parametrize(("locale", "reason"), [*product(FOREIGN, REASONS)])
def test_the_reasons_of_points_are_written_in_the_language(locale: Locale, reason: str) -> None:
    translated = report_language(locale).say(reason)
    assert translated != reason
    assert not re.search(r"\b(the|would|posture|away|between|wanted)\b", translated), translated
    for number in re.findall(r"\d+(?:\.\d+)?", reason):
        assert report_language(locale).number(number) in translated


@pytest.mark.parametrize("locale", FOREIGN)
def test_what_programs_do_beside_their_points_is_written_in_the_language(locale: Locale) -> None:
    positions = replace(LineProgram("A", 1).positions, names=("P[7]",))
    remark_texts = [remark.text for remark in remarks_of(STATEMENTS, 0, len(STATEMENTS), positions)]
    assert len(remark_texts) >= 5
    for text in (*remark_texts, RATIOS_NEEDED):
        assert report_language(locale).say(text) != text, text


@pytest.mark.parametrize("locale", FOREIGN)
def test_the_page_has_no_english_sentence_of_its_own(locale: Locale) -> None:
    report = report_of(
        make_result("A", [1.0, None, 2.5], [0.1, 0.0, 0.4]), make_result("B", [3.0] * 4000, [0.2] * 4000)
    )
    report.title = make_message("Moved in {cell_name}", cell_name="cell 7")
    report.entries[0].reasons[1] = REASONS[0]
    report.refused.append(
        RefusedProgram("x.ls", "the file is empty.", "Save the program from the controller again.")
    )
    page, english = as_html(report, report_language(locale)), as_html(report)
    assert f'<html lang="{locale}">' in page
    for word in fields(ReportTexts):
        english_text = getattr(ENGLISH, word.name)
        whole = english_text if isinstance(english_text, str) else ""
        if whole and "{" not in whole and whole in english and whole != getattr(TEXTS[locale], word.name):
            assert f">{whole}<" not in page, word.name
    assert "Moved in" not in page
    assert "the file is empty" not in page
    assert "12.3 mm away" not in page


def test_numbers_are_written_in_the_format_of_the_language() -> None:
    report = report_of(make_result("A", [1.25], [0.5]))
    assert "0,50 mm" in accuracy_text(report, report_language("de"))
    assert "0.50 mm" in accuracy_text(report, report_language("zh"))
    assert ">1,250</td>" in as_html(report, report_language("es"))
    assert (
        "width:" not in as_html(report, report_language("de")).replace("width: 100%", "").split("<body>")[1]
    )


def test_one_and_many_are_distinguished() -> None:
    one = report_of(make_result("A", [1.0], [0.1]))
    assert verdict_text(one, report_language("de")).startswith("1 Programm, 1 Punkt: 1 geändert")
    many = report_of(*(make_result(name, [1.0], [0.1]) for name in "ABCDE"))
    assert verdict_text(many, report_language("es")).startswith("5 programas, 5 puntos")
    assert list_problems(many, report_language("de"))[1].startswith(
        "A (Zeile 3), B (Zeile 3), C (Zeile 3) und 2 weitere Programme: "
    )


def test_without_tables_what_others_say_stays_english(tmp_path) -> None:
    language = ReportLanguage.for_locale("de", Translations.read_tables("de", tmp_path))
    assert language.say(REASONS[0]) == REASONS[0]
    assert verdict_text(ProgramsReport("Nothing"), language).startswith("0 Programme")
