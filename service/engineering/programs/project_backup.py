"""Frames and tools of a project read from its controller's own backup instead of being typed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.programs.transfer import same_place
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.service.engineering.programs.project_poses import PoseTable, ProjectError, pose_of
from cellcal.service.engineering.programs.project_tables import RobotTable

_MAKE = "fanuc_"
_GROUP = 1  # programs of other motion groups are not carried
_ALIKE_M, _ALIKE_RAD = 1e-5, np.radians(0.01)  # a pendant shows three decimals


@dataclass(frozen=True, eq=False)
class BackupFrames:
    """The controller's frames by the number that programs write; empty where the project names no backup."""

    frames: Mapping[str, Array] = field(default_factory=dict)  # (4, 4) base_frame
    tools: Mapping[str, Array] = field(default_factory=dict)  # (4, 4) flange_tip
    folder: Path | None = None  # of the backup


def frames_of_backup(robot: RobotTable, folder: Path, nominal: RobotModel, where: str) -> BackupFrames:
    """Return the user frames and tools of the backup that ``[robot] backup`` names.

    Raises
    ------
    ProjectError
        Another make's robot, or a folder without a readable SYSFRAME.VA.
    """
    if robot.backup is None:
        return BackupFrames()
    if not nominal.name.startswith(_MAKE):
        raise ProjectError(
            make_message(
                "{where}: backup is a folder of FANUC's .VA files, and the robot is a {model}.",
                where=where,
                model=nominal.label,
            ),
            remedy="Enter tools and frames under [tools] and [frames].",
        )
    # a project without a backup does not wait for the patterns of these files
    from cellcal.drivers.fanuc.program_files.va_backup import FRAMES, read_backup  # noqa: PLC0415

    place = (folder / robot.backup).resolve()
    try:
        backup = read_backup(place)
    except ProgramFileError as refused:
        raise ProjectError(
            make_message(
                "{where}: {place}: {refused_message}",
                where=where,
                place=place,
                refused_message=refused.message,
            ),
            remedy=refused.remedy,
        ) from refused
    if FRAMES in backup.missing_files:
        raise ProjectError(
            make_message(
                "{where}: {place} holds no {file}, in which a controller keeps its frames and tools.",
                where=where,
                place=place,
                file=FRAMES,
            ),
            remedy="Save all of the controller's files as text (.VA) and name that folder.",
        )
    its = backup.group_frames(_GROUP)
    return BackupFrames(
        {number: pose.to_matrix() for number, pose in its.base_frame.items()},
        {number: pose.to_matrix() for number, pose in its.flange_tip.items()},
        place,
    )


def pose_or_backup(table: PoseTable, from_backup: Array | None, where: str) -> Array:
    """Return a pose as the project or the controller's backup has it; where both have it, they must agree.

    Raises
    ------
    ProjectError
        Neither has it, they differ, or the project's is no pose.
    """
    if from_backup is None:
        return pose_of(table, where)
    if table.is_empty:
        return from_backup
    entered = pose_of(table, where)
    apart, turned = same_place(from_backup[None], entered[None])
    if apart[0] > _ALIKE_M or turned[0] > _ALIKE_RAD:
        raise ProjectError(
            make_message(
                "{where}: what is written here is {apart_mm:.3f} mm and {turned_deg:.3f} deg from what the "
                "controller's backup holds.",
                where=where,
                apart_mm=apart[0] * 1e3,
                turned_deg=np.degrees(turned[0]),
            ),
            remedy="Remove it here where the backup is newer; else save the backup again.",
        )
    return entered
