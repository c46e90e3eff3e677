"""Shifts that a program applies to its points while it runs.

A shift whose axes are those of a user frame or of the base stays as it is when the points are changed. Where the
change turns these axes, the shifted place is no longer the one that the change asks for. A shift along the axes of
the tool turns with its point and is none of these.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import nan

import numpy as np

from cellcal.calibration.geometry import Array, homogeneous_matrix, rotation_from_quaternion

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # w first
UNREADABLE: Triple = (nan, nan, nan)
UNKNOWN_FRAME = "*"  # of `ProgramShift.other_frame` and `other_tool`: only the running program knows which
NO_TURN: Quaternion = (1.0, 0.0, 0.0, 0.0)


class ShiftAxes(StrEnum):
    """The frame to which the axes of a shift belong."""

    USER_FRAME = "user_frame"
    BASE = "base"


@dataclass(frozen=True, slots=True)
class ProgramShift:
    """One shift: the tip goes to ``shift @ point``, both seen in the user frame or in the base."""

    line: int  # from 1, of the instruction
    what: str  # the instruction, as the maker names it
    axes: ShiftAxes
    rows: tuple[int, ...] = ()  # of `Positions`: the points that are shifted
    point: str = ""  # where no row is: the point of another file, or the move itself
    user_frame: str | None = None  # where no row is: the frame of the move, None where the file does not say
    translation_m: Triple = UNREADABLE  # NaN where a component is only known while the program runs
    quaternion: Quaternion | None = NO_TURN  # None: it may turn the point, by what only the controller knows
    each_time: bool = False  # it adds to a variable, once more for each time that the line runs
    sets: bool = False  # no shift: a part of the point is set to another value
    other_frame: str = (
        ""  # no shift: the motion takes the point's numbers in this user frame, which is not its own
    )
    other_tool: str = (
        ""  # no shift: the motion takes the point's numbers with this tool, which is not its own
    )
    goes_on: bool = False  # no shift: a step begins where the points leave the robot
    made_by: str = ""  # no shift: this program makes the user frame ``user_frame`` when a person runs it
    absent: str = ""  # no shift: the motion goes to a place that no file holds; what to do with it

    def to_matrix(self) -> Array:
        """Return the shift (4, 4); components that are not readable count as zero."""
        turn = rotation_from_quaternion(np.array([self.quaternion or NO_TURN]))
        shift: Array = homogeneous_matrix(turn, np.nan_to_num(np.array([self.translation_m])))[0]
        return shift


def renumber_shifts(shifts: Sequence[ProgramShift], new_rows: Mapping[int, int]) -> tuple[ProgramShift, ...]:
    """Return shifts in the order of the file, with rows counted anew; rows that are dropped fall away."""
    renumbered = [
        replace(one, rows=tuple(sorted(new_rows[row] for row in one.rows if row in new_rows)))
        for one in shifts
    ]
    remaining = [one for one in renumbered if one.rows or one.point]
    return tuple(sorted(remaining, key=lambda one: (one.line, one.rows, one.point)))
