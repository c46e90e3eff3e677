"""Cells with a rail or a positioner: the project as a person writes it, and the same cell by plain numpy."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from cellcal.service.engineering.programs.project import Project, read_project
from tests.programs.external.brands import BrandSpelling, WrittenPoint
from tests.programs.external.hand_geometry import Array, arm, axis_pose, flange_of, pose

TOOL = pose((0.01, -0.02, 0.11), (0.0, 0.2, 0.0))
FRAME = pose((0.35, -0.15, 0.12), (0.02, -0.03, 0.5))
ON_TABLE = pose((0.03, 0.02, 0.05), (0.0, 0.0, 0.3))  # a frame that a table turns, from the axis


@dataclass(frozen=True, eq=False)
class HandAxis:
    """One external axis."""

    name: str
    axis: str
    kind: str
    frame: Array
    direction: tuple[float, float, float]
    coordinated: bool
    carries_robot: bool
    sign: int = 1
    zero: float = 0.0  # mm or deg

    @property
    def unit(self) -> str:
        return "mm" if self.kind == "prismatic" else "deg"

    def motion(self, value: float) -> Array:
        """Return what the axis does at a value [mm or deg]."""
        per_unit = 1e-3 if self.kind == "prismatic" else np.pi / 180
        travel = self.sign * (value - self.zero) * per_unit
        return axis_pose(self.kind, self.frame, self.direction, travel)

    def table_text(self, frame_name: str) -> str:
        """Return the axis as the project writes it."""
        head = "track" if self.carries_robot else "positioner"
        frames = "" if self.carries_robot else f'frames = ["{frame_name}"]\n'
        return (
            f'[[{head}]]\nname = "{self.name}"\naxis = "{self.axis}"\nkind = "{self.kind}"\n'
            f"{pose_text(self.frame)}direction = {list(self.direction)}\nsign = {self.sign}\n"
            f"zero_{self.unit} = {self.zero}\nlower_{self.unit} = -4000\nupper_{self.unit} = 4000\n"
            f"coordinated = {str(self.coordinated).lower()}\npulses_per_{self.unit} = 100\n{frames}"
        )


@dataclass(frozen=True, eq=False)
class HandCell:
    """A cell with nominal arm and tool."""

    spelling: BrandSpelling
    axes: tuple[HandAxis, ...]
    frame: Array = field(default_factory=FRAME.copy)  # in the cell with every axis at its zero
    lines: str = ""  # more of the project

    def base(self, values: dict[str, float]) -> Array:
        """Return where the robot's base stands."""
        return _product(axis.motion(values[axis.axis]) for axis in self.axes if axis.carries_robot)

    def work(self, values: dict[str, float]) -> Array:
        """Return what positioners do to the work."""
        return _product(axis.motion(values[axis.axis]) for axis in self.axes if not axis.carries_robot)

    def entered_frame(self, values: dict[str, float]) -> Array:
        """Return the user frame in the robot's base, as its controller has it."""
        found = self.frame
        for axis in reversed(self.axes):
            if axis.coordinated and not axis.carries_robot:
                found = axis.motion(values[axis.axis]) @ found
        for axis in self.axes:
            if axis.coordinated and axis.carries_robot:
                found = np.linalg.inv(axis.motion(values[axis.axis])) @ found
        return found

    def points(self, values: Sequence[dict[str, float]], *, joints: bool = False) -> list[WrittenPoint]:
        """Return points at the postures of the spelling."""
        model = arm(self.spelling.model)
        found = []
        for number, posture in enumerate(self.spelling.postures):
            q, at = np.radians(posture), values[number % len(values)]
            tip = np.linalg.inv(self.entered_frame(at)) @ flange_of(model, q) @ TOOL
            found.append(WrittenPoint(None if joints else tip, q if joints else None, at))
        return found

    def project(self, folder: Path) -> Project:
        """Write the project file and read it."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "project.toml"
        path.write_text(self.project_text(), encoding="utf-8")
        return read_project(path)

    def project_text(self) -> str:
        """Return the project as a person writes it."""
        turned = [axis for axis in self.axes if axis.coordinated and not axis.carries_robot]
        frame = np.linalg.inv(turned[-1].frame) @ self.frame if turned else self.frame
        axes = "".join(axis.table_text(self.spelling.frame) for axis in self.axes)
        return (
            f'format = 1\nname = "cell"\n[robot]\nserial = "S1"\nmodel = "{self.spelling.model}"\n'
            f"smallest_sigma = 1e-6\n[tools.{self.spelling.tool}.entered]\n{pose_text(TOOL)}"
            f"[frames.{self.spelling.frame}]\n{pose_text(frame)}{axes}{self.lines}"
        )


def pose_text(matrix: Array) -> str:
    """Return a pose as a project writes it."""
    x, y, z = (matrix[:3, 3] * 1e3).tolist()
    rotvec = Rotation.from_matrix(matrix[:3, :3]).as_rotvec().tolist()
    return f"position_mm = [{x:.12g}, {y:.12g}, {z:.12g}]\nur_rotation_vector_rad = {rotvec}\n"


def rail(spelling: BrandSpelling, *, coordinated: bool = True, **more: object) -> HandAxis:
    """Return a rail along an inclined direction."""
    frame = pose((0.2, 0.1, 0.0), (0.0, 0.0, 0.4))
    found = HandAxis(
        "rail", spelling.rail, "prismatic", frame, (0.6, 0.8, 0.0), coordinated, carries_robot=True
    )
    return replace(found, **more)  # type: ignore[arg-type]


def table(spelling: BrandSpelling, *, coordinated: bool = True, **more: object) -> HandAxis:
    """Return a table that turns about an inclined axis."""
    frame = pose((0.45, 0.05, 0.1), (0.1, -0.2, 0.0))
    found = HandAxis(
        "table", spelling.table, "revolute", frame, (0.0, 0.0, 1.0), coordinated, carries_robot=False
    )
    return replace(found, **more)  # type: ignore[arg-type]


def _product(some: object) -> Array:
    found = np.eye(4)
    for one in some:  # type: ignore[attr-defined]
        found = found @ one
    return found
