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
from cellcal.calibration.orientation import values_from
from cellcal.drivers.kuka.program_files.collected import Collected, refusal
from cellcal.drivers.kuka.program_files.configuration import KukaConfigurations, parts_of
from cellcal.drivers.kuka.program_files.data_list import declared_names, read_data_list
from cellcal.drivers.kuka.program_files.imports import imports_of, remarked_imports
from cellcal.drivers.kuka.program_files.literals import AXIS_FIELDS, POSE_FIELDS, STATE_FIELDS, field_spans
from cellcal.drivers.kuka.program_files.point_uses import in_set_table
from cellcal.drivers.kuka.program_files.program import read_program
from cellcal.drivers.kuka.program_files.written import (
    LEAST_ANGLE_DECIMALS,
    LEAST_LENGTH_DECIMALS,
    LEAST_TURN,
    Written,
)
from cellcal.drivers.programs.across import Abroad, Said, settled
from cellcal.drivers.programs.barred import COMPUTED
from cellcal.drivers.programs.brands import ProgramBrand
from cellcal.drivers.programs.columns import BEYOND, gets_only_a_pose, part_of
from cellcal.drivers.programs.declared_poses import Poses, with_declared
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, Change, Frames, Positions, Remark
from cellcal.drivers.programs.shifts import Shift
from cellcal.drivers.programs.spans import Edit, Source, Wanted, checked_rows, finest, written

_DEFINED = re.compile(
    r"^[ \t]*+(?:GLOBAL[ \t]++)?+(?:DEFDAT|DEFFCT[ \t]++\w++|DEF)[ \t]++(\w++)", re.IGNORECASE | re.MULTILINE
)
_DEFINED_BYTES = re.compile(
    rb"^(?:\xef\xbb\xbf)?[ \t]*+(?:GLOBAL[ \t]++)?+(?:DEFDAT|DEFFCT|DEF)\b|^&[A-Z]", re.I | re.M
)
_TABLES = re.compile(rb"\b(?:TOOL|BASE)_DATA[ \t]*+\[", re.IGNORECASE)
_ROOT = re.compile(r"R\d", re.IGNORECASE)  # KRC/R1: where the programs of a controller stand
Spans = dict[str, tuple[int, int]]
_LOOKED_AT = 1 << 16  # bytes in which a program names itself


@dataclass(frozen=True, eq=False)
class KukaFile:
    """One .src or .dat file."""

    source: Source
    name: str
    positions: Positions
    remarks: tuple[Remark, ...]
    frames: Frames
    written: Written
    fixed: dict[int, str]  # positions that take no change, and why
    said: Said  # what counts for other files
    keys: tuple[str, ...]  # (N,) the positions' names as other files write them
    taught: frozenset[int]  # rows with frame data of their own
    routines: Mapping[int, str]  # rows written into moves, and their routine
    brand: str = "kuka"

    def to_bytes(self) -> bytes:
        """Return the file as it stands."""
        return self.source.data

    def changed(self, change: Change) -> Self:
        """Return the file with new coordinates; see `drivers.programs.positions.ProgramFile`."""
        rows = checked_rows(self.source.name, self.positions, change)
        in_columns = gets_only_a_pose(rows, change, self.positions) & (self.written.widths[rows, 0] > 0)
        edits: list[Edit] = []
        if change.frame_tip is not None:
            some = rows[in_columns]
            edits += self.written.edits(some, self.positions.frame_tip[some], change.frame_tip[in_columns])
        if not in_columns.all():
            edits += self._edits(rows[~in_columns], part_of(change, ~in_columns))
        return type(self).read(self.source.name, self.source.edited(edits))

    def _edits(self, rows: NDArray[np.int64], change: Change) -> Iterator[Edit]:
        wanted = Wanted.of(self.positions, rows, change)
        angles = _angles_deg(len(rows), change.frame_tip).tolist()
        for k, row in enumerate(rows.tolist()):
            configuration = _new_text(change.configurations, k, self.positions.configurations[row])
            base = _new_text(change.user_frames, k, self.positions.user_frames[row] or "")
            if not (
                wanted.has_pose[k] or wanted.has_joints[k] or configuration is not None or base is not None
            ):
                continue
            self._refuse_unfit(row, pose=wanted.has_pose[k], joints=wanted.has_joints[k], base=base)
            spans = field_spans(self.source.text, int(self.written.starts[row]), len(self.source.text))
            if wanted.has_pose[k]:
                yield from self._pose_edits(row, spans, wanted, k, angles[k])
            if wanted.has_joints[k]:
                yield from self._joint_edits(row, spans, wanted.joints_deg[k])
            if configuration is not None:
                yield from self._state_edits(row, spans, configuration)

    @classmethod
    def read(cls, name: str, data: bytes) -> Self:
        """Read a file.

        Raises
        ------
        ProgramFileError
            A position is not understood, or the file is none of these.
        """
        source = Source(name, data)
        if b"\n" not in data and b"\r" in data:
            raise ProgramFileError(name, "its lines do not end as KUKA's do.", remedy="Save it with CR LF.")
        is_data = PurePath(name).suffix.lower() == ".dat"
        reader: Callable[[Source], _Read] = _read_data if is_data else _read_src
        found, frames, said = reader(source)
        rows = found.rows()
        own = _DEFINED.search(source.text, 0, _LOOKED_AT)
        module = own[1] if own else PurePath(name).stem
        written = found.written(rows)
        return cls(
            source=source,
            name=module,
            said=_said_as(PurePath(name), said.said),
            keys=tuple(found.names[row].upper() for row in rows.tolist()),
            taught=frozenset(k for k, row in enumerate(rows.tolist()) if row in said.taught),
            routines={k: said.routines[row] for k, row in enumerate(rows.tolist()) if row in said.routines},
            positions=found.positions(rows, written, said.shifts),
            remarks=tuple(sorted(found.remarks, key=lambda remark: remark.line)),
            frames=frames,
            written=written,
            fixed={k: found.fixed[row] for k, row in enumerate(rows.tolist()) if row in found.fixed},
        )

    def with_abroad(self, abroad: Abroad) -> Self:
        """Return the file with what others say of its positions."""
        used = frozenset(self.routines) | {
            k
            for k, (tool, base) in enumerate(
                zip(self.positions.tools, self.positions.user_frames, strict=True)
            )
            if tool or base
        }
        positions, remarks = settled(
            self.positions,
            abroad,
            self.keys,
            used=used - self.taught,
            taught=self.taught,
            routines=self.routines,
        )
        positions = _without_set_tables(positions, self.said.module, abroad)
        frames = with_declared(self.frames, positions, abroad.tools, abroad.bases, own=frozenset())
        return replace(self, positions=positions, frames=frames, remarks=(*self.remarks, *remarks))

    def _refuse_unfit(self, row: int, *, pose: bool, joints: bool, base: str | None) -> None:
        kind = self.positions.kinds[row]
        if row in self.fixed:
            raise self._refusal(row, self.fixed[row])
        if base is not None:
            raise self._refusal(row, "its base stands in its FDAT, which is not rewritten")
        if (pose and kind != CARTESIAN) or (joints and kind != JOINTS):
            raise self._refusal(row, f"it holds {kind} coordinates")

    def _pose_edits(
        self, row: int, spans: Spans, wanted: Wanted, k: int, angles: list[float]
    ) -> Iterator[Edit]:
        texts = [self.source.text[slice(*spans[name])] for name in POSE_FIELDS]
        length, angle = finest(texts[:3], LEAST_LENGTH_DECIMALS), finest(texts[3:], LEAST_ANGLE_DECIMALS)
        if wanted.moved_mm[k] > 0.5 * 10.0**-length * (1 - 1e-9):
            yield from self._number_edits(row, spans, POSE_FIELDS[:3], wanted.place_mm[k], length)
        if wanted.turned[k] > LEAST_TURN * radians(10.0**-angle):
            # A, B and C have a second spelling, which must not come of an unchanged orientation.
            yield from self._number_edits(row, spans, POSE_FIELDS[3:], angles, angle)

    def _joint_edits(self, row: int, spans: Spans, joints_deg: list[float]) -> Iterator[Edit]:
        if any(isnan(value) for value in joints_deg):
            raise self._refusal(row, "some of its new joints are not given")
        texts = [self.source.text[slice(*spans[name])] for name in AXIS_FIELDS]
        yield from self._number_edits(
            row, spans, AXIS_FIELDS, joints_deg, finest(texts, LEAST_ANGLE_DECIMALS)
        )

    def _number_edits(
        self, row: int, spans: Spans, names: tuple[str, ...], values: list[float], decimals: int
    ) -> Iterator[Edit]:
        for name, value in zip(names, values, strict=True):
            start, end = spans[name]
            if not abs(value) < BEYOND:
                raise self._refusal(row, f"no robot has the coordinate {name} {value:.0f}")
            yield start, end, written(self.source.text[start:end], value, decimals)

    def _state_edits(self, row: int, spans: Spans, text: str) -> Iterator[Edit]:
        parts = parts_of(text)
        if parts is None or any((name in parts) != (name in spans) for name in STATE_FIELDS):
            raise self._refusal(row, f"{text!r} does not take the place of its S and T")
        for name, value in parts.items():
            yield *spans[name], value

    def _refusal(self, row: int, why: str) -> ProgramFileError:
        return refusal(self.source, int(self.written.starts[row]), self.positions.names[row], why)


@dataclass(frozen=True)
class _ToOthers:
    said: Said
    taught: Set[int] = frozenset()
    routines: Mapping[int, str] = field(default_factory=dict)
    shifts: Sequence[Shift] = ()


_Read = tuple[Collected, Frames, _ToOthers]


def _read_data(source: Source) -> _Read:
    data = read_data_list(source)
    said = Said(
        "",
        declares=data.shown,
        tools=_of_tables(data.tools),
        bases=_of_tables(data.bases),
        imports=remarked_imports(data.found),
    )
    return data.found, data.frames(), _ToOthers(said, data.taught)


def _of_tables(poses: Mapping[str, Pose]) -> Poses:
    """Return what stands in TOOL_DATA or BASE_DATA, which every program sees; number 0 is the language's."""
    return {number: pose for number, pose in poses.items() if number != "0"}


def _read_src(source: Source) -> _Read:
    program = read_program(source)
    points = program.points
    said = Said(
        "",
        uses=points.uses_said(),
        routines=points.routines_said(),
        doubtful=dict.fromkeys(points.set_tables, COMPUTED),
        imports=remarked_imports(points.found),
    )
    routines = {used.row: points.routines[used.routine].name for used in points.rows}
    return (
        points.found,
        points.frames(),
        _ToOthers(said, routines=routines, shifts=program.shifts.shifts(points)),
    )


def _angles_deg(count: int, frame_tip: Array | None) -> Array:
    """Return (count, 3) angles A B C of poses, NaN where there is none."""
    angles = np.full((count, 3), np.nan)
    if frame_tip is not None:
        given = ~np.isnan(frame_tip).any(axis=(1, 2))
        angles[given] = np.rad2deg(values_from("kuka_abc", frame_tip[given, :3, :3])) if given.any() else 0.0
    return angles


def _new_text(texts: Sequence[str] | None, k: int, old: str) -> str | None:
    return None if texts is None or texts[k] == old else texts[k]


def writes_program(data: bytes) -> bool:
    """Tell whether a .dat or .src file is KUKA's: others use these suffixes, too."""
    return _DEFINED_BYTES.search(data, 0, _LOOKED_AT) is not None


def _says(name: str, data: bytes) -> Said | None:
    """Return what a data list says to other files without its coordinates; None for a program."""
    path = PurePath(name)
    if path.suffix.lower() != ".dat":
        return None
    if _TABLES.search(data) is not None:
        try:
            return KukaFile.read(name, data).said
        except ProgramFileError:
            pass  # it is refused when its turn comes, and declares its names all the same
    text = Source(name, data).text
    return _said_as(path, Said("", declares=declared_names(text), imports=imports_of(text)))


def _said_as(path: PurePath, said: Said) -> Said:
    module = path.stem.upper()
    doubtful = {
        f"{module if key[-1] == '*' else _cell(path)} {key}": why for key, why in said.doubtful.items()
    }
    return replace(said, module=module, public=module == "$CONFIG", doubtful=doubtful)


def _cell(path: PurePath) -> str:
    """Return the folder of a controller's programs: all below its R1, or those that lie together."""
    parts = path.parent.parts
    roots = [depth for depth, part in enumerate(parts, 1) if _ROOT.fullmatch(part)]
    return str(PurePath(*parts[: roots[-1]] if roots else parts))


def _without_set_tables(positions: Positions, module: str, abroad: Abroad) -> Positions:
    """Return positions of which those are left whose tool or base a program sets in the tables.

    Where an index is computed, that is said of the program's own points only.
    """
    if not abroad.doubtful:  # as nearly always
        return positions
    cell = PurePath(_cell(PurePath(abroad.file)))
    whose = (module, *map(str, (cell, *cell.parents)))  # a program counts for those below its folder
    barred = dict(positions.barred)
    known: dict[tuple[str | None, str | None], str] = {}
    for row, held in enumerate(zip(positions.tools, positions.user_frames, strict=True)):
        if held not in known:
            whys = (in_set_table(abroad.doubtful, *held, f"{one} ") for one in whose)
            known[held] = next(filter(None, whys), "")
        if positions.kinds[row] == CARTESIAN and known[held]:
            barred.setdefault(row, known[held])
    return replace(positions, barred=barred)


BRAND = ProgramBrand(
    brand="kuka",
    suffixes=(".src", ".dat"),
    read=KukaFile.read,
    configurations=KukaConfigurations(),
    writes_program=writes_program,
    tells=True,
    says=_says,
)
