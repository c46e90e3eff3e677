"""The languages in which a certificate can be read: its own words, and those of procedures and refusals.

What is signed is English and stays as it is; a signed file holds no templates. Numbers keep the point that they have
in the signed file, so that two sheets can be compared line by line.
"""

import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.service.legacy_texts import LegacyTexts
from cellcal.service.translation import Locale, Translations, load_translations

_COMMA = re.compile(r"(?<=\d),(?=\d)")  # in a number of a translation
_OWN = Path(__file__).with_name("translations")


@cache
def translations_in(locale: Locale) -> Translations:
    """Return a language's words."""
    file = _OWN / f"{locale}.json"
    own = parse_json(read_plain_text(file)) if file.is_file() else {}
    return build_translations(locale, {**load_translations(locale).table, **own})


def build_translations(locale: Locale, table: Mapping[str, str]) -> Translations:
    """Return the words of a table, with numbers as they are signed."""
    pointed = {english: _COMMA.sub(".", translated) for english, translated in table.items()}
    return Translations(locale, pointed, commas=False, find=LegacyTexts.from_templates(table).find_message)
