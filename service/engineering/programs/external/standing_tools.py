"""Tools that stand in the cell, and work in the gripper: each as the controller has it in its own table.

KUKA keeps such a tool as a base and the work as a tool, ABB a tooldata with robhold FALSE and a wobjdata with robhold
TRUE; their positions are poses of the tool, seen from the work. FANUC writes ordinary poses, with RTCP at the motion.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.service.engineering.programs.project_poses import ProjectTool

_Entry = TypeVar("_Entry")


@dataclass(frozen=True, eq=False)
class StandingTools:
    """The standing tools of a cell, and what its gripper holds."""

    tools: Mapping[str, ProjectTool] = field(default_factory=dict)  # poses in the cell
    works: Mapping[str, ProjectTool] = field(default_factory=dict)  # poses on the flange

    def states(self, brand: str, tool: str | None, frame: str | None, *, held: bool) -> bool:
        """Return whether a project states what a position at a standing tool needs."""
        if not held:
            return frame is not None and frame in self.tools
        return self.of_position(brand, tool, frame) is not None

    def of_position(
        self, brand: str, tool: str | None, frame: str | None
    ) -> tuple[ProjectTool, ProjectTool] | None:
        """Return the standing tool and the work in the gripper that a position names."""
        standing, work = (tool, frame) if brand == "abb" else (frame, tool)
        found, held = _caseless(self.tools, standing), _caseless(self.works, work)
        return None if found is None or held is None else (found, held)


def standing_change(
    change: Array, source: tuple[ProjectTool, bool], target: tuple[ProjectTool, bool], *, one_cell: bool
) -> Array:
    """Return the change for work at a standing tool; each end is the tool and whether its arm is the real one.

    Within a cell the tool goes along with the change. In another cell it is where it was measured; where it was
    not measured in both, the change of the cells counts.
    """
    before, after = (tool.real if real else tool.entered for tool, real in (source, target))
    if one_cell:
        found: Array = change @ after @ inverse_transform(before)
        return found
    if source[0].measured and target[0].measured:
        measured: Array = after @ inverse_transform(before)
        return measured
    return change


def _caseless(entries: Mapping[str, _Entry], name: str | None) -> _Entry | None:
    if name is None:
        return None
    if name in entries:
        return entries[name]
    return next((entry for key, entry in entries.items() if key.lower() == name.lower()), None)


NO_STANDING_TOOLS = StandingTools()
