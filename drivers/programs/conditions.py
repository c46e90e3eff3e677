"""Positions that can be changed only where a project says what their file does not: external axes, standing tools."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, StrEnum, auto


class AxisUnit(StrEnum):
    """The unit in which a file writes the values of an external axis."""

    MILLIMETRES = "mm"
    DEGREES = "deg"
    PULSES = "pulses"
    UNSTATED = ""  # millimetres or degrees, as the kind of the axis has it
    MIXED = "mixed"  # this file writes some positions in one unit, some in another


@dataclass(frozen=True, slots=True)
class ExternalColumn:
    """One column of `Positions.external`."""

    name: str  # as the maker counts it: "E1", "eax_a", "GP2 J1", "B1", "S1"
    unit: AxisUnit = AxisUnit.UNSTATED
    other_group: bool = False  # of another motion group, whose records stand beside the robot's


class ProjectNeed(Enum):
    """A statement that a project must make before a position may be changed."""

    LEADER = auto()  # of a motion that another group leads: a coordinated positioner
    MOVED_FRAME = auto()  # of a frame that an axis moves: a coordinated positioner that carries it
    STANDING_TOOL = auto()  # a tool that stands in the cell


@dataclass(frozen=True, slots=True)
class ConditionalBar:
    """Why a position is left while the project lacks something."""

    needs: frozenset[ProjectNeed]
    why: str

    @classmethod
    def for_need(cls, need: ProjectNeed, why: str) -> "ConditionalBar":
        """Return the bar of one need."""
        return cls(frozenset((need,)), why)

    def add_need(self, other: "ConditionalBar | None") -> "ConditionalBar":
        """Return the bar of both needs; the reason is the first one."""
        return self if other is None else ConditionalBar(self.needs | other.needs, self.why)


Conditions = Mapping[int, ConditionalBar]  # by row of `Positions`
