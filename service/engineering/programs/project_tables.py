"""The tables and keys of a project file, as they are written: millimetres and degrees, paths as texts.

What needs the robot's model, other tables or other files to be judged is checked where it is used.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import AfterValidator, Field, ValidationError

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.message import join_messages, make_message
from cellcal.service.engineering.programs.checked_table import (
    CheckedTable,
    NonNegative,
    Number,
    Numbers,
    Text,
    Triple,
    allow_only,
    table_faults,
)
from cellcal.service.engineering.programs.project_poses import (
    MeasuredPoseTable,
    OrientationTable,
    PoseTable,
    ProjectError,
)

FORMAT = 1

Version = Annotated[int, allow_only("is a whole number, beside parameter_store")]
Patterns = Annotated[
    list[Annotated[str, Field(min_length=1)]], allow_only("is a list of file names or patterns")
]
RoutinePatterns = Annotated[
    list[Annotated[str, Field(min_length=1)]],
    allow_only('is a list of names or patterns of routines, such as ["GLUE_GUN_*"]'),
]
JointNumbers = Annotated[list[int], allow_only("is a list of joints from 1, such as held_joints = [3]")]
FrameNames = Annotated[
    list[Annotated[str, Field(min_length=1)]],
    allow_only('is a list of user frames, such as frames = ["3"]'),
]
ControlGroup = Annotated[
    Literal["RB1", "RB2", "RB3", "RB4", "RB5", "RB6", "RB7", "RB8"],
    allow_only("is the robot as the header of its jobs names it, RB1 to RB8"),
]
Kind = Annotated[
    Literal["prismatic", "revolute"],
    allow_only(
        "is prismatic or revolute", "Write prismatic for an axis that slides, revolute for one that turns."
    ),
]
_COORDINATED = "Write true where the controller computes with this axis, false where it only moves it."
Coordinated = Annotated[bool, allow_only("is neither true nor false", _COORDINATED)]


def _is_sign(value: int) -> int:
    if value not in (1, -1):
        raise ValueError
    return value


Sign = Annotated[int, AfterValidator(_is_sign), allow_only("is 1 or -1")]


class RobotTable(CheckedTable):
    """[robot]: which arm it is, what its controller computes with, and what was identified."""

    serial: Text
    model: Text
    arm: Text | None = None
    factory: Text | None = None
    backup: Text | None = None
    parameters: Text | None = None
    parameter_store: Text | None = None
    parameter_version: Version | None = None
    held_out_rms_mm: NonNegative | None = None
    lower_deg: Numbers | None = None
    upper_deg: Numbers | None = None
    smallest_sigma: NonNegative | None = None
    pulses_per_rad: Numbers | None = None
    control_group: ControlGroup | None = None
    starting_posture_deg: Numbers | None = None
    held_joints: JointNumbers | None = None
    largest_tilt_deg: NonNegative | None = None
    missing_remedies: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("serial", "model"), "A project's robot needs serial and model."
    )


class ToolTable(CheckedTable):
    """[tools.NAME]: a tool as the controller has it, and as it was measured."""

    entered: PoseTable = PoseTable()
    real: MeasuredPoseTable = MeasuredPoseTable()


class MasterTable(CheckedTable):
    """[master]: the project that a clone's programs come from."""

    project: Text | None = None


class UnsaidTable(CheckedTable):
    """[unsaid]: what holds where a program does not say."""

    tool: Text | None = None
    frame: Text | None = None


class FixtureTable(CheckedTable):
    """[fixture]: an alignment, and the values of external axes [mm or deg] while it was measured."""

    alignment: Text | None = None
    name: Text | None = None
    at: dict[str, Number] = Field(default_factory=dict)


class ShapesTable(CheckedTable):
    """[shapes]: a file of what stands in the cell."""

    file: Text | None = None


class AxisMotionTable(OrientationTable):
    """How an external axis moves: its frame, direction and zero."""

    position_mm: Triple | None = None
    direction: Triple | None = None
    zero_mm: Number | None = None
    zero_deg: Number | None = None


class RealAxisTable(AxisMotionTable):
    """An external axis as it was identified."""

    scale: Number | None = None


class AxisTable(AxisMotionTable):
    """[[track]] or [[positioner]]: an external axis as the controller has it."""

    name: Text
    axis: Text
    kind: Kind
    coordinated: Coordinated
    sign: Sign = 1
    lower_mm: Number | None = None
    upper_mm: Number | None = None
    lower_deg: Number | None = None
    upper_deg: Number | None = None
    pulses_per_mm: Number | None = None
    pulses_per_deg: Number | None = None
    frames: FrameNames | None = None
    real: RealAxisTable = RealAxisTable()
    identified: Text | None = None
    missing_remedies: ClassVar[Mapping[str, str]] = {
        "name": 'Give the axis a name of your own, such as name = "rail".',
        "axis": 'Name it as programs do: axis = "E1", "eax_a", "GP2 J1" or "B1".',
        "kind": "Write prismatic for an axis that slides, revolute for one that turns.",
        "coordinated": _COORDINATED,
    }


class ProjectTables(CheckedTable):
    """A whole project file."""

    format: Literal[1]
    name: Text | None = None
    programs: Patterns = Field(default_factory=list)
    programs_without_motion: RoutinePatterns = Field(default_factory=list)
    master: MasterTable = MasterTable()
    robot: RobotTable
    tools: dict[str, ToolTable] = Field(default_factory=dict)
    frames: dict[str, PoseTable] = Field(default_factory=dict)
    unsaid: UnsaidTable = UnsaidTable()
    fixture: FixtureTable = FixtureTable()
    shapes: ShapesTable = ShapesTable()
    track: list[AxisTable] = Field(default_factory=list)
    positioner: list[AxisTable] = Field(default_factory=list)
    standing_tools: dict[str, ToolTable] = Field(default_factory=dict)
    held_work: dict[str, ToolTable] = Field(default_factory=dict)
    starting_postures: dict[str, Numbers] = Field(default_factory=dict)
    missing_remedies: ClassVar[Mapping[str, str]] = {
        "robot": "Begin it with [robot]: serial and model are needed."
    }


TableT = TypeVar("TableT", bound=CheckedTable)


def read_project_tables(path: Path) -> ProjectTables:
    """Read the tables of a project file.

    Raises
    ------
    ProjectError
        No such file, or keys that are missing, unknown or of the wrong kind: all of them at once.
    """
    try:
        data = _load_toml(path)
    except (OSError, DocumentError) as broken:
        raise ProjectError(
            make_message("{path} cannot be read as a project: {broken}", path=path, broken=broken),
            remedy="The README beside the code shows one.",
        ) from broken
    if type(data.get("format")) is not int or data["format"] != FORMAT:
        raise ProjectError(
            make_message("{path}: this is not a project of format {format}.", path=path, format=FORMAT),
            remedy="Begin it with format = 1.",
        )
    return _check_tables(ProjectTables, data, path)


def read_identified_axis(path: Path) -> RealAxisTable:
    """Read a file with the keys of ``[track.real]``.

    Raises
    ------
    ProjectError
        No such file, or keys that are unknown or of the wrong kind: all of them at once.
    """
    try:
        data = _load_toml(path)
    except (OSError, DocumentError) as broken:
        raise ProjectError(
            make_message("{path} cannot be read as an identified axis: {broken}", path=path, broken=broken)
        ) from broken
    return _check_tables(RealAxisTable, data, path)


def _load_toml(path: Path) -> dict[str, Any]:
    return parse_toml(read_plain_text(path))


def _check_tables(model: type[TableT], data: dict[str, Any], path: Path) -> TableT:
    try:
        return model.model_validate(data)
    except ValidationError as error:
        faults = table_faults(error, model, data)
    if len(faults) == 1:
        raise ProjectError(
            make_message("{path}: {fault}", path=path, fault=faults[0].text), remedy=faults[0].remedy
        )
    lines = [join_messages(" ", filter(None, (fault.text, fault.remedy))) for fault in faults]
    raise ProjectError(
        make_message("{path} cannot be used:\n  {faults}", path=path, faults=join_messages("\n  ", lines)),
        remedy="\nCorrect the file and try again.",
    )
