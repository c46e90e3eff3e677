"""The user frame and the tool that are in force when a program ends, where that is certain.

A program that is called chooses a frame for its own work, and often the caller's again at its end: by its number, or
from a register in which it kept the number at its beginning.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from cellcal.drivers.fanuc.program_files.ls_statements import (
    BESIDE_WORDS,
    Statement,
    before_positions,
    macro_of,
    read_statements,
)
from cellcal.drivers.programs.file_declarations import CALLED_LAST, NOT_CERTAIN


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
_CALL = re.compile(rb"(?:CALL|AUFRUF)[ \t]++([A-Za-z_]\w*+)[ \t]*+(?:\([^;]*\))?[ \t]*+", re.IGNORECASE)
_ENDS = re.compile(rb"\b(?:ABORT|END|ENDE)\b")
# A way through the program may part or meet another one here, or another program may choose a frame.
_BRANCHES = re.compile(
    rb"\b(?:IF|WENN|LBL|MARKE|JMP|SPRUNG|SELECT|FOR|ENDFOR|WHILE|ENDWHILE|ELSE|ELSEIF|ENDIF|SKIP|ABORT|END|ENDE"
    rb"|CALL|AUFRUF|" + BESIDE_WORDS + rb")\b",
    re.IGNORECASE,
)


def frame_left_by(data: bytes) -> str | None:
    """Return the frame in force at the end, "" for the one that the program began with; None where not certain.

    Programs that it surely calls behind all choices stand before it, as `RoutineEffects.frame_left` says.
    """
    return _number_left(_OF_FRAME, data)


def tool_left_by(data: bytes) -> str | None:
    """Return the tool in force at the end, as `frame_left_by` the frame."""
    return _number_left(_OF_TOOL, data)


def _number_left(patterns: _Patterns, data: bytes) -> str | None:
    statements = list(read_statements(data))
    called, rest = _called_last(patterns, statements)
    own = _own_number_left(patterns, data, rest)
    if not called:
        return own
    chooses = patterns.selection.search(before_positions(data)) is not None
    if own is None and not chooses and not any(_is_branch(each) for each in rest):
        own = ""  # it chooses none itself
    return CALLED_LAST.join([*called, NOT_CERTAIN if own is None else own])


def _called_last(
    patterns: _Patterns, statements: Sequence[Statement]
) -> tuple[list[str], Sequence[Statement]]:
    """Return the programs that are called on every way behind all choices, the last first, and what is above them."""
    called: list[str] = []
    end = len(statements)
    for number in range(len(statements) - 1, -1, -1):
        text = statements[number].text
        if (call := _CALL.fullmatch(text)) is not None:
            called.append(call[1].decode("cp437").upper())
            end = number
        elif _is_branch(statements[number]) or patterns.selection.search(text):
            break
    if any(_ENDS.search(each.text) for each in statements[:end]):
        return [], statements
    return called, statements[:end]


def _is_branch(statement: Statement) -> bool:
    return _BRANCHES.search(statement.text) is not None or macro_of(statement) != ""


def _own_number_left(patterns: _Patterns, data: bytes, statements: Sequence[Statement]) -> str | None:
    if not patterns.selection.search(before_positions(data)):
        return None  # programs that it calls may choose one
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
    if any(_is_branch(each) for each in statements[last + 1 :]):
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
