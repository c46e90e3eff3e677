"""What readers refuse and remark, of real files of every brand, through the look-up of the report and the pages."""

import re
from collections.abc import Iterator

import numpy as np
import pytest

from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.service.engineering.programs.files import RefusedProgram
from cellcal.service.engineering.programs.report_sentences import ReportNote, merge_notes, refusal_text
from cellcal.service.engineering.programs.report_texts import ReportLanguage
from cellcal.service.engineering.programs.verdicts import place_in
from cellcal.service.translation import Translations
from tests.programs.fuzz import Source, sources
from tests.service.spoken import ROOT, SENTENCE

GERMAN = ReportLanguage.for_locale("de", Translations.read_tables("de", ROOT / "web/src/locales"))
ENGLISH = re.compile(r"\b(the|and|of|is|are|not|with|this|that|it|its|more|line|holds|should|there)\b")
# What is cited from a file, and what the XML parser says in its own words.
QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"|\([^()]*(?:\([^()]*\))?[^()]*: line \d+, column \d+\)")
SOURCES = sources()


def english(said: str) -> bool:
    """Whether a German text has English in it."""
    return bool(ENGLISH.search(QUOTED.sub("", said)))


def left_english(text: str) -> bool:
    """Whether a sentence of a text is said as it was given."""
    return any(GERMAN.say(part) == part for part in SENTENCE.split(text.strip()))


def damaged(source: Source) -> Iterator[bytes]:
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
def test_remarks_of_every_brand_are_said_in_german(source: Source) -> None:
    texts = set()
    for seed in range(60):
        program = source.brand.read(f"a{source.suffix}", source.generate(seed))
        texts |= {remark.text for remark in program.remarks}
        texts |= set(program.positions.barred.values())
    assert texts
    assert not [text for text in texts if left_english(text)]
    assert not [
        said for said in merge_notes((ReportNote("A", 3, text) for text in texts), GERMAN) if english(said)
    ]


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: source.name)
def test_refusals_of_every_brand_are_said_in_german(source: Source) -> None:
    refused = []
    for data in damaged(source):
        try:
            source.brand.read(f"a{source.suffix}", data)
        except ProgramFileError as error:
            refused.append(RefusedProgram.from_error(f"a{source.suffix}", error))
    assert len(refused) > 3
    told = {f"{place_in(one.message).sentence} {one.remedy}" for one in refused}
    assert not [text for text in told if left_english(text)]
    assert not [said for said in (refusal_text(one, GERMAN) for one in refused) if english(said)]
