"""Statements that set an external axis of a point while the program runs: what stands in the file holds no longer."""

import re

_STATEMENTS = {
    "kuka": re.compile(rb"\.[ \t]*E[1-6][ \t]*=(?!=)", re.IGNORECASE),
    "abb": re.compile(rb"\.\s*extax\b[^;:\"]{0,80}:=", re.IGNORECASE),
    # element 7 to 9 of a position register, or one that a register chooses
    "fanuc": re.compile(rb"PR\[[^=;\n]{0,60},[ ]*(?:[7-9][ ]*|A?R\[[^=;\n]{0,40})\][ ]*="),
    "yaskawa": re.compile(
        rb"^[ \t]*(?:SETE?|ADD|SUB|MUL|DIV|INC|DEC|GETS|GETE|CNVRT)[ \t]+L?(?:BP|EX)\d", re.MULTILINE
    ),
}


def sets_external_axes(brand: str, data: bytes) -> bool:
    """Return whether a program of a brand may set an external axis of a point; comments count, too."""
    pattern = _STATEMENTS.get(brand)
    return pattern is not None and pattern.search(data) is not None
