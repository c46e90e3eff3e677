"""The languages in which a certificate can be read: its own words, and those of procedures and refusals.

What is signed is English and stays as it is; a signed file holds no templates. Numbers have their digits, with the
decimal mark of the language: to a German or Spanish reader, 1335.444 mm is more than a million.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.service.legacy_texts import LegacyTexts
from cellcal.service.translation import Locale, Translations, load_translations, writes_commas

_OWN = Path(__file__).with_name("translations")


@cache
def translations_in(locale: Locale) -> Translations:
    """Return a language's words."""
    file = _OWN / f"{locale}.json"
    own = parse_json(read_plain_text(file)) if file.is_file() else {}
    return build_translations(locale, {**load_translations(locale).table, **own})


def build_translations(locale: Locale, table: Mapping[str, str]) -> Translations:
    """Return the words of a table, which also know what was signed without templates."""
    return Translations(
        locale, table, commas=writes_commas(locale), find=LegacyTexts.from_templates(table).find_message
    )
