"""What stands between /POS and /END of a FANUC listing, as patterns over bytes.

Blanks, tabs and line ends may stand between any two tokens. Every quantifier is possessive, so a line of a million
characters is read once.
Sources: FANUC B-83284EN section 8.4.5; public programs of real controllers (the German ones write KONFIG).
"""

import re

from cellcal.calibration.message import make_message

_GAP = rb"[ \t\r\n]*+"
NUMBER = rb"[+-]?+(?:\d{1,12}+(?:\.\d{0,9}+)?+|\.\d{1,9}+)"
_STARS = rb"\*{1,20}+"
_COMMA = _GAP + rb",?+"

_HEAD_PIECES = (
    ("P[number]", rb"P\[ *+(\d{1,5}+) *+"),
    ('a name in quotes, or "]{"', rb'(?::[ \t]*+"[^"\r\n]{0,200}+"[ \t]*+)?+\]' + _GAP + rb"\{"),
)
_FRAME_PIECES = (
    ("GP and a group of 1 to 9", rb"(?:GP *+([1-9])" + _GAP + rb":" + _GAP + rb")?+"),
    ("UF : number,", rb"UF" + _GAP + rb":" + _GAP + rb"(\d{1,3}+|F)" + _GAP + rb","),
    ("UT : number,", rb"UT" + _GAP + rb":" + _GAP + rb"(\d{1,3}+|F)" + _COMMA),
    (
        "CONFIG : '…'",
        rb"(?:[A-Z]{3,12}+" + _GAP + rb":" + _GAP + rb"'([^'\r\n]{0,80}+)'" + _COMMA + rb")?+",
    ),
)


def _value_pattern(name: bytes, number: bytes, unit: bytes) -> bytes:
    return name + _GAP + rb"=([ \t]*+(?:" + number + rb"))" + _GAP + unit + rb"\b" + _COMMA


def _extended_pattern(number: bytes) -> bytes:
    field = rb"E[1-9]" + _GAP + rb"=[ \t]*+(?:" + number + rb")" + _GAP + rb"(?:mm|deg)\b" + _COMMA
    return rb"(?P<extended>(?:" + field + _GAP + rb")*+)(?!" + _GAP + rb"[EJ][1-9])"  # none of them has stars


def _cartesian_pieces(number: bytes, prefix: str = "") -> tuple[tuple[str, bytes], ...]:
    axes = [(prefix + name, b"mm") for name in "XYZ"] + [(prefix + name, b"deg") for name in "WPR"]
    fields = [
        (
            make_message("{name} = number {unit}", name=name, unit=unit.decode()),
            _value_pattern(name.encode(), number, unit),
        )
        for name, unit in axes
    ]
    return (*_FRAME_PIECES, *fields, ("E1 = number", _extended_pattern(number)))


def _joint_pieces(number: bytes) -> tuple[tuple[str, bytes], ...]:
    field = rb"J[1-9]" + _GAP + rb"=[ \t]*+(?:" + number + rb")" + _GAP + rb"(?:mm|deg)\b" + _COMMA
    return (
        *_FRAME_PIECES,
        ("J1= number deg", rb"((?:" + field + _GAP + rb")++)"),
        ("E1 = number", _extended_pattern(number)),
    )


def _join_pieces(pieces: tuple[tuple[str, bytes], ...]) -> re.Pattern[bytes]:
    return re.compile(b"".join(_GAP + pattern for _, pattern in pieces))


_EITHER = NUMBER + rb"|" + _STARS
# What stands where a number belongs after a computation or an editor: nan, 1.2.3, 1e3, or nothing before the unit.
_PIECE = rb"(?!(?:mm|deg)\b)[^\s,=:;'{}]{1,24}+"
_BROKEN = _EITHER + rb"|" + _PIECE + rb"(?:[ \t]++" + _PIECE + rb"){0,2}+|"
HEAD = _join_pieces(_HEAD_PIECES)
HEAD_ALONE = re.compile(_GAP.join(pattern for _, pattern in _HEAD_PIECES))  # to be searched for
CARTESIAN = _join_pieces(
    _cartesian_pieces(NUMBER)
)  # groups: GP, UF, UT, CONFIG, X, Y, Z, W, P, R, extended axes
JOINTS = _join_pieces(_joint_pieces(NUMBER))  # groups: GP, UF, UT, CONFIG, joints, extended axes
UNTAUGHT_CARTESIAN = _join_pieces(_cartesian_pieces(_BROKEN))
UNTAUGHT_JOINTS = _join_pieces(_joint_pieces(_BROKEN))
REMOTE = _join_pieces(_cartesian_pieces(_EITHER, "R"))  # RX RY RZ RW RP RR: of a tool that stands in the cell
_CLOSE = _GAP + rb"\}" + _GAP + rb";?+"
CLOSE = re.compile(_CLOSE)


def _split_pattern() -> bytes:
    """Return the usual record in pieces: with a configuration, without extended axes."""
    inner = [_GAP + pattern for _, pattern in _FRAME_PIECES[:3]]
    before = b"".join(inner) + _GAP + rb"[A-Z]{3,12}+" + _GAP + rb":" + _GAP + rb"'"
    pieces = [
        rb"[ \t\r\n]{0,8}+P\[ *+",
        rb"\d{1,5}+",
        rb" *+" + _HEAD_PIECES[1][1],
        before,
        rb"[^'\r\n]{0,80}+",
    ]
    between = rb"'" + _COMMA
    for name, unit in zip(b"XYZWPR", (b"mm",) * 3 + (b"deg",) * 3, strict=True):
        pieces += [between + _GAP + bytes([name]) + _GAP + rb"=", rb"[ \t]*+" + NUMBER]
        between = _GAP + unit + rb"\b" + _COMMA
    return b"".join(rb"(" + piece + rb")" for piece in (*pieces, between + _CLOSE))


# Groups: P[, number, name, frames (in it GP, UF, UT), CONFIG, then text and value in turn for X to R, and the rest.
SPLIT = re.compile(_split_pattern())
GAP = re.compile(_GAP)
WHOLE_NUMBER = re.compile(rb"[ \t]*+(?:" + NUMBER + rb")")
FIELD = re.compile(
    rb"([JE])([1-9])" + _GAP + rb"=([ \t]*+(?:" + _BROKEN + rb"))" + _GAP + rb"(mm|deg)"
)  # axis, its number, text, unit

CONFIGURATION = re.compile(r" *(?:[FNLRUDTB] *){0,4}(?:, *-?\d{0,3} *){0,9}")

_SEARCHED = (
    _HEAD_PIECES,
    _cartesian_pieces(_EITHER),
    _joint_pieces(_EITHER),
    _cartesian_pieces(_EITHER, "R"),
    (("}; after the last number", rb"\}"),),
)


def furthest_match(data: bytes, start: int, end: int) -> tuple[int, str]:
    """Return where reading on from ``start`` stops, and what was expected there."""
    best = (start, "P[number]{")
    for pieces in _SEARCHED:
        at = start
        for expected, pattern in pieces:
            gap = GAP.match(data, at, end)
            at = gap.end() if gap else at
            found = re.compile(pattern).match(data, at, end)
            if found is None:
                best = max(best, (at, expected), key=lambda stop: stop[0])
                break
            at = found.end()
        else:
            best = max(best, (at, "a comma and a known axis, or };"), key=lambda stop: stop[0])
    return best
