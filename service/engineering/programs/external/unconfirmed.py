"""Meanings of makers' words that no text of the maker confirms here: said beside every program that rests on one.

Where the controller does not compute with a leading axis, a frame that it turns all the same would put the
point elsewhere: such a point is a finding.
"""

import math
from collections.abc import Iterator

from cellcal.drivers.programs.conditions import ProjectNeed
from cellcal.service.engineering.programs.external.moving_axes import CellAxes
from cellcal.service.engineering.programs.program_points import ProgramPoints
from cellcal.service.engineering.programs.result import LEFT, PointFinding, ProgramResult

_LED = (
    "end points of motions that another group leads (COORD) are taken as poses in their user frame; no text of the "
    "maker confirms it. Compare one point at the robot before the program runs."
)
_STANDING = (
    "points at a standing tool (RTCP, #TCP) are taken as the work in the gripper seen from that tool; no text of the "
    "maker confirms it. Compare one point at the robot before the program runs."
)
_UNCONFIRMED = {
    "fanuc": {ProjectNeed.LEADER: _LED, ProjectNeed.STANDING_TOOL: _STANDING},
    "kuka": {ProjectNeed.STANDING_TOOL: _STANDING},
}


def unconfirmed_meanings(points: ProgramPoints, axes: CellAxes) -> list[str]:
    """Return what is assumed about points that can be moved, and that is no finding."""
    found: dict[str, None] = {}
    for i in points.open_rows().tolist():
        program = points.programs[points.of[i]]
        condition = program.positions.conditions.get(int(points.row[i]))
        if condition is not None:
            words = _UNCONFIRMED.get(program.brand, {})
            is_doubtful = _is_led_apart(points, i, axes)
            found.update(
                dict.fromkeys(
                    words[need]
                    for need in condition.needs
                    if need in words and not (is_doubtful and need is ProjectNeed.LEADER)
                )
            )
    return list(found)


def led_findings(
    points: ProgramPoints, start: int, result: ProgramResult, axes: CellAxes
) -> Iterator[PointFinding]:
    """Yield the points of a program, whose rows begin at ``start``, that an axis apart from the controller leads."""
    positions = result.before.positions
    for row in positions.conditions:
        in_arm = int(positions.groups[row]) == 1
        if in_arm and result.status[row] != LEFT and _is_led_apart(points, start + row, axes):
            line, name = int(positions.lines[row]), positions.names[row]
            yield PointFinding(line, name, "COORD", 0.0, math.nan, math.nan, _LED, row)


def _is_led_apart(points: ProgramPoints, i: int, axes: CellAxes) -> bool:
    """Return whether another group leads a point, and the controller computes with no axis that carries it."""
    program = points.programs[points.of[i]]
    condition = program.positions.conditions.get(int(points.row[i]))
    if condition is None or ProjectNeed.LEADER not in condition.needs or program.brand not in _UNCONFIRMED:
        return False
    carriers = axes.carriers_of(points.user_frames[i], caseless=False)
    return not any(axes.axes[number].coordinated for number in carriers)
