"""TOOL.CND: the tools of a controller. Five rows follow each name: pose, centre of mass, mass, inertia, a list."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.documents.plain_numbers import parse_number
from cellcal.calibration.geometry import Pose, homogeneous_matrix
from cellcal.calibration.orientation import rotation_from

_TOOL = re.compile(r"^//TOOL\s+(\d{1,3})\s*$")


@dataclass(frozen=True, slots=True)
class ToolData:
    """One tool: its tip seen from the flange, and its mass."""

    flange_tool: Pose
    mass_kg: float


def read_tools(text: str) -> dict[int, ToolData]:
    """Return the tools by number; a tool whose rows cannot be read is left out."""
    found: dict[int, ToolData] = {}
    number = -1
    rows: list[str] = []
    for line in [*text.splitlines(), "//END"]:
        if line.startswith("//") and not line.startswith("///"):
            tool = _tool_of(rows) if number >= 0 else None
            if tool is not None:
                found[number] = tool
            match = _TOOL.match(line)
            number, rows = (int(match[1]) if match else -1), []
        elif line.strip() and not line.startswith("///"):
            rows.append(line)
    return found


def _tool_of(rows: list[str]) -> ToolData | None:
    try:
        pose = [parse_number(value) for value in rows[0].split(",")]
        mass = parse_number(rows[2].split(",")[0])
    except (IndexError, ValueError):
        return None
    if len(pose) != 6:
        return None
    return ToolData(pose_of([value * 1e-3 for value in pose[:3]], pose[3:]), mass)


def pose_of(position_m: Sequence[float], rotation_deg: Sequence[float]) -> Pose:
    """Return the pose of X Y Z and Rx Ry Rz."""
    rotation = rotation_from("yaskawa_rpy", np.radians(rotation_deg))
    return Pose.from_matrix(homogeneous_matrix(rotation, np.array(position_m)))
