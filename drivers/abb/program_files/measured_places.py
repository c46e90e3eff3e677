"""Places that a RAPID program takes from where the robot stands (CRobT, SearchL), each in a work object of its own.

Such a place goes along with the work where moves go to it in the same work object. It is followed like any other
place that is copied and passed, under a name that tells where it is taken and in which work object.
"""

import re
from collections.abc import Collection, Iterable, Iterator

from cellcal.drivers.abb.program_files.literals import NAME, W, decode_name
from cellcal.drivers.programs.file_declarations import VALUES_GIVEN, MoveFrames
from cellcal.drivers.programs.shifts import UNKNOWN_FRAME, UNREADABLE, ProgramShift, ShiftAxes
from cellcal.drivers.programs.spans import ProgramText

_BEGINS, _COMPUTED = "crobt@", "?"
_MEASURED = re.compile(
    rf"{W}(?:(?:Offs|RelTool){W}\({W}){{0,4}}+CRobT\b{W}\((?P<options>[^();]*+)\)", re.ASCII | re.IGNORECASE
)
_TAKEN = re.compile(r"\bCRobT\b", re.ASCII | re.IGNORECASE)
_SEARCH = re.compile(r"Search[LJC]", re.IGNORECASE)
_WORK_OBJECT = re.compile(rf"\\{W}WObj{W}:={W}(?:(?P<name>{NAME}){W}(?=\\|\Z))?+", re.ASCII | re.IGNORECASE)


def measured_name(text: str, place: int, at: int | None = None) -> str:
    """Return the name under which the place that stands here is followed; "" where none is taken, or in no object.

    Without a work object CRobT takes that of the last move. ``at`` is where the statement stands, if elsewhere.
    """
    found = _MEASURED.match(text, place)
    named = None if found is None else _WORK_OBJECT.search(found["options"])
    if named is None:
        return ""
    return name_of_found(place if at is None else at, named["name"] and decode_name(named["name"]))


def name_of_found(place: int, frame: str | None) -> str:
    """Return the name under which a place is followed that a statement takes in a work object, None if computed."""
    return f"{_BEGINS}{place}@{(frame or _COMPUTED).lower()}"


def measured_inside(text: str, place: int, end: int) -> Iterator[str]:
    """Yield the names of the places that are taken in an array or a record."""
    for found in _TAKEN.finditer(text, place, end):
        if name := measured_name(text, found.start()):
            yield name


def is_measured(name: str) -> bool:
    """Return whether a name is that of a place that is taken from where the robot stands."""
    return name.startswith(_BEGINS)


def measured_shifts(
    source: ProgramText, name: str, frames: Iterable[str | None], parameters: Collection[str] = ()
) -> Iterable[ProgramShift]:
    """Yield the moves to a measured place in other work objects, None for one that is computed, than its own."""
    _, place, own = name.split("@")
    own = _COMPUTED if own in parameters else own
    for frame in sorted({(one or _COMPUTED).lower() for one in frames} - {own}):
        yield ProgramShift(
            source.line_of(int(place)),
            found[0] if (found := _SEARCH.match(source.text, int(place))) else "CRobT",
            ShiftAxes.USER_FRAME,
            point="a computed place",
            user_frame=None if own == _COMPUTED else own,
            translation_m=UNREADABLE,
            quaternion=None,
            other_frame=UNKNOWN_FRAME if frame == _COMPUTED else frame,
        )


def frames_in_other_files(uses: Iterable[tuple[MoveFrames, str]]) -> set[str | None]:
    """Return the work objects in which other files move to a measured place."""
    return {use.frame for use, _ in uses if use.why not in VALUES_GIVEN}
