"""A project: one cell as its programs see it, and as it really is. A clone's project names its master's.

The file's keys are those of `project_tables`, with an example in the README beside this file. Everything that it
names is read once, checked, and converted to plain values in SI.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.joint_kinds import shown_units
from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.arm.model_references import fixed_reference
from cellcal.calibration.compensation.other_joint_counts import moves_six_joints
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import describe_unreadable, read_plain_text
from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.geometry import Array, homogeneous_matrix
from cellcal.calibration.identification.parameters import ArmState
from cellcal.calibration.message import join_messages, make_message
from cellcal.calibration.motion.cell_shapes import CellShape
from cellcal.calibration.points.alignment import Alignment, read_alignments
from cellcal.calibration.programs.transfer_other_arms import OtherArm
from cellcal.service.configuration.cell_shapes import read_cell_shape
from cellcal.service.engineering.programs.arm_of_backup import arm_doubts
from cellcal.service.engineering.programs.external.axis_tables import (
    fixture_values,
    frames_at_zero,
    read_axes,
)
from cellcal.service.engineering.programs.external.moving_axes import NO_AXES, CellAxes
from cellcal.service.engineering.programs.external.standing_tools import NO_STANDING_TOOLS, StandingTools
from cellcal.service.engineering.programs.files import is_log
from cellcal.service.engineering.programs.held_joints import read_held_joints
from cellcal.service.engineering.programs.length_doubts import length_doubts
from cellcal.service.engineering.programs.project_arms import (
    IdentifiedArm,
    factory_arm,
    identified_arm,
    nominal_arm,
)
from cellcal.service.engineering.programs.project_backup import frames_of_backup, pose_or_backup
from cellcal.service.engineering.programs.project_poses import (
    PoseTable,
    ProjectError,
    ProjectTool,
    axis_numbers,
    pose_of,
)
from cellcal.service.engineering.programs.project_pulses import FIRST_GROUP, pulses_per_rad
from cellcal.service.engineering.programs.project_tables import (
    FixtureTable,
    RobotTable,
    ShapesTable,
    ToolTable,
    read_project_tables,
)
from cellcal.service.engineering.programs.robot_makes import RobotMake, make_of
from cellcal.service.engineering.programs.starting_postures import (
    NO_STARTING_POSTURES,
    StartingPostures,
    read_starting_postures,
)

LARGEST_TILT_RAD = float(np.radians(0.02))  # some times what a pendant shows
_IS_FLANGE = "{place}: on this make of robot, that is the flange itself, and nowhere else."
_IS_BASE = "{place}: on this make of robot, that is the base itself, and nowhere else."
SMALLEST_SIGMA = 0.01  # m/rad: nearer to a singularity no point is computed unless a project says so


@dataclass(frozen=True, eq=False)
class Project:
    """One cell."""

    path: Path
    name: str
    serial: str
    nominal: RobotModel
    controller: RobotModel  # what the controller computes with: the nominal arm, or its factory calibration
    factory_known: bool  # whether the project says what the controller computes with
    identified: IdentifiedArm | None
    tools: Mapping[str, ProjectTool]
    frames: Mapping[str, Array]  # (4, 4) base_frame as entered into the controller
    default_tool: str | None  # holds where a program does not say
    default_frame: str | None
    alignment: Alignment | None
    shapes: CellShape | None
    smallest_sigma: float
    master: Path | None
    programs: tuple[str, ...]  # patterns relative to the project's folder
    programs_without_motion: tuple[str, ...] = ()  # patterns of routines that move no robot
    pulses_per_rad: Array | None = None  # (n,) with sign, of a controller whose programs hold pulses
    control_group: str = FIRST_GROUP  # which of its controller's robots it is
    backup: Path | None = None  # folder of the controller's .VA files
    doubts: tuple[str, ...] = ()  # what speaks against its positions, and its backup against its arm
    axes: CellAxes = NO_AXES  # external axes
    table_frames: Mapping[str, Array] = field(
        default_factory=dict
    )  # of frames that a table turns: what their pose in the controller is seen from
    standing_tools: StandingTools = NO_STANDING_TOOLS
    starting: StartingPostures = NO_STARTING_POSTURES
    held_joints: tuple[int, ...] = ()  # from 0: they stay at their taught values
    largest_tilt_rad: float = LARGEST_TILT_RAD  # that a change may ask of an arm which cannot follow it
    held_out_setting: str = (
        "held_out_rms_mm"  # where the error at held-out poses is stated: a key, or a field's label
    )

    @property
    def file_name(self) -> str:
        """Return the file's name for people; many are called project.toml: then with its folder."""
        folder = self.path.resolve().parent.name if self.path.name == "project.toml" else ""
        return f"{folder}/{self.path.name}" if folder else self.path.name

    @property
    def identified_state(self) -> ArmState | None:
        """Return the identified arm, or None where the project names no parameters."""
        return None if self.identified is None else self.identified.state

    def real_arm(self, flange_tip: Array) -> TipArm:
        """Return the real arm with a tip: as identified, or as the controller assumes where it was not measured."""
        if self.identified is None:
            return TipArm(self.controller, flange_tip)
        return TipArm.of_state(replace(self.identified.state, flange_tool=flange_tip))

    def frame_named(self, name: str) -> Array:
        """Return a user frame (4, 4) [m] as entered into the controller.

        Raises
        ------
        ProjectError
            The cell does not know it.
        """
        if name in self.frames:
            return self.frames[name]
        make = make_of(self.nominal)
        if make is None or name != make.base:
            names = ", ".join(self.frames) or "none"
            raise ProjectError(
                make_message(
                    "{project_name} has no user frame {frame_name}.", project_name=self.name, frame_name=name
                ),
                remedy=make_message("It has {names}; a project's are [frames.NAME].", names=names),
            )
        return np.eye(4)

    @property
    def other_arm(self) -> OtherArm | None:
        """Return what keeps the posture of an arm that has not six turning joints; None of one that has."""
        return None if moves_six_joints(self.nominal) else OtherArm.from_model(self.nominal, self.held_joints)

    def program_files(self) -> tuple[Path, ...]:
        """Return the programs of this cell, sorted by name; a pattern passes over the logs of a whole backup."""
        found = {item for pattern in self.programs for item in self.path.parent.glob(pattern)}
        return tuple(sorted(item for item in found if item.is_file() and not is_log(item)))


def read_project(path: Path) -> Project:
    """Read a project file and everything it names.

    Raises
    ------
    ProjectError
        No such file, or a key that is missing, unknown or of the wrong kind.
    CellError
        A file that the project names cannot be used: parameters of another arm, an alignment of another robot.
    """
    tables = read_project_tables(path)
    where, folder, robot = str(path), path.parent, tables.robot
    nominal = _read_nominal(robot, folder, f"{where}: [robot]")
    controller = (
        nominal if robot.factory is None else factory_arm(_relative_path(folder, robot.factory), nominal)
    )
    controller = _with_limits(controller, robot, f"{where}: [robot]")
    backup, make = frames_of_backup(robot, folder, nominal, where), make_of(nominal)
    frames = _read_frames(tables.frames, backup.frames, make, where)
    axes = read_axes(tables, folder, make, tuple(frames), where)
    axes = replace(axes, fixture_at=fixture_values(tables.fixture, axes, f"{where}: [fixture.at]"))
    frames, table_frames = frames_at_zero(frames, axes)
    master = tables.master.project
    return Project(
        path=path,
        name=tables.name or path.stem,
        serial=robot.serial,
        nominal=nominal,
        controller=controller,
        factory_known=robot.factory is not None,
        identified=identified_arm(robot, folder, replace_limits(nominal, controller), where),
        tools=_read_tools(tables.tools, backup.tools, make, where),
        frames=frames,
        default_tool=tables.unsaid.tool,
        default_frame=tables.unsaid.frame,
        alignment=_read_alignment(tables.fixture, folder, robot.serial),
        shapes=_read_shapes(tables.shapes, folder, controller),
        smallest_sigma=SMALLEST_SIGMA if robot.smallest_sigma is None else robot.smallest_sigma,
        master=None if master is None else _relative_path(folder, master),
        programs=_program_patterns(tables.programs, where),
        programs_without_motion=tuple(tables.programs_without_motion),
        pulses_per_rad=pulses_per_rad(robot, nominal.axis_count, f"{where}: [robot]"),
        control_group=robot.control_group or FIRST_GROUP,
        backup=backup.folder,
        doubts=(
            *length_doubts(tables, where),
            *arm_doubts(controller, backup.tools, backup.folder, f"{where}: [robot]"),
        ),
        axes=axes,
        table_frames=table_frames,
        standing_tools=StandingTools(
            tools=_read_tools(tables.standing_tools, {}, None, where, "standing_tools"),
            works=_read_tools(tables.held_work, {}, None, where, "held_work"),
        ),
        starting=read_starting_postures(robot, tables.starting_postures, nominal, where),
        held_joints=read_held_joints(robot.held_joints, nominal, f"{where}: [robot]"),
        largest_tilt_rad=LARGEST_TILT_RAD
        if robot.largest_tilt_deg is None
        else float(np.radians(robot.largest_tilt_deg)),
    )


def replace_limits(model: RobotModel, limits: RobotModel) -> RobotModel:
    """Return a model with the joint limits of another one."""
    return replace(model, lower_rad=limits.lower_rad, upper_rad=limits.upper_rad)


def _read_nominal(robot: RobotTable, folder: Path, where: str) -> RobotModel:
    if robot.arm is not None:
        return nominal_arm(_relative_path(folder, robot.arm), robot.model)
    try:
        return load_model(fixed_reference(robot.model, folder))
    except CalibrationError as refused:
        raise ProjectError(
            make_message(
                "{where}: no model is called {model!r}: {refused_message}",
                where=where,
                model=robot.model,
                refused_message=refused.message,
            ),
            remedy=join_messages(" ", (refused.remedy, "Or name a file of another one as arm.")),
        ) from refused


def _with_limits(model: RobotModel, robot: RobotTable, where: str) -> RobotModel:
    def joint_limits(values: Sequence[float] | None, key: str, default: Array) -> Array:
        if values is None:
            return default
        return axis_numbers(values, key, model.axis_count, where) / shown_units(model)[0]

    return replace(
        model,
        lower_rad=joint_limits(robot.lower_deg, "lower_deg", model.lower_rad),
        upper_rad=joint_limits(robot.upper_deg, "upper_deg", model.upper_rad),
    )


def _read_tools(
    tables: Mapping[str, ToolTable],
    from_backup: Mapping[str, Array],
    make: RobotMake | None,
    where: str,
    heading: str = "tools",
) -> dict[str, ProjectTool]:
    tools = {name: ProjectTool(pose, pose) for name, pose in from_backup.items()}
    for name, table in tables.items():
        place = f"{where}: [{heading}.{name}"
        pose = pose_or_backup(table.entered, from_backup.get(name), f"{place}.entered]")
        if make is not None and name == make.flange:
            _refuse_moved(pose, f"{place}]", _IS_FLANGE)
        measured = pose if table.real.is_empty else pose_of(table.real, f"{place}.real]")
        if not table.real.orientation_keys:  # three touches of a tip see no turn
            measured = homogeneous_matrix(pose[:3, :3], measured[:3, 3])
        sigma_m = (table.real.sigma_mm or 0.0) / 1e3
        tools[name] = ProjectTool(pose, measured, sigma_m, not table.real.is_empty)
    return tools


def _read_frames(
    tables: Mapping[str, PoseTable], from_backup: Mapping[str, Array], make: RobotMake | None, where: str
) -> dict[str, Array]:
    frames = dict(from_backup)
    for name, table in tables.items():
        place = f"{where}: [frames.{name}]"
        frames[name] = pose_or_backup(table, from_backup.get(name), place)
        if make is not None and name == make.base:
            _refuse_moved(frames[name], place, _IS_BASE)
    return frames


def _refuse_moved(pose: Array, place: str, template: str) -> None:
    """Refuse another pose of a frame that no controller lets a person change."""
    if not np.allclose(pose, np.eye(4), atol=1e-9):
        raise ProjectError(
            make_message(template, place=place),
            remedy="Leave the table out, or name the one that was meant.",
        )


def _read_alignment(table: FixtureTable, folder: Path, serial: str) -> Alignment | None:
    file, name = table.alignment, table.name
    if file is None:
        return None
    path = _relative_path(folder, file)
    try:
        found = read_alignments(read_plain_text(path))
    except (OSError, DocumentError) as broken:
        raise ProjectError(describe_unreadable(path, broken)) from broken
    except CellError as refused:
        raise ProjectError(
            make_message("{path}: {refused_message}", path=path, refused_message=refused.message),
            remedy=refused.remedy,
        ) from refused
    mine = [a for a in found if a.robot_serial == serial and name in (None, a.fixture)]
    if len(mine) != 1:
        fixture_label = (
            make_message("{serial} with {fixture}", serial=serial, fixture=name) if name else serial
        )
        there = [
            make_message("{fixture} from robot {serial}", fixture=a.fixture, serial=a.robot_serial)
            for a in found
        ]
        raise ProjectError(
            make_message(
                "{path} holds {count} alignments of robot {wanted}: {there}.",
                path=path,
                count=len(mine),
                wanted=fixture_label,
                there=join_messages("; ", there) or "nothing",
            ),
            remedy="Name the robot's own alignment file, and the fixture under [fixture] name.",
        )
    return mine[0]


def _read_shapes(table: ShapesTable, folder: Path, model: RobotModel) -> CellShape | None:
    return None if table.file is None else read_cell_shape(_relative_path(folder, table.file), model)


def _program_patterns(patterns: Sequence[str], where: str) -> tuple[str, ...]:
    absolute = [item for item in patterns if Path(item).is_absolute()]
    if absolute:
        raise ProjectError(
            make_message(
                "{where}: {pattern} must be relative to the project's folder.",
                where=where,
                pattern=absolute[0],
            )
        )
    return tuple(patterns)


def _relative_path(folder: Path, name: str) -> Path:
    return (folder / name).resolve()
