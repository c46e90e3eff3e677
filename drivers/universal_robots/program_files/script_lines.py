"""Blocks of a URScript that stand in one line, with each statement in a line of its own.

``while not is_steady(): sync() end`` is written by people who send scripts to a controller. Whether each controller
takes it, no document says; what follows it must not be read as its inside. A line feed takes the place of a blank,
so that every offset stays.
"""

import re

_CANDIDATE = re.compile(
    r"^(?=[^\n]*?(?::[ \t]++[^\s#]|\S[ \t]++(?:end|else|elif)\b))[^\n]*+", re.ASCII | re.MULTILINE
)
_PIECE = re.compile(
    r"(?P<skipped>\"[^\"\n]*+\"|'[^'\n]*+'|\#[^\n]*+)|(?P<open>[(\[{])|(?P<close>[)\]}])|(?P<colon>:)|(?P<word>\w++)",
    re.ASCII,
)
_BEGINS = re.compile(r"[ \t]*+(?:def|thread|sec|while|if|for|switch|else|elif|case|default)\b", re.ASCII)
_CODE = re.compile(r"[ \t]*+\S")
_BLANK = re.compile(r"[ \t](?=[ \t]*+[^\s#])")


def with_one_statement_a_line(text: str) -> str:
    """Return a text of the same length in which no block begins or ends within a line."""
    breaks = [at for line in _CANDIDATE.finditer(text) for at in _breaks_in(line)]
    if not breaks:  # as in nearly all
        return text
    characters = list(text)
    for at in breaks:
        characters[at] = "\n"
    return "".join(characters)


def _breaks_in(line: re.Match[str]) -> list[int]:
    """Return the blanks of a line behind a block's colon, before the words that end it and behind its end."""
    text, start, found, depth = line.string, line.start(), list[int](), 0
    for piece in _PIECE.finditer(text, start, line.end()):
        if piece["open"]:
            depth += 1
        elif piece["close"]:
            depth -= 1
        if depth or piece["skipped"]:
            continue
        at = piece.start()
        is_last = piece["word"] in ("end", "else", "elif") and text[at - 1] in " \t"
        if is_last and _CODE.match(text, start, at) is not None:
            found.append(at - 1)
            start = at
        begins_block = piece["colon"] and _BEGINS.match(text, start)
        if (begins_block or piece["word"] == "end") and (blank := _BLANK.match(text, piece.end())):
            found.append(blank.start())
            start = blank.end()
    return found
