"""A program of the master's cell for the clone's: Eq. 9 to 12 with both robots' identified models."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.calibration.message import make_message
from cellcal.calibration.points.joint_bases import bases_together
from cellcal.calibration.programs.transfer import TransferFrames
from cellcal.drivers.programs.brands import ConfigurationRule
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.expected_accuracy import Expectation
from cellcal.service.engineering.programs.program_transfer import ProgramTransfer
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.project_poses import ProjectError
from cellcal.service.engineering.programs.result import ProgramResult
from cellcal.service.engineering.programs.transfer_route import FramePair


@dataclass(frozen=True, eq=False)
class CloneRoute:
    """From the master's real robot to the clone's, through the fixture that both are aligned with."""

    source: Project
    target: Project
    change: Array  # (4, 4) the master's base seen from the clone's, Eq. 9
    change_covariance: Array  # (6, 6) of its right twist

    @classmethod
    def between_cells(cls, master: Project, clone: Project) -> "CloneRoute":
        """Find the master's base in the clone's from the alignments of both.

        Raises
        ------
        ProjectError
            An alignment or parameters are missing, the fixtures are different ones, or found in different shapes.
        """
        for project in (master, clone):
            if project.alignment is None:
                raise ProjectError(
                    make_message(
                        "{path}: no alignment is named.",
                        path=project.path,
                    ),
                    remedy="Measure the fixture in this cell and name the file under [fixture].",
                )
            if project.identified is None:
                raise ProjectError(
                    make_message(
                        "{path}: no parameters of {serial} are named.",
                        path=project.path,
                        serial=project.serial,
                    ),
                    remedy="Calibrate the robot and name its parameter set: base shift alone misses by millimetres.",
                )
        if master.nominal.name != clone.nominal.name:
            raise ProjectError(
                make_message(
                    "{master} has a {model}, {clone} a {other}.",
                    master=master.file_name,
                    model=master.nominal.label,
                    clone=clone.file_name,
                    other=clone.nominal.label,
                ),
                remedy="A program is cloned between robots of one type.",
            )
        assert master.alignment is not None
        assert clone.alignment is not None
        _refuse_other_gears(master, clone)
        if master.alignment.fixture != clone.alignment.fixture:
            raise ProjectError(
                make_message(
                    "the alignments are of two fixtures: {fixture} and {other}.",
                    fixture=master.alignment.fixture,
                    other=clone.alignment.fixture,
                )
            )
        try:
            both = bases_together([clone.alignment, master.alignment])
        except CalibrationError as refused:
            raise ProjectError(
                make_message("{path}: {refused_message}", path=clone.path, refused_message=refused.message),
                remedy=refused.remedy,
            ) from refused
        if not both.is_consistent():
            raise ProjectError(
                make_message(
                    "{serial} and {other} found {fixture} in two shapes "
                    "(chi square {chi:.0f} at {freedom} degrees of freedom).",
                    serial=master.serial,
                    other=clone.serial,
                    fixture=clone.alignment.fixture,
                    chi=both.chi_square,
                    freedom=both.degrees_of_freedom,
                ),
                remedy="See that its alignment points are whole and the same in both cells; measure it again.",
            )
        base = both.bases[0]
        change = _at_zero(base.other_base_base.to_matrix(), master, clone)
        return cls(master, clone, change, np.array(base.covariance))

    @property
    def real_ends(self) -> tuple[bool, bool]:
        """Tell that real arms stand at both ends."""
        return (True, True)

    @property
    def keeps_joint_points(self) -> bool:
        """Return whether points in joint angles are requested to stay."""
        return False

    def covers_frame(self, frame: str | None, *, bare_joints: bool, in_joints: bool = False) -> bool | str:
        """Every point is cloned."""
        return True

    def transfer_way(self, frame_pair: FramePair) -> TransferFrames:
        """Real robot to real robot, written for the clone's controller."""
        return TransferFrames(
            source=self.source.real_arm(frame_pair.source_tool.real),
            change=self.change,
            target=self.target.real_arm(frame_pair.target_tool.real),
            written=TipArm(self.target.controller, frame_pair.target_tool.entered),
        )

    def make_expectation(self, frame_pair: FramePair) -> Expectation:
        """Both arms and both alignments."""
        return Expectation(self.source, self.target, self.change, self.change_covariance)


def _at_zero(change: Array, master: Project, clone: Project) -> Array:
    """Return the change between the cells with all external axes at zero, from that while fixtures were measured."""
    if not (len(master.axes) or len(clone.axes)):
        return change
    found: Array = (
        clone.axes.cell_fixture_motion() @ change @ inverse_transform(master.axes.cell_fixture_motion())
    )
    return found


def _refuse_other_gears(master: Project, clone: Project) -> None:
    """Refuse two ratios for one type of robot: a clone's job is written with the master's."""
    here, there = master.pulses_per_rad, clone.pulses_per_rad
    if here is not None and there is not None and not np.array_equal(here, there):
        raise ProjectError(
            make_message(
                "{master} and {clone} give different pulses per radian.",
                master=master.path,
                clone=clone.path,
            ),
            remedy="Robots of one type have the same gears: see the parameters of both controllers.",
        )


def clone_transfer(master: Project, clone: Project, rule: ConfigurationRule | None) -> ProgramTransfer:
    """Return what clones programs of one brand; it may be used for many, one after the other or together.

    Raises
    ------
    ProjectError
        The projects do not hold what a clone needs.
    """
    return ProgramTransfer(CloneRoute.between_cells(master, clone), rule)


def clone_programs(
    programs: Sequence[ProgramFile], master: Project, clone: Project, rule: ConfigurationRule | None
) -> tuple[ProgramResult, ...]:
    """Clone programs of one brand; ``rule`` is the brand's `ProgramBrand.configurations`.

    Raises
    ------
    ProjectError
        The projects do not hold what a clone needs.
    ProgramFileError
        A program of another robot, or in another unit.
    """
    return clone_transfer(master, clone, rule).transfer_programs(programs)
