"""Does a program say the same place twice? Stored and printed poses against joints under the file's own kinematics.

A difference beyond rounding means another tool, another feature, or a waypoint of another arm: such a program does
not go where its numbers say, and should be understood before it is changed.
"""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.drivers.universal_robots.program_files.script_program import ScriptProgram
from cellcal.drivers.universal_robots.program_files.urp_kinematics import pose_distances
from cellcal.drivers.universal_robots.program_files.urp_program import UrpProgram


@dataclass(frozen=True, eq=False)
class PoseMisfit:
    """Per waypoint, NaN where there is nothing to compare."""

    names: tuple[str, ...]
    position_m: Array  # (N,)
    angle_rad: Array  # (N,)


def pose_misfit_m(program: ProgramFile) -> Array:
    """Return (N,) how far the pose that a position stores is from its own joints [m].

    NaN where a position stores no pose, or its kinematics are not known; that is every position of a script, and of a
    program of PolyScope 3.5 or later, which stores joints only.
    """
    if isinstance(program, UrpProgram):
        return program.columns.misfit_m
    return np.full(len(program.positions), np.nan)


def misfit_to_script(program: UrpProgram, script: ScriptProgram) -> PoseMisfit:
    """Return how far the poses that PolyScope printed into the script beside a program are from its waypoints.

    Waypoints are matched by name. The printed poses are in the base, with the tool of the waypoint.
    """
    here, there = program.positions, script.positions
    rows = {name: row for row, name in enumerate(there.names)}
    printed = np.full((len(here), 4, 4), np.nan)
    for row, name in enumerate(here.names):
        if name in rows:
            printed[row] = there.frame_tip[rows[name]]
    base_tip = program.columns.base_feature @ here.frame_tip
    both = np.isfinite(printed).all(axis=(1, 2)) & np.isfinite(base_tip).all(axis=(1, 2))
    position_m, angle_rad = np.full(len(here), np.nan), np.full(len(here), np.nan)
    position_m[both], angle_rad[both] = pose_distances(base_tip[both], printed[both])
    return PoseMisfit(here.names, position_m, angle_rad)
