"""A certificate in the reader's language: its own words are whole, its figures those that are signed.

Its figures have the decimal mark of the language.
"""

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import typst

from cellcal.service.certificates import languages, pdf
from cellcal.service.certificates.html import as_html
from cellcal.service.certificates.printing import page_from, pdf_from
from cellcal.service.cli.certificate import write_certificate
from cellcal.service.translation import LOCALES, Locale
from tests.service.printed_documents import HtmlText, PdfReader, source_table, squeeze_text
from tests.service.source_sentences import ROOT, SENTENCE
from tests.service.test_certificate_pages import certified_frame_cell

FOREIGN: tuple[Locale, ...] = LOCALES[1:]
HOLE = re.compile(r"\{\w+\}")
PIECES = re.compile(r"\{\w+\}|: ")
TITLES = {"de": "Kalibrierbericht", "es": "Informe de calibración", "zh": "标定报告"}


@pytest.fixture(autouse=True)
def _tables_of_the_source(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Speak from the tables as they are written: the pages need not be built."""
    languages.translations_in.cache_clear()
    monkeypatch.setattr(
        languages,
        "load_translations",
        lambda locale: languages.build_translations(locale, source_table(locale) if locale != "en" else {}),
    )
    yield
    languages.translations_in.cache_clear()


def own_texts(locale: str) -> dict[str, str]:
    table = json.loads(
        (ROOT / f"service/certificates/translations/{locale}.json").read_text(encoding="utf-8")
    )
    assert isinstance(table, dict)
    return table


@pytest.mark.parametrize("locale", FOREIGN)
def test_every_word_is_translated_with_its_holes_and_is_one_sentence(locale: Locale) -> None:
    assert own_texts(locale).keys() == own_texts("de").keys()
    for english, translated in own_texts(locale).items():
        assert translated.strip(), english
        assert sorted(HOLE.findall(translated)) == sorted(HOLE.findall(english)), (english, translated)
        assert len(SENTENCE.split(english)) == 1, english


def test_nothing_is_translated_that_no_certificate_says() -> None:
    files = [file for room in ("service", "procedures") for file in (ROOT / room).rglob("*.py")]
    written = "\n".join(
        node.value.casefold()
        for file in files
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    )
    pieces = {
        english: [part.casefold().strip(" .:") for part in PIECES.split(english)]
        for english in own_texts("de")
    }
    unsaid = [english for english, parts in pieces.items() if not all(part in written for part in parts)]
    assert not unsaid


@pytest.mark.parametrize("locale", FOREIGN)
async def test_page_and_paper_are_in_the_language_and_say_so(locale: Locale, tmp_path: Path) -> None:
    _, issued = await certified_frame_cell(tmp_path)
    html = as_html(page_from(issued.json_path, locale))
    assert f'<html lang="{locale}">' in html
    assert HtmlText.read_html(html).asks_for == []
    assert TITLES[locale] in html
    on_screen = json.loads((ROOT / f"web/src/locales/{locale}.json").read_text(encoding="utf-8"))
    assert squeeze_text(on_screen["safety"]) in squeeze_text(html)  # one sentence, on screen and paper
    paper = squeeze_text(PdfReader(pdf_from(issued.json_path, locale)).read_text())
    assert (
        squeeze_text(TITLES[locale]) in paper or squeeze_text("Set in English") in paper
    )  # no font of this computer
    assert issued.sha256 in paper
    pointed, commas = (len(re.findall(rf"\d[{mark}]\d+ mm", html)) for mark in (".", ","))
    assert (commas == 0, pointed == 0) == (locale == "zh", locale != "zh")
    settings = json.loads(issued.json_path.read_text(encoding="utf-8"))["content"]["settings"]
    raw = [name for name in settings if "_" in name and f"<dt>{name.replace('_', ' ')}" in html]
    assert not raw, "a setting stands under its label, in the language of the page"


async def test_without_a_font_the_paper_is_english_and_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, issued = await certified_frame_cell(tmp_path)
    bare = typst.Fonts(include_system_fonts=False, include_embedded_fonts=True)
    monkeypatch.setattr(pdf, "_load_fonts", lambda *, of_computer: bare)
    text = " ".join(PdfReader(pdf_from(issued.json_path, "zh")).read_text().split())
    assert "Calibration report" in text
    assert squeeze_text("Set in English: this computer has no font for the language") in squeeze_text(text)
    assert (
        "Kalibrierbericht" in PdfReader(pdf_from(issued.json_path, "de")).read_text()
    )  # its letters are always there


async def test_the_command_writes_page_and_paper_in_a_language_and_signs_in_english(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, issued = await certified_frame_cell(tmp_path)
    signed = issued.json_path.read_bytes()
    html = tmp_path / "page.html"
    assert write_certificate("last", cell=config.path, html=html, language="de") == 0
    assert "Kalibrierbericht" in html.read_text()
    assert "CALIBRATION REPORT" in capsys.readouterr().out
    assert issued.json_path.read_bytes() == signed
