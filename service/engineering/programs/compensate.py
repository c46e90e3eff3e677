"""A program corrected for the errors of its own robot, and a taught one brought back to the nominal world."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.compensation.compensate import ProgramDirection
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.programs.transfer import TransferFrames
from cellcal.drivers.programs.brands import ConfigurationRule
from cellcal.service.engineering.programs.expected_accuracy import Expectation
from cellcal.service.engineering.programs.program_transfer import ProgramTransfer
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.project_poses import ProjectError
from cellcal.service.engineering.programs.transfer_route import FramePair, OneCellRoute


@dataclass(frozen=True, eq=False)
class CompensationRoute(OneCellRoute):
    """From where the controller believes its tip to be to where the real one is, or back."""

    direction: ProgramDirection

    @property
    def change(self) -> Array:
        """Return that nothing of the work moves."""
        return np.eye(4)

    @property
    def real_ends(self) -> tuple[bool, bool]:
        """Return which end is the real arm: the target of an upload, the source of a download."""
        upload = self.direction is ProgramDirection.UPLOAD
        return not upload, upload

    @property
    def keeps_joint_points(self) -> bool:
        """Return whether points in joint angles are requested to stay."""
        return False

    def covers_frame(self, frame: str | None, *, bare_joints: bool, in_joints: bool = False) -> bool | str:
        """Every point is corrected."""
        return True

    def transfer_way(self, frame_pair: FramePair) -> TransferFrames:
        """Upload: the real tip shall be where the program says. Download: the program shall say where it is."""
        tool = frame_pair.source_tool
        believed = TipArm(self.project.controller, tool.entered)
        real = self.project.real_arm(tool.real)
        ends = (believed, real) if self.direction is ProgramDirection.UPLOAD else (real, believed)
        return TransferFrames(ends[0], np.eye(4), ends[1], believed)

    def make_expectation(self, frame_pair: FramePair) -> Expectation:
        """One arm against a computed place."""
        return Expectation(self.project, self.project, np.eye(4), nominal=True)


def compensation_transfer(
    project: Project, direction: ProgramDirection, rule: ConfigurationRule | None
) -> ProgramTransfer:
    """Return what compensates programs of one brand.

    Raises
    ------
    ProjectError
        The project names no parameters.
    """
    if project.identified is None:
        raise ProjectError(
            make_message(
                "{path}: no parameters of {serial} are named.",
                path=project.path,
                serial=project.serial,
            ),
            remedy="Calibrate the robot and name its parameter set under [robot].",
        )
    return ProgramTransfer(CompensationRoute(project, ProgramDirection(direction)), rule)
