"""Points that a KRL program takes from where the robot stands ($POS_ACT), in one base, and goes to in another."""

import re
from collections.abc import Iterator

from cellcal.drivers.kuka.program_files.found_shifts import COMPUTED_PLACE
from cellcal.drivers.kuka.program_files.frame_uses import RESET
from cellcal.drivers.kuka.program_files.point_uses import FRAME_DATA, PointUses
from cellcal.drivers.programs.shifts import UNREADABLE, ProgramShift, ShiftAxes

MEASURED = re.compile(r"\$POS_(?:ACT|INT|MEAS|RET|FOR)\b", re.IGNORECASE)


def measured_shifts(points: PointUses) -> Iterator[ProgramShift]:
    """Yield the moves to points that were taken in a base which is certain, in other bases than that."""
    for key, taken in points.measured.items():
        own = points.frames_of_move(taken, joints=False).frame
        bases = {use.frame for use in points.frames_of_copies(key) if use.frame is not None}
        for base in sorted(bases - {own}):
            if own is None or any(one == RESET or one.startswith(FRAME_DATA) for one in (own, base)):
                continue
            yield ProgramShift(
                points.found.source.line_of(taken.place),
                "$POS_ACT",
                ShiftAxes.USER_FRAME,
                point=COMPUTED_PLACE,
                user_frame=own,
                translation_m=UNREADABLE,
                quaternion=None,
                other_frame=base,
            )
