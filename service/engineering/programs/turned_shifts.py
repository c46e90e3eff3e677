"""What a change costs where a program shifts points, while it runs, in axes that the change turns.

With F the change in the user frame, F = u'^-1 E u, and D the shift, the work asks for F D p, and the changed program
goes to D F p. The findings tell how far these two are apart.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellcal.calibration.geometry import Array, inverse_transform, log_rotation
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.drivers.programs.shifts import ProgramShift, ShiftAxes
from cellcal.service.engineering.programs.cell_of_program import frame_of, name_in
from cellcal.service.engineering.programs.copies_in_other_frames import find_copy
from cellcal.service.engineering.programs.external.carried_points import CarriedChanges
from cellcal.service.engineering.programs.program_points import ProgramPoints
from cellcal.service.engineering.programs.result import PointFinding
from cellcal.service.engineering.programs.taken_places import find_taken
from cellcal.service.engineering.programs.transfer_route import TransferRoute

_LEAST_M, _LEAST_RAD = 1e-5, math.radians(0.005)  # what a pendant shows of a place and an orientation
_TOO_FAR_M = (
    1.0  # no shift of a program is longer; a turn counts where it costs this length the least distance
)
_SHOWN_M = 0.1
_COSTS = (
    "{what} shifts {point} in axes that this change turns by {angle} deg: the point then misses by {distance} mm "
    "and {turn} deg. Turn the shift in the program, too, or teach the point there."
)
_COSTS_EACH_TIME = (
    "{what} shifts {point} in axes that this change turns by {angle} deg: the point then misses by {distance} mm "
    "for each time that this runs. Turn the shift in the program, too, or teach the point there."
)
_COSTS_UP_TO = (
    "{what} shifts {point} in axes that this change turns by {angle} deg: the point then misses by up to "
    "{distance} mm. Turn the shift in the program, too, or teach the point there."
)
_SIZE_UNREADABLE = (
    "{what} shifts {point} in axes that this change turns by {angle} deg; the size of the shift is not readable, "
    "and each 100 mm of it may miss by {distance} mm. Turn the shift in the program, too, or teach the point there."
)
_SETS = (
    "{what} sets a part of {point} in axes that this change turns by {angle} deg and moves by {distance} mm: the "
    "value stays as it is. Set it to the value of the changed place, or teach the point there."
)
_MAY_TURN = (
    "{what} shifts {point} and may turn it by what is not readable: the point then misses by up to {distance} mm. "
    "Turn the shift in the program, too, or teach the point there."
)
_STAYS = (
    "the motion goes to {point}, whose place no file here holds: its frame moves by {distance} mm and turns by "
    "{angle} deg with the work, and {point} stays. {cure}"
)
_OF_OTHER_CONTROLLER = (
    "the motion goes to {point}, whose place no file here holds: what the other robot's controller has there counts. "
    "{cure}"
)
_MADE_BY = (
    "{maker} makes {point} when a person runs it, and the points in it are changed for the frame of the project: do "
    "not run {maker} for the changed points, or let the frame go along instead of the points."
)
_NOT_CORRECTED = "the motion goes to {point}, whose place no file here holds: it is not corrected. {cure}"
_COMPUTED_PLACE = (
    "{what} goes to {point}, which the program computes while it runs: it is not corrected for the arm. Correct what "
    "computes it, or teach the point there."
)
_SETS_UNCORRECTED = (
    "{what} sets a part of {point} while the program runs: that part is not corrected for the arm. Set it to the "
    "value of the changed place, or teach the point there."
)


class _TurnedChange(NamedTuple):
    """The change as one frame sees it, and that frame before it; ``exact`` where the frame is known."""

    change: Array
    frame: Array
    exact: bool


def find_turned_shifts(
    points: ProgramPoints, route: TransferRoute, carried: CarriedChanges | None = None
) -> list[tuple[PointFinding, ...]]:
    """Return for each program its shifted points that the change does not bring to where they belong."""
    starts = np.searchsorted(points.of, np.arange(len(points.programs)))
    return [
        tuple(_findings_of(points, number, int(start), (route, carried))) if program.positions.shifts else ()
        for number, (program, start) in enumerate(zip(points.programs, starts, strict=True))
    ]


def _findings_of(
    points: ProgramPoints, number: int, start: int, by: tuple[TransferRoute, CarriedChanges | None]
) -> list[PointFinding]:
    (route, carried), program = by, points.programs[number]
    by_frame: dict[str | None, _TurnedChange] = {}
    found: list[PointFinding] = []
    for shift in program.positions.shifts:
        robot_places = find_taken(points, shift, (number, start), route)
        if robot_places is not None:
            found += [_computed_finding(one, shift, route) for one in robot_places]
            continue
        if not shift.rows:
            frame = name_in(route.source, program, shift.user_frame)
            if frame is None or route.covers_frame(frame, bare_joints=False) is True:
                turned = _turned_change(by_frame, program, frame, shift, route)
                turned = turned if carried is None else turned._replace(exact=False)
                found.append(_computed_finding(_finding_elsewhere(shift, turned, route), shift, route))
            continue
        for row in _rows_that_go_along(points, shift, start):
            at = start + row
            turned = _turned_change(by_frame, program, points.user_frames[at], shift, route)
            if carried is not None:
                turned = _carried_change(carried, at, shift)
            pose = points.frame_tip[at] if points.cartesian[at] else None
            apart = carried is not None and not shift.other_tool
            copy = None if apart else find_copy(points, (at, row), shift, route)
            if copy is None and points.stays[at]:
                continue
            one = copy or _shift_finding(shift, program.positions.names[row], row, pose, turned)
            found.append(_computed_finding(one, shift, route))
    return [one for one in found if one.text]


def _rows_that_go_along(points: ProgramPoints, shift: ProgramShift, start: int) -> list[int]:
    """Return the rows of a shift whose points are not named already and go along.

    The numbers of a point that stays may be taken in a frame that does not.
    """
    return [
        row
        for row in shift.rows
        if not points.reasons[start + row] and (shift.other_frame or not points.stays[start + row])
    ]


def _turned_change(
    by_frame: dict[str | None, _TurnedChange],
    program: ProgramFile,
    frame: str | None,
    shift: ProgramShift,
    route: TransferRoute,
) -> _TurnedChange:
    if frame not in by_frame:
        before = frame_of(route.source, program, frame)
        after = frame_of(route.target, program, frame, at_home=route.source is route.target)
        if before is None or after is None:
            by_frame[frame] = _TurnedChange(route.change, np.eye(4), False)
        else:
            by_frame[frame] = _TurnedChange(inverse_transform(after) @ route.change @ before, before, True)
    turned = by_frame[frame]
    return _TurnedChange(route.change, turned.frame, True) if shift.axes is ShiftAxes.BASE else turned


def _carried_change(carried: CarriedChanges, row: int, shift: ProgramShift) -> _TurnedChange:
    """Return the change as a point that external axes carry meets it; along axes of the base by its size only."""
    if shift.axes is ShiftAxes.BASE:
        return _TurnedChange(carried.in_base[row], carried.frame[row], False)
    return _TurnedChange(carried.in_frame[row], carried.frame[row], True)


def _shift_finding(
    shift: ProgramShift, point: str, row: int, pose: Array | None, turned: _TurnedChange
) -> PointFinding:
    """Return what a shift costs at one point; without a text where it costs nothing."""
    change = turned.change
    angle = float(np.linalg.norm(log_rotation(change[:3, :3])))
    if shift.sets:
        moved_m = float(np.linalg.norm(change[:3, 3]))
        changes = _set_part_counts(shift, turned) or (shift.quaternion is None and angle > _LEAST_RAD)
        text = _finding_text(_SETS, shift, point, angle, moved_m, 0.0) if changes else ""
        return PointFinding(shift.line, point, shift.what, angle, math.nan, math.nan, text, row)
    if _size_counts(shift, turned) or (pose is None and shift.quaternion not in (None, (1.0, 0.0, 0.0, 0.0))):
        if angle > _LEAST_RAD:
            text = _finding_text(_SIZE_UNREADABLE, shift, point, angle, _SHOWN_M * _chord_length(angle), 0.0)
        else:  # a turn of the shift swings the step of the change
            text = _finding_text(
                _MAY_TURN, shift, point, angle, 2.0 * float(np.linalg.norm(change[:3, 3])), 0.0
            )
        return PointFinding(shift.line, point, shift.what, angle, math.nan, math.nan, text, row)
    if not turned.exact:
        distance = float(np.linalg.norm(np.nan_to_num(shift.translation_m))) * _chord_length(angle)
        turn = 0.0
    else:
        tip = np.eye(4) if pose is None else pose
        tip = turned.frame @ tip if shift.axes is ShiftAxes.BASE else tip
        expected, reached = change @ shift.to_matrix() @ tip, shift.to_matrix() @ change @ tip
        distance = float(np.linalg.norm(expected[:3, 3] - reached[:3, 3]))
        turn = float(np.linalg.norm(log_rotation(expected[:3, :3].T @ reached[:3, :3])))
    costs = distance > _LEAST_M or turn > _LEAST_RAD
    form = _COSTS_EACH_TIME if shift.each_time else _COSTS
    form = form if turned.exact else _COSTS_UP_TO  # which axis of an unknown frame turns is unknown, too
    text = _finding_text(form, shift, point, angle, distance, turn) if costs else ""
    return PointFinding(shift.line, point, shift.what, angle, distance, turn, text, row)


def _finding_elsewhere(shift: ProgramShift, turned: _TurnedChange, route: TransferRoute) -> PointFinding:
    """Return a finding of what is no point of the file."""
    if shift.absent or shift.made_by:
        return _absent_finding(shift, turned, route)
    return _shift_finding(shift, shift.point, -1, None, turned)


def _absent_finding(shift: ProgramShift, turned: _TurnedChange, route: TransferRoute) -> PointFinding:
    """Return what becomes of a motion to a place that no file holds; without a text where nothing is asked of it."""
    change = turned.change
    angle, distance_m = (
        float(np.linalg.norm(log_rotation(change[:3, :3]))),
        float(np.linalg.norm(change[:3, 3])),
    )
    if shift.made_by:
        moves = angle > _LEAST_RAD or distance_m > _LEAST_M or not _is_plain_move(route)
        text = make_message(_MADE_BY, maker=shift.made_by, point=shift.point) if moves else ""
    elif route.source is not route.target:
        text = make_message(_OF_OTHER_CONTROLLER, point=shift.point, cure=shift.absent)
    elif not _is_plain_move(route):
        text = make_message(_NOT_CORRECTED, point=shift.point, cure=shift.absent)
    elif angle > _LEAST_RAD or distance_m > _LEAST_M:
        text = make_message(
            _STAYS,
            point=shift.point,
            distance=f"{distance_m * 1000.0:.2f}",
            angle=f"{math.degrees(angle):.2f}",
            cure=shift.absent,
        )
    else:
        text = ""
    return PointFinding(shift.line, shift.point, shift.what, angle, math.nan, math.nan, text, -1)


def _is_plain_move(route: TransferRoute) -> bool:
    """Return whether work is moved in one cell, without corrections for the arm."""
    return route.source is route.target and route.real_ends == (True, True)


def _computed_finding(found: PointFinding, shift: ProgramShift, route: TransferRoute) -> PointFinding:
    """Return a finding with the words for what is computed, where another arm is corrected for and the work stays.

    A step that is added to a corrected point goes on from there; a place or a coordinate that the program computes is
    one of the nominal arm.
    """
    one_arm = _is_plain_move(route)
    is_place = not shift.rows and shift.quaternion is None
    if found.text or one_arm or not (shift.sets or is_place):
        return found
    form = _SETS_UNCORRECTED if shift.sets else _COMPUTED_PLACE
    return replace(found, text=make_message(form, what=shift.what, point=found.point))


def _size_counts(shift: ProgramShift, turned: _TurnedChange) -> bool:
    """Return whether a part of the shift that is not readable costs something."""
    change = turned.change
    if shift.quaternion is None and (np.abs(change - np.eye(4)) > _LEAST_M).any():
        return True
    unread = np.isnan(shift.translation_m)
    apart = change[:3, :3] - np.eye(3)
    costs = np.linalg.norm(apart if turned.exact else np.full((3, 3), np.abs(apart).max()), axis=0)
    return bool((costs[unread] * _TOO_FAR_M > _LEAST_M).any())


def _set_part_counts(shift: ProgramShift, change: _TurnedChange) -> bool:
    """Return whether coordinates that get a value of their own would change with the point."""
    apart = np.abs(change.change - np.eye(4))[:3]
    if not change.exact:
        return bool((apart > _LEAST_M).any())
    return bool((apart[np.isnan(shift.translation_m)] > _LEAST_M).any())


def _chord_length(angle_rad: float) -> float:
    """Return how far a turn takes the end of a unit length across its axis."""
    return 2.0 * math.sin(min(angle_rad, math.pi) / 2.0)


def _finding_text(
    form: str, shift: ProgramShift, point: str, angle: float, distance_m: float, turn: float
) -> str:
    return make_message(
        form,
        what=shift.what,
        point=point,
        angle=f"{math.degrees(angle):.2f}",
        distance=f"{distance_m * 1000.0:.2f}",
        turn=f"{math.degrees(turn):.2f}",
    )
