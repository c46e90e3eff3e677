"""A project: one cell as its programs see it, and as it really is. A clone's project names its master's.

The file's keys, with an example, stand in this room's README. Everything that it names is read once, checked, and
kept as plain values in SI.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.arm.mounting import is_mounted_model
from cellcal.calibration.arm.robot_models import model_names
from cellcal.calibration.compensation.pose_gap import Arm
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.errors import CellError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.parameters import ArmState
from cellcal.calibration.motion.collision import CellShape
from cellcal.calibration.points.alignment import Alignment, read_alignments
from cellcal.service.configuration.cell_shapes import read_cell_shape
from cellcal.service.engineering.programs.makes import Make, make_of
from cellcal.service.engineering.programs.project_arms import (
    IdentifiedArm,
    factory_arm,
    identified_arm,
    nominal_arm,
)
from cellcal.service.engineering.programs.project_backup import kept_by_controller, pose_as_kept
from cellcal.service.engineering.programs.project_poses import (
    ProjectError,
    number,
    numbers,
    pose_keys,
    pose_of,
    refuse_keys,
    sub_table,
    word,
)
from cellcal.service.engineering.programs.project_pulses import pulses_per_rad

FORMAT = 1
SMALLEST_SIGMA = 0.01  # m/rad: nearer to a singularity no point is computed unless a project says so

_ROBOT = {
    "serial", "model", "factory", "parameters", "parameter_store", "parameter_version", "held_out_rms_mm",
    "lower_deg", "upper_deg", "smallest_sigma", "backup", "arm", "pulses_per_rad",
}  # fmt: skip
_TOP = {"format", "name", "master", "robot", "tools", "frames", "unsaid", "fixture", "shapes", "programs"}


@dataclass(frozen=True, eq=False)
class Tool:
    """A tool as the controller has it, and as it really is."""

    entered: Array  # (4, 4) flange_tip in the controller
    real: Array  # (4, 4), the same where nobody measured it
    sigma_m: float = 0.0  # of one coordinate of the real tip
    measured: bool = False


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
    tools: Mapping[str, Tool]
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

    @property
    def state(self) -> ArmState | None:
        """Return the identified arm, or None where the project names no parameters."""
        return None if self.identified is None else self.identified.state

    def real_arm(self, flange_tip: Array) -> Arm:
        """Return the real arm with a tip: as identified, or as the controller believes where nobody measured it."""
        if self.identified is None:
            return Arm(self.controller, flange_tip)
        return Arm.of_state(replace(self.identified.state, flange_tool=flange_tip))

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
            known = ", ".join(self.frames) or "none"
            raise ProjectError(
                f"{self.name} has no user frame {name}.",
                remedy=f"It has {known}; a project's are [frames.NAME].",
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
    data = _loaded(path)
    where = str(path)
    refuse_keys(data, _TOP, where)
    if data.get("format") != FORMAT:
        raise ProjectError(
            f"{where}: this is not a project of format {FORMAT}.", remedy="Begin it with format = 1."
        )
    robot = sub_table(data, "robot", where)
    refuse_keys(robot, _ROBOT, f"{where}: [robot]")
    folder = path.parent
    nominal, serial = _robot(robot, folder, f"{where}: [robot]")
    factory = word(robot, "factory", where)
    controller = nominal if factory is None else factory_arm(_beside(folder, factory), nominal)
    controller = _limited(controller, robot, f"{where}: [robot]")
    unsaid = sub_table(data, "unsaid", where)
    refuse_keys(unsaid, {"tool", "frame"}, f"{where}: [unsaid]")
    smallest = number(robot, "smallest_sigma", where)
    kept, make = kept_by_controller(robot, folder, nominal, where), make_of(nominal)
    return Project(
        path=path,
        name=word(data, "name", where) or path.stem,
        serial=serial,
        nominal=nominal,
        controller=controller,
        factory_known=factory is not None,
        identified=identified_arm(robot, folder, replace_limits(nominal, controller), serial, where),
        tools=_tools(sub_table(data, "tools", where), kept.tools, make, where),
        frames=_frames(sub_table(data, "frames", where), kept.frames, make, where),
        unsaid_tool=word(unsaid, "tool", where),
        unsaid_frame=word(unsaid, "frame", where),
        alignment=_alignment(sub_table(data, "fixture", where), folder, serial, where),
        shapes=_shapes(sub_table(data, "shapes", where), folder, controller, where),
        smallest_sigma=SMALLEST_SIGMA if smallest is None else smallest,
        master=_master(data, folder, where),
        programs=_patterns(data, where),
        pulses_per_rad=pulses_per_rad(robot, nominal.axes, f"{where}: [robot]"),
        backup=kept.folder,
    )


def replace_limits(model: RobotModel, limits: RobotModel) -> RobotModel:
    """Return a model with the joint limits of another one."""
    return replace(model, lower_rad=limits.lower_rad, upper_rad=limits.upper_rad)


def _loaded(path: Path) -> dict[str, Any]:
    try:
        return parse_toml(read_plain_text(path))
    except (OSError, DocumentError) as broken:
        raise ProjectError(
            f"{path} cannot be read as a project: {broken}", remedy="The README beside the code shows one."
        ) from broken


def _robot(robot: Mapping[str, Any], folder: Path, where: str) -> tuple[RobotModel, str]:
    model, serial = word(robot, "model", where), word(robot, "serial", where)
    if model is None or serial is None:
        raise ProjectError(f"{where}: serial and model are needed")
    arm = word(robot, "arm", where)
    if arm is not None:
        return nominal_arm(_beside(folder, arm), model), serial
    if not is_mounted_model(model, model_names()):
        raise ProjectError(
            f"{where}: no model is called {model!r}.",
            remedy=f"Known: {', '.join(model_names())}; name a file of another one as arm.",
        )
    return load_model(model), serial


def _limited(model: RobotModel, robot: Mapping[str, Any], where: str) -> RobotModel:
    def side(name: str, given: Array) -> Array:
        key = f"{name}_deg"
        return np.deg2rad(numbers(robot, key, model.axes, where)) if key in robot else given

    return replace(model, lower_rad=side("lower", model.lower_rad), upper_rad=side("upper", model.upper_rad))


def _tools(
    tables: Mapping[str, Any], kept: Mapping[str, Array], make: Make | None, where: str
) -> dict[str, Tool]:
    tools = {name: Tool(pose, pose) for name, pose in kept.items()}
    for name in tables:
        place = f"{where}: [tools.{name}]"
        table = sub_table(tables, name, place)
        refuse_keys(table, {"entered", "real"}, place)
        entered, real = sub_table(table, "entered", place), sub_table(table, "real", place)
        refuse_keys(entered, pose_keys(), f"{place[:-1]}.entered]")
        refuse_keys(real, {*pose_keys(), "sigma_mm"}, f"{place[:-1]}.real]")
        pose = pose_as_kept(entered, kept.get(name), f"{place[:-1]}.entered]")
        if make is not None and name == make.flange:
            _refuse_moved(pose, place, "flange")
        sigma = number(real, "sigma_mm", place)
        measured = pose_of(real, f"{place[:-1]}.real]") if real else pose
        tools[name] = Tool(pose, measured, (sigma or 0.0) / 1e3, bool(real))
    return tools


def _frames(
    tables: Mapping[str, Any], kept: Mapping[str, Array], make: Make | None, where: str
) -> dict[str, Array]:
    frames = dict(kept)
    for name in tables:
        place = f"{where}: [frames.{name}]"
        table = sub_table(tables, name, place)
        refuse_keys(table, pose_keys(), place)
        frames[name] = pose_as_kept(table, kept.get(name), place)
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


def _alignment(table: Mapping[str, Any], folder: Path, serial: str, where: str) -> Alignment | None:
    refuse_keys(table, {"alignment", "name"}, f"{where}: [fixture]")
    file, name = word(table, "alignment", where), word(table, "name", where)
    if file is None:
        return None
    path = _beside(folder, file)
    try:
        found = read_alignments(read_plain_text(path))
    except (OSError, DocumentError) as broken:
        raise ProjectError(f"{path} cannot be read: {broken}") from broken
    except CellError as refused:
        raise ProjectError(f"{path}: {refused.message}", remedy=refused.remedy) from refused
    mine = [a for a in found if a.robot_serial == serial and name in (None, a.fixture)]
    if len(mine) != 1:
        there = ", ".join(f"{a.fixture} from robot {a.robot_serial}" for a in found) or "nothing"
        raise ProjectError(
            f"{path} holds {len(mine)} alignments of robot {serial}{f' with {name}' if name else ''}: {there}.",
            remedy="Name the robot's own alignment file, and the fixture under [fixture] name.",
        )
    return mine[0]


def _shapes(table: Mapping[str, Any], folder: Path, model: RobotModel, where: str) -> CellShape | None:
    refuse_keys(table, {"file"}, f"{where}: [shapes]")
    file = word(table, "file", where)
    return None if file is None else read_cell_shape(_beside(folder, file), model)


def _master(data: Mapping[str, Any], folder: Path, where: str) -> Path | None:
    table = sub_table(data, "master", where)
    refuse_keys(table, {"project"}, f"{where}: [master]")
    file = word(table, "project", where)
    return None if file is None else _beside(folder, file)


def _patterns(data: Mapping[str, Any], where: str) -> tuple[str, ...]:
    found = data.get("programs", [])
    if not isinstance(found, list) or not all(isinstance(item, str) and item for item in found):
        raise ProjectError(f"{where}: programs is a list of file names or patterns")
    absolute = [item for item in found if Path(item).is_absolute()]
    if absolute:
        raise ProjectError(f"{where}: {absolute[0]} must be relative to the project's folder")
    return tuple(found)


def _beside(folder: Path, name: str) -> Path:
    return (folder / name).resolve()
