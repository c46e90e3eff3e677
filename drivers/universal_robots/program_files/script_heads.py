"""The first lines of a URScript's functions: names and parameters, whose defaults may be calls, lists or poses."""

import re
from collections.abc import Iterator
from typing import NamedTuple

_HEAD = re.compile(r"^[ \t]*+(?:def|thread|sec)[ \t]++([A-Za-z_]\w*+)[ \t]*+\(", re.ASCII | re.MULTILINE)
_PIECE = re.compile(r"\"[^\"\n]*+\"|'[^'\n]*+'|\#[^\n]*+|(?P<open>[(\[{])|(?P<close>[)\]}])|(?P<comma>,)")
_PARAMETER = re.compile(r"\s*+([A-Za-z_]\w*+)", re.ASCII)
_LONGEST = 5000  # a bracket that is not closed within it does not end the parameters


class FunctionHead(NamedTuple):
    """A function's name and its parameters in their order."""

    name: str
    parameters: tuple[str, ...]  # "" for one that is not understood; ("",) where there is none


def head_at(text: str, start: int) -> FunctionHead | None:
    """Return the head in the line that begins at an offset; None for one that is not understood."""
    found = _HEAD.match(text, start)
    return None if found is None else _read_parameters(text, found)


def heads_in(text: str) -> Iterator[FunctionHead]:
    """Yield the heads of a script that are understood."""
    for found in _HEAD.finditer(text):
        head = _read_parameters(text, found)
        if head is not None:
            yield head


def _read_parameters(text: str, found: re.Match[str]) -> FunctionHead | None:
    names, depth, begin = list[str](), 0, found.end()
    for piece in _PIECE.finditer(text, begin, begin + _LONGEST):
        if piece["open"]:
            depth += 1
        elif piece["close"] and depth:
            depth -= 1
        elif piece["close"] or (piece["comma"] and not depth):
            named = _PARAMETER.match(text, begin, piece.start())
            names.append(named[1] if named else "")
            begin = piece.end()
            if piece["close"]:
                return FunctionHead(found[1], tuple(names))
    return None
