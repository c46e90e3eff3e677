"""Numbers of a listing: a new value in the style of the file."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array

LEAST_DECIMALS = (
    3  # of controllers; a person's or a generator's `45 mm` does not mean that nothing finer counts
)
LARGEST = 1e6  # exclusive: 1 km, or as many degrees; the controller prints stars long before

_PADDED = re.compile(rb"=[ ]{2,}[-+.\d]")
_BARE_FRACTION = re.compile(rb"=[ \t]*+[+-]?+\.\d")
_FULL_FRACTION = re.compile(rb"=[ \t]*+[+-]?+0\.0*+[1-9]")


def count_decimals(text: bytes) -> int:
    """Return how many digits stand behind the point."""
    point = text.find(b".")
    return len(text) - point - 1 if point >= 0 else 0


def kept_decimals(text: bytes) -> int:
    """Return how many decimals a new value gets: those of the old one, and as many as controllers write."""
    return max(count_decimals(text), LEAST_DECIMALS)


def all_decimals(texts: Sequence[bytes]) -> Array:
    """Return `decimals` of every text without a line end, as floats."""
    characters = np.frombuffer(b"\n".join([*texts, b""]), dtype=np.uint8)
    ends, points = (np.flatnonzero(characters == ord(sign)) for sign in "\n.")
    found = np.zeros(len(texts))
    at = np.searchsorted(ends, points)
    found[at] = ends[at] - points - 1
    return found


@dataclass(frozen=True, slots=True)
class NumberStyle:
    """The form of this file's numbers: right-aligned in a field or not, ``.154`` or ``0.154``.

    The controller writes ``.154``, and ``0.000`` for zero.
    """

    padded: bool
    leading_zero: bool

    @classmethod
    def from_listing(cls, data: bytes, start: int, end: int) -> "NumberStyle":
        """Look at the positions of a file, between two offsets."""
        bare = _BARE_FRACTION.search(data, start, end) is not None
        full = not bare and _FULL_FRACTION.search(data, start, end) is not None
        return cls(padded=_PADDED.search(data, start, end) is not None, leading_zero=full)

    def write_value(self, old: bytes, value: float) -> bytes:
        """Return a value (in the file's unit) with the decimals of ``old``, at least three, and blanks before it."""
        digits = kept_decimals(old)
        if self.padded and (value >= 1.0 or value <= -1.0) and old[:1] == b" " and b"\t" not in old:
            return b" %*.*f" % (len(old) - 1, digits, value)  # nearly all of a million numbers
        text = b"%.*f" % (digits, value)
        if -1.0 < value < 1.0:
            text = self._write_small(text)
        blanks = len(old) - len(old.lstrip(b" \t"))
        if self.padded and blanks and b"\t" not in old:
            return b" " + text.rjust(len(old) - 1)
        return old[:blanks] + text

    def _write_small(self, text: bytes) -> bytes:
        if not text.strip(b"-0."):
            return text.lstrip(b"-")  # zero has no sign
        return text if self.leading_zero else text.replace(b"0.", b".", 1)
