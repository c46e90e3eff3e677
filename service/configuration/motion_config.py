"""What a robot's table of the cell file says about motion: who moves it, and the shapes of arm and cell."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from calibration.errors import CellError
from procedures.cell import MotionLevel
from procedures.motion.surroundings import NOTHING_KNOWN, Surroundings
from service.configuration.cell_shapes import check_shapes, surroundings_of

MOTION_KEYS = ("motion", "space")  # of [[robot]]; no driver knows them


@dataclass(frozen=True)
class RobotMotion:
    """Who moves a robot, and what is known of the shapes of its arm and cell."""

    level: MotionLevel = MotionLevel.OBSERVE
    surroundings: Surroundings = NOTHING_KNOWN


def read_motion(table: Mapping[str, Any], where: str, faults: list[tuple[str, str]]) -> RobotMotion:
    """Read both keys of a robot's table; what is wrong is added to ``faults``."""
    level, space = table.get("motion", MotionLevel.OBSERVE.value), table.get("space", {})
    levels = [one.value for one in MotionLevel]
    if level not in levels:
        faults.append((f"{where}.motion", f"there is no level {level!r}; there are {', '.join(levels)}"))
        level = MotionLevel.OBSERVE.value
    if not isinstance(space, dict):
        faults.append((f"{where}.space", "is written as [robot.space]"))
        space = {}
    return RobotMotion(MotionLevel(level), _surroundings(table, space, f"{where}.space", faults))


def _surroundings(
    table: Mapping[str, Any], space: dict[str, Any], where: str, faults: list[tuple[str, str]]
) -> Surroundings:
    try:
        found = surroundings_of(space, where)
        check_shapes(str(table.get("model")), found)
    except CellError as error:
        faults.append((where, f"{error.message} {error.remedy}".strip()))
        return NOTHING_KNOWN
    return found
