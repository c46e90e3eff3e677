"""Each question has buttons that say what they do, and a drawing; no key of an instruction is forgotten."""

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.prompt_answers import PLAIN, all_answers, answers_for
from cellcal.service.cell_process.screen_operator import Prompt
from tests.service.source_sentences import read_source

ROOT = Path(__file__).parents[2]
LOCALES = ("en", "de", "es", "zh")


def instruction_keys() -> Iterator[str]:
    """Yield the keys of all instructions in the source; a number stands where a key has one."""
    for folder in ("procedures", "service"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            if "Instruction(" not in text and "Question(" not in text:
                continue
            for node in ast.walk(ast.parse(text)):
                called = getattr(node.func, "id", "") if isinstance(node, ast.Call) else ""
                if called in ("Instruction", "Question") and isinstance(node, ast.Call) and node.args:
                    key = node.args[0]
                    if isinstance(key, ast.Constant):
                        yield str(key.value)
                    elif isinstance(key, ast.JoinedStr):
                        parts = (str(p.value) if isinstance(p, ast.Constant) else "1" for p in key.values)
                        yield "".join(parts)


def test_every_instruction_has_answers_of_its_own() -> None:
    keys = set(instruction_keys())
    assert len(keys) > 40
    assert sorted(key for key in keys if answers_for(key) == PLAIN) == []


def test_no_instruction_speaks_of_a_yes_that_no_button_has() -> None:
    paths = sorted((ROOT / "procedures").rglob("*.py"))
    sentences = {sentence for path in paths for sentence in read_source(path).sentences}
    assert len(sentences) > 500
    assert [each for each in sentences if re.search(r"\b(say|answer) (yes|no)\b", each, re.IGNORECASE)] == []


def test_yes_and_no_say_different_things_and_questions_ask_for_a_yes() -> None:
    for answers in all_answers():
        assert answers.yes != answers.no
        assert not answers.question or answers.question.endswith("?")
        assert not re.search(r"\b(no|not|never)\b", answers.question), "a question is positive"


@pytest.mark.parametrize("locale", LOCALES)
def test_each_drawing_is_there_and_has_words_for_who_does_not_see_it(locale: str) -> None:
    texts = json.loads((ROOT / f"web/src/locales/{locale}.json").read_text(encoding="utf-8"))
    for answers in all_answers():
        assert (ROOT / f"web/public/steps/{answers.drawing}.svg").exists(), answers.drawing
        assert texts[f"step_picture_{answers.drawing}"].strip()


def test_a_prompt_carries_its_buttons_and_the_journal_keeps_the_words_alone() -> None:
    shown = Prompt("run:1", "confirm", "saved_counts", "words", "", "confirm the saved counts").as_json()
    assert (shown["yes"], shown["no"]) == ("Use these counts", "I have newer ones")
    assert shown["is_folded"]
    assert not hasattr(Instruction("saved_counts", "words"), "yes")
