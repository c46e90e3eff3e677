"""Tools and work objects that a RAPID module declares."""

import re
from collections.abc import Mapping, Set
from dataclasses import dataclass, field, replace

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.drivers.abb.program_files.collected_positions import RapidPositions, pose_of
from cellcal.drivers.abb.program_files.literals import AGGREGATES, AggregateError
from cellcal.drivers.abb.program_files.target_uses import TargetUses
from cellcal.drivers.programs.positions import Positions, ProgramFrames

_HELD_WORK_TEXT = (
    "{} is held by the robot: its targets are seen from the flange, and need [held_work] in the project."
)
_MOVED_TEXT = "The user frame of {} is moved by {}; it is not taken as fixed."
_STATIONARY_TEXT = (
    "{} stands in the cell: its targets are seen from the flange, and need [held_work] in the project."
)
_UNREAD_TEXT = "{} is not read: it is computed, or not as {} is written."


@dataclass
class DeclaredFrames:
    """The tools and work objects of a module while it is read."""

    found: RapidPositions
    uses: TargetUses
    bases: dict[str, Pose] = field(default_factory=lambda: {"wobj0": Pose((0.0, 0.0, 0.0))})
    tools: dict[str, Pose] = field(default_factory=lambda: {"tool0": Pose((0.0, 0.0, 0.0))})
    declared: set[str] = field(default_factory=set)  # in small letters
    seen_outside: set[str] = field(default_factory=set)  # those of them that other modules see
    tool_names: set[str] = field(default_factory=set)  # those of them that are tools

    def declare_name(self, kind: str, name: str, *, shown: bool) -> None:
        """Note a name of a kind of data; ``public_poses`` where other modules see it."""
        self.declared.add(name.lower())
        if kind == "tooldata":
            self.tool_names.add(name.lower())
        if shown:
            self.seen_outside.add(name.lower())
            self.uses.local_frames.discard(name.lower())
        elif name.lower() not in self.seen_outside:
            self.uses.local_frames.add(name.lower())

    def drop_ambiguous(self) -> None:
        """Take away what is declared twice, differently."""
        for poses in (self.tools, self.bases):
            for name in [name for name in poses if name.lower() in self.uses.facts.several]:
                del poses[name]

    def to_frames(self) -> ProgramFrames:
        """Return the tools and fixed work objects that stand here, and the two of the language itself."""
        return ProgramFrames(base_frame=self.bases, flange_tip=self.tools)

    def public_poses(self, poses: Mapping[str, Pose]) -> dict[str, Pose | None]:
        """Return what other modules see, by names in small letters; None for one without a fixed pose."""
        return _poses_of(poses, self.seen_outside)

    def local_poses(self, poses: Mapping[str, Pose]) -> dict[str, Pose | None]:
        """Return what other modules do not see, as `public_poses`."""
        return _poses_of(poses, self.uses.local_frames)

    def all_tools(self) -> set[str]:
        """Return the names that this file declares, or moves, as a tool, in small letters."""
        return self.tool_names | self.uses.tools_of_moves

    def public_tools(self) -> frozenset[str]:
        """Return those of them that are not this file's only."""
        return frozenset(self.all_tools() - self.uses.local_frames)

    def take_declaration(self, kind: str, name: str, declared: re.Match[str]) -> int:
        """Take a tool or a work object that is declared; return where it ends."""
        if not declared[4]:
            return declared.end()
        try:
            found = AGGREGATES[kind].match_at(self.found.source.text, declared.end())
        except AggregateError:
            self.found.add_remark(declared.start(2), "foreign", make_message(_UNREAD_TEXT, name, kind))
            return declared.end()
        self.uses.spell_name(name)
        if kind == "tooldata":
            self._take_tool(name, found)
        else:
            self._take_work_object(name, found)
        return found.end()

    def _take_tool(self, name: str, found: re.Match[str]) -> None:
        pose = pose_of(found.groups()[1:8])
        if found[1].upper() == "FALSE":
            self.uses.facts.seen_from_flange.add(name.lower())
            self.found.add_remark(found.start(), "foreign", make_message(_STATIONARY_TEXT, name))
        elif pose is not None:
            self._store_pose(self.tools, name, pose)

    def _take_work_object(self, name: str, found: re.Match[str]) -> None:
        user, obj = pose_of(found.groups()[3:10]), pose_of(found.groups()[10:17])
        if found[1].upper() == "TRUE":
            self.uses.facts.seen_from_flange.add(name.lower())
            self.uses.facts.held_objects.add(name.lower())
            self.found.add_remark(found.start(), "foreign", make_message(_HELD_WORK_TEXT, name))
        elif found[2].upper() == "FALSE":
            self.uses.facts.moved.add(name.lower())
            self.found.add_remark(found.start(), "foreign", make_message(_MOVED_TEXT, name, found[3]))
        elif user is not None and obj is not None:
            self._store_pose(self.bases, name, user @ obj)

    def _store_pose(self, poses: dict[str, Pose], name: str, pose: Pose) -> None:
        """Take a tool's or a work object's pose; modules and routines of one file may each have their own."""
        name = self.uses.spell_name(name)
        if poses.setdefault(name, pose) != pose:
            self.uses.facts.several.add(name.lower())


def with_standing_work(positions: Positions, frames: ProgramFrames) -> Positions:
    """Return positions that note which of them are in a work object whose declaration says that no unit moves it."""
    fixed = {name.lower() for name in (*frames.base_frame, *frames.cell_base_frame)}
    rows = {
        row for row, name in enumerate(positions.user_frames) if name is not None and name.lower() in fixed
    }
    return replace(positions, standing_frames=frozenset(rows))


def _poses_of(poses: Mapping[str, Pose], names: Set[str]) -> dict[str, Pose | None]:
    of = {name.lower(): pose for name, pose in poses.items()}
    return {name: of.get(name) for name in names}
