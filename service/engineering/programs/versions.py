"""Which cell runs which version of which program: records beside the clones, compared with what is there now.

A controller that saves a program writes dates and sizes of its own into it. So a clone is known by its points too:
the same points in another text are the clone, saved again, and that is said.
"""

import datetime
import hashlib
import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import join_messages
from cellcal.drivers.program_registry import read_program
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.files import FilesError, RefusedProgram, read_bytes, whole_file
from cellcal.service.engineering.programs.folders import paths_below
from cellcal.service.engineering.programs.project import Project, read_project
from cellcal.service.engineering.programs.result import LEFT, ProgramResult
from cellcal.service.times import read_time

RECORD = "cellcal_clones.json"
_FORMAT = 1


class CloneState(StrEnum):
    """The state of a master's program in a cell."""

    CURRENT = "current"
    OLD = "old version"  # the master's program has changed since
    OUTDATED = "cell has changed"  # a calibration, tool, frame or alignment of either cell has
    EDITED = "points edited"  # in the cell
    UNKNOWN = "no record"  # what it was made from is unknown
    MISSING = "not there"


@dataclass(frozen=True, slots=True)
class CloneRecord:
    """One clone as it was written."""

    file: str
    sha256: str
    points_sha256: str
    source: str
    source_sha256: str
    master: str
    master_cell_sha256: str  # of all that the clone depends on in the master's cell
    cell: str
    cell_sha256: str
    points: int
    left: int
    made_at: str  # ISO 8601, UTC
    made_with: str


@dataclass(frozen=True, slots=True)
class ProgramInCell:
    """A master's program in one cell."""

    cell: str
    program: str
    state: CloneState
    master_sha256: str  # of the program as it is in the master's cell
    made_from_sha256: str  # of the program that the clone was made from; empty where unknown
    made_at: str
    note: str

    @property
    def is_current(self) -> bool:
        """Return whether this cell runs what it should."""
        return self.state is CloneState.CURRENT


class CloneRecorder:
    """Records clones as they are written."""

    def __init__(self, master: Project, clone: Project) -> None:
        self._master, self._clone = master.name, clone.name
        self._cells = cell_sha256(master), cell_sha256(clone)
        self._made_with = installed_version("cellcal")  # reads a file each time it is asked

    def made_of(self, source: str, written: str, result: ProgramResult) -> CloneRecord:
        """Return the record of a clone that was just written."""
        return CloneRecord(
            file=Path(written).name,
            sha256=_sha256_hex(result.after.to_bytes()),
            points_sha256=points_sha256(result.after),
            source=Path(source).name,
            source_sha256=_sha256_hex(result.before.to_bytes()),
            master=self._master,
            master_cell_sha256=self._cells[0],
            cell=self._clone,
            cell_sha256=self._cells[1],
            points=len(result.status),
            left=Counter(result.status)[LEFT],
            made_at=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            made_with=self._made_with,
        )

    def write_records(self, made: Iterable[tuple[str, CloneRecord]]) -> None:
        """Write the records beside their clones."""
        by_folder: defaultdict[Path, list[CloneRecord]] = defaultdict(list)
        for written, one in made:
            by_folder[Path(written).parent].append(one)
        for folder, some in by_folder.items():
            merge_records(folder, some)


def merge_records(folder: Path, made: Sequence[CloneRecord]) -> None:
    """Add records to those of a folder, in place of older ones of the same file."""
    path = folder / RECORD
    by_file = {one.file.casefold(): one for one in (_read_records(path) if path.is_file() else ())}
    by_file |= {one.file.casefold(): one for one in made}
    document = {"format": _FORMAT, "clones": [asdict(by_file[name]) for name in sorted(by_file)]}
    with whole_file(path, replace=True) as file:
        file.write((json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode())


def find_projects(named: Sequence[str]) -> list[Path]:
    """Return the projects that files and folders name; of a folder those that name a master.

    Raises
    ------
    FilesError
        None is named, or a folder holds none.
    """
    if not named:
        raise FilesError("No project was named.", remedy="Name projects of clones, or a folder of them.")
    found: list[Path] = []
    for name in named:
        path = Path(name)
        inside = [each for each in paths_below(path) if each.suffix == ".toml"] if path.is_dir() else [path]
        mine = [one for one in inside if not path.is_dir() or _names_a_master(one)]
        if not mine:
            raise FilesError(
                f"{path}: no project in this folder names a master.", remedy="Name project files."
            )
        found += [one for one in mine if one not in found]
    return found


def _names_a_master(path: Path) -> bool:
    try:
        return "master" in parse_toml(read_plain_text(path))
    except (OSError, ValueError):
        return False


def status_of(projects: Iterable[Path]) -> tuple[list[ProgramInCell], list[RefusedProgram]]:
    """Compare the cells of some clones' projects with their masters, and say which projects cannot be used."""
    found: list[ProgramInCell] = []
    refused: list[RefusedProgram] = []
    for path in projects:
        try:
            found += _of_project(path)
        except CellError as error:
            refused.append(RefusedProgram.from_error(path, error))
    return found, refused


def points_sha256(program: ProgramFile) -> str:
    """Return a hash of a program's points: their names, coordinates, configurations, frames and tools."""
    positions = program.positions
    words = [
        positions.names,
        positions.kinds,
        positions.user_frames,
        positions.tools,
        positions.configurations,
    ]
    digest = hashlib.sha256(json.dumps(words).encode())
    for figures in (positions.frame_tip, positions.joints, positions.external):
        digest.update(np.ascontiguousarray(figures + 0.0, dtype="<f8").tobytes())
    return digest.hexdigest()


def cell_sha256(project: Project) -> str:
    """Return a hash of everything in a cell that its clones depend on: arm, tools, frames, alignment."""
    words: list[Any] = [
        project.serial,
        None if project.identified is None else project.identified.sha256,
        repr(project.alignment),
        project.default_tool,
        project.default_frame,
        sorted(project.tools),
        sorted(project.frames),
    ]
    digest = hashlib.sha256(json.dumps(words).encode())
    matrices = [project.controller.placements, project.controller.joint_coupling]
    matrices += [m for name in sorted(project.tools) for m in _project_matrices(project, name)]
    matrices += [project.frames[name] for name in sorted(project.frames)]
    for matrix in matrices:
        digest.update(np.ascontiguousarray(matrix + 0.0, dtype="<f8").tobytes())
    return digest.hexdigest()


def _project_matrices(project: Project, tool: str) -> list[Any]:
    return [project.tools[tool].entered, project.tools[tool].real]


def _of_project(path: Path) -> list[ProgramInCell]:
    clone = read_project(path)
    if clone.master is None:
        raise FilesError(
            f"{path}: this is a master's project, and a master is not a clone.",
            remedy="Name the projects of its clones.",
        )
    master = read_project(clone.master)
    programs = master.program_files()
    if not programs:
        raise FilesError(
            f"{path}: its master {clone.master} names no programs.",
            remedy='Write programs = ["programs/*.ls"] or the like into it.',
        )
    records = [one for file in sorted(path.parent.rglob(RECORD)) for one in _read_records(file)]
    here = {file.name.casefold(): file for file in clone.program_files()}
    cells = cell_sha256(master), cell_sha256(clone)
    return [_compare_clone(file, here.get(file.name.casefold()), clone, records, cells) for file in programs]


def _compare_clone(
    source: Path, here: Path | None, clone: Project, records: Sequence[CloneRecord], cells: tuple[str, str]
) -> ProgramInCell:
    master_sha256 = _sha256_hex(read_bytes(source))
    if here is None:
        return ProgramInCell(clone.name, source.name, CloneState.MISSING, master_sha256, "", "", "")
    data = read_bytes(here)
    points = points_sha256(read_program(str(here), data))
    own = [one for one in records if one.file.casefold() == here.name.casefold() and one.cell == clone.name]
    if not own:
        return ProgramInCell(clone.name, source.name, CloneState.UNKNOWN, master_sha256, "", "", "")
    made = max(
        own, key=lambda one: (one.sha256 == _sha256_hex(data), one.points_sha256 == points, one.made_at)
    )
    state = _clone_state(made, points, master_sha256, cells)
    return ProgramInCell(
        clone.name,
        source.name,
        state,
        master_sha256,
        made.source_sha256,
        made.made_at,
        _clone_note(made, resaved=state is not CloneState.EDITED and made.sha256 != _sha256_hex(data)),
    )


def _clone_state(made: CloneRecord, points: str, master_sha256: str, cells: tuple[str, str]) -> CloneState:
    if made.points_sha256 != points:
        return CloneState.EDITED
    if made.source_sha256 != master_sha256:
        return CloneState.OLD
    return CloneState.CURRENT if (made.master_cell_sha256, made.cell_sha256) == cells else CloneState.OUTDATED


def _clone_note(made: CloneRecord, *, resaved: bool) -> str:
    remarks = (
        ["its points are the clone's, its text is not: saved again, or edited elsewhere"] if resaved else []
    )
    if made.left:
        remarks.append(f"{made.left} of {made.points} points were left as in the master")
    return join_messages("; ", remarks)


def _read_records(path: Path) -> list[CloneRecord]:
    try:
        document = parse_json(read_plain_text(path))
        if document["format"] != _FORMAT:
            raise ValueError(f"format {document['format']}")
        names = {field.name for field in fields(CloneRecord)}
        found = [CloneRecord(**{name: one[name] for name in names}) for one in document["clones"]]
        for one in found:
            read_time(one.made_at)
    except (OSError, ValueError, KeyError, TypeError) as broken:
        raise FilesError(
            f"{path} is no record of clones: {broken!r}.",
            remedy="Clone the programs again, or remove it: then what they were made from is unknown.",
        ) from broken
    return found


def _sha256_hex(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
