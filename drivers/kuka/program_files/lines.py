"""Lines of KRL: what is code and what is comment, and the words that name things."""

import re
from dataclasses import dataclass
from typing import NamedTuple

_B = r"[ \t\r]"
LINE = r'(?P<code>(?:[^;"\n]++|"[^"\n]*+"?+)*+)(?P<comment>;[^\n]*+)?+(?:\n|\Z)'
_LINE = re.compile(LINE)
_DECLARATION = re.compile(
    rf"{_B}*+(?:(?:DECL|GLOBAL|PUBLIC|CONST){_B}++)*+(E6POS|POS|E6AXIS|AXIS|FRAME|FDAT){_B}++(?=[$A-Za-z_])",
    re.ASCII | re.IGNORECASE,
)
_ITEM = re.compile(
    rf"{_B}*+([$A-Za-z_][\w$]*+)(?:{_B}*+\[([^\[\]\n]*+)\])?+{_B}*+(=(?!=)|,|\Z)?+{_B}*+", re.ASCII
)
_WORD = re.compile(rf"{_B}*+(\w*+)", re.ASCII)
DECLARING = frozenset(
    ("DECL", "GLOBAL", "PUBLIC", "CONST", "E6POS", "POS", "E6AXIS", "AXIS", "FRAME", "FDAT")
)  # words that a declaration of a position begins with
_STRING = re.compile(r'"[^"\n]*+"?+')
_STRUCT = re.compile(r"\{[^{}]*+\}")
_FIELD = re.compile(rf"(?<=[{{,]){_B}*+(?:\w++{_B}*+:)?+{_B}*+\w++(?:\[\])?+(?={_B})", re.ASCII)


class KrlLine(NamedTuple):
    """One line: code from ``start`` to ``end``, then a comment."""

    start: int
    end: int
    comment: str


@dataclass(slots=True)
class NamedItem:
    """A name that is declared or assigned, with its index, and where its value begins."""

    name: str
    index: str | None
    value: int | None  # None: it gets none here
    end: int

    @property
    def full_name(self) -> str:
        """Return the name with its index, without blanks."""
        return self.name if self.index is None else f"{self.name}[{''.join(self.index.split())}]"


def line_at(text: str, place: int) -> KrlLine | None:
    """Return the line that begins at a place; None for one that holds nothing."""
    found = _LINE.match(text, place)
    assert found is not None  # any line is one
    start, end = found.span(1)
    return KrlLine(start, end, found[2] or "") if start < end or found[2] else None


def first_word(text: str, line: KrlLine) -> str:
    """Return the word that a line begins with, in capitals; "" where it begins with something else."""
    found = _WORD.match(text, line.start, line.end)
    return "" if found is None else found[1].upper()


def find_declaration(text: str, line: KrlLine) -> tuple[str, int] | None:
    """Return the type that a line declares, in capitals, and where its names begin; None for other lines."""
    found = _DECLARATION.match(text, line.start, line.end)
    return None if found is None else (found[1].upper(), found.end())


def find_item(text: str, place: int, end: int) -> NamedItem | None:
    """Return the name at a place and whether ``=`` follows."""
    found = _ITEM.match(text, place, end)
    if found is None:
        return None
    return NamedItem(found[1], found[2], found.end() if found[3] == "=" else None, found.end())


def without_strings(code: str) -> str:
    """Return code with blanks in place of its strings, so that nothing in them is taken for code."""
    return _STRING.sub(lambda found: " " * len(found[0]), code) if '"' in code else code


def without_field_names(code: str) -> str:
    """Return code with blanks in place of the names of components in braces: ``{X 5,Y dy}`` names ``dy`` only."""
    if "{" not in code:
        return code
    return _STRUCT.sub(lambda struct: _FIELD.sub(lambda name: " " * len(name[0]), struct[0]), code)


def point_key(name: str, index: str | None) -> str:
    """Return a point's name as its uses have it: ``[]`` is an element whose number the program computes."""
    if index is None:
        return name.upper()
    index = "".join(index.split())
    return name.upper() + (f"[{index}]" if index.replace(",", "").isdigit() else "[]")


def skip_blanks(text: str, place: int, end: int) -> int:
    """Return where what follows blanks begins."""
    while place < end and text[place] in " \t\r":
        place += 1
    return place
