"""Whether a project's arm is the one that its controller computes with, as CURPOS.DG of the backup shows."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import MODEL_TOLERANCE_M, RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.service.engineering.programs.project_poses import ProjectError

_REPORT = "CURPOS.DG"
_GROUP = 1
_ALIKE_M = (
    0.003  # shown joints are rounded to 0.01 deg: six of them move the tip of a large arm by 2 mm at most
)


def arm_doubts(
    arm: RobotModel, tools: Mapping[str, Array], folder: Path | None, where: str
) -> tuple[str, ...]:
    """Return what to know of an arm (tools: flange_tip (4, 4) by number) whose tip the controller has elsewhere.

    Raises
    ------
    ProjectError
        It is the arm of another model: its tip would be more than 50 mm from where the controller has it.
    """
    shown = None if folder is None else _shown_position(folder)
    if shown is None:
        return ()
    joints_rad, tool, base_tip_m = shown
    flange_tip = np.eye(4) if tool == "0" else tools.get(tool)
    if flange_tip is None or len(joints_rad) != arm.axis_count:
        return ()
    ours = arm.base_flange(joints_rad[None])[0] @ flange_tip
    gap_m = float(np.linalg.norm(ours[:3, 3] - base_tip_m))
    if gap_m > MODEL_TOLERANCE_M:
        raise ProjectError(
            make_message(
                "{where}: its controller is of another arm than {model}: at the joints that {report} shows, the tip "
                "is {gap_mm:.0f} mm from where this arm has it.",
                where=where,
                model=arm.name,
                report=_REPORT,
                gap_mm=gap_m * 1e3,
            ),
            remedy="Name the model of the type plate, or the backup of this robot.",
        )
    if gap_m <= _ALIKE_M:
        return ()
    return (
        make_message(
            "at the joints that {report} shows, the controller has the tip {gap_mm:.1f} mm from where {model} has "
            "it: another variant of the arm, such as an adapter at its flange; points in joint angles carry this "
            "error",
            report=_REPORT,
            gap_mm=gap_m * 1e3,
            model=arm.name,
        ),
    )


def _shown_position(folder: Path) -> tuple[Array, str, Array] | None:
    """Return the joints (n,) [rad], the tool's number and the tip in the base (3,) [m] that the backup shows."""
    # a project without a backup does not wait for the patterns of these files
    from cellcal.drivers.fanuc.backup_file import read_report_in  # noqa: PLC0415
    from cellcal.drivers.fanuc.controller_files.position_report import read_position_report  # noqa: PLC0415
    from cellcal.drivers.programs.errors import ProgramFileError  # noqa: PLC0415

    try:
        data = read_report_in(folder, _REPORT)
        group = None if data is None else read_position_report(data, _REPORT).find_group(_GROUP)
    except ProgramFileError:
        return None  # a damaged report tells nothing of the arm; frames and tools stand in other files
    if group is None or group.world_tip_mm is None or group.tool is None or group.is_extended:
        return None
    joints = [each for each in group.joints_deg if each is not None]
    if len(joints) != len(group.joints_deg):
        return None
    return np.radians(joints), str(group.tool), np.array(group.world_tip_mm) / 1e3
