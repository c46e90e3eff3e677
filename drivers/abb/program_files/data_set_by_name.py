"""Data that RAPID sets by a name which is computed (SetDataVal, SetAllDataVal): any data of the value's type."""

import re
from collections.abc import Iterator, Mapping, Set

from cellcal.drivers.abb.program_files.literals import NAME, NOT_CODE, decode_name
from cellcal.drivers.abb.program_files.passed_targets import TYPES_WITHOUT_TARGETS, split_arguments

_BY_NAME = re.compile(
    rf'{NOT_CODE}|\bSet(?P<all>All)DataVal\b|\bSetDataVal\b(?!\s*+"\w++"\s*+[,\\])',
    re.ASCII | re.IGNORECASE,
)
_DECLARED = re.compile(
    rf"(?:\b(?:VAR|PERS|CONST|INOUT)\s++|[,(]\s*+)(\w++)\s++({NAME})", re.ASCII | re.IGNORECASE
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
    declared: dict[str, set[str]] = {}
    for found in _BY_NAME.finditer(text):
        if found[0][0] in '!"':
            continue
        arguments = [
            part for is_option, part in split_arguments(text, (found.end(), len(text))) if not is_option
        ]
        if found["all"]:
            named = _TYPE.fullmatch(arguments[0]) if arguments else None
            yield named[1].lower() if named else ""
            continue
        declared = declared or _declared_types(text)
        yield _type_of_value("".join(arguments[1:2]), declared)


def _declared_types(text: str) -> dict[str, set[str]]:
    """Return the types that data and parameters of a name are declared with, all in small letters."""
    found: dict[str, set[str]] = {}
    for kind, name in _DECLARED.findall(text):
        found.setdefault(decode_name(name).lower(), set()).add(kind.lower())
    return found


def _type_of_value(value: str, declared: Mapping[str, Set[str]]) -> str:
    if _SMALL_VALUE.match(value):
        return "num"
    plain = _PLAIN.fullmatch(value)
    kinds = declared.get(decode_name(plain[1]).lower(), ()) if plain is not None else ()
    return "".join(kinds) if len(kinds) == 1 else ""
