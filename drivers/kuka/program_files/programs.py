"""KUKA programs and data lists as `ProgramFile`: lossless, span by span."""

import re
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import PurePath
from typing import Self

from cellcal.calibration.geometry import Pose
from cellcal.drivers.kuka.program_files.cell_folders import cells_of, program_folder
from cellcal.drivers.kuka.program_files.collected_positions import KrlPositions
from cellcal.drivers.kuka.program_files.configuration import KukaConfigurations
from cellcal.drivers.kuka.program_files.data_list import declared_names, read_data_list
from cellcal.drivers.kuka.program_files.empty_points import empty_points_of, places_without_values
from cellcal.drivers.kuka.program_files.frame_data import (
    TaughtFrames,
    data_set_by_programs,
    marks_of_set_data,
    uses_of_own_data,
    with_frame_data,
    without_external_tools,
    without_mixed_work,
)
from cellcal.drivers.kuka.program_files.frame_uses import WRITTEN_OUT
from cellcal.drivers.kuka.program_files.imports import imports_of, remark_imports
from cellcal.drivers.kuka.program_files.krl_called import NAMES
from cellcal.drivers.kuka.program_files.krl_program import read_program
from cellcal.drivers.kuka.program_files.machine_data import (
    CARRIED,
    ROOT,
    ROOT_SET,
    SET,
    carried_bases,
    root_among,
)
from cellcal.drivers.kuka.program_files.measured_points import measured_shifts
from cellcal.drivers.kuka.program_files.passed_points import (
    calls_of_file,
    copies_of_file,
    explain_passed_table,
    routine_targets_of,
)
from cellcal.drivers.kuka.program_files.point_edits import PointEdits
from cellcal.drivers.kuka.program_files.point_uses import explain_set_table
from cellcal.drivers.kuka.program_files.standing_bases import standing_rows, with_standing_bases
from cellcal.drivers.kuka.program_files.taught_entries import (
    NO_ENTRIES,
    EntryMarks,
    marks_of_entries,
    with_set_entries,
    without_entries_set_beside,
    without_set_data,
)
from cellcal.drivers.kuka.program_files.written_numbers import (
    WrittenPoints,
)
from cellcal.drivers.programs.barred import COMPUTED, TURNED_BASE
from cellcal.drivers.programs.brands import ProgramBrand
from cellcal.drivers.programs.columns import gets_only_a_pose, part_of
from cellcal.drivers.programs.conditions import ConditionalBar, ProjectNeed
from cellcal.drivers.programs.declared_poses import Poses, with_declared
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.file_declarations import ExternalUses, FileDeclarations, MoveFrames
from cellcal.drivers.programs.missing_ends import refuse_missing_end
from cellcal.drivers.programs.positions import (
    CARTESIAN,
    PositionChange,
    Positions,
    ProgramFrames,
    Remark,
)
from cellcal.drivers.programs.settled_positions import copies_with_other_tools, settle_positions
from cellcal.drivers.programs.shifts import ProgramShift
from cellcal.drivers.programs.spans import (
    Edit,
    ProgramText,
    checked_rows,
)
from cellcal.drivers.programs.world_frames import seen_from_base, standing_remark

_DEFINED = re.compile(
    r"^[ \t]*+(?:GLOBAL[ \t]++)?+(?:DEFDAT|DEFFCT[ \t]++\w++|DEF)[ \t]++(\w++)", re.IGNORECASE | re.MULTILINE
)
_ENDED = re.compile(r"^[ \t]*+END(?:DAT|FCT)?\b", re.IGNORECASE | re.MULTILINE)
_DEFINED_BYTES = re.compile(
    rb"^(?:\xef\xbb\xbf)?[ \t]*+(?:GLOBAL[ \t]++)?+(?:DEFDAT|DEFFCT|DEF)\b|^&[A-Z]", re.I | re.M
)
_TABLES = re.compile(rb"\b(?:TOOL|BASE)_DATA[ \t]*+\[|\$ROBROOT\b", re.IGNORECASE)
Spans = dict[str, tuple[int, int]]
_LOOKED_AT = 1 << 16  # bytes in which a program names itself


@dataclass(frozen=True, eq=False)
class KukaFile:
    """One .src, .sub or .dat file."""

    source: ProgramText
    name: str
    positions: Positions
    remarks: tuple[Remark, ...]
    frames: ProgramFrames
    written: WrittenPoints
    fixed: dict[int, str]  # positions that take no change, and why
    declarations: FileDeclarations  # what counts for other files
    keys: tuple[str, ...]  # (N,) the positions' names as other files write them
    taught: frozenset[int]  # rows with frame data of their own
    routines: Mapping[int, str]  # rows written into moves, and their routine
    frame_data: Mapping[str, TaughtFrames]  # of a data list
    empty: Mapping[str, frozenset[MoveFrames]]  # a program's own points without a value
    taken: Mapping[str, Set[str]]  # as `EntryMarks` says
    brand: str = "kuka"

    def to_bytes(self) -> bytes:
        """Return the file as it stands."""
        return self.source.data

    def with_changes(self, change: PositionChange) -> Self:
        """Return the file with new coordinates; see `drivers.programs.positions.ProgramFile`."""
        rows = checked_rows(self.source.name, self.positions, change)
        in_columns = gets_only_a_pose(rows, change, self.positions) & (self.written.widths[rows, 0] > 0)
        edits: list[Edit] = []
        if change.frame_tip is not None:
            some = rows[in_columns]
            edits += self.written.make_edits(
                some, self.positions.frame_tip[some], change.frame_tip[in_columns]
            )
        if not in_columns.all():
            point_edits = PointEdits(self.source, self.positions, self.written, self.fixed)
            edits += point_edits.make_edits(rows[~in_columns], part_of(change, ~in_columns))
        return type(self).from_bytes(self.source.name, self.source.apply_edits(edits))

    @classmethod
    def from_bytes(cls, name: str, data: bytes) -> Self:
        """Read a file.

        Raises
        ------
        ProgramFileError
            A position is not understood, or the file is none of these.
        """
        source = ProgramText(name, data)
        if b"\n" not in data and b"\r" in data:
            raise ProgramFileError(name, "its lines do not end as KUKA's do.", remedy="Save it with CR LF.")
        refuse_missing_end(source, _DEFINED, _ENDED)
        reader: Callable[[ProgramText], _Read] = _read_data if _is_data_list(name) else _read_src
        found, frames, summary = reader(source)
        rows = found.counted_rows()
        own = _DEFINED.search(source.text, 0, _LOOKED_AT)
        module = own[1] if own else PurePath(name).stem
        written = found.written_numbers(rows)
        taught = frozenset(k for k, row in enumerate(rows.tolist()) if row in summary.taught)
        return cls(
            source=source,
            name=module,
            declarations=_with_path(PurePath(name), summary.declarations, summary.set_data, summary.entries),
            keys=tuple(found.names[row].upper() for row in rows.tolist()),
            taught=taught,
            routines={
                k: summary.routines[row] for k, row in enumerate(rows.tolist()) if row in summary.routines
            },
            frame_data=summary.frame_data,
            empty=summary.empty,
            taken=summary.entries.taken,
            positions=with_standing_bases(found.to_positions(rows, written, summary.shifts), taught),
            remarks=tuple(sorted(found.remarks, key=lambda remark: remark.line)),
            frames=frames,
            written=written,
            fixed={k: found.fixed[row] for k, row in enumerate(rows.tolist()) if row in found.fixed},
        )

    def with_external_uses(self, external_uses: ExternalUses) -> Self:
        """Return the file with what others say of its positions."""
        set_data = data_set_by_programs(external_uses, self.frame_data)
        taught_keys = {self.keys[row] for row in self.taught}
        standing = standing_rows(self.positions, external_uses, self.keys)
        external_uses = with_frame_data(external_uses, self.frame_data, set_data, taught_keys)
        used = frozenset(self.routines) | {
            k
            for k, (tool, base) in enumerate(
                zip(self.positions.tools, self.positions.user_frames, strict=True)
            )
            if tool or base
        }
        positions, remarks = settle_positions(
            self.positions,
            external_uses,
            self.keys,
            used=used - self.taught,
            taught=self.taught,
            routines=self.routines,
        )
        folders = cells_of(external_uses.file)
        positions = with_set_entries(positions, self.keys, self._own_taught(), external_uses, folders)
        positions = without_entries_set_beside(positions, self.taken, external_uses, folders)
        positions = without_external_tools(positions, self.taught, external_uses)
        positions = _without_set_tables(positions, external_uses)
        positions = without_mixed_work(positions, self.keys, external_uses)
        positions = without_set_data(positions, self.keys, self.taught, set_data)
        positions = _with_carried_bases(positions, self.taught, external_uses)
        positions = replace(positions, standing_frames=standing - positions.conditions.keys())
        frames = with_declared(
            self.frames, positions, external_uses.tools, external_uses.bases, own=frozenset()
        )
        root = external_uses.bases.get(ROOT)
        frames = seen_from_base(_with_written_out(frames), root)
        of_root = (standing_remark(root),) if root is not None and len(positions) else ()
        declared = self.declarations.declares.keys() if _is_data_list(self.source.name) else None
        places = places_without_values(self.source, external_uses, self.empty, (declared, self.keys))
        copies = copies_with_other_tools(positions, external_uses, self.keys)
        positions = replace(positions, shifts=(*positions.shifts, *places, *copies))
        return replace(self, positions=positions, frames=frames, remarks=(*of_root, *self.remarks, *remarks))

    def _own_taught(self) -> Set[int]:
        """Return the taught points to which no other program moves by their frame data."""
        return {row for row in self.taught if not self.declarations.declares.get(self.keys[row], True)}


@dataclass(frozen=True)
class _FileSummary:
    declarations: FileDeclarations
    taught: Set[int] = frozenset()
    routines: Mapping[int, str] = field(default_factory=dict)
    shifts: Sequence[ProgramShift] = ()
    set_data: Set[str] = frozenset()  # names that a program gives a value
    entries: EntryMarks = NO_ENTRIES  # of TOOL_DATA and BASE_DATA that it sets
    frame_data: Mapping[str, TaughtFrames] = field(default_factory=dict)
    empty: Mapping[str, frozenset[MoveFrames]] = field(default_factory=dict)  # own points without a value


_Read = tuple[KrlPositions, ProgramFrames, _FileSummary]


def _read_data(source: ProgramText) -> _Read:
    data = read_data_list(source)
    declarations = FileDeclarations(
        "",
        declares=data.shown,
        uses=uses_of_own_data(data.shown),
        tools=_of_tables(data.tools),
        bases={**_of_tables(data.bases), **root_among(data.frames_alone(), source.text)},
        doubtful={f"{CARRIED} {number}": TURNED_BASE for number in carried_bases(source.text)}
        if data.of_controller
        else {},
        imports=remark_imports(data.found),
    )
    return data.found, data.to_frames(), _FileSummary(declarations, data.taught, frame_data=data.frame_data)


def _with_written_out(frames: ProgramFrames) -> ProgramFrames:
    """Return frames with those that other files write out among the program's own: a clone has them, too."""
    tools, bases = (
        {name: pose for name, pose in poses.items() if name.startswith(WRITTEN_OUT)}
        for poses in (frames.cell_flange_tip, frames.cell_base_frame)
    )
    return replace(
        frames, flange_tip={**frames.flange_tip, **tools}, base_frame={**frames.base_frame, **bases}
    )


def _of_tables(poses: Mapping[str, Pose]) -> Poses:
    """Return what stands in TOOL_DATA or BASE_DATA, which every program sees; number 0 is the language's."""
    return {number: pose for number, pose in poses.items() if number != "0"}


def _read_src(source: ProgramText) -> _Read:
    program = read_program(source)
    points = program.points
    declarations = FileDeclarations(
        "",
        uses=points.declared_uses(),
        tools=points.frames_written_out("TOOL"),
        bases=points.frames_written_out("BASE"),
        routines=points.routine_effects(),
        doubtful=dict.fromkeys(points.set_tables, COMPUTED) | ({SET: ROOT_SET} if points.sets_root else {}),
        imports=remark_imports(points.found),
        routine_targets=routine_targets_of(points),
        calls=calls_of_file(points),
        copies=copies_of_file(points),
        capitals=True,
    )
    routines = points.scopes
    return (
        points.found,
        points.to_frames(),
        _FileSummary(
            declarations,
            routines=routines,
            shifts=(*program.shifts.to_shifts(points), *measured_shifts(points)),
            set_data=points.set_data,
            entries=marks_of_entries(program.tables, points.routines),
            empty=empty_points_of(points),
        ),
    )


def _is_data_list(name: str) -> bool:
    return PurePath(name).suffix.lower() == ".dat"


def writes_program(data: bytes) -> bool:
    """Return whether a .dat, .src or .sub file is KUKA's: others use these suffixes, too."""
    return _DEFINED_BYTES.search(data, 0, _LOOKED_AT) is not None


def _declarations_of(name: str, data: bytes) -> FileDeclarations | None:
    """Return what a data list says to other files without its coordinates; None for a program."""
    path = PurePath(name)
    if not _is_data_list(name):
        return None
    if _TABLES.search(data) is not None:
        try:
            return KukaFile.from_bytes(name, data).declarations
        except ProgramFileError:
            pass  # it is refused when its turn comes, and declares its names all the same
    text = ProgramText(name, data).text
    declares = declared_names(text)
    declarations = FileDeclarations(
        "", declares=declares, uses=uses_of_own_data(declares), imports=imports_of(text)
    )
    return _with_path(path, declarations)


def _with_path(
    path: PurePath,
    declarations: FileDeclarations,
    set_data: Set[str] = frozenset(),
    entries: EntryMarks = NO_ENTRIES,
) -> FileDeclarations:
    module = path.stem.upper()
    doubtful = {f"{program_folder(path)} {key}": why for key, why in declarations.doubtful.items()}
    doubtful |= marks_of_set_data(set_data, path) | entries.of_file(program_folder(path), path)
    return replace(declarations, module=module, public=module == "$CONFIG", doubtful=doubtful)


def _with_carried_bases(positions: Positions, taught: Set[int], external_uses: ExternalUses) -> Positions:
    """Return positions of which those need a positioner whose base the controller's lists say one carries."""
    cells = cells_of(external_uses.file)
    carried = {
        base
        for base in set(positions.user_frames) - {None}
        if any(f"{cell} {CARRIED} {base}" in external_uses.doubtful for cell in cells)
    }
    conditions = {
        row: ConditionalBar.for_need(ProjectNeed.MOVED_FRAME, TURNED_BASE).add_need(
            positions.conditions.get(row)
        )
        for row in taught
        if positions.user_frames[row] in carried
    }
    return replace(positions, conditions={**positions.conditions, **conditions}) if conditions else positions


def _without_set_tables(positions: Positions, external_uses: ExternalUses) -> Positions:
    """Return positions of which those are left whose tool or base a program sets in the tables, or the robot's root.

    Where an index is computed, that is said of every entry.
    """
    if not external_uses.doubtful:  # as nearly always
        return positions
    whose = cells_of(external_uses.file)
    if any(f"{one} {SET}" in external_uses.doubtful for one in whose):
        cartesian = {row: ROOT_SET for row, kind in enumerate(positions.kinds) if kind == CARTESIAN}
        return replace(positions, barred={**cartesian, **positions.barred})
    barred = dict(positions.barred)
    remarks_by_frames: dict[tuple[str | None, str | None], str] = {}
    for row, row_frames in enumerate(zip(positions.tools, positions.user_frames, strict=True)):
        if row_frames not in remarks_by_frames:
            whys = [explain_set_table(external_uses.doubtful, *row_frames, f"{one} ") for one in whose]
            whys.append(explain_passed_table(external_uses.doubtful, *row_frames))
            remarks_by_frames[row_frames] = next(filter(None, whys), "")
        if positions.kinds[row] == CARTESIAN and remarks_by_frames[row_frames]:
            barred.setdefault(row, remarks_by_frames[row_frames])
    return replace(positions, barred=barred)


BRAND = ProgramBrand(
    brand="kuka",
    suffixes=(".src", ".dat", ".sub"),
    read=KukaFile.from_bytes,
    configurations=KukaConfigurations(),
    writes_program=writes_program,
    tells=True,
    routine_names=NAMES,
    says=_declarations_of,
    beside=(PurePath("Mada") / "$machine.dat", PurePath("System") / "$config.dat"),
)
