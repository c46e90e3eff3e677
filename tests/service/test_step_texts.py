"""What procedures say, in every language: nothing is forgotten, and what is said in English only is listed here."""

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from cellcal.procedures.catalogue import DEFINITIONS
from cellcal.procedures.procedure_definition import NEEDS
from cellcal.procedures.procedure_guide import GUIDE, NEED_REMEDIES
from cellcal.procedures.prompt_answers import all_answers
from tests.service.source_sentences import SENTENCE, expression_texts, number_holes

ROOT = Path(__file__).parents[2]
TRANSLATED = ("de", "es", "zh")
HOLE = re.compile(r"\{\w+\}")

# Sentences that carry words of the run beside figures: shown as they are said. Their figures stand on the page.
ENGLISH_ONLY = 22  # at most; it may only fall


def translation_tables() -> dict[str, dict[str, str]]:
    folder = ROOT / "web/src/locales/procedures"
    return {name: json.loads((folder / f"{name}.json").read_text(encoding="utf-8")) for name in TRANSLATED}


def translated_sentences(locale: str) -> set[str]:
    """Return the sentences of both catalogues, holes numbered."""
    refusals = json.loads((ROOT / f"web/src/locales/refusals/{locale}.json").read_text(encoding="utf-8"))
    return set(map(number_holes, (*refusals, *translation_tables()[locale])))


def literal_text(node: ast.expr) -> tuple[str, bool] | None:
    """Return a literal's text, holes numbered, and whether it has any; None where it is no literal."""
    if isinstance(node, ast.Constant):
        return str(node.value), False
    texts = list(expression_texts(node)) if isinstance(node, ast.JoinedStr | ast.Call) else []
    return (texts[0], True) if texts else None


def calls_of(*names: str) -> Iterator[ast.Call]:
    for path in sorted((ROOT / "procedures").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                called = (
                    node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                )
                if called in names and node.args:
                    yield node


def instruction_texts() -> tuple[set[str], set[str]]:
    """Return every sentence of the procedures' instructions: those without figures, and those with."""
    plain: set[str] = set()
    figured: set[str] = set()
    for call in calls_of("Instruction"):
        text = literal_text(call.args[1]) if len(call.args) > 1 else None
        if text is not None:
            for sentence in SENTENCE.split(text[0]):
                (figured if "{" in sentence else plain).add(number_holes(sentence))
    return plain, figured - {"{1}", "{1}."}


def step_names() -> set[str]:
    names = (literal_text(call.args[0]) for call in calls_of("Phase", "ensure"))
    return {name for found in names if found is not None and not found[1] for name in [found[0]]}


@pytest.mark.parametrize("locale", TRANSLATED)
def test_titles_steps_and_plain_instructions_are_translated(locale: str) -> None:
    expected_texts = {
        "titles": {entry.title for entry in DEFINITIONS},
        "guide": {text for entry in GUIDE.values() for text in (entry.when, entry.uses)},
        "remedies": {part for text in NEED_REMEDIES.values() for part in SENTENCE.split(text)},
        "answers": {text for answers in all_answers() for text in (answers.yes, answers.no, answers.question)}
        - {""},
        "steps": step_names(),
        "needs": {words for words, _ in NEEDS.values()},
        "instructions": instruction_texts()[0],
    }
    missing = {what: sorted(texts - translated_sentences(locale)) for what, texts in expected_texts.items()}
    assert missing == {what: [] for what in expected_texts}


def test_sentences_with_figures_that_are_written_in_english_only_are_counted() -> None:
    untranslated = sorted(instruction_texts()[1] - translated_sentences("de"))
    assert len(untranslated) <= ENGLISH_ONLY, "\n".join(untranslated)


def test_every_language_translates_the_same_and_keeps_the_figures() -> None:
    texts = translation_tables()
    for locale in TRANSLATED:
        assert texts[locale].keys() == texts["de"].keys()
        for english, words in texts[locale].items():
            assert words.strip(), (locale, english)
            assert set(HOLE.findall(words)) == set(HOLE.findall(english)), (locale, english)
