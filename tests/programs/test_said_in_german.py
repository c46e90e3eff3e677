"""What readers refuse and remark, of real files of every brand, through the look-up of the report and the pages."""

import re
from collections.abc import Iterator

import numpy as np
import pytest

from cellcal.calibration.message import join_messages
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.service.engineering.programs.files import RefusedProgram
from cellcal.service.engineering.programs.report_sentences import ReportNote, merge_notes, refusal_text
from cellcal.service.engineering.programs.report_texts import ReportLanguage
from cellcal.service.engineering.programs.verdicts import place_in
from cellcal.service.translation import Translations
from tests.programs.fuzz import GeneratorSource, generator_sources
from tests.service.source_sentences import ROOT, SENTENCE

GERMAN = ReportLanguage.for_locale("de", Translations.read_tables("de", ROOT / "web/src/locales"))
ENGLISH = re.compile(r"\b(the|and|of|is|are|not|with|this|that|it|its|more|line|holds|should|there)\b")
# What is cited from a file, and what the XML parser says in its own words.
QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"|\([^()]*(?:\([^()]*\))?[^()]*: line \d+, column \d+\)")
SOURCES = generator_sources()


def has_english_words(german_text: str) -> bool:
    """Whether a German text has English in it."""
    return bool(ENGLISH.search(QUOTED.sub("", german_text)))


def untranslated_texts(text: str) -> bool:
    """Whether a sentence of a text is said as it was given."""
    return not set(SENTENCE.split(text.strip())).isdisjoint(SENTENCE.split(GERMAN.say(text)))


def damaged_files(source: GeneratorSource) -> Iterator[bytes]:
    """Yield files with a byte or a line amiss."""
    rng = np.random.default_rng(3)
    for seed in range(60):
        plain = source.unpacked(source.generate(seed))
        at = int(rng.integers(len(plain)))
        yield source.packed(plain[:at] + rng.choice([b"}", b"x", b"", b",", b"("]) + plain[at + 1 :])
        lines = plain.splitlines(keepends=True)
        gone = int(rng.integers(len(lines)))
        yield source.packed(b"".join(lines[:gone] + lines[gone + 1 :]))


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: source.name)
def test_remarks_of_every_brand_are_written_in_german(source: GeneratorSource) -> None:
    texts = set()
    for seed in range(60):
        program = source.brand.read(f"a{source.suffix}", source.generate(seed))
        texts |= {remark.text for remark in program.remarks}
        texts |= set(program.positions.barred.values())
    assert texts
    assert not [text for text in texts if untranslated_texts(text)]
    assert not [
        german_text
        for german_text in merge_notes((ReportNote("A", 3, text) for text in texts), GERMAN)
        if has_english_words(german_text)
    ]


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: source.name)
def test_refusals_of_every_brand_are_written_in_german(source: GeneratorSource) -> None:
    refused = []
    for data in damaged_files(source):
        try:
            source.brand.read(f"a{source.suffix}", data)
        except ProgramFileError as error:
            refused.append(RefusedProgram.from_error(f"a{source.suffix}", error))
    assert len(refused) > 3
    refusal_sentences = {join_messages(" ", (place_in(one.message).sentence, one.remedy)) for one in refused}
    assert not [text for text in refusal_sentences if untranslated_texts(text)]
    assert not [
        german_text
        for german_text in (refusal_text(one, GERMAN) for one in refused)
        if has_english_words(german_text)
    ]
