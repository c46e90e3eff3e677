"""A FANUC program listing (.LS): its sections, its positions, and the same file with some of them changed.

The bytes are the program. Positions are read from spans of it, and a change writes into those spans; nothing is
printed from a parsed form.
"""

import re
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from drivers.fanuc.ls_edit import edited
from drivers.fanuc.ls_positions import positions_of
from drivers.fanuc.ls_records import Place
from drivers.fanuc.ls_remarks import remarks_of
from drivers.programs.errors import ProgramFileError
from drivers.programs.positions import Change, Frames, Positions, Remark

_SECTION = re.compile(rb"/(PROG|ATTR|APPL|MN|POS|END)\b[^\n]*+")
_INDENT = 40  # a section's name stands at the beginning of its line, behind so many blanks at most
_PROGRAM = re.compile(rb"/PROG[ \t]++([^\s;]{1,80}+)")
_AFTER_END = re.compile(rb"[\s\x1a\x00]*+")
_ORDER = (b"PROG", b"ATTR", b"APPL", b"MN", b"POS", b"END")
_SAVE_AGAIN = "Save the program again on the controller, in ASCII."


class LsProgram:
    """One .LS file; `drivers.programs.positions.ProgramFile`."""

    brand = "fanuc"

    def __init__(self, file: str, data: bytes) -> None:
        self._place = Place(file, data)
        self._sections = _sections(self._place)

    @property
    def name(self) -> str:
        found = _PROGRAM.match(self._place.data, self._sections["PROG"])
        return found[1].decode("cp437") if found else ""

    @property
    def positions(self) -> Positions:
        return self._read[0]

    @cached_property
    def remarks(self) -> tuple[Remark, ...]:
        return remarks_of(self._place.data, self._sections["MN"], self._sections["POS"], self.positions)

    @property
    def frames(self) -> Frames:
        """Return nothing: a listing names its frames by number, the controller keeps them."""
        return Frames()

    def to_bytes(self) -> bytes:
        return self._place.data

    def changed(self, change: Change) -> "LsProgram":
        positions, offsets = self._read
        start, end = self._body
        return LsProgram(self._place.file, edited(self._place, (start, end), positions, offsets, change))

    @property
    def _body(self) -> tuple[int, int]:
        """Return where the records begin, after the line /POS, and where they end."""
        return self._sections["RECORDS"], self._sections["END"]

    @cached_property
    def _read(self) -> tuple[Positions, NDArray[np.int64]]:
        return positions_of(self._place, *self._body)


def read_ls(file: str, data: bytes) -> LsProgram:
    """Read a listing.

    Raises
    ------
    ProgramFileError
        Not a program, damaged, or not understood in /POS: with line and column.
    """
    program = LsProgram(file, data)
    _ = program.positions
    return program


def _sections(place: Place) -> dict[str, int]:
    """Return the offset of each section's line; RECORDS is the first byte after the line /POS."""
    found: dict[str, int] = {}
    last = 0
    for section in filter(
        lambda each: _begins_a_line(place.data, each.start()), _SECTION.finditer(place.data)
    ):
        rank = _ORDER.index(section[1])
        word = section[1].decode()
        if rank < last or (word in found and word != "APPL"):
            raise place.error(
                section.start(), f"/{word} stands at a place where it does not belong.", _SAVE_AGAIN
            )
        last = rank
        found[word] = section.start()
        if word == "POS":
            found["RECORDS"] = _after(place, section, b"/POS")
        if word == "END":
            _check_end(place, _after(place, section, b"/END"))
    for word in ("PROG", "MN", "POS", "END"):
        if word not in found:
            raise ProgramFileError(
                place.file,
                f"the line /{word} is missing: this is no complete program listing.",
                remedy=_SAVE_AGAIN,
            )
    if place.data[: found["PROG"]].strip() or not _PROGRAM.match(place.data, found["PROG"]):
        raise place.error(0, "the file does not begin with /PROG and a name.", _SAVE_AGAIN)
    return found


def _begins_a_line(data: bytes, at: int) -> bool:
    return not data[max(0, at - _INDENT) : at].rpartition(b"\n")[2].strip(b" \t")


def _after(place: Place, section: re.Match[bytes], word: bytes) -> int:
    """Return the offset after the word, which must stand alone on its line."""
    at = section.start() + section[0].index(word) + len(word)
    if place.data[at : section.end()].strip():
        raise place.error(at, f"there is something behind {word.decode()}.", _SAVE_AGAIN)
    return at


def _check_end(place: Place, at: int) -> None:
    rest = _AFTER_END.match(place.data, at)
    if rest is None or rest.end() != len(place.data):
        raise place.error(rest.end() if rest else at, "the file goes on behind /END.", _SAVE_AGAIN)
