"""Positions that stand in a RAPID file and were not read: in records, arrays of records, calls, computed in part."""

import re
from collections.abc import Iterator, Set

from cellcal.drivers.abb.program_files.literals import NOT_CODE, W

INSIDE = "it stands inside other data, or is computed in part, and is not read"
_VALUE = r'[^\[\],;!"]++'
_LIST3, _LIST4, _LIST6 = (
    rf"\[{W}{_VALUE}" + rf",{W}{_VALUE}" * (count - 1) + rf"\]{W}" for count in (3, 4, 6)
)
_COMMA = rf",{W}"
_NEAR = re.compile(r"\[(?=\s*+(?:![^\n]*+\n\s*+)*+(?:\[|[A-Za-z\x80-\xff][^\[\],;!\"]*+,\s*+\[))")
_PLACE = rf"(?:{_LIST3}{_COMMA}(?:{_LIST4}|{_VALUE})|{_VALUE}{_COMMA}{_LIST4})"  # and an orientation, one written out
_POSITION = re.compile(
    rf"\[{W}(?:({_PLACE}){_COMMA}(?:{_LIST4}|{_VALUE}){_COMMA}(?:{_LIST6}|{_VALUE})|({_LIST6}){_COMMA}{_LIST6})\]",
    re.ASCII,
)
_NEXT = r"\s*+[-+.\d][^\[\],;]*+"
LIKE_A_POSITION = re.compile(  # a place and a quaternion, or two lists of six axes
    rf"\[\s*+\[{_NEXT}(?:,{_NEXT}(?:,{_NEXT}\]\s*+,\s*+\[{_NEXT}(?:,{_NEXT}){{3}}\]|(?:,{_NEXT}){{4}}\]\s*+,\s*+\[))"
)
_DIGIT = re.compile(r"\d")
_NOT_CODE = re.compile(NOT_CODE)


def unread_positions(text: str, read: Set[int]) -> Iterator[int]:
    """Yield where positions open that are not among those that were read, comments and strings left out."""
    for near in _NEAR.finditer(text):
        place = near.start()
        if place in read:
            continue
        found = _POSITION.match(text, place)
        if found is not None and _DIGIT.search(found[1] or found[2]) and not _outside_code(text, place):
            yield place


def _outside_code(text: str, place: int) -> bool:
    """Return whether a place is inside a comment or a string."""
    start = text.rfind("\n", 0, place) + 1
    return any(
        found.end() > place for found in _NOT_CODE.finditer(text, start, place + 1) if found.start() < place
    )
