"""Data that RAPID sets by a name which is computed (SetDataVal, SetAllDataVal): any data of the value's type."""

import re
from collections.abc import Iterator

from cellcal.drivers.abb.program_files.literals import NAME, decode_name
from cellcal.drivers.abb.program_files.passed_targets import TYPES_WITHOUT_TARGETS, split_arguments

_BY_NAME = re.compile(
    r'![^\n]*+|"(?:[^"\n]++|"")*+"?+|\bSet(?P<all>All)DataVal\b|\bSetDataVal\b(?!\s*+"\w++"\s*+[,\\])',
    re.ASCII | re.IGNORECASE,
)
_TYPE = re.compile(r'\s*+"(\w++)"\s*+', re.ASCII)
_PLAIN = re.compile(rf"\s*+({NAME})\s*+(?:\{{[^{{}}]*+\}}\s*+)?+", re.ASCII)
_SMALL_VALUE = re.compile(r'\s*+(?:[-+\d.]|"|TRUE\b|FALSE\b)', re.IGNORECASE)  # a number, a text, a truth
_HARMLESS = TYPES_WITHOUT_TARGETS - {"tooldata", "wobjdata"}


def sets_any_place(text: str) -> bool:
    """Return whether a module may set any target, tool or work object by a name that is computed."""
    return any(kind not in _HARMLESS for kind in _types_set(text))


def _types_set(text: str) -> Iterator[str]:
    """Yield the types, in small letters, of the data that it sets by such names; "" where that is not certain."""
    for found in _BY_NAME.finditer(text):
        if found[0][0] in '!"':
            continue
        arguments = [
            part for is_option, part in split_arguments(text, (found.end(), len(text))) if not is_option
        ]
        named = _TYPE.fullmatch(arguments[0]) if found["all"] and arguments else None
        if found["all"]:
            yield named[1].lower() if named else ""
        else:
            yield _type_of_value("".join(arguments[1:2]), text)


def _type_of_value(value: str, text: str) -> str:
    if _SMALL_VALUE.match(value):
        return "num"
    plain = _PLAIN.fullmatch(value)
    if plain is None:
        return ""
    name = re.escape(decode_name(plain[1]))
    kinds = re.findall(
        rf"\b(?:VAR|PERS|CONST|INOUT|[,(])\s*+(\w++)\s++{name}\b", text, re.ASCII | re.IGNORECASE
    )
    return kinds[0].lower() if len({kind.lower() for kind in kinds}) == 1 else ""
