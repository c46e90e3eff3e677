"""The records of /POS, one after the other; what is not understood is refused where it stands."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.ls_grammar import (
    CARTESIAN,
    CLOSE,
    CONFIGURATION,
    FIELD,
    GAP,
    HEAD,
    JOINTS,
    REMOTE,
    UNTAUGHT_CARTESIAN,
    UNTAUGHT_JOINTS,
    WHOLE_NUMBER,
    furthest_match,
)
from cellcal.drivers.programs.errors import ProgramFileError


class CoordinateForm(Enum):
    """The form of a group's coordinates."""

    CARTESIAN = "cartesian"
    JOINTS = "joints"
    UNTAUGHT = "untaught"
    BROKEN = "broken"  # a coordinate is no number, or its configuration none
    REMOTE = "remote"


class AxisText(NamedTuple):
    """One joint or extended axis as written: J2, its text with the blanks before it, mm or deg."""

    letter: bytes
    number: int
    text: bytes
    unit: bytes


class PositionRecord(NamedTuple):
    """One group of one position."""

    number: int
    group: int
    start: int  # of P[…] in the file
    offset: int  # of this group's text in the file
    form: CoordinateForm
    user_frame: bytes
    tool: bytes
    configuration: bytes
    cartesian: tuple[bytes, ...]  # X Y Z W P R as written, blanks before them included
    axes: tuple[AxisText, ...]  # joints, then extended axes


@dataclass(frozen=True, slots=True)
class ListingFile:
    """A file's name and bytes, to say where something is wrong."""

    file: str
    data: bytes

    def error_at(self, at: int, message: str, remedy: str = "") -> ProgramFileError:
        """Return the error for the byte at ``at``."""
        line = self.data.count(b"\n", 0, at) + 1
        column = at - (self.data.rfind(b"\n", 0, at) + 1) + 1
        return ProgramFileError(self.file, message, line=line, column=column, remedy=remedy)


def read_records(place: ListingFile, start: int, end: int) -> Iterator[PositionRecord]:
    """Yield the records between two offsets.

    Raises
    ------
    ProgramFileError
        With the line and column at which something is not understood.
    """
    data, at = place.data, start
    known_texts: dict[bytes, bool] = {}
    while head := HEAD.match(data, at, end):
        found, at = _any_record(place, head, end)
        for record in found:
            text = record.configuration
            if text not in known_texts:
                known_texts[text] = is_configuration(text.decode("cp437"))
            yield record if known_texts[text] else record._replace(form=CoordinateForm.BROKEN)
    gap = GAP.match(data, at, end)
    if gap is None or gap.end() != end:
        raise _not_understood(place, at, end)


def _any_record(place: ListingFile, head: re.Match[bytes], end: int) -> tuple[list[PositionRecord], int]:
    found, at = [], head.end()
    while group := _match_group(place.data, at, end):
        form, block = group
        found.append(_make_record(place, int(head[1]), head.start(1) - 2, form, block))
        at = block.end()
    close = CLOSE.match(place.data, at, end)
    if close is None or not found:
        raise _not_understood(place, at, end, "}; or another group" if found else "")
    return found, close.end()


def _match_group(data: bytes, at: int, end: int) -> tuple[CoordinateForm, re.Match[bytes]] | None:
    if found := CARTESIAN.match(data, at, end):
        return CoordinateForm.CARTESIAN, found
    if found := JOINTS.match(data, at, end):
        return CoordinateForm.JOINTS, found
    if found := UNTAUGHT_CARTESIAN.match(data, at, end) or UNTAUGHT_JOINTS.match(data, at, end):
        # Stars in an extended axis only leave the arm's own coordinates what they are.
        *main, extended = found.groups(b"")[4:]
        return (_form_of(main, extended), found)
    found = REMOTE.match(data, at, end)
    return (CoordinateForm.REMOTE, found) if found else None


def _form_of(main: Sequence[bytes], extended: bytes) -> CoordinateForm:
    texts = main if len(main) == 6 else [found[3] for found in FIELD.finditer(main[0])]
    if any(b"*" in text for text in texts):
        return CoordinateForm.UNTAUGHT
    beside = [found[3] for found in FIELD.finditer(extended)]
    if not all(is_number(text) or b"*" in text for text in (*texts, *beside)):
        return CoordinateForm.BROKEN
    return CoordinateForm.CARTESIAN if len(main) == 6 else CoordinateForm.JOINTS


def is_number(text: bytes) -> bool:
    """Return whether a value is written as controllers write numbers."""
    return WHOLE_NUMBER.fullmatch(text) is not None


def _make_record(
    place: ListingFile, number: int, first: int, form: CoordinateForm, block: re.Match[bytes]
) -> PositionRecord:
    group, user_frame, tool, configuration, *main, extended = block.groups(b"")
    cartesian = len(main) == 6
    axes: tuple[AxisText, ...] = ()
    if extended or not cartesian:
        axes = _read_axes(
            place,
            block.start("extended") if cartesian else block.start(5),
            (b"" if cartesian else main[0]) + extended,
        )
    return PositionRecord(
        number,
        int(group or 1),
        first,
        block.start(),
        form,
        user_frame,
        tool,
        configuration,
        tuple(main) if cartesian else (),
        axes,
    )


def _read_axes(place: ListingFile, at: int, text: bytes) -> tuple[AxisText, ...]:
    axes = tuple(AxisText(found[1], int(found[2]), found[3], found[4]) for found in FIELD.finditer(text))
    for letter in (b"J", b"E"):
        numbers = [axis.number for axis in axes if axis.letter == letter]
        if numbers != list(range(1, len(numbers) + 1)):
            raise place.error_at(
                at,
                make_message("the axes {letter} are not numbered 1, 2, 3 and so on.", letter=letter.decode()),
                "Save it again.",
            )
    return axes


def is_configuration(text: str) -> bool:
    """Return whether a text is written as controllers write configurations."""
    return CONFIGURATION.fullmatch(text) is not None


def _not_understood(place: ListingFile, at: int, end: int, next_is: str = "") -> ProgramFileError:
    gap = GAP.match(place.data, at, end)
    start = gap.end() if gap else at
    stop, expected = furthest_match(place.data, start, end)
    expected = next_is if next_is and stop == start else expected
    text = place.data[stop : min(stop + 24, end)].decode("cp437").split("\n")[0].strip() or "the end"
    return place.error_at(
        stop,
        make_message(
            "this is not understood: {text!r}; expected is {expected}.", text=text, expected=expected
        ),
        "Save the program again on the controller; a listing must not be shortened or edited in /POS.",
    )
