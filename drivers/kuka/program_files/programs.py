"""KUKA programs and data lists as `ProgramFile`: lossless, span by span."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from math import isnan, radians
from pathlib import PurePath
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import values_from
from cellcal.drivers.kuka.program_files.collected_positions import KrlPositions, change_error
from cellcal.drivers.kuka.program_files.configuration import KukaConfigurations, parts_of
from cellcal.drivers.kuka.program_files.data_list import declared_names, read_data_list
from cellcal.drivers.kuka.program_files.frame_data import TaughtFrames, uses_of_own_data, with_frame_data
from cellcal.drivers.kuka.program_files.imports import imports_of, remark_imports
from cellcal.drivers.kuka.program_files.krl_program import read_program
from cellcal.drivers.kuka.program_files.literals import (
    AXIS_FIELDS,
    EXTERNAL_FIELDS,
    POSE_FIELDS,
    STATE_FIELDS,
    field_spans,
)
from cellcal.drivers.kuka.program_files.patterns import MOVE
from cellcal.drivers.kuka.program_files.point_uses import in_set_table
from cellcal.drivers.kuka.program_files.written_numbers import (
    LEAST_ANGLE_DECIMALS,
    LEAST_LENGTH_DECIMALS,
    LEAST_TURN,
    WrittenPoints,
)
from cellcal.drivers.programs.absent_places import absent_places
from cellcal.drivers.programs.barred import COMPUTED
from cellcal.drivers.programs.brands import ProgramBrand
from cellcal.drivers.programs.columns import BEYOND, gets_only_a_pose, part_of
from cellcal.drivers.programs.cross_file_uses import ExternalUses, FileDeclarations
from cellcal.drivers.programs.declared_poses import Poses, with_declared
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import (
    CARTESIAN,
    JOINTS,
    PositionChange,
    Positions,
    ProgramFrames,
    Remark,
)
from cellcal.drivers.programs.settled_positions import settle_positions
from cellcal.drivers.programs.shifts import ProgramShift
from cellcal.drivers.programs.spans import (
    Edit,
    ProgramText,
    RequestedChange,
    checked_rows,
    finest_decimals,
    write_number,
)

_DEFINED = re.compile(
    r"^[ \t]*+(?:GLOBAL[ \t]++)?+(?:DEFDAT|DEFFCT[ \t]++\w++|DEF)[ \t]++(\w++)", re.IGNORECASE | re.MULTILINE
)
_DEFINED_BYTES = re.compile(
    rb"^(?:\xef\xbb\xbf)?[ \t]*+(?:GLOBAL[ \t]++)?+(?:DEFDAT|DEFFCT|DEF)\b|^&[A-Z]", re.I | re.M
)
_TABLES = re.compile(rb"\b(?:TOOL|BASE)_DATA[ \t]*+\[", re.IGNORECASE)
_HOME = re.compile(r"X?HOME\d*\b", re.IGNORECASE)  # joint angles of $CONFIG.DAT, which no work moves
_ROOT = re.compile(r"R\d", re.IGNORECASE)  # KRC/R1: where the programs of a controller stand
Spans = dict[str, tuple[int, int]]
_LOOKED_AT = 1 << 16  # bytes in which a program names itself
MIXED_WORK = "it is taught with an external tool (IPO_FRAME #TCP), and moved to without its frame data"


@dataclass(frozen=True, eq=False)
class KukaFile:
    """One .src or .dat file."""

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
            edits += self._make_edits(rows[~in_columns], part_of(change, ~in_columns))
        return type(self).from_bytes(self.source.name, self.source.apply_edits(edits))

    def _make_edits(self, rows: NDArray[np.int64], change: PositionChange) -> Iterator[Edit]:
        requested = RequestedChange.from_change(self.positions, rows, change)
        angles = _angles_deg(len(rows), change.frame_tip).tolist()
        for k, row in enumerate(rows.tolist()):
            configuration = _new_text(change.configurations, k, self.positions.configurations[row])
            base = _new_text(change.user_frames, k, self.positions.user_frames[row] or "")
            if not (
                requested.has_pose[k]
                or requested.has_joints[k]
                or configuration is not None
                or requested.has_external[k]
                or base is not None
            ):
                continue
            self._refuse_unfit(row, pose=requested.has_pose[k], joints=requested.has_joints[k], base=base)
            spans = field_spans(self.source.text, int(self.written.starts[row]), len(self.source.text))
            if requested.has_pose[k]:
                yield from self._pose_edits(row, spans, requested, k, angles[k])
            if requested.has_joints[k]:
                yield from self._joint_edits(row, spans, requested.joints_deg[k])
            if configuration is not None:
                yield from self._state_edits(row, spans, configuration)
            if requested.has_external[k]:
                yield from self._external_edits(row, spans, requested.external[k])

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
        reader: Callable[[ProgramText], _Read] = _read_data if _is_data_list(name) else _read_src
        found, frames, summary = reader(source)
        rows = found.counted_rows()
        own = _DEFINED.search(source.text, 0, _LOOKED_AT)
        module = own[1] if own else PurePath(name).stem
        written = found.written_numbers(rows)
        return cls(
            source=source,
            name=module,
            declarations=_with_path(PurePath(name), summary.declarations),
            keys=tuple(found.names[row].upper() for row in rows.tolist()),
            taught=frozenset(k for k, row in enumerate(rows.tolist()) if row in summary.taught),
            routines={
                k: summary.routines[row] for k, row in enumerate(rows.tolist()) if row in summary.routines
            },
            frame_data=summary.frame_data,
            positions=found.to_positions(rows, written, summary.shifts),
            remarks=tuple(sorted(found.remarks, key=lambda remark: remark.line)),
            frames=frames,
            written=written,
            fixed={k: found.fixed[row] for k, row in enumerate(rows.tolist()) if row in found.fixed},
        )

    def with_external_uses(self, external_uses: ExternalUses) -> Self:
        """Return the file with what others say of its positions."""
        external_uses = with_frame_data(external_uses, self.frame_data)
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
        positions = _without_set_tables(positions, self.declarations.module, external_uses)
        positions = _without_mixed_work(positions, self.keys, external_uses)
        frames = with_declared(
            self.frames, positions, external_uses.tools, external_uses.bases, own=frozenset()
        )
        absent = {
            name: moves
            for name, moves in external_uses.absent.items()
            if not _is_data_list(self.source.name) and not _HOME.match(name)
        }
        places = absent_places(self.source, absent, MOVE, comment=";", statement_end="\n")
        positions = replace(positions, shifts=(*positions.shifts, *places))
        return replace(self, positions=positions, frames=frames, remarks=(*self.remarks, *remarks))

    def _refuse_unfit(self, row: int, *, pose: bool, joints: bool, base: str | None) -> None:
        kind = self.positions.kinds[row]
        if row in self.fixed:
            raise self._change_error(row, self.fixed[row])
        if base is not None:
            raise self._change_error(row, "its base stands in its FDAT, which is not rewritten")
        if (pose and kind != CARTESIAN) or (joints and kind != JOINTS):
            raise self._change_error(row, make_message("it holds {kind} coordinates", kind=kind))

    def _pose_edits(
        self, row: int, spans: Spans, requested: RequestedChange, k: int, angles: list[float]
    ) -> Iterator[Edit]:
        texts = [self.source.text[slice(*spans[name])] for name in POSE_FIELDS]
        length, angle = (
            finest_decimals(texts[:3], LEAST_LENGTH_DECIMALS),
            finest_decimals(texts[3:], LEAST_ANGLE_DECIMALS),
        )
        if requested.moved_mm[k] > 0.5 * 10.0**-length * (1 - 1e-9):
            yield from self._number_edits(row, spans, POSE_FIELDS[:3], requested.place_mm[k], length)
        if requested.turned[k] > LEAST_TURN * radians(10.0**-angle):
            # A, B and C have a second spelling, which must not come of an unchanged orientation.
            yield from self._number_edits(row, spans, POSE_FIELDS[3:], angles, angle)

    def _joint_edits(self, row: int, spans: Spans, joints_deg: list[float]) -> Iterator[Edit]:
        if any(isnan(value) for value in joints_deg):
            raise self._change_error(row, "some of its new joints are not given")
        texts = [self.source.text[slice(*spans[name])] for name in AXIS_FIELDS]
        yield from self._number_edits(
            row, spans, AXIS_FIELDS, joints_deg, finest_decimals(texts, LEAST_ANGLE_DECIMALS)
        )

    def _external_edits(self, row: int, spans: Spans, values: list[float]) -> Iterator[Edit]:
        stated = [
            (name, value) for name, value in zip(EXTERNAL_FIELDS, values, strict=False) if not isnan(value)
        ]
        if any(name not in spans for name, _ in stated):
            raise self._change_error(row, "an external axis that it leaves out is given a value")
        for name, value in stated:
            decimals = finest_decimals([self.source.text[slice(*spans[name])]], LEAST_LENGTH_DECIMALS)
            yield from self._number_edits(row, spans, (name,), [value], decimals)

    def _number_edits(
        self, row: int, spans: Spans, names: tuple[str, ...], values: list[float], decimals: int
    ) -> Iterator[Edit]:
        for name, value in zip(names, values, strict=True):
            start, end = spans[name]
            if not abs(value) < BEYOND:
                raise self._change_error(
                    row,
                    make_message("no robot has the coordinate {name} {value:.0f}", name=name, value=value),
                )
            yield start, end, write_number(self.source.text[start:end], value, decimals)

    def _state_edits(self, row: int, spans: Spans, text: str) -> Iterator[Edit]:
        parts = parts_of(text)
        if parts is None or any((name in parts) != (name in spans) for name in STATE_FIELDS):
            raise self._change_error(
                row, make_message("{text!r} does not take the place of its S and T", text=text)
            )
        for name, value in parts.items():
            yield *spans[name], value

    def _change_error(self, row: int, why: str) -> ProgramFileError:
        return change_error(self.source, int(self.written.starts[row]), self.positions.names[row], why)


@dataclass(frozen=True)
class _FileSummary:
    declarations: FileDeclarations
    taught: Set[int] = frozenset()
    routines: Mapping[int, str] = field(default_factory=dict)
    shifts: Sequence[ProgramShift] = ()
    frame_data: Mapping[str, TaughtFrames] = field(default_factory=dict)


_Read = tuple[KrlPositions, ProgramFrames, _FileSummary]


def _read_data(source: ProgramText) -> _Read:
    data = read_data_list(source)
    declarations = FileDeclarations(
        "",
        declares=data.shown,
        uses=uses_of_own_data(data.shown),
        tools=_of_tables(data.tools),
        bases=_of_tables(data.bases),
        imports=remark_imports(data.found),
    )
    return data.found, data.to_frames(), _FileSummary(declarations, data.taught, frame_data=data.frame_data)


def _of_tables(poses: Mapping[str, Pose]) -> Poses:
    """Return what stands in TOOL_DATA or BASE_DATA, which every program sees; number 0 is the language's."""
    return {number: pose for number, pose in poses.items() if number != "0"}


def _read_src(source: ProgramText) -> _Read:
    program = read_program(source)
    points = program.points
    declarations = FileDeclarations(
        "",
        uses=points.declared_uses(),
        routines=points.routine_effects(),
        doubtful=dict.fromkeys(points.set_tables, COMPUTED),
        imports=remark_imports(points.found),
    )
    routines = {used.row: points.routines[used.routine].name for used in points.rows}
    return (
        points.found,
        points.to_frames(),
        _FileSummary(declarations, routines=routines, shifts=program.shifts.to_shifts(points)),
    )


def _angles_deg(count: int, frame_tip: Array | None) -> Array:
    """Return (count, 3) angles A B C of poses, NaN where there is none."""
    angles = np.full((count, 3), np.nan)
    if frame_tip is not None:
        is_given = ~np.isnan(frame_tip).any(axis=(1, 2))
        angles[is_given] = (
            np.rad2deg(values_from("kuka_abc", frame_tip[is_given, :3, :3])) if is_given.any() else 0.0
        )
    return angles


def _new_text(texts: Sequence[str] | None, k: int, old: str) -> str | None:
    return None if texts is None or texts[k] == old else texts[k]


def _is_data_list(name: str) -> bool:
    return PurePath(name).suffix.lower() == ".dat"


def writes_program(data: bytes) -> bool:
    """Tell whether a .dat or .src file is KUKA's: others use these suffixes, too."""
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


def _with_path(path: PurePath, declarations: FileDeclarations) -> FileDeclarations:
    module = path.stem.upper()
    doubtful = {
        f"{module if key[-1] == '*' else _program_folder(path)} {key}": why
        for key, why in declarations.doubtful.items()
    }
    return replace(declarations, module=module, public=module == "$CONFIG", doubtful=doubtful)


def _program_folder(path: PurePath) -> str:
    """Return the folder of a controller's programs: all below its R1, or those that lie together."""
    parts = path.parent.parts
    roots = [depth for depth, part in enumerate(parts, 1) if _ROOT.fullmatch(part)]
    return str(PurePath(*parts[: roots[-1]] if roots else parts))


def _without_mixed_work(positions: Positions, keys: Sequence[str], external_uses: ExternalUses) -> Positions:
    """Return positions of which those are left that are taught for a standing tool and moved to otherwise."""
    mixed = {row: MIXED_WORK for row in positions.held_work if external_uses.uses_of_name(keys[row])}
    return replace(positions, barred={**mixed, **positions.barred}) if mixed else positions


def _without_set_tables(positions: Positions, module: str, external_uses: ExternalUses) -> Positions:
    """Return positions of which those are left whose tool or base a program sets in the tables.

    Where an index is computed, that is said of the program's own points only.
    """
    if not external_uses.doubtful:  # as nearly always
        return positions
    cell = PurePath(_program_folder(PurePath(external_uses.file)))
    whose = (module, *map(str, (cell, *cell.parents)))  # a program counts for those below its folder
    barred = dict(positions.barred)
    remarks_by_frames: dict[tuple[str | None, str | None], str] = {}
    for row, row_frames in enumerate(zip(positions.tools, positions.user_frames, strict=True)):
        if row_frames not in remarks_by_frames:
            whys = (in_set_table(external_uses.doubtful, *row_frames, f"{one} ") for one in whose)
            remarks_by_frames[row_frames] = next(filter(None, whys), "")
        if positions.kinds[row] == CARTESIAN and remarks_by_frames[row_frames]:
            barred.setdefault(row, remarks_by_frames[row_frames])
    return replace(positions, barred=barred)


BRAND = ProgramBrand(
    brand="kuka",
    suffixes=(".src", ".dat"),
    read=KukaFile.from_bytes,
    configurations=KukaConfigurations(),
    writes_program=writes_program,
    tells=True,
    says=_declarations_of,
)
