"""Motions of KRL to places without a value: declared in no file, or declared and given a value by none."""

import re
from collections.abc import Iterator, Mapping, Sequence, Set

from cellcal.drivers.kuka.program_files.frame_data import without_reset
from cellcal.drivers.kuka.program_files.patterns import MOVE
from cellcal.drivers.kuka.program_files.point_uses import PointUses
from cellcal.drivers.programs.absent_places import absent_places
from cellcal.drivers.programs.file_declarations import (
    NO_MOTION,
    VALUES_GIVEN,
    ExternalUses,
    MoveFrames,
    array_name_of,
)
from cellcal.drivers.programs.shifts import ProgramShift, ShiftAxes
from cellcal.drivers.programs.spans import ProgramText

_HOME = re.compile(r"X?HOME\d*\b", re.IGNORECASE)  # joint angles of $CONFIG.DAT, which no work moves
_TEACH_IT = "No file here gives it a value: give the file that does, or teach it there."


def empty_points_of(points: PointUses) -> dict[str, frozenset[MoveFrames]]:
    """Return the moves to points that a program declares itself and gives no value, nor passes to a routine."""
    declared = {name for routine in points.routines for name in routine.declared}
    declared -= {name for routine in points.routines for name in routine.assigned}
    declared -= {array_name_of(name.upper()) for name in points.found.names}
    for call in points.calls:
        passed = (*call.arguments, *call.parts, *call.options.values())
        declared -= {array_name_of(name.lstrip("\0\1").upper()) for name in passed}
    found: dict[str, set[MoveFrames]] = {}
    for name, all_used in points.uses.items():
        if array_name_of(name) in declared:
            some = {points.frames_of_move(used, joints=False) for used in all_used.values()}
            found.setdefault(array_name_of(name), set()).update(
                one for one in some if one.why not in NO_MOTION
            )
    return {name: frozenset(some) for name, some in found.items() if some}


def places_without_values(
    source: ProgramText,
    external_uses: ExternalUses,
    empty: Mapping[str, frozenset[MoveFrames]],
    of_list: tuple[Set[str] | None, Sequence[str]],
) -> Iterator[ProgramShift]:
    """Yield a program's motions to names that no file declares, and to its own that get no value.

    ``of_list`` are the names that a data list declares, None for a program, and those of its positions.
    """
    declared, keys = of_list
    if declared is not None:
        return _declarations_without_values(source, external_uses, declared, keys)
    absent = {
        name: frozenset(without_reset(move_frames, known=False) for move_frames in moves)
        for name, moves in {**external_uses.absent, **empty}.items()
        if not _HOME.match(name)
    }
    return absent_places(source, absent, MOVE, comment=";", statement_end="\n")


def _declarations_without_values(
    source: ProgramText, external_uses: ExternalUses, declared: Set[str], keys: Sequence[str]
) -> Iterator[ProgramShift]:
    """Yield the names of a data list that files move to and none gives a value."""
    empty = declared - {array_name_of(key) for key in keys}
    for name in sorted(empty & {array_name_of(each) for each in external_uses.uses}):
        uses = [
            use for each, some in external_uses.uses.items() if array_name_of(each) == name for use, _ in some
        ]
        gone_to = [use for use in uses if use.why not in NO_MOTION]
        if not gone_to or any(use.why in VALUES_GIVEN for use in uses) or _HOME.match(name):
            continue
        found = re.search(rf"(?<![\w$]){re.escape(name)}(?![\w$])([^\n]*)", source.text, re.IGNORECASE)
        if found is None or "{" in found[1]:
            continue  # written out in a form of its own: it is remarked as such
        frames = {use.frame for use in gone_to if not use.why}
        yield ProgramShift(
            source.line_of(found.start()),
            "move",
            ShiftAxes.USER_FRAME,
            point=name,
            user_frame=frames.pop() if len(frames) == 1 else None,
            absent=_TEACH_IT,
        )
