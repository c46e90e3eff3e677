"""What a change costs where a motion takes a point's numbers in another frame or with another tool than its own.

The work asks for E2 u2 q, with q the numbers, u2 the frame that the motion takes them in, E2 the change of the work
there. The numbers are the point's own p, or those in which the robot's place at it is taken: u q = u1 p, with u1 the
point's frame. The changed program goes to u2' u'^-1 E1 u1 p: the numbers are changed as the point's own frame asks.
"""

import math

import numpy as np

from cellcal.calibration.geometry import Array, inverse_transform, log_rotation
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.shifts import UNKNOWN_FRAME, ProgramShift
from cellcal.service.engineering.programs.cell_of_program import frame_of
from cellcal.service.engineering.programs.program_points import ProgramPoints
from cellcal.service.engineering.programs.result import PointFinding
from cellcal.service.engineering.programs.transfer_route import TransferRoute, change_angle_rad

_OTHER_FRAME = (
    "{what} takes the numbers of {point} in user frame {frame}, which is not its own: the point then misses by "
    "{distance} mm and {turn} deg. Teach the point there."
)
_UNKNOWN = (
    "{what} takes the numbers of {point} in a user frame that only the running program knows: where it is not the "
    "point's own, the point misses. Choose the frame by its number, or teach the point there."
)
_OF_ANOTHER_PLACE = (
    "{what} takes the numbers of {point} in another user frame than its own: the correction for the arm is then that "
    "of another place. Teach the point there."
)
_OF_ANOTHER_TOOL = (
    "{what} takes the numbers of {point} with another tool than its own: the correction for the arm is then that of "
    "another posture. Teach the point there."
)
_LEAST_M, _LEAST_RAD = 1e-5, math.radians(0.005)  # what a pendant shows of a place and an orientation


def find_copy(
    points: ProgramPoints, place: tuple[int, int], shift: ProgramShift, route: TransferRoute
) -> PointFinding | None:
    """Return what it costs at a point, given by its row of all and of its program; without a text where nothing.

    None where the shift is none of these, or a frame is not known. A tool counts only where an arm is corrected for.
    """
    at, row = place
    program = points.programs[points.of[at]]
    if shift.other_tool:
        name = program.positions.names[row]
        text = _uncorrected_text(_OF_ANOTHER_TOOL, shift, name, route)
        return PointFinding(shift.line, name, shift.what, 0.0, math.nan, math.nan, text, row)
    if not (shift.other_frame and points.cartesian[at]):
        return None
    if shift.other_frame == UNKNOWN_FRAME:
        return _unknown_finding(points, place, shift, route)
    poses: list[Array] = []
    taken = (
        shift.user_frame or points.user_frames[at]
    )  # the place of the robot may be taken in another one, too
    for frame in (points.user_frames[at], taken, shift.other_frame):
        before = frame_of(route.source, program, frame)
        after = frame_of(route.target, program, frame, at_home=route.source is route.target)
        if before is None or after is None:
            return None
        poses += [before, after]
    own, _, numbers, numbers_after, other, other_after = poses
    place = own @ points.frame_tip[at]
    expected = _change_of(shift.other_frame, route) @ other @ inverse_transform(numbers) @ place
    own_change = np.eye(4) if points.stays[at] else route.change
    reached = other_after @ inverse_transform(numbers_after) @ own_change @ place
    distance = float(np.linalg.norm(expected[:3, 3] - reached[:3, 3]))
    turn = float(np.linalg.norm(log_rotation(expected[:3, :3].T @ reached[:3, :3])))
    name = program.positions.names[row]
    text = make_message(
        _OTHER_FRAME,
        what=shift.what,
        point=name,
        frame=shift.other_frame,
        distance=f"{distance * 1000.0:.2f}",
        turn=f"{math.degrees(turn):.2f}",
    )
    if not (distance > _LEAST_M or turn > _LEAST_RAD):
        text = _uncorrected_text(_OF_ANOTHER_PLACE, shift, name, route)
    return PointFinding(shift.line, name, shift.what, turn, distance, turn, text, row)


def _change_of(frame: str, route: TransferRoute) -> Array:
    """Return the change of the work in a user frame, (4, 4) in the robot's base."""
    return route.change if route.covers_frame(frame, bare_joints=False) is True else np.eye(4)


def _unknown_finding(
    points: ProgramPoints, place: tuple[int, int], shift: ProgramShift, route: TransferRoute
) -> PointFinding:
    """Return that a frame is not known; without a text where nothing of the work moves."""
    at, row = place
    program = points.programs[points.of[at]]
    name = program.positions.names[row]
    stays = route.source is route.target and bool((np.abs(route.change - np.eye(4)) < _LEAST_M).all())
    text = make_message(_UNKNOWN, what=shift.what, point=name)
    text = _uncorrected_text(_OF_ANOTHER_PLACE, shift, name, route) if stays else text
    angle = change_angle_rad(route)
    return PointFinding(shift.line, name, shift.what, angle, math.nan, math.nan, text, row)


def _uncorrected_text(form: str, shift: ProgramShift, name: str, route: TransferRoute) -> str:
    """Return what a copy lacks that goes along, where numbers are corrected for an arm; "" where none are."""
    one_arm = route.source is route.target and route.real_ends == (True, True)
    return "" if one_arm else make_message(form, what=shift.what, point=name)
