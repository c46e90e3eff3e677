"""Values as KRL writes them: numbers, TRUE and FALSE, #NAMES, texts, and aggregates in braces."""

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from cellcal.calibration.documents.plain_numbers import NUMBER, parse_number
from cellcal.calibration.geometry import Pose, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import rotation_from, values_from

AXES = 6
_MEMBER = re.compile(rf"(?<!\w)([A-Za-z]\w*+)\s++({NUMBER})\s*(?=[,}}])")
_NAME = re.compile(r"#\w{1,40}", re.ASCII)
_DECIMAL_COMMA = re.compile(r",\s*[-+.\d]")  # behind a comma stands a name, and never a number
_MOST_TEXT = 4096
_POSE_MEMBERS = ("X", "Y", "Z", "A", "B", "C")


def read_flag(text: str) -> bool:
    """Return TRUE or FALSE; raise ValueError for anything else."""
    word = text.strip().upper()
    if word not in ("TRUE", "FALSE"):
        raise ValueError(make_message("{text!r} is neither TRUE nor FALSE", text=text[:60]))
    return word == "TRUE"


def read_name(text: str) -> str:
    """Return a name of an enumeration with its sign, in upper case; raise ValueError for anything else."""
    name = text.strip().upper()
    if not _NAME.fullmatch(name):
        raise ValueError(make_message("{text!r} is no name", text=text[:60]))
    return name


def read_members(text: str) -> Mapping[str, float]:
    """Return the numbers of an aggregate by their names; raise ValueError where there are none."""
    if len(text) > _MOST_TEXT:
        raise ValueError(
            make_message("{text_count} characters are more than any aggregate has", text_count=len(text))
        )
    if _DECIMAL_COMMA.search(text):
        raise ValueError(make_message("{text!r} has decimal commas", text=text[:60]))
    found = {name.upper(): parse_number(value) for name, value in _MEMBER.findall(text)}
    if not found or not all(map(math.isfinite, found.values())):
        raise ValueError(make_message("{text!r} holds no numbers", text=text[:60]))
    return found


def read_axes(text: str) -> tuple[float, ...]:
    """Return A1 to A6 [rad]."""
    return tuple(map(math.radians, _read_members_once(text, [f"A{axis}" for axis in range(1, AXES + 1)])))


def read_external_axes(text: str) -> tuple[tuple[str, float], ...]:
    """Return those of E1 to E6 that the aggregate has, with where they stand [mm or deg]."""
    members = read_members(text)
    names = [name for name in (f"E{axis}" for axis in range(1, AXES + 1)) if name in members]
    return tuple(zip(names, _read_members_once(text, names), strict=True))


def read_pose(text: str) -> Pose:
    """Return the pose of X Y Z [mm] and A B C [deg]; the rotation is Rz(A) Ry(B) Rx(C)."""
    position_mm, abc_deg = np.split(np.array(_read_members_once(text, _POSE_MEMBERS)), 2)
    return Pose.from_matrix(
        homogeneous_matrix(rotation_from("kuka_abc", np.radians(abc_deg)), position_mm * 1e-3)
    )


def _read_members_once(text: str, names: Sequence[str]) -> list[float]:
    """Return the numbers of these names, each of which stands once; raise ValueError where one does not."""
    members = read_members(text)
    missing = [name for name in names if name not in members]
    if missing:
        raise ValueError(make_message("{missing} are missing", missing=", ".join(missing)))
    written = [name.upper() for name, _ in _MEMBER.findall(text)]
    doubled = [name for name in names if written.count(name) > 1]
    if doubled:
        raise ValueError(make_message("{doubled} stand twice", doubled=", ".join(doubled)))
    return [members[name] for name in names]


def write_axes(joints_rad: tuple[float, ...]) -> str:
    """Return an E6AXIS of six joints."""
    members = ", ".join(f"A{axis} {math.degrees(value):.6f}" for axis, value in enumerate(joints_rad, 1))
    return f"{{E6AXIS: {members}}}"


def write_pose(pose: Pose) -> str:
    """Return a FRAME."""
    abc = np.degrees(values_from("kuka_abc", pose.rotation_matrix()))
    values = [*(value * 1e3 for value in pose.position_m), *(float(angle) for angle in abc)]
    members = ", ".join(f"{name} {value:.6f}" for name, value in zip(_POSE_MEMBERS, values, strict=True))
    return f"{{FRAME: {members}}}"
