"""The languages in which a certificate can be read: its own words, and those of procedures and refusals.

What is signed is English and stays as it is. Numbers keep the point that they have in the signed file, so that
nobody has to ask whether two sheets say the same.
"""

import re
from functools import cache
from pathlib import Path

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.service.translation import Locale, Sayings, sayings

_COMMA = re.compile(r"(?<=\d),(?=\d)")  # in a number
_OWN = Path(__file__).with_name("translations")


@cache
def words_in(locale: Locale) -> Sayings:
    """Return a language's words."""
    file = _OWN / f"{locale}.json"
    own = parse_json(read_plain_text(file)) if file.is_file() else {}
    return spoken(locale, sayings(locale).table | own)


def spoken(locale: Locale, table: dict[str, str]) -> Sayings:
    """Return the words of a table, with numbers as they are signed."""
    pointed = {english: _COMMA.sub(".", said) for english, said in table.items()}
    return Sayings.of(locale, pointed, commas=False)
