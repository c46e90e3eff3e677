"""Templates in the source and in the catalogues are the same; no code takes a sentence apart to find its arguments."""

import ast
import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from cellcal.calibration.message import fill_template
from cellcal.calibration.message_table import read_message
from cellcal.calibration.renamed_holes import renamed_holes
from cellcal.service.translation import Locale
from tests.service.source_sentences import ROOT, SENTENCE, constant_templates, number_holes, read_source

ROOMS = ("calibration", "drivers", "procedures", "service")
CATALOGUES = ("web/src/locales/refusals", "web/src/locales/procedures", "service/certificates/translations")
FORMER = ROOT / "tests/data/former_refusals.json"  # journals of earlier versions contain these
HOLE = re.compile(r"\{\w+\}")
NAMED = re.compile(r"\{[a-z]\w*\}")
NUMBERED = re.compile(r"\{[a-z]\w*_\d+\}")
IN_RADIANS = re.compile(r"\} rad\b(?!/m)")
LEAD = re.compile(r"^(\{\w+\}\s*)+")
JOINT = re.compile(r"[\s.,;:]*")
LATIN_MARK = re.compile(r"[\u4e00-\u9fff”][,;:?!]|[,;:?!]\s*[\u4e00-\u9fff]")
CODE = re.compile(r"^U[FT] : |\}:1 |SHA256: |\}\]|^\{where\}: \{heading\}：|[或的] \}\};?")  # noqa: RUF001 - Chinese
LONG_NUMBER = re.compile(r"(?<![{\w.,])\d{2,}")
FIXED_MARK = re.compile(r"""\.join\("[,;] "\)\)?\}|t\([^()]*\)\}: \{|\)\}: \$\{t\(""")


@cache
def catalogue(locale: str = "de") -> frozenset[str]:
    """Return the keys of every catalogue."""
    files = [ROOT / folder / f"{locale}.json" for folder in CATALOGUES]
    return frozenset(key for file in files for key in json.loads(file.read_text(encoding="utf-8")))


def source_files() -> Iterator[Path]:
    for room in ROOMS:
        yield from sorted((ROOT / room).rglob("*.py"))


def sentences_with_holes(template: str) -> Iterator[str]:
    """Yield the sentences of a template that have holes and words."""
    for sentence in SENTENCE.split(template):
        if HOLE.search(sentence) and not JOINT.fullmatch(HOLE.sub("", sentence)):
            yield sentence.strip()


def test_every_template_stands_in_the_catalogues_with_the_names_of_its_holes() -> None:
    numbered = {number_holes(key): key for key in catalogue()}
    wrong = [
        f"{file.relative_to(ROOT)}:{line}: {sentence!r} is {numbered[number_holes(sentence)]!r} in the catalogue"
        for file in source_files()
        for line, template in read_source(file).templates
        for sentence in sentences_with_holes(template)
        if number_holes(sentence) in numbered and not {sentence, LEAD.sub("", sentence)} & catalogue()
    ]
    assert not wrong


OF_DESCRIPTIONS = ("calibration/arm/",)  # URDF files are written in radians


def test_no_sentence_shows_an_angle_in_radians() -> None:
    """Pendants and people have degrees; only a file that is itself in radians is spoken of in them."""
    wrong = [
        f"{file.relative_to(ROOT)}:{line}: {template}"
        for file in source_files()
        if not str(file.relative_to(ROOT)).startswith(OF_DESCRIPTIONS)
        for line, template in read_source(file).templates
        if IN_RADIANS.search(template)
    ]
    assert not wrong


def test_no_hole_has_a_numbered_name() -> None:
    """Two holes of one sentence are two things: their names say which."""
    templates = [
        f"{file.relative_to(ROOT)}:{line}: {template}"
        for file in source_files()
        for line, template in read_source(file).templates
        if NUMBERED.search(template)
    ]
    assert not templates
    assert not [key for key in catalogue() if NUMBERED.search(key)]


@pytest.mark.parametrize("locale", ["de", "es", "zh"])
def test_records_with_numbered_names_of_holes_are_shown_with_those_of_today(locale: Locale) -> None:
    keys = {
        key for folder in CATALOGUES for key in json.loads((ROOT / folder / f"{locale}.json").read_text())
    }
    assert len(renamed_holes()) > 20
    for sentence, names in renamed_holes().items():
        holes = NAMED.findall(sentence)
        written = {name.strip("{}"): f"value {number}" for number, name in enumerate(holes)}
        text = fill_template(sentence, written)
        arguments = {"name": "arm"} | written
        entry = {"template": f"Before. {sentence} {{name}}", "arguments": arguments}
        message = read_message(f"Before. {text} {arguments['name']}", entry)
        assert message is not None, sentence
        current = message.template.removeprefix("Before. ").removesuffix(" {name}")
        assert current in keys
        assert not NUMBERED.search(current)
        assert set(message.arguments) == {hole.strip("{}") for hole in NAMED.findall(message.template)}
        assert names.keys() <= written.keys()


def test_every_entry_with_named_holes_has_a_template() -> None:
    templates = {
        sentence
        for file in source_files()
        for template in (*(each for _, each in read_source(file).templates), *constant_templates(file))
        for whole in sentences_with_holes(template)
        for sentence in (whole, LEAD.sub("", whole))
    }
    tables = "".join(file.read_text(encoding="utf-8") for file in (ROOT / "drivers").rglob("*.tsv"))
    templates |= set(json.loads(FORMER.read_text(encoding="utf-8")))
    assert not [
        key for key in catalogue() if NAMED.search(key) and key not in templates and key not in tables
    ]


def test_no_f_string_is_used_where_a_translated_message_belongs() -> None:
    """An f-string is English for ever: use ``make_message("... {name} ...", name=...)``."""
    numbered = {number_holes(key) for key in catalogue() if HOLE.search(key)}
    found = [
        f"{file.relative_to(ROOT)}:{line}: {sentence}"
        for file in source_files()
        for line, text in read_source(file).f_strings
        for sentence in _numbered_sentences(text)
        if sentence in numbered - _NAMES
    ]
    assert not found


_NAMES = {"J{1} offset"}  # a parameter's name: each number has an entry of its own


def _numbered_sentences(text: str) -> Iterator[str]:
    yield from (number_holes(part) for part in SENTENCE.split(text) if "{0}" in part)


def read_catalogue(file: Path) -> dict[str, str]:
    return dict(json.loads(file.read_text(encoding="utf-8")))


def test_chinese_texts_have_the_marks_of_chinese() -> None:
    """A comma between Latin names and a colon of a ratio or of an option are as they are everywhere."""
    files = [*(ROOT / "web/src/locales").rglob("zh.json"), ROOT / "service/certificates/translations/zh.json"]
    wrong = [
        text
        for file in files
        for text in read_catalogue(file).values()
        if LATIN_MARK.search(text) and not CODE.search(text)
    ]
    assert len(files) > 3
    assert not wrong


def test_translations_keep_the_numbers_of_their_sentence() -> None:
    wrong = [
        (file.parts[-2:], sentence, text)
        for file in (ROOT / "web/src/locales").glob("*/*.json")
        for sentence, text in read_catalogue(file).items()
        if set(LONG_NUMBER.findall(sentence)) - set(LONG_NUMBER.findall(text))
        or ("#" in text and "#" not in sentence)
    ]
    assert not wrong


def test_pages_write_lists_and_colons_as_their_language_does() -> None:
    """`sayings.listed` and `sayings.colon` know the language; a mark between two expressions does not."""
    pages = [*(ROOT / "web/src").rglob("*.svelte")]
    wrong = [
        f"{file.name}: {line.strip()[:120]}"
        for file in pages
        for line in file.read_text(encoding="utf-8").split("\n")
        if FIXED_MARK.search(line)
    ]
    assert len(pages) > 60
    assert not wrong


def test_pages_show_no_code_in_backticks() -> None:
    """A page's own text is plain; what the service says gets quotes, and the place of a command, in say.svelte.ts."""
    files = [ROOT / f"web/src/locales/{locale}.json" for locale in ("en", "de", "es", "zh")]
    assert not [text for file in files for text in read_catalogue(file).values() if "`" in text]


def test_pages_tell_why_something_could_not_be_loaded() -> None:
    """What the service said is shown; "is the service running?" is asked only where it did not answer."""
    pages = [*(ROOT / "web/src/pages").glob("*.svelte")]
    assert len(pages) > 10
    assert not [page.name for page in pages if '{t("not_loaded")}' in page.read_text(encoding="utf-8")]


@pytest.mark.parametrize(
    "file",
    ["service/translation.py", "calibration/message.py", "calibration/message_table.py"],
)
def test_translation_uses_no_regular_expression(file: str) -> None:
    imported = {
        alias.name
        for node in ast.walk(ast.parse((ROOT / file).read_text(encoding="utf-8")))
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    assert not imported & {"re", "regex"}


def test_only_records_without_templates_are_taken_apart() -> None:
    """`legacy_texts` is used for runs and cells of earlier versions, parameter sets and signed certificates, and nowhere else."""
    users = {
        str(file.relative_to(ROOT))
        for file in source_files()
        if "legacy_texts import" in file.read_text(encoding="utf-8")
    }
    assert users == {
        "service/certificates/languages.py",
        "service/review/reviewer.py",
        "service/site/fleet.py",
        "service/web/history.py",
        "service/web/parameters.py",
        "service/web/points.py",
    }


def test_the_pages_build_no_pattern_from_a_text_and_match_no_sentence() -> None:
    """A template is filled in and cut into sentences; a text of the service is looked up."""
    files = [each for suffix in ("ts", "svelte") for each in (ROOT / "web/src").rglob(f"*.{suffix}")]
    assert len(files) > 50
    assert not [file.name for file in files if "new RegExp" in file.read_text(encoding="utf-8")]
    for name in ("say.svelte.ts", "messages.ts", "faults.ts"):
        text = (ROOT / "web/src/lib" / name).read_text(encoding="utf-8")
        assert "(.*" not in text, name
        assert text.count(".exec(") == text.count("LEAD.exec(template)"), name
