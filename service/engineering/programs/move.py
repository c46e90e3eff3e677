"""A program for a workpiece or fixture that was moved: Eq. 7 and 8, with the robot's errors where they are known."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, inverse_transform, is_rigid
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import CONVENTIONS, values_from
from cellcal.calibration.points.alignment import Alignment
from cellcal.calibration.programs.transfer import TransferFrames
from cellcal.drivers.programs.brands import ConfigurationRule
from cellcal.service.engineering.programs.expected_accuracy import Expectation
from cellcal.service.engineering.programs.joint_points import UNDECIDED, JointPoints
from cellcal.service.engineering.programs.named_entries import is_written_out, name_without_numbers
from cellcal.service.engineering.programs.program_transfer import ProgramTransfer
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.robot_makes import RobotMake, make_of
from cellcal.service.engineering.programs.transfer_route import FramePair, OneCellRoute

_POSE = 6  # joints that follow every change

_SET_TO_NUMBERS = (
    "its program sets {frame} to numbers of its own: state the change in the robot's base, without --frame"
)


@dataclass(frozen=True, eq=False)
class MoveRoute(OneCellRoute):
    """One cell in which the work has moved; ``base_change`` carries every place of the work to its new one."""

    base_change: Array  # (4, 4) in the base: new place = change @ old place
    frame: str | None = None  # only points of this user frame; None: all
    joints: JointPoints | None = (
        None  # points in joint angles; None: those whose program names no frame are left
    )

    @property
    def change(self) -> Array:
        """Return the motion of the work."""
        return self.base_change

    @property
    def real_ends(self) -> tuple[bool, bool]:
        """Tell that real arms stand at both ends."""
        return (True, True)

    @property
    def keeps_joint_points(self) -> bool:
        """Return whether points in joint angles are requested to stay."""
        return self.joints == "keep"

    def covers_frame(self, frame: str | None, *, bare_joints: bool, in_joints: bool = False) -> bool | str:
        """Return whether points of a user frame move; the option for joint angles goes before what a file says."""
        if in_joints and (self.joints == "keep" or (bare_joints and self.joints == "move")):
            return self.joints == "move"
        named = frame if frame is not None else self.project.default_frame
        if self.frame is not None and named != self.frame:
            sets_it = (
                named is not None and is_written_out(named) and name_without_numbers(named) == self.frame
            )
            return make_message(_SET_TO_NUMBERS, frame=self.frame) if sets_it else False
        if bare_joints and self.joints is None:
            return UNDECIDED
        return True

    def transfer_way(self, frame_pair: FramePair) -> TransferFrames:
        """Carry the real tip along with the work; without parameters the controller's arm stands for the real one."""
        tool = frame_pair.source_tool
        real = self.project.real_arm(tool.real)
        return TransferFrames(real, self.base_change, real, TipArm(self.project.controller, tool.entered))

    def make_expectation(self, frame_pair: FramePair) -> Expectation:
        """One arm at two places; how the move was measured is not in it."""
        return Expectation(self.project, self.project, self.base_change, one_cell=True)


def change_of_frame(base_frame: Array, frame_offset: Array) -> Array:
    """Return the change in the base for an offset ``UF_T_UF'`` (4, 4) of a user frame: ``UF offset UF^-1``.

    Raises
    ------
    CalibrationError
        A pose that is not a finite rigid transform.
    """
    if not (is_rigid(base_frame) and is_rigid(frame_offset)):
        raise CalibrationError("a frame's offset is a rigid transform (4, 4) of finite numbers")
    change: Array = base_frame @ frame_offset @ inverse_transform(base_frame)
    return change


def change_between(before: Alignment, after: Alignment) -> Array:
    """Return the change in the base between two alignments of one fixture by one robot.

    Raises
    ------
    CalibrationError
        Of two robots or two fixtures.
    """
    if (before.robot_serial, before.fixture) != (after.robot_serial, after.fixture):
        raise CalibrationError(
            make_message(
                "the alignments are of {before} from {before_serial} and of {after} from {after_serial}.",
                before=before.fixture,
                before_serial=before.robot_serial,
                after=after.fixture,
                after_serial=after.robot_serial,
            ),
            remedy="A moved fixture is measured twice by one robot.",
        )
    change: Array = after.base_fixture.to_matrix() @ inverse_transform(before.base_fixture.to_matrix())
    return change


def change_at_zero(cell: Project, base_change: Array) -> Array:
    """Return the change with all external axes at zero, from that while the fixture was measured."""
    if not len(cell.axes):
        return base_change
    carrier = cell.axes.cell_fixture_motion()
    found: Array = carrier @ base_change @ inverse_transform(carrier)
    return found


def move_transfer(
    project: Project,
    base_change: Array,
    rule: ConfigurationRule | None,
    *,
    frame: str | None = None,
    joints: JointPoints | None = None,
) -> ProgramTransfer:
    """Return what moves the points of programs of one brand; programs then run with the frame as it was entered.

    Raises
    ------
    ProjectError
        The project does not know the frame.
    CalibrationError
        A change that is not a rigid transform.
    """
    if not is_rigid(base_change):
        raise CalibrationError("a move is a rigid transform (4, 4) of finite numbers")
    if frame is not None:
        project.frame_named(frame)  # or it is refused
    return ProgramTransfer(MoveRoute(project, base_change, frame, joints), rule)


def redefined_frame(project: Project, frame: str, base_change: Array) -> tuple[Array, str]:
    """Return a user frame's new pose (4, 4) for the controller, and what to type: programs then stay as they are.

    The frame that is the robot's base is not listed: it cannot be entered.

    The frame is entered where the work is, so only the robot's errors at the new place remain uncorrected.

    Raises
    ------
    ProjectError
        The project does not know the frame.
    """
    if not is_rigid(base_change):
        raise CalibrationError("a move is a rigid transform (4, 4) of finite numbers")
    make = make_of(project.nominal)
    moved: Array = base_change @ project.frame_named(frame)
    if (make is not None and frame == make.base) or not _stands_for_all_points(project, frame):
        return moved, ""
    table = project.table_frames.get(frame, np.eye(4))
    return moved, make_message(
        "user frame {frame} at {as_typed}",
        frame=frame,
        as_typed=_as_typed(make, inverse_transform(table) @ moved),
    )


def _stands_for_all_points(project: Project, frame: str) -> bool:
    """Return whether a user frame, entered anew, moves the points of every position of the external axes alike."""
    carriers = project.axes.carriers_of(frame, caseless=False)
    tracks = [axis for axis in project.axes.axes if axis.carries_robot]
    return all(project.axes.axes[n].coordinated for n in carriers) and all(
        axis.coordinated for axis in tracks
    )


def instead_of_moving(project: Project, frame: str, base_change: Array) -> str:
    """Return what could be entered into the controller so that programs stay as they are; "" where nothing can.

    Raises
    ------
    ProjectError
        The project does not know the frame.
    """
    if not _can_follow(project, base_change):
        return ""
    alternative = redefined_frame(project, frame, base_change)[1]
    if not alternative:
        return ""
    return make_message(
        "Instead of running the moved programs, the old ones could run with {alternative}. Never do both.",
        alternative=alternative,
    )


def _can_follow(project: Project, base_change: Array) -> bool:
    """Return whether the robot keeps a frame's points when the frame is entered anew: few joints follow few turns."""
    other = project.other_arm
    if other is None or other.free_count >= _POSE:
        return True
    if other.scara is None:
        return False
    moved_up = base_change[:3, :3] @ other.scara.up
    lean = np.arctan2(np.linalg.norm(np.cross(moved_up, other.scara.up)), moved_up @ other.scara.up)
    return bool(lean <= project.largest_tilt_rad)


def _as_typed(make: RobotMake | None, pose: Array) -> str:
    """Return a pose with the letters and units of the robot's maker."""
    name = "ur_rotation_vector" if make is None else make.orientation
    values = values_from(name, pose[:3, :3])
    unit, digits = {"ur_rotation_vector": (" rad", 6), "abb_quaternion": ("", 6)}.get(name, (" deg", 4))
    shown = np.degrees(values) if unit == " deg" else values
    place = ", ".join(f"{axis} {v:.3f}" for axis, v in zip("XYZ", pose[:3, 3] * 1e3, strict=True))
    turn = ", ".join(
        f"{key} {round(v, digits) + 0.0:.{digits}f}"
        for key, v in zip(CONVENTIONS[name].fields, shown, strict=True)
    )
    return f"{place} mm, {turn}{unit}"
