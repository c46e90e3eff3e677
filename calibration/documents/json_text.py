"""JSON within limits: finite numbers, whole numbers of 64 bits, text that can be written, bounded depth.

A name that an object holds twice with two values is refused: readers differ in which of them they take.
"""

import json
import math
import re
from typing import Any

from cellcal.calibration.documents.errors import DocumentError

MOST_BYTES = 64_000_000
MOST_DEPTH = 64
_LONGEST_NUMBER = 400  # characters; a double has at most 17 digits
_SMALLEST, _LARGEST = -(1 << 63), (1 << 64) - 1
_STRUCTURE = re.compile(r'"(?:[^"\\]++|\\.)*+"?|[\[\]{}]', re.DOTALL)
_HALF_CHARACTER = re.compile("[\ud800-\udfff]")
_CURE = "Give the file as the program that made it wrote it."


def parse_json(raw: bytes | str, *, most_bytes: int = MOST_BYTES, most_depth: int = MOST_DEPTH) -> Any:
    """Return what a JSON document holds.

    Raises
    ------
    DocumentError
        It is no JSON in UTF-8, or goes past a limit.
    """
    if len(raw) > most_bytes:
        raise _json_error(f"it is larger than {most_bytes} bytes")
    try:
        text = raw if isinstance(raw, str) else raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _json_error(f"it is not text in UTF-8 (byte {error.start})") from error
    _refuse_depth(text, most_depth)
    try:
        found = json.loads(
            text.removeprefix("\ufeff"),
            object_pairs_hook=_join_fields,
            parse_constant=_refuse_constant,
            parse_float=_parse_real,
            parse_int=_parse_whole,
        )
    except DocumentError:
        raise
    except (ValueError, RecursionError) as error:
        raise _json_error(str(error)) from error
    if "\\u" in text or _HALF_CHARACTER.search(text):
        _refuse_half_characters(found)
    return found


def _json_error(why: str) -> DocumentError:
    return DocumentError(f"it is not valid JSON: {why}.", remedy=_CURE)


def _refuse_depth(text: str, most_depth: int) -> None:
    if text.count("[") + text.count("{") <= most_depth:
        return
    depth = 0
    for mark in _STRUCTURE.finditer(text):
        first = mark[0]
        depth += (first in "[{") - (first in "]}")
        if depth > most_depth:
            raise _json_error(f"it is nested deeper than {most_depth} levels")


def _join_fields(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) < len(pairs):
        for name, value in pairs:
            if fields[name] != value:
                raise _json_error(f"{name[:40]!r} stands in it twice, with two values")
    return fields


def _refuse_constant(word: str) -> Any:
    raise _json_error(f"{word} is not a number that can be used")


def _parse_real(digits: str) -> float:
    value = float(digits) if len(digits) <= _LONGEST_NUMBER else math.inf
    if not math.isfinite(value):
        raise _json_error(f"{digits[:40]} is too large or too long for a number")
    return value


def _parse_whole(digits: str) -> int:
    if len(digits) <= len(str(_SMALLEST)):
        value = int(digits)
        if _SMALLEST <= value <= _LARGEST:
            return value
    raise _json_error(f"{digits[:40]} is too large for a whole number")


def _refuse_half_characters(found: Any) -> None:
    waiting = [found]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict):
            waiting += [*one.keys(), *one.values()]
        elif isinstance(one, list):
            waiting += one
        elif isinstance(one, str) and _HALF_CHARACTER.search(one):
            raise _json_error("a text in it holds half a character (a surrogate)")
