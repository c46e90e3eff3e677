"""What a robot's table of the cell file says about motion: who moves it, shapes, and what must be active."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cellcal.calibration.errors import CellError
from cellcal.drivers.interfaces import ActiveFrames
from cellcal.procedures.cell import MotionLevel
from cellcal.procedures.surroundings import NOTHING_KNOWN, Surroundings
from cellcal.service.configuration.cell_shapes import check_shapes, surroundings_of

MOTION_KEYS = ("motion", "space", "active")  # of [[robot]]; no driver knows them


@dataclass(frozen=True)
class RobotMotion:
    """The way in which a robot is moved, and what is known of the shapes of its arm and cell."""

    level: MotionLevel = MotionLevel.OBSERVE
    surroundings: Surroundings = NOTHING_KNOWN
    active: ActiveFrames = field(default_factory=ActiveFrames)


class ActiveTable(BaseModel):
    """[robot.active]: what must be selected on the controller when a run begins."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    tool_number: int | None = Field(default=None, ge=0, le=99)
    user_frame_number: int | None = Field(default=None, ge=0, le=99)
    payload_kg: float | None = Field(default=None, ge=0, le=10_000)


def read_motion(table: Mapping[str, Any], where: str, faults: list[tuple[str, str]]) -> RobotMotion:
    """Read these keys of a robot's table; what is wrong is added to ``faults``."""
    level, space = table.get("motion", MotionLevel.OBSERVE.value), table.get("space", {})
    levels = [one.value for one in MotionLevel]
    if level not in levels:
        faults.append((f"{where}.motion", f"there is no level {level!r}; there are {', '.join(levels)}"))
        level = MotionLevel.OBSERVE.value
    if not isinstance(space, dict):
        faults.append((f"{where}.space", "is written as [robot.space]"))
        space = {}
    surroundings = _read_surroundings(table, space, f"{where}.space", faults)
    return RobotMotion(MotionLevel(level), surroundings, _read_active(table, f"{where}.active", faults))


def _read_active(table: Mapping[str, Any], where: str, faults: list[tuple[str, str]]) -> ActiveFrames:
    try:
        named = ActiveTable.model_validate(table.get("active", {}))
    except ValidationError as error:
        faults += [(".".join((where, *map(str, one["loc"]))), one["msg"]) for one in error.errors()]
        return ActiveFrames()
    return ActiveFrames(named.tool_number, None, named.user_frame_number, named.payload_kg)


def _read_surroundings(
    table: Mapping[str, Any], space: dict[str, Any], where: str, faults: list[tuple[str, str]]
) -> Surroundings:
    try:
        found = surroundings_of(space, where)
        check_shapes(str(table.get("model")), found)
    except CellError as error:
        faults.append((where, f"{error.message} {error.remedy}".strip()))
        return NOTHING_KNOWN
    return found
