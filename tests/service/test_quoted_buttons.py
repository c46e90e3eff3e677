"""What a text of the pages puts between quotation marks stands so on the page: a button is quoted as it is labelled."""

import json
import re

import pytest

from tests.service.source_sentences import ROOT

QUOTED = {"en": "“([^”]+)”", "de": "„([^“”]+)[“”]", "es": "«([^»]+)»", "zh": "“([^”]+)”"}
HOLE = re.compile(r"\{\w+\}")
ON_OTHER_SCREENS = {"Move"}  # a tab of a Universal Robots pendant


@pytest.mark.parametrize("locale", QUOTED)
def test_a_button_is_quoted_as_it_is_labelled(locale: str) -> None:
    texts: dict[str, str] = json.loads((ROOT / f"web/src/locales/{locale}.json").read_text(encoding="utf-8"))
    quoted = {(key, each) for key, text in texts.items() for each in re.findall(QUOTED[locale], text)}
    assert quoted
    labels = {*texts.values(), *ON_OTHER_SCREENS}
    assert not {(key, each) for key, each in quoted if each not in labels and not HOLE.fullmatch(each)}
