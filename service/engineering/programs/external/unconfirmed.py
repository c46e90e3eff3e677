"""Meanings of makers' words that no text of the maker confirms here: said beside every program that rests on one."""

from cellcal.drivers.programs.conditions import ProjectNeed
from cellcal.service.engineering.programs.program_points import ProgramPoints

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


def unconfirmed_meanings(points: ProgramPoints) -> list[str]:
    """Return what is assumed about points that can be moved."""
    found: dict[str, None] = {}
    for i in points.open_rows().tolist():
        program = points.programs[points.of[i]]
        condition = program.positions.conditions.get(int(points.row[i]))
        if condition is not None:
            words = _UNCONFIRMED.get(program.brand, {})
            found.update(dict.fromkeys(words[need] for need in condition.needs if need in words))
    return list(found)
