"""RAPID modules as `ProgramFile`: lossless, span by span."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import hypot, isnan
from pathlib import PurePath
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array, quaternion_from_rotation
from cellcal.drivers.abb.program_files.collected import LEAST_ANGLE_DECIMALS
from cellcal.drivers.abb.program_files.configuration import AbbConfigurations, numbers_of
from cellcal.drivers.abb.program_files.literals import AGGREGATES
from cellcal.drivers.abb.program_files.module import read_module
from cellcal.drivers.abb.program_files.written import (
    LEAST_LENGTH_DECIMALS,
    LEAST_QUATERNION_DECIMALS,
    Written,
)
from cellcal.drivers.programs.across import Abroad, Said, settled
from cellcal.drivers.programs.brands import ProgramBrand
from cellcal.drivers.programs.columns import BEYOND, gets_only_a_pose, part_of
from cellcal.drivers.programs.declared_poses import with_declared
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, Change, Frames, Positions, Remark
from cellcal.drivers.programs.spans import Edit, Source, Wanted, checked_rows, finest, written

_MODULE = re.compile(rb"^(?:\xef\xbb\xbf)?[ \t]*+(?:MODULE[ \t]++[A-Za-z]|%%%)", re.IGNORECASE | re.MULTILINE)
_LOOKED_AT = 1 << 16  # bytes in which a module names itself


@dataclass(frozen=True, eq=False)
class AbbFile:
    """One .mod, .prg or .sys file."""

    source: Source
    name: str
    positions: Positions
    remarks: tuple[Remark, ...]
    frames: Frames
    starts: NDArray[np.int64]  # (N,) where each target's numbers open
    written: Written
    fixed: dict[int, str]  # targets that take no change, and why
    said: Said  # what counts for other files
    keys: tuple[str, ...]  # (N,) the targets' names as other modules write them
    used: frozenset[int]  # rows that moves of this file go to
    declared: frozenset[str]  # its own tools and work objects, in small letters
    brand: str = "abb"

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
            edits += self.written.edits(some, self.starts[some], change.frame_tip[in_columns])
        if not in_columns.all():
            edits += self._edits(rows[~in_columns], part_of(change, ~in_columns))
        return type(self).read(self.source.name, self.source.edited(edits))

    def _edits(self, rows: NDArray[np.int64], change: Change) -> Iterator[Edit]:
        wanted = Wanted.of(self.positions, rows, change)
        turns = _quaternions(len(rows), change.frame_tip).tolist()
        for k, row in enumerate(rows.tolist()):
            configuration = _new(change.configurations, k, self.positions.configurations[row])
            frame = _new(change.user_frames, k, self.positions.user_frames[row] or "")
            if not (
                wanted.has_pose[k] or wanted.has_joints[k] or configuration is not None or frame is not None
            ):
                continue
            self._refuse_unfit(row, pose=wanted.has_pose[k], joints=wanted.has_joints[k], frame=frame)
            shape = "jointtarget" if self.positions.kinds[row] == JOINTS else "robtarget"
            found = AGGREGATES[shape].match(self.source.text, int(self.starts[row]))
            if wanted.has_pose[k]:
                yield from self._pose_edits(row, found, wanted.place_mm[k], turns[k])
            if wanted.has_joints[k]:
                yield from self._joint_edits(row, found, wanted.joints_deg[k])
            if configuration is not None:
                yield from self._configuration_edits(row, found, configuration)

    @classmethod
    def read(cls, name: str, data: bytes) -> Self:
        """Read a file.

        Raises
        ------
        ProgramFileError
            A target is not understood, or the file is none of these.
        """
        source = Source(name, data)
        if b"\n" not in data and b"\r" in data:
            raise ProgramFileError(name, "its lines do not end as ABB's do.", remedy="Save it with CR LF.")
        module = read_module(source)
        found, count = module.found, len(module.found.names)
        order = np.argsort(np.array(found.starts, dtype=np.int64), kind="stable")
        user_frames = [module.uses.user_frames.get(row) for row in range(count)]
        tools = [module.uses.tools.get(row) for row in range(count)]
        uses = module.uses
        return cls(
            source=source,
            said=Said(
                (module.name or PurePath(name).stem).lower(),
                declares=uses.shown,
                uses={name: frozenset(held) for name, held in uses.abroad.items()},
                doubtful=uses.doubtful(),
                tools=module.frames.shown(module.frames.tools),
                bases=module.frames.shown(module.frames.bases),
            ),
            keys=tuple(found.names[row].lower() for row in order.tolist()),
            used=frozenset(k for k, row in enumerate(order.tolist()) if uses.of_row.get(row)),
            declared=frozenset(module.frames.declared),
            name=module.name or PurePath(name).stem,
            positions=found.positions(
                order, user_frames, tools, module.uses.barred, module.shifts.shifts(found, module.uses)
            ),
            remarks=tuple(sorted(found.remarks, key=lambda remark: remark.line)),
            frames=module.frames.frames(),
            starts=np.array(found.starts, dtype=np.int64)[order],
            written=module.written.ordered(order, found.fixed),
            fixed={k: found.fixed[row] for k, row in enumerate(order.tolist()) if row in found.fixed},
        )

    def with_abroad(self, abroad: Abroad) -> Self:
        """Return the file with what other modules say of its targets."""
        positions, remarks = settled(
            self.positions, abroad, self.keys, used=self.used, taught=frozenset(), routines={}
        )
        frames = with_declared(self.frames, positions, abroad.tools, abroad.bases, own=self.declared)
        return replace(self, positions=positions, frames=frames, remarks=(*self.remarks, *remarks))

    def _refuse_unfit(self, row: int, *, pose: bool, joints: bool, frame: str | None) -> None:
        kind = self.positions.kinds[row]
        if row in self.fixed:
            raise self._refusal(row, self.fixed[row])
        if frame is not None:
            raise self._refusal(row, "its work object stands in the moves, which are not rewritten")
        if (pose and kind != CARTESIAN) or (joints and kind != JOINTS):
            raise self._refusal(row, f"it holds {kind} coordinates")

    def _pose_edits(
        self, row: int, found: re.Match[str], place_mm: list[float], turn: list[float]
    ) -> Iterator[Edit]:
        texts = found.groups()[:7]
        length, digits = (
            finest(texts[:3], LEAST_LENGTH_DECIMALS),
            finest(texts[3:], LEAST_QUATERNION_DECIMALS),
        )
        yield from self._number_edits(row, found, 0, place_mm, length)
        old = [float(text) for text in texts[3:]]
        norm = hypot(*old)
        sign = -1.0 if sum(a * b for a, b in zip(turn, old, strict=True)) < 0 else 1.0
        new = [sign * value for value in turn]  # q and -q are one orientation; the file keeps its own
        if max(abs(a - b / norm) for a, b in zip(new, old, strict=True)) > 0.5 * 10.0**-digits:
            yield from self._number_edits(row, found, 3, new, digits)

    def _joint_edits(self, row: int, found: re.Match[str], joints_deg: list[float]) -> Iterator[Edit]:
        unused = np.isnan(self.positions.joints[row]).tolist()
        if any(gone and not isnan(value) for gone, value in zip(unused, joints_deg, strict=True)):
            raise self._refusal(row, "an axis that it leaves out is given a value")
        texts = [text for text, gone in zip(found.groups()[:6], unused, strict=True) if not gone]
        yield from self._number_edits(row, found, 0, joints_deg, finest(texts, LEAST_ANGLE_DECIMALS))

    def _configuration_edits(self, row: int, found: re.Match[str], text: str) -> Iterator[Edit]:
        if numbers_of(text) is None:
            raise self._refusal(row, f"{text!r} is no configuration such as [0,-1,0,1]")
        for k, part in enumerate(text.strip()[1:-1].split(",")):
            yield *found.span(8 + k), part.strip()

    def _number_edits(
        self, row: int, found: re.Match[str], first: int, values: list[float], decimals: int
    ) -> Iterator[Edit]:
        for k, value in enumerate(values):
            if isnan(value):
                continue
            if not abs(value) < BEYOND:
                raise self._refusal(row, f"no robot has the coordinate {value:.0f}")
            yield *found.span(first + k + 1), written(found[first + k + 1], value, decimals)

    def _refusal(self, row: int, why: str) -> ProgramFileError:
        return self.source.error(
            int(self.starts[row]),
            f"{self.positions.names[row]} cannot be changed: {why}.",
            remedy="Leave it out, or teach it on the robot.",
        )


def _quaternions(count: int, frame_tip: Array | None) -> Array:
    """Return (count, 4) quaternions of poses, NaN where there is none."""
    quaternions = np.full((count, 4), np.nan)
    if frame_tip is not None:
        given = ~np.isnan(frame_tip).any(axis=(1, 2))
        quaternions[given] = quaternion_from_rotation(frame_tip[given, :3, :3])
    return quaternions


def _new(texts: Sequence[str] | None, k: int, old: str) -> str | None:
    return None if texts is None or texts[k] == old else texts[k]


def writes_program(data: bytes) -> bool:
    """Tell whether a .mod, .prg or .sys file is a RAPID module: others use these suffixes, too."""
    return _MODULE.search(data, 0, _LOOKED_AT) is not None


BRAND = ProgramBrand(
    brand="abb",
    suffixes=(".mod", ".prg", ".sys"),
    read=AbbFile.read,
    configurations=AbbConfigurations(),
    writes_program=writes_program,
    tells=True,
)
