"""What moving, cloning and compensating programs give to a transfer: arms, frames and expected errors."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cellcal.calibration.geometry import Array, log_rotation
from cellcal.calibration.programs.transfer import TransferFrames
from cellcal.service.engineering.programs.expected_accuracy import Expectation
from cellcal.service.engineering.programs.external.standing_tools import standing_change
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.project_poses import ProjectTool


@dataclass(frozen=True, eq=False)
class FramePair:
    """One sort of points: tools and frames at both ends. A frame is None where only joints are programmed."""

    source_tool: ProjectTool
    target_tool: ProjectTool
    source_frame: Array | None
    target_frame: Array | None
    standing: tuple[ProjectTool, ProjectTool] | None = (
        None  # tools in the cell, where the gripper holds the work
    )

    def work_change(self, route: "TransferRoute") -> Array:
        """Return the change of the work (4, 4), as seen from the cells."""
        if self.standing is None:
            return route.change
        source, target = zip(self.standing, route.real_ends, strict=True)
        return standing_change(route.change, source, target, one_cell=route.source is route.target)


class TransferRoute(Protocol):
    """The differences between moving, cloning and compensating."""

    @property
    def source(self) -> Project: ...
    @property
    def target(self) -> Project: ...

    @property
    def change(self) -> Array:
        """Return what carries places of the source's base into the target's (4, 4)."""
        ...

    @property
    def real_ends(self) -> tuple[bool, bool]:
        """Tell of source and target whether their arms, and what carries these, are the real ones."""
        ...

    @property
    def keeps_joint_points(self) -> bool:
        """Return whether points in joint angles are requested to stay, whatever a program does with them."""
        ...

    def covers_frame(self, frame: str | None, *, bare_joints: bool, in_joints: bool = False) -> bool | str:
        """Return whether points of a user frame go this way, or why that is not known.

        ``in_joints`` are joint angles, ``bare_joints`` those whose program names no frame but the base.
        """
        ...

    def transfer_way(self, frame_pair: FramePair) -> TransferFrames:
        """Return the arms and the change of base for one sort of points."""
        ...

    def make_expectation(self, frame_pair: FramePair) -> Expectation:
        """Return what the expected errors come from."""
        ...


def change_angle_rad(route: TransferRoute) -> float:
    """Return the angle by which a route's change turns what it carries."""
    return float(np.linalg.norm(log_rotation(route.change[:3, :3])))


@dataclass(frozen=True, eq=False)
class OneCellRoute:
    """A route whose source and target are the same cell."""

    project: Project

    @property
    def source(self) -> Project:
        """Return the cell."""
        return self.project

    @property
    def target(self) -> Project:
        """Return the cell."""
        return self.project
