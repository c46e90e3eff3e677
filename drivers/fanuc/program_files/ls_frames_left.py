"""The user frame and the tool that are in force when a program ends, where that is certain.

A program that is called chooses a frame for its own work, and often the caller's again at its end: by its number, or
from a register in which it kept the number at its beginning.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from cellcal.drivers.fanuc.program_files.ls_statements import before_positions, macro_of, read_statements


class _Patterns(NamedTuple):
    """The forms in which a program chooses a frame or a tool, and stores its number in a register."""

    selection: re.Pattern[bytes]
    by_number: re.Pattern[bytes]
    restored: re.Pattern[bytes]
    saved: re.Pattern[bytes]


def _patterns_of(words: bytes, variable: bytes) -> _Patterns:
    word = rb"(?:" + words + rb"|\$" + variable + rb")[ \t]*+(?:\[ *+(?:GP *+)?+1 *+\][ \t]*+)?+"
    return _Patterns(
        re.compile(rb"\b(?:" + words + rb")\b|" + variable),
        re.compile(word + rb"=[ \t]*+(\d{1,5}+)"),
        re.compile(word + rb"=[ \t]*+R\[ *+(\d++) *+\]"),
        re.compile(rb"R\[ *+(\d++) *+\][ \t]*+=[ \t]*+\(?[ \t]*+" + word + rb"\)?"),
    )


_OF_FRAME = _patterns_of(rb"UFRAME_NUM|BENUTZER_NUM", b"MNUFRAMENUM")
_OF_TOOL = _patterns_of(rb"UTOOL_NUM|WKZ_NUM", b"MNUTOOLNUM")
_GETS_VALUE = re.compile(rb"(?<![A-Z])R\[ *+(\d++|[A-Z]++\[[^\]]*+\]) *+\][ \t]*+=")
_ENDS = re.compile(rb"\b(?:ABORT|END|ENDE)\b")
# A way through the program may part or meet another one here, or another program may choose a frame.
_BRANCHES = re.compile(
    rb"\b(?:IF|WENN|LBL|MARKE|JMP|SPRUNG|SELECT|FOR|ENDFOR|WHILE|ENDWHILE|ELSE|ELSEIF|ENDIF|SKIP|ABORT|END|ENDE"
    rb"|CALL|AUFRUF|RUN|MONITOR)\b",
    re.IGNORECASE,
)


def frame_left_by(data: bytes) -> str | None:
    """Return the frame in force at the end, "" for the one that the program began with; None where not certain."""
    return _number_left(_OF_FRAME, data)


def tool_left_by(data: bytes) -> str | None:
    """Return the tool in force at the end, as `frame_left_by` the frame."""
    return _number_left(_OF_TOOL, data)


def _number_left(patterns: _Patterns, data: bytes) -> str | None:
    if not patterns.selection.search(before_positions(data)):
        return None  # programs that it calls may choose one
    statements = list(read_statements(data))
    texts = [each.text for each in statements]
    chosen = [
        number
        for number, text in enumerate(texts)
        if patterns.selection.search(text) and not patterns.saved.fullmatch(text)
    ]
    if not chosen:
        return None
    first, last = chosen[0], chosen[-1]
    if any(_ENDS.search(text) for text in texts[:last]):
        return None
    if any(_BRANCHES.search(each.text) or macro_of(each) for each in statements[last + 1 :]):
        return None
    if (number := patterns.by_number.fullmatch(texts[last])) is not None:
        return str(int(number[1]))
    return "" if _is_restored(patterns, texts, first, last) else None


def _is_restored(patterns: _Patterns, texts: Sequence[bytes], first: int, last: int) -> bool:
    """Return whether the last choice is that of a register that got the number before the first one, and no other."""
    restored = patterns.restored.fullmatch(texts[last])
    if restored is None:
        return False
    register = restored[1]
    begun = next((number for number, text in enumerate(texts) if _BRANCHES.search(text)), len(texts))
    saved = [
        (number, found[1]) for number, text in enumerate(texts) if (found := patterns.saved.fullmatch(text))
    ]
    saves = [number for number, its_register in saved if its_register == register]
    assigned = [each for text in texts for each in _GETS_VALUE.findall(text)]
    assigned = [each for each in assigned if each == register or not each.isdigit()]
    return len(saves) == len(assigned) == 1 and saves[0] < min(first, begun)
