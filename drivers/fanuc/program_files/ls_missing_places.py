"""Motions to positions that a listing does not record: the program stops there, and no change reaches them."""

import re
from collections.abc import Iterator

from cellcal.drivers.fanuc.program_files.ls_statements import before_positions, motion_of, read_statements
from cellcal.drivers.programs.positions import Positions
from cellcal.drivers.programs.shifts import ProgramShift, ShiftAxes

_USED = re.compile(rb"(?<![A-Za-z])P\[ *+(\d{1,5}+)")
_TEACH_IT = "The program stops there: record it at the controller."


def missing_places(positions: Positions, data: bytes) -> Iterator[ProgramShift]:
    """Yield the motions of a listing to positions that do not stand under /POS, once for each position."""
    missing = {int(each) for each in _USED.findall(before_positions(data))} - {
        int(name[2:-1]) for name in positions.names
    }
    if not missing:
        return
    for statement in read_statements(data):
        for number in motion_of(statement).targets if statement.is_motion else ():
            if number in missing:
                missing.discard(number)
                name = f"P[{number}]"
                yield ProgramShift(statement.line, name, ShiftAxes.USER_FRAME, point=name, absent=_TEACH_IT)
