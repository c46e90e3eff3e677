"""Tools and work objects of a RAPID file: which are fixed, move or change, and what the uses of a target agree on."""

from dataclasses import dataclass, field
from typing import NamedTuple

from cellcal.drivers.programs.barred import MOVED_BY_UNIT, SEEN_FROM_FLANGE

ToolAndFrame = tuple[str | None, str | None]  # tool, work object; None where it is computed

BARRED_DIFFERENT = "the program uses it with different tools or work objects"
BARRED_COMPUTED = "the program uses it with a tool or work object that is computed"
_BARRED_SEVERAL = "its file declares several tools or work objects of one name"
BARRED_SET = "its tool or work object is set while the program runs"
FRAME_PARTS = ("uframe", "oframe", "tframe", "robhold", "ufprog", "ufmec")  # a tool's load places nothing


class AgreedUse(NamedTuple):
    """The use on which all statements that name a target agree."""

    tool: str | None
    frame: str | None
    why: str  # why tool or frame cannot be determined; "" where they can
    different: bool
    seen_from_flange: bool


@dataclass
class FrameFacts:
    """The tools and work objects that a file states, by their names in small letters."""

    several: set[str] = field(default_factory=set)  # declared twice, differently
    set_while_running: set[str] = field(default_factory=set)
    seen_from_flange: set[str] = field(default_factory=set)
    held_objects: set[str] = field(default_factory=set)  # those of them that are work objects
    moved: set[str] = field(default_factory=set)  # work objects that a mechanical unit moves

    def agree_on(self, uses: frozenset[ToolAndFrame]) -> AgreedUse:
        """Return what all uses of a target together say."""
        tools, frames = {use[0] for use in uses}, {use[1] for use in uses}
        return AgreedUse(
            next(iter(tools)) if len(tools) == 1 else None,
            next(iter(frames)) if len(frames) == 1 else None,
            self._barred_reason(uses),
            different=len(uses) > 1,
            seen_from_flange=any(
                part is not None and part.lower() in self.seen_from_flange for part in tools | frames
            ),
        )

    def _barred_reason(self, uses: frozenset[ToolAndFrame]) -> str:
        """Return why a target's place cannot be told though the moves to it name tools and frames; or ""."""
        if any(part is not None and part.lower() in self.several for use in uses for part in use):
            return _BARRED_SEVERAL
        if any(part is not None and part.lower() in self.set_while_running for use in uses for part in use):
            return BARRED_SET
        if len(uses) > 1:
            return BARRED_DIFFERENT
        tool, frame = next(iter(uses))
        if tool is None or frame is None:
            return BARRED_COMPUTED
        return MOVED_BY_UNIT if frame.lower() in self.moved else ""

    def is_held_work(self, settled: AgreedUse) -> bool:
        """Return whether a tool in the cell works at a work object in the gripper, and nothing else is named."""
        tool, frame = (settled.tool or "").lower(), (settled.frame or "").lower()
        return (
            not settled.different
            and tool in self.seen_from_flange - self.held_objects
            and frame in self.held_objects
        )

    def open_tools(self) -> set[str]:
        """Return the names that are not the one tool at the flange."""
        return self.several | self.set_while_running | self.seen_from_flange

    def doubtful_frames(self) -> dict[str, str]:
        """Return tools and work objects in which no target may be carried, and why."""
        return (
            dict.fromkeys(self.moved, MOVED_BY_UNIT)
            | dict.fromkeys(self.seen_from_flange, SEEN_FROM_FLANGE)
            | dict.fromkeys(self.set_while_running, BARRED_SET)
        )
