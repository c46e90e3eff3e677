"""Instructions of Yaskawa jobs in capitals, as controllers write them."""

import re
from string import ascii_lowercase, ascii_uppercase

_SMALL_LETTERS = re.compile(r"^(?:[^\na-z/']|/(?!/))*+[a-z][^\n]*+", re.MULTILINE)  # before a comment
_KEPT = re.compile(
    r"//|'|(?<=job:)[ \t]*+[^\s,]++", re.IGNORECASE
)  # a comment begins, or a job's name stands
_CAPITALS = str.maketrans(ascii_lowercase, ascii_uppercase)


def in_capitals(instructions: str) -> str:
    """Return instructions in capitals where an editor wrote some in small letters; the file keeps its own."""
    return _SMALL_LETTERS.sub(_line_in_capitals, instructions)


def _line_in_capitals(line: re.Match[str]) -> str:
    """Return a line in capitals but for the names of jobs and its comment."""
    text, pieces, at = line[0], list[str](), 0
    for kept in _KEPT.finditer(text):
        pieces.append(text[at : kept.start()].translate(_CAPITALS))
        at = kept.start()
        if kept[0] in ("'", "//"):
            return "".join([*pieces, text[at:]])
        pieces.append(kept[0])
        at = kept.end()
    return "".join([*pieces, text[at:].translate(_CAPITALS)])
