"""TOML within limits: size, depth, parts of a key, finite numbers, whole numbers of 64 bits.

``tomllib`` needs time in the square of the parts of a dotted key and recursion for nested lists; both are bounded
before it sees the text.
"""

import math
import re
import tomllib
from typing import Any

from cellcal.calibration.documents.errors import DocumentError

MOST_CHARACTERS = 1_000_000
_MOST_PARTS, _MOST_DEPTH = 12, 32
_LONGEST_NUMBER = 400
_SMALLEST, _LARGEST = -(1 << 63), (1 << 63) - 1
_MARKS = re.compile(
    r'"""(?:[^"\\]++|\\.|"(?!""))*+(?:"{3,5})?' + r"|'''(?:[^']++|'(?!''))*+(?:'{3,5})?"
    r'|"(?:[^"\\\n]++|\\[^\n])*+"?' + r"|'[^'\n]*+'?|#[^\n]*+|[\[\]{}.=,\n]",
    re.DOTALL,
)  # a quotation mark that is never closed takes the rest, so that nothing is looked at twice
_LONG_NUMBER = re.compile(r"\d[\d_]{4000,}")  # longer than what Python itself converts
_CURE = "Correct the file and try again."


def parse_toml(text: str, *, most_characters: int = MOST_CHARACTERS) -> dict[str, Any]:
    """Return what a TOML document holds.

    Raises
    ------
    DocumentError
        It is no TOML, or goes past a limit.
    """
    if len(text) > most_characters:
        raise _toml_error(f"it is longer than {most_characters} characters")
    plain = text.removeprefix("\ufeff")
    _refuse_nesting(plain)
    try:
        found = tomllib.loads(plain, parse_float=_parse_real)
    except DocumentError:
        raise
    except (ValueError, RecursionError, OverflowError) as error:
        if (long_number := _LONG_NUMBER.search(plain)) and "int_max_str_digits" in str(error):
            line = plain.count("\n", 0, long_number.start()) + 1
            raise _toml_error(f"line {line}: a whole number is larger than 64 bits") from error
        raise _toml_error(str(error)[:300]) from error
    _refuse_numbers(found)
    return found


def _toml_error(why: str, key: str = "") -> DocumentError:
    return DocumentError(f"it is not valid TOML: {why}.", remedy=_CURE, key=key)


def _refuse_nesting(text: str) -> None:
    depth = parts = 0
    for found in _MARKS.finditer(text):
        mark = found[0]
        if mark == ".":
            parts += 1
        elif mark in "[{":
            depth, parts = depth + 1, 0
        elif mark in "]}":
            depth, parts = max(depth - 1, 0), 0
        elif mark in "=,\n":
            parts = 0
        if parts > _MOST_PARTS or depth > _MOST_DEPTH:
            line = text.count("\n", 0, found.start()) + 1
            raise _toml_error(f"line {line} is nested too deep")


def _parse_real(digits: str) -> float:
    return float(digits) if len(digits) <= _LONGEST_NUMBER else math.inf


def _refuse_numbers(document: dict[str, Any]) -> None:
    waiting: list[tuple[str, Any]] = [("", document)]
    while waiting:
        key, one = waiting.pop()
        if isinstance(one, dict):
            waiting += [(f"{key}.{name}".lstrip("."), value) for name, value in one.items()]
        elif isinstance(one, list):
            waiting += [(f"{key}[{i}]", value) for i, value in enumerate(one)]
        elif isinstance(one, float) and not math.isfinite(one):
            raise _toml_error(f"{key[:100]}: {one} is not a finite number", key)
        elif isinstance(one, int) and not _SMALLEST <= one <= _LARGEST:
            raise _toml_error(f"{key[:100]}: a whole number is larger than 64 bits", key)
