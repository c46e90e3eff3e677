"""Names that a RAPID module declares with a value that holds places, such as a record of a station."""

import re

_DECLARED = re.compile(
    r"\b(?:PERS|CONST|VAR)[ \t]+([A-Za-z]\w*)[ \t]+([A-Za-z]\w*)[ \t]*(?:\{[^}\n]*\})?\s*:="
    r"(?=[^;]*\[\s*\[\s*[-+.\d])",  # numbers of a place, which are left and named where they stand
    re.IGNORECASE,
)
_POINTS = frozenset(("robtarget", "jointtarget"))  # which have a declaration of their own


def declared_records(text: str) -> frozenset[str]:
    """Return the names, in small letters."""
    return frozenset(name.lower() for kind, name in _DECLARED.findall(text) if kind.lower() not in _POINTS)
