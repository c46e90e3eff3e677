"""What a change costs where a program takes the place of the robot, and goes on from it or to it in another frame."""

import math
from collections.abc import Sequence

import numpy as np

from cellcal.calibration.geometry import inverse_transform
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.drivers.programs.shifts import UNKNOWN_FRAME, ProgramShift
from cellcal.service.engineering.programs.cell_of_program import frame_of, name_in
from cellcal.service.engineering.programs.program_points import ProgramPoints
from cellcal.service.engineering.programs.result import PointFinding
from cellcal.service.engineering.programs.transfer_route import TransferRoute, change_angle_rad

_GOES_ON = (
    "{what} is where {point} leaves the robot, and {point} stays: the place that is computed from it stays, too. "
    "Where that is a place at the work, move the joints with it, or teach a point there."
)
_IN_ANOTHER_FRAME = (
    "{what} takes where the robot stands in the user frame {own}, and a motion takes these numbers in {frame}: with "
    "this change it misses. Take the place in the frame of the motion, or teach a point there."
)
_ONE_THAT_IS_COMPUTED = "a computed one"
_LEAST_M = 1e-5  # what a pendant shows of a place


def find_taken(
    points: ProgramPoints, shift: ProgramShift, program: tuple[int, int], route: TransferRoute
) -> Sequence[PointFinding] | None:
    """Return what is to be said of a place that a program, given by its number and first row, takes.

    None where the shift is none of these.
    """
    number, start = program
    if shift.goes_on:
        return _steps_from_what_stays(points, shift, start, route)
    if shift.other_frame and not shift.rows:
        return [_measured_finding(shift, points.programs[number], route)]
    return None


def _steps_from_what_stays(
    points: ProgramPoints, shift: ProgramShift, start: int, route: TransferRoute
) -> list[PointFinding]:
    """Return that a step begins at a point that stays, where work moves in the frame that both are in."""
    is_moving = route.source is route.target and bool((np.abs(route.change - np.eye(4)) > _LEAST_M).any())
    rows = [
        row
        for row in shift.rows
        if is_moving
        and points.stays[start + row]
        and route.covers_frame(points.user_frames[start + row], bare_joints=False) is True
    ]
    names = [points.programs[points.of[start + row]].positions.names[row] for row in rows[:1]]
    angle = change_angle_rad(route)
    return [
        PointFinding(
            shift.line,
            name,
            shift.what,
            angle,
            math.nan,
            math.nan,
            make_message(_GOES_ON, what=shift.what, point=name),
            rows[0],
        )
        for name in names
    ]


def _measured_finding(shift: ProgramShift, program: ProgramFile, route: TransferRoute) -> PointFinding:
    """Return what becomes of a place that is measured in one frame and moved to in another; no text where nothing.

    It stands at P, so that it is u1^-1 P there and the motion goes to X P with X = u2 u1^-1: changed to X E P, where
    the work asks for E X P.
    """
    own, other = shift.user_frame, None if shift.other_frame == UNKNOWN_FRAME else shift.other_frame
    frame_names = [name_in(route.source, program, one) for one in (own, other)]
    covers = [one is None or route.covers_frame(one, bare_joints=False) is True for one in frame_names]
    misses = any(covers) and bool((np.abs(route.change - np.eye(4)) > _LEAST_M).any())
    before, after = (None if one is None else frame_of(route.source, program, one) for one in frame_names)
    if all(covers) and before is not None and after is not None:
        across = after @ inverse_transform(before)
        misses = bool((np.abs(across @ route.change - route.change @ across) > _LEAST_M).any())
    angle = change_angle_rad(route)
    names = (one or _ONE_THAT_IS_COMPUTED for one in (own, other))
    text = (
        make_message(_IN_ANOTHER_FRAME, what=shift.what, own=next(names), frame=next(names)) if misses else ""
    )
    return PointFinding(shift.line, shift.point, shift.what, angle, math.nan, math.nan, text, -1)
