"""What programs hold, read and never changed: points, frames, tools, configurations, reach, expected errors."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypedDict

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.geometry import Array
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.batches import ReadProgram, process_batch, read_batches
from cellcal.service.engineering.programs.cell_of_program import frame_of, tool_of
from cellcal.service.engineering.programs.files import (
    FilesError,
    FoundPrograms,
    OutputFolder,
    ProgramSource,
    RefusedProgram,
    find_programs,
)
from cellcal.service.engineering.programs.project import SMALLEST_SIGMA, Project, read_project
from cellcal.service.engineering.programs.reach import ProgramReach, reach_of
from cellcal.service.exit_codes import ExitCode

_DECIMALS = 6


class PointRow(TypedDict):
    """A point of a program for tables and JSON, in millimetres and degrees; None where it is not known."""

    point: str
    line: int
    kind: str
    user_frame: str | None
    tool: str | None
    configuration: str | None
    position_mm: list[float | None] | None
    joints_deg: list[float | None] | None
    reach: str | None
    miss_mm: float | None
    known_within_mm: float | None


@dataclass(frozen=True, slots=True)
class InspectionRequest:
    """The programs to inspect, and the project to compare them with."""

    files: Sequence[str]
    project: Path | None = None
    robot: str | None = None
    roundtrip: Path | None = None


@dataclass(frozen=True, eq=False)
class InspectedProgram:
    """One program; ``reach`` and ``identical`` are None where not requested."""

    source: ProgramSource
    program: ProgramFile
    known_tools: dict[str | None, bool]  # by name: whether the cell or the file knows it
    known_frames: dict[str | None, bool]
    reach: ProgramReach | None
    identical: bool | None  # printed as it was read

    @property
    def kind_counts(self) -> dict[str, int]:
        """Return how many positions are of which kind."""
        return dict(Counter(self.program.positions.kinds))

    @property
    def out_of_reach(self) -> int:
        """Return how many points the arm cannot go to, of those that can be computed."""
        return 0 if self.reach is None else int(self.reach.failed.sum())

    def as_object(self) -> dict[str, object]:
        """Return the program and all its points for JSON, in millimetres and degrees."""
        positions = self.program.positions
        return {
            "file": str(self.source.path),
            "program": self.program.name,
            "brand": self.program.brand,
            "point_count": len(positions),
            "kinds": self.kind_counts,
            "tools": _names_to_json(self.known_tools),
            "user_frames": _names_to_json(self.known_frames),
            "out_of_reach": None if self.reach is None else self.out_of_reach,
            "identical": self.identical,
            "remarks": [{"line": r.line, "code": r.code, "text": r.text} for r in self.program.remarks],
            "points": list(self.iter_points()),
        }

    def iter_points(self) -> Iterator[PointRow]:
        """Yield every point."""
        positions, reach = self.program.positions, self.reach
        places = _rounded_rows(positions.frame_tip[:, :3, 3] * 1e3)
        shown = np.full(positions.joints.shape[1], np.degrees(1.0))
        if reach is not None:
            reach_joints = reach.shown_per_joint[: len(shown)]
            shown[: len(reach_joints)] = reach_joints
        joints = _rounded_rows(positions.joints * shown) if positions.joints.size else [[]] * len(positions)
        for i, name in enumerate(positions.names):
            yield {
                "point": name,
                "line": int(positions.lines[i]),
                "kind": positions.kinds[i],
                "user_frame": positions.user_frames[i],
                "tool": positions.tools[i],
                "configuration": positions.configurations[i],
                "position_mm": places[i] if None not in places[i] else None,
                "joints_deg": joints[i] if joints[i] and None not in joints[i] else None,
                "reach": None if reach is None else (reach.why[i] or "reached"),
                "miss_mm": None if reach is None else _to_mm(reach.miss_m[i]),
                "known_within_mm": None if reach is None else _to_mm(reach.expected_m[i]),
            }


@dataclass
class InspectionTotals:
    """The totals of an inspection."""

    programs: int = 0
    points: int = 0
    out_of_reach: int = 0
    not_identical: int = 0
    refused: list[RefusedProgram] = field(default_factory=list)

    @property
    def exit_code(self) -> ExitCode:
        """Return what the shell gets to know."""
        if self.refused or self.not_identical:
            return ExitCode.FILES_REFUSED
        return ExitCode.REFUSED if self.out_of_reach else ExitCode.PASS


def sources_of(request: InspectionRequest) -> tuple[FoundPrograms, Project | None]:
    """Return the programs that are asked for, and the cell that they are for.

    Raises
    ------
    CellError
        A project that cannot be read, no such robot, or nothing named at all.
    """
    if request.project is not None and request.robot is not None:
        raise FilesError("--project names the robot already.", remedy="Leave --robot out.")
    cell = _read_cell(request)
    named = request.files
    if not named and request.project is not None and cell is not None:
        named = find_named_programs(cell)
    return find_programs(named, out=request.roundtrip), cell


def find_named_programs(project: Project) -> tuple[str, ...]:
    """Return the programs that a project names.

    Raises
    ------
    FilesError
        It names none that is there.
    """
    named = tuple(str(path) for path in project.program_files())
    if not named:
        raise FilesError(
            f"{project.path} names no programs that are there.",
            remedy='Name files on the command line, or write programs = ["programs/*.ls"] into the project.',
        )
    return named


def inspect_programs(
    found: FoundPrograms,
    cell: Project | None,
    roundtrip: Path | None,
    tell: Callable[[InspectedProgram], None],
) -> InspectionTotals:
    """Inspect programs one after another; each is told and let go."""
    totals = InspectionTotals(refused=list(found.refused))
    place = None if roundtrip is None else OutputFolder(roundtrip, found.sources)
    for some in read_batches(found.sources, lambda _: None, totals.refused):
        for read, reach in process_batch(
            some, lambda programs: _program_reaches(programs, cell), totals.refused
        ):
            try:
                inspected = _inspect_program(read, reach, cell, place)
            except CellError as error:
                totals.refused.append(RefusedProgram.from_error(read.source.path, error))
                continue
            totals.programs += 1
            totals.points += len(inspected.program.positions)
            totals.out_of_reach += inspected.out_of_reach
            totals.not_identical += inspected.identical is False
            tell(inspected)
    return totals


def _program_reaches(programs: Sequence[ProgramFile], cell: Project | None) -> Sequence[ProgramReach | None]:
    return [None] * len(programs) if cell is None else reach_of(programs, cell)


def _inspect_program(
    read: ReadProgram, reach: ProgramReach | None, cell: Project | None, place: OutputFolder | None
) -> InspectedProgram:
    program, identical = read.program, None
    if place is not None:
        printed = program.to_bytes()
        place.write_program(read.source, printed)
        identical = printed == read.data
    positions = program.positions
    return InspectedProgram(
        read.source,
        program,
        {name: _knows_tool(cell, program, name) for name in dict.fromkeys(positions.tools)},
        {name: _knows_frame(cell, program, name) for name in dict.fromkeys(positions.user_frames)},
        reach,
        identical,
    )


def _knows_tool(cell: Project | None, program: ProgramFile, name: str | None) -> bool:
    if cell is None:
        return name is not None and (
            name in program.frames.flange_tip or name in program.frames.cell_flange_tip
        )
    return tool_of(cell, program, name) is not None


def _knows_frame(cell: Project | None, program: ProgramFile, name: str | None) -> bool:
    if cell is None:
        return name is not None and (
            name in program.frames.base_frame or name in program.frames.cell_base_frame
        )
    return frame_of(cell, program, name) is not None


def _read_cell(request: InspectionRequest) -> Project | None:
    if request.project is not None:
        return read_project(request.project)
    if request.robot is None:
        return None
    try:
        model = load_model(request.robot)
    except CalibrationError as refused:
        raise FilesError(refused.message, remedy=refused.remedy) from refused
    return Project(
        path=Path(f"--robot {model.name}"),
        name=model.title,
        serial="",
        nominal=model,
        controller=model,
        factory_known=False,
        identified=None,
        tools={},
        frames={},
        default_tool=None,
        default_frame=None,
        alignment=None,
        shapes=None,
        smallest_sigma=SMALLEST_SIGMA,
        master=None,
        programs=(),
    )


def _names_to_json(known_by_name: dict[str | None, bool]) -> list[dict[str, object]]:
    return [{"name": name, "known": there} for name, there in known_by_name.items()]


def _rounded_rows(figures: Array) -> list[list[float | None]]:
    rows = (np.round(figures, _DECIMALS) + 0.0).tolist()
    return [[value if np.isfinite(value) else None for value in row] for row in rows]


def _to_mm(value_m: float) -> float | None:
    return round(float(value_m) * 1e3, _DECIMALS) if np.isfinite(value_m) else None
