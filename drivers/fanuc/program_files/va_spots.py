"""Places in a .VA file, and what their text says."""

import re
from dataclasses import dataclass
from math import isfinite

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError

UNINITIALISED = "Uninitialized"
AGAIN = "Save the file on the controller again and carry it over in binary mode."
_INTEGER = re.compile(r"[+-]?\d{1,10}\Z")
_REAL = re.compile(r"[+-]?(?:\d{1,30}(?:\.\d{0,30})?|\.\d{1,30})(?:[eE][+-]?\d{1,3})?\Z")


@dataclass(frozen=True, slots=True)
class ValueSpot:
    """A value as written, and where: the offset of its first byte and its line from 1."""

    text: str
    start: int
    line: int

    @property
    def is_initialised(self) -> bool:
        """Return whether the controller holds a value there."""
        return self.text != UNINITIALISED and not (self.text and set(self.text) == {"*"})


def damaged_file_error(file: str, line: int, what: str) -> ProgramFileError:
    """Return the refusal of a file that is not as a controller writes it."""
    return ProgramFileError(file, what, line=line, remedy=AGAIN)


def parse_integer(file: str, spot: ValueSpot) -> int:
    """Read a whole number of 32 bits.

    Raises
    ------
    ProgramFileError
        It is none.
    """
    if not _INTEGER.match(spot.text) or not -(2**31) <= int(spot.text) < 2**31:
        raise damaged_file_error(
            file,
            spot.line,
            make_message("{spot_text!r} is no whole number of 32 bits.", spot_text=spot.text[:40]),
        )
    return int(spot.text)


def parse_real(file: str, spot: ValueSpot) -> float:
    """Read a finite number.

    Raises
    ------
    ProgramFileError
        It is none.
    """
    if not _REAL.match(spot.text) or not isfinite(float(spot.text)):
        raise damaged_file_error(
            file, spot.line, make_message("{spot_text!r} is no number.", spot_text=spot.text[:40])
        )
    return float(spot.text)


def parse_boolean(file: str, spot: ValueSpot) -> bool:
    """Read TRUE or FALSE.

    Raises
    ------
    ProgramFileError
        It is neither.
    """
    if spot.text not in ("TRUE", "FALSE"):
        raise damaged_file_error(
            file,
            spot.line,
            make_message("{spot_text!r} is neither TRUE nor FALSE.", spot_text=spot.text[:40]),
        )
    return spot.text == "TRUE"
