"""A FANUC TP program in ASCII (.LS) with joint positions.

Source: FANUC, R-30iB HandlingTool Operator's Manual, program structure and motion instructions; remarks hold 32
characters. Joint speeds are in whole per cent of each axis' own maximum, so the override is set as well. Needs
the option ASCII Upload, or conversion by the maker's tool. Not run on a robot by us.
"""

import math

from cellcal.drivers.wire.program_file import ProgramHeader, ProgramWriter, Way, lines_of

_REMARK = 32
_FASTEST_AXIS_RAD_S = (
    10.5  # 600 deg/s: no axis of such an arm is faster, so one per cent is at most 0.105 rad/s
)
_OVERRIDES = (100, 50, 25, 10, 5, 1)


def write_ls(header: ProgramHeader, way_rad: Way, speed_rad_s: float) -> str:
    """Return a program that sets the override and moves along the corners, each at standstill."""
    percent, override = joint_speed_and_override(speed_rad_s)
    remarks = [
        f"cellcal {header.token}",
        *lines_of(header.robot, _REMARK),
        *lines_of(header.warning, _REMARK),
    ]
    steps = [f"  !{line} ;" for line in remarks]
    steps += [f"  OVERRIDE={override}% ;"]
    steps += [f"J P[{k}] {percent}% FINE    ;" for k in range(1, len(way_rad) + 1)]
    numbered = [f"{k:4d}:{step}" for k, step in enumerate(steps, 1)]
    attributes = [f'COMMENT\t\t= "CELLCAL {header.token}";', "DEFAULT_GROUP\t= 1,*,*,*,*;"]
    positions = [_position_text(k, corner) for k, corner in enumerate(way_rad, 1)]
    return "\n".join(
        [f"/PROG  {header.name}", "/ATTR", *attributes, "/MN", *numbered, "/POS", *positions, "/END", ""]
    )


def joint_speed_and_override(speed_rad_s: float) -> tuple[int, int]:
    """Return per cent of joint speed and override [%] that together keep the fastest axis below the speed."""
    for override in _OVERRIDES:
        percent = math.floor(speed_rad_s / (_FASTEST_AXIS_RAD_S * override * 1e-4))
        if percent >= 1:
            return min(percent, 100), override
    return 1, _OVERRIDES[-1]


def _position_text(number: int, corner: tuple[float, ...]) -> str:
    joints = ",\t".join(f"J{k}= {math.degrees(q):9.3f} deg" for k, q in enumerate(corner, 1))
    return f"P[{number}]{{\n   GP1:\n\tUF : 0, UT : 1,\t\n\t{joints}\n}};"


PROGRAM_WRITER = ProgramWriter(".LS", write_ls)
