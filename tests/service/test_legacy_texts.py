"""Texts that were recorded without templates are shown in every language, by templates that are found for them."""

import json

import pytest

from cellcal.calibration.message import Message, find_message, make_message
from cellcal.calibration.message_table import with_messages
from cellcal.service import legacy_texts
from cellcal.service.legacy_texts import LegacyTexts, remember_recorded_texts
from cellcal.service.translation import Locale, Translations
from tests.service.source_sentences import ROOT

TABLES = ROOT / "web/src/locales"
FORMER = ROOT / "tests/data/former_refusals.json"


def read_legacy(locale: Locale) -> Translations:
    found = Translations.read_tables(locale, TABLES)
    recover = LegacyTexts.from_templates(found.table).find_message
    return Translations(locale, found.table, found.commas, recover)


RECORDED = {
    "probe: reading the joints took longer than 0.4 s. Look at the robot.": (
        "probe: das Lesen der Achswinkel dauerte länger als 0,4 s. Sehen Sie nach dem Roboter."
    ),
    "the wire is out to its end (7.5 mm).": "das Seil ist bis zum Ende ausgezogen (7,5 mm).",
    "Select tool 3 on the pendant again, then go on here.": (
        "Wählen Sie am Bediengerät wieder Werkzeug 3, dann hier weiter."
    ),
    "This run stood still for 7.5 hours.": "Dieser Lauf stand 7,5 Stunden still.",
    "the controller reports: SRVO-062 BZAL; the robot is not mastered": (
        "die Steuerung meldet: SRVO-062 BZAL; der Roboter ist nicht justiert"
    ),
}


@pytest.mark.parametrize("text", RECORDED)
def test_a_recorded_text_is_shown_in_german(text: str) -> None:
    german = read_legacy("de")
    assert german.translate(text) == RECORDED[text]
    recovered = german.find(text)
    assert recovered == text
    assert isinstance(recovered, Message)
    assert Message.from_template(recovered.template, recovered.arguments) == text


def test_what_no_template_gives_stays_as_it_is() -> None:
    german = read_legacy("de")
    assert german.find("this was never said by anything.") is None
    assert german.translate("this was never said by anything.") == "this was never said by anything."


@pytest.mark.parametrize("locale", ["de", "es", "zh"])
def test_sentences_of_earlier_versions_have_templates(locale: Locale) -> None:
    legacy = read_legacy(locale)
    for template in json.loads(FORMER.read_text(encoding="utf-8")):
        text = template
        for number, value in enumerate(("7", "probe", "0.5", "12"), start=1):
            text = text.replace(f"{{{number}}}", value)
        assert legacy.translate(text) != text, text


def test_a_text_without_recovery_is_found_only_if_it_is_a_message() -> None:
    """Today's texts are never taken apart."""
    german = Translations.read_tables("de", TABLES)
    text = "the wire is out to its end (8.25 mm)."
    assert german.translate(text) == text
    made = make_message("the wire is out to its end ({value_mm:.2f} mm).", value_mm=8.25)
    assert german.translate(made) == "das Seil ist bis zum Ende ausgezogen (8,25 mm)."
    assert german.translate(text) == german.translate(made)  # it passed through JSON meanwhile


def test_the_document_of_an_old_run_is_sent_with_templates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        legacy_texts, "load_translations", lambda locale: Translations.read_tables(locale, TABLES)
    )
    legacy_texts._load_legacy_texts.cache_clear()
    text = "the wire is out to its end (9.75 mm)."
    assert find_message(text) is None
    remember_recorded_texts({"reason": text, "result": [1, {"word": "PASS"}]})
    legacy_texts._load_legacy_texts.cache_clear()
    sent = with_messages({"reason": text})
    assert sent["messages"][text]["arguments"] == {"value_mm": "9.75"}
