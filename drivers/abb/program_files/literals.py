"""RAPID aggregates of positions: nested lists of numbers with blanks, line ends and comments between them."""

import re
from dataclasses import dataclass

from cellcal.calibration.message import make_message

W = r"(?:[ \t\r\n\f]++|![^\n]*+)*+"  # what may stand between two tokens
NOT_CODE = r'![^\n]*+|"(?:[^"\n]++|"")*+"?+'  # a comment, or a text in quotes
NAME = r"[A-Za-z\x80-\xff][\w\x80-\xff]*+"  # any letter of ISO 8859-1 or, byte by byte, of UTF-8
NUMBER = r"[+-]?(?:\d++(?:\.\d*+)?+|\.\d++)(?:[eE][+-]?\d++)?+(?![\w.])"
OPTION = re.compile(rf"{W}({NAME}){W}:=", re.ASCII)  # of a call, behind its backslash
NAMED_ARGUMENT = re.compile(rf"\A{W}{NAME}{W}:={W}", re.ASCII)  # a parameter's name before what it gets
OPENED = re.compile(rf"{W}(\()?+", re.ASCII)  # the bracket of a function's arguments, if any
INDEX = re.compile(r"\d+(?:,\d+)*")  # of an array, without blanks
_FLAG = r"TRUE|FALSE"
_TEXT = r'"[^"\n]*+"'
_TOKENS = {"n": NUMBER, "b": _FLAG, "s": _TEXT}
_NAMES = {"n": "a number", "b": "TRUE or FALSE", "s": "a string"}
_BLANK = re.compile(W)
_BETWEEN = re.compile(rf"{NOT_CODE}|[\[\](){{}},;]")
_COMPUTED = re.compile(r"[A-Za-z(]|[+-]\s*[A-Za-z(]|[*/+-]", re.ASCII)

_NO_NUMBER = re.compile(r"[+-]?(?:\d*\.?#)?(?:[QS]?NAN|IND|INF)\b", re.ASCII | re.IGNORECASE)
_ONE_LINE = re.compile(r'[^!";\n]*+')  # of an aggregate whose brackets say where it ends

POSE = "[nnn][nnnn]"
ROBTARGET = f"[{POSE}[nnnn][nnnnnn]]"
JOINTTARGET = "[[nnnnnn][nnnnnn]]"
TOOLDATA = f"[b[{POSE}][n[nnn][nnnn]nnn]]"
WOBJDATA = f"[bbs[{POSE}][{POSE}]]"


class AggregateError(ValueError):
    """The text is not the aggregate that is expected.

    ``computed`` where only the controller knows a value, ``broken`` where one of a whole aggregate is no number.
    """

    def __init__(self, place: int, message: str, *, computed: bool, broken: bool = False) -> None:
        super().__init__(message)
        self.place = place
        self.computed = computed
        self.broken = broken


def tokens_of(shape: str) -> list[str]:
    """Return the tokens of a shape: brackets, commas and values."""
    tokens: list[str] = []
    for sign in shape:
        if tokens and sign != "]" and tokens[-1] != "[":
            tokens.append(",")
        tokens.append(sign)
    return tokens


@dataclass(frozen=True)
class RapidAggregate:
    """One shape of aggregate."""

    tokens: list[str]
    pattern: re.Pattern[str]

    @classmethod
    def from_shape(cls, shape: str) -> "RapidAggregate":
        """Build from a shape such as ``[[nnn][nnnn]]``."""
        tokens = tokens_of(shape)
        parts = (f"({_TOKENS[token]})" if token in _TOKENS else re.escape(token) for token in tokens)
        return cls(tokens, re.compile(W.join(parts), re.ASCII | re.IGNORECASE))

    def match_at(self, text: str, place: int) -> re.Match[str]:
        """Return the aggregate that stands at a place; its groups are the values.

        Raises
        ------
        LiteralError
            Something else stands there.
        """
        found = self.pattern.match(text, place)
        if found is None:
            raise self.error_at(text, place)
        return found

    def error_at(self, text: str, place: int) -> AggregateError:
        """Return what is wrong with an aggregate that does not stand at a place."""
        begin = place
        for token in self.tokens:
            blank = _BLANK.match(text, place)
            place = blank.end() if blank else place
            pattern = _TOKENS.get(token)
            fitting = re.compile(pattern or re.escape(token), re.ASCII | re.IGNORECASE).match(text, place)
            if fitting is None:
                expected = _NAMES.get(token, f"'{token}'")
                computed = _COMPUTED.match(text, place) is not None and _NO_NUMBER.match(text, place) is None
                return AggregateError(
                    place,
                    make_message("here should be {expected} of the position.", expected=expected),
                    computed=computed,
                    broken=not computed and _is_whole(text, begin),
                )
            place = fitting.end()
        return AggregateError(place, "this position is not understood.", computed=False)


AGGREGATES = {
    "robtarget": RapidAggregate.from_shape(ROBTARGET),
    "jointtarget": RapidAggregate.from_shape(JOINTTARGET),
    "tooldata": RapidAggregate.from_shape(TOOLDATA),
    "wobjdata": RapidAggregate.from_shape(WOBJDATA),
}
TARGETS = ("robtarget", "jointtarget")


def _is_whole(text: str, place: int) -> bool:
    """Return whether brackets open at a place and close again on its line."""
    depth, line = 0, _ONE_LINE.match(text, place)
    for sign in line[0] if line is not None else "":
        depth += (sign == "[") - (sign == "]")
        if depth <= 0:
            return sign == "]"
    return False


def after_blanks(text: str, place: int) -> int:
    """Return where the next token begins."""
    blank = _BLANK.match(text, place)
    return blank.end() if blank else place


def decode_name(name: str) -> str:
    """Return a name as people write it: newer controllers save UTF-8, older ones ISO 8859-1."""
    if name.isascii():
        return name
    try:
        return name.encode("latin-1").decode("utf-8")
    except UnicodeDecodeError:
        return name


def end_of_element(text: str, place: int) -> int:
    """Return where the comma or bracket behind an array's element stands; the end of the text where none does."""
    depth = 0
    for found in _BETWEEN.finditer(text, place):
        if not depth and found[0] in (",", "]", ";"):
            return found.start()
        depth += (found[0] in ("[", "(", "{")) - (found[0] in ("]", ")", "}"))
    return len(text)
