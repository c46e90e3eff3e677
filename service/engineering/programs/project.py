"""A project: one cell as its programs see it, and as it really is. A clone's project names its master's.

The file's keys, with an example, stand in this room's README. Everything that it names is read once, checked, and
kept as plain values in SI.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.arm.model_references import fixed_reference
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.parameters import ArmState
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.collision import CellShape
from cellcal.calibration.points.alignment import Alignment, read_alignments
from cellcal.service.configuration.cell_shapes import read_cell_shape
from cellcal.service.engineering.programs.external.axis_tables import (
    frames_at_zero,
    read_axes,
    read_fixture_values,
)
from cellcal.service.engineering.programs.external.moving_axes import NO_AXES, CellAxes
from cellcal.service.engineering.programs.external.standing_tools import NO_STANDING_TOOLS, StandingTools
from cellcal.service.engineering.programs.project_arms import (
    IdentifiedArm,
    factory_arm,
    identified_arm,
    nominal_arm,
)
from cellcal.service.engineering.programs.project_backup import frames_of_backup, pose_or_backup
from cellcal.service.engineering.programs.project_poses import (
    ProjectError,
    ProjectTool,
    pose_keys,
    pose_of,
    read_number,
    read_numbers,
    read_text,
    refuse_keys,
    sub_table,
)
from cellcal.service.engineering.programs.project_pulses import pulses_per_rad
from cellcal.service.engineering.programs.robot_makes import RobotMake, make_of
from cellcal.service.engineering.programs.starting_postures import (
    NO_STARTING_POSTURES,
    StartingPostures,
    read_starting_postures,
)

FORMAT = 1
SMALLEST_SIGMA = 0.01  # m/rad: nearer to a singularity no point is computed unless a project says so

_ROBOT = {
    "serial", "model", "factory", "parameters", "parameter_store", "parameter_version", "held_out_rms_mm",
    "lower_deg", "upper_deg", "smallest_sigma", "backup", "arm", "pulses_per_rad", "starting_posture_deg",
}  # fmt: skip
_TOP = {
    "format", "name", "master", "robot", "tools", "frames", "unsaid", "fixture", "shapes", "programs",
    "track", "positioner", "standing_tools", "held_work", "starting_postures",
}  # fmt: skip


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
    unsaid_tool: str | None  # holds where a program does not say
    unsaid_frame: str | None
    alignment: Alignment | None
    shapes: CellShape | None
    smallest_sigma: float
    master: Path | None
    programs: tuple[str, ...]  # patterns relative to the project's folder
    pulses_per_rad: Array | None = None  # (n,) with sign, of a controller whose programs hold pulses
    backup: Path | None = None  # folder of the controller's .VA files
    axes: CellAxes = NO_AXES  # external axes
    table_frames: Mapping[str, Array] = field(
        default_factory=dict
    )  # of frames that a table turns: what their pose in the controller is seen from
    standing_tools: StandingTools = NO_STANDING_TOOLS
    starting: StartingPostures = NO_STARTING_POSTURES

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
                make_message("{name} has no user frame {name_2}.", name=self.name, name_2=name),
                remedy=make_message("It has {names}; a project's are [frames.NAME].", names=names),
            )
        return np.eye(4)

    def program_files(self) -> tuple[Path, ...]:
        """Return the programs of this cell, sorted by name."""
        found = {item for pattern in self.programs for item in self.path.parent.glob(pattern)}
        return tuple(sorted(item for item in found if item.is_file()))


def read_project(path: Path) -> Project:
    """Read a project file and everything it names.

    Raises
    ------
    ProjectError
        No such file, or a key that is missing, unknown or of the wrong kind.
    CellError
        A file that the project names cannot be used: parameters of another arm, an alignment of another robot.
    """
    data = _load_toml(path)
    where = str(path)
    refuse_keys(data, _TOP, where)
    if data.get("format") != FORMAT:
        raise ProjectError(
            f"{where}: this is not a project of format {FORMAT}.", remedy="Begin it with format = 1."
        )
    robot = sub_table(data, "robot", where)
    refuse_keys(robot, _ROBOT, f"{where}: [robot]")
    folder = path.parent
    nominal, serial = _read_robot(robot, folder, f"{where}: [robot]")
    factory = read_text(robot, "factory", where)
    controller = nominal if factory is None else factory_arm(_relative_path(folder, factory), nominal)
    controller = _with_limits(controller, robot, f"{where}: [robot]")
    unsaid = sub_table(data, "unsaid", where)
    refuse_keys(unsaid, {"tool", "frame"}, f"{where}: [unsaid]")
    smallest = read_number(robot, "smallest_sigma", where)
    backup, make = frames_of_backup(robot, folder, nominal, where), make_of(nominal)
    frames = _read_frames(sub_table(data, "frames", where), backup.frames, make, where)
    fixture = sub_table(data, "fixture", where)
    axes = read_axes(data, folder, make, tuple(frames), where)
    axes = replace(axes, fixture_at=read_fixture_values(fixture, axes, f"{where}: [fixture]"))
    frames, table_frames = frames_at_zero(frames, axes)
    return Project(
        path=path,
        name=read_text(data, "name", where) or path.stem,
        serial=serial,
        nominal=nominal,
        controller=controller,
        factory_known=factory is not None,
        identified=identified_arm(robot, folder, replace_limits(nominal, controller), serial, where),
        tools=_read_tools(sub_table(data, "tools", where), backup.tools, make, where),
        frames=frames,
        unsaid_tool=read_text(unsaid, "tool", where),
        unsaid_frame=read_text(unsaid, "frame", where),
        alignment=_read_alignment(fixture, folder, serial, where),
        shapes=_read_shapes(sub_table(data, "shapes", where), folder, controller, where),
        smallest_sigma=SMALLEST_SIGMA if smallest is None else smallest,
        master=_read_master(data, folder, where),
        programs=_program_patterns(data, where),
        pulses_per_rad=pulses_per_rad(robot, nominal.axis_count, f"{where}: [robot]"),
        backup=backup.folder,
        axes=axes,
        table_frames=table_frames,
        standing_tools=StandingTools(
            tools=_read_tools(sub_table(data, "standing_tools", where), {}, None, where, "standing_tools"),
            works=_read_tools(sub_table(data, "held_work", where), {}, None, where, "held_work"),
        ),
        starting=read_starting_postures(robot, sub_table(data, "starting_postures", where), nominal, where),
    )


def replace_limits(model: RobotModel, limits: RobotModel) -> RobotModel:
    """Return a model with the joint limits of another one."""
    return replace(model, lower_rad=limits.lower_rad, upper_rad=limits.upper_rad)


def _load_toml(path: Path) -> dict[str, Any]:
    try:
        return parse_toml(read_plain_text(path))
    except (OSError, DocumentError) as broken:
        raise ProjectError(
            f"{path} cannot be read as a project: {broken}", remedy="The README beside the code shows one."
        ) from broken


def _read_robot(robot: Mapping[str, Any], folder: Path, where: str) -> tuple[RobotModel, str]:
    model, serial = read_text(robot, "model", where), read_text(robot, "serial", where)
    if model is None or serial is None:
        raise ProjectError(f"{where}: serial and model are needed")
    arm = read_text(robot, "arm", where)
    if arm is not None:
        return nominal_arm(_relative_path(folder, arm), model), serial
    try:
        return load_model(fixed_reference(model, folder)), serial
    except CalibrationError as refused:
        raise ProjectError(
            f"{where}: no model is called {model!r}: {refused.message}",
            remedy=f"{refused.remedy} Or name a file of another one as arm.",
        ) from refused


def _with_limits(model: RobotModel, robot: Mapping[str, Any], where: str) -> RobotModel:
    def joint_limits(name: str, default: Array) -> Array:
        key = f"{name}_deg"
        return np.deg2rad(read_numbers(robot, key, model.axis_count, where)) if key in robot else default

    return replace(
        model,
        lower_rad=joint_limits("lower", model.lower_rad),
        upper_rad=joint_limits("upper", model.upper_rad),
    )


def _read_tools(
    tables: Mapping[str, Any],
    from_backup: Mapping[str, Array],
    make: RobotMake | None,
    where: str,
    heading: str = "tools",
) -> dict[str, ProjectTool]:
    tools = {name: ProjectTool(pose, pose) for name, pose in from_backup.items()}
    for name in tables:
        place = f"{where}: [{heading}.{name}]"
        table = sub_table(tables, name, place)
        refuse_keys(table, {"entered", "real"}, place)
        entered, real = sub_table(table, "entered", place), sub_table(table, "real", place)
        refuse_keys(entered, pose_keys(), f"{place[:-1]}.entered]")
        refuse_keys(real, {*pose_keys(), "sigma_mm"}, f"{place[:-1]}.real]")
        pose = pose_or_backup(entered, from_backup.get(name), f"{place[:-1]}.entered]")
        if make is not None and name == make.flange:
            _refuse_moved(pose, place, "flange")
        sigma = read_number(real, "sigma_mm", place)
        measured = pose_of(real, f"{place[:-1]}.real]") if real else pose
        tools[name] = ProjectTool(pose, measured, (sigma or 0.0) / 1e3, bool(real))
    return tools


def _read_frames(
    tables: Mapping[str, Any], from_backup: Mapping[str, Array], make: RobotMake | None, where: str
) -> dict[str, Array]:
    frames = dict(from_backup)
    for name in tables:
        place = f"{where}: [frames.{name}]"
        table = sub_table(tables, name, place)
        refuse_keys(table, pose_keys(), place)
        frames[name] = pose_or_backup(table, from_backup.get(name), place)
        if make is not None and name == make.base:
            _refuse_moved(frames[name], place, "base")
    return frames


def _refuse_moved(pose: Array, place: str, what: str) -> None:
    """Refuse another pose of what no controller lets anybody enter."""
    if not np.allclose(pose, np.eye(4), atol=1e-9):
        raise ProjectError(
            f"{place}: on this make of robot, that is the {what} itself, and nowhere else.",
            remedy="Leave the table out, or name the one that was meant.",
        )


def _read_alignment(table: Mapping[str, Any], folder: Path, serial: str, where: str) -> Alignment | None:
    refuse_keys(table, {"alignment", "name", "at"}, f"{where}: [fixture]")
    file, name = read_text(table, "alignment", where), read_text(table, "name", where)
    if file is None:
        return None
    path = _relative_path(folder, file)
    try:
        found = read_alignments(read_plain_text(path))
    except (OSError, DocumentError) as broken:
        raise ProjectError(f"{path} cannot be read: {broken}") from broken
    except CellError as refused:
        raise ProjectError(
            make_message("{path}: {refused_message}", path=path, refused_message=refused.message),
            remedy=refused.remedy,
        ) from refused
    mine = [a for a in found if a.robot_serial == serial and name in (None, a.fixture)]
    if len(mine) != 1:
        there = ", ".join(f"{a.fixture} from robot {a.robot_serial}" for a in found) or "nothing"
        raise ProjectError(
            f"{path} holds {len(mine)} alignments of robot {serial}{f' with {name}' if name else ''}: {there}.",
            remedy="Name the robot's own alignment file, and the fixture under [fixture] name.",
        )
    return mine[0]


def _read_shapes(table: Mapping[str, Any], folder: Path, model: RobotModel, where: str) -> CellShape | None:
    refuse_keys(table, {"file"}, f"{where}: [shapes]")
    file = read_text(table, "file", where)
    return None if file is None else read_cell_shape(_relative_path(folder, file), model)


def _read_master(data: Mapping[str, Any], folder: Path, where: str) -> Path | None:
    table = sub_table(data, "master", where)
    refuse_keys(table, {"project"}, f"{where}: [master]")
    file = read_text(table, "project", where)
    return None if file is None else _relative_path(folder, file)


def _program_patterns(data: Mapping[str, Any], where: str) -> tuple[str, ...]:
    found = data.get("programs", [])
    if not isinstance(found, list) or not all(isinstance(item, str) and item for item in found):
        raise ProjectError(f"{where}: programs is a list of file names or patterns")
    absolute = [item for item in found if Path(item).is_absolute()]
    if absolute:
        raise ProjectError(f"{where}: {absolute[0]} must be relative to the project's folder")
    return tuple(found)


def _relative_path(folder: Path, name: str) -> Path:
    return (folder / name).resolve()
