"""RAPID values as Robot Web Services writes them: numbers, and lists in square brackets."""

import math
import re

from cellcal.calibration.documents.plain_numbers import parse_number
from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message

_BRACKETS = re.compile(r"[\[\]]")
NO_AXIS = 9e9
AXES = 6


def read_numbers(text: str) -> list[float]:
    """Return all numbers of a value in their order; raise ValueError where it holds anything else."""
    try:
        return [parse_number(word) for word in _BRACKETS.sub("", text).split(",")]
    except ValueError as error:
        raise ValueError(make_message("{text!r} is no RAPID value of numbers", text=text[:60])) from error


def read_tool(text: str) -> tuple[bool, Pose, float]:
    """Return of a tooldata whether the robot holds the tool, its tip seen from the flange, and its mass [kg]."""
    holds, _, rest = text.strip().lstrip("[").partition(",")
    numbers = read_numbers(rest)
    if holds.strip().upper() not in ("TRUE", "FALSE") or len(numbers) < 8:
        raise ValueError(make_message("{text!r} is no tooldata", text=text[:60]))
    return holds.strip().upper() == "TRUE", pose_of(numbers[:3], numbers[3:7]), numbers[7]


def pose_of(position_mm: list[float], quaternion: list[float]) -> Pose:
    """Return the pose of a position [mm] and a quaternion, w first; raise ValueError where that is none."""
    norm = math.sqrt(sum(value * value for value in quaternion))
    if not 0.99 < norm < 1.01:
        raise ValueError(make_message("{quaternion} is no unit quaternion", quaternion=quaternion))
    w, x, y, z = (value / norm for value in quaternion)
    px, py, pz = (value * 1e-3 for value in position_mm)
    return Pose((px, py, pz), (w, x, y, z))


def write_joint_target(joints_rad: tuple[float, ...]) -> str:
    """Return a jointtarget of six axes without external ones."""
    axes = ",".join(f"{math.degrees(value):.6f}" for value in joints_rad)
    return f"[[{axes}],[{','.join(['9E+09'] * AXES)}]]"
