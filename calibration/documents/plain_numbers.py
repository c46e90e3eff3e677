"""Numbers of controllers and descriptions in text: ASCII digits, a point, an exponent; no more that Python takes.

``float`` also takes ``nan``, ``inf``, ``1_0`` and the digits of every script; ``int`` all but the first two.
"""

import math
import re

from cellcal.calibration.message import make_message

NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]{1,3})?"
_NUMBER = re.compile(NUMBER)
_LONGEST = 64  # characters; a double has at most 17 digits


def parse_number(text: str) -> float:
    """Return the finite number that a text is, blanks around it aside; raise ValueError where it is none."""
    plain = text.strip(" \t\r\n")
    if len(plain) > _LONGEST or not _NUMBER.fullmatch(plain):
        raise ValueError(make_message("{text!r} is not a number", text=text[:60]))
    value = float(plain)
    if not math.isfinite(value):
        raise ValueError(make_message("{text!r} is not finite", text=text[:60]))
    return value


def parse_whole(text: str) -> int:
    """Return the whole number that a text is, also with zeros behind a point; raise ValueError where it is none."""
    value = parse_number(text)
    if value != int(value) or abs(value) >= 2**53:
        raise ValueError(make_message("{text!r} is no whole number", text=text[:60]))
    return int(value)
