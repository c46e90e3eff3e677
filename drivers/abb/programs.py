"""RAPID modules as `ProgramFile`: lossless, span by span."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Self

import numpy as np
from numpy.typing import NDArray

from calibration.geometry import Array, quaternion_from_rotation
from drivers.abb.collected import (
    LEAST_ANGLE_DECIMALS,
    LEAST_LENGTH_DECIMALS,
    LEAST_QUATERNION_DECIMALS,
)
from drivers.abb.configuration import AbbConfigurations, numbers_of
from drivers.abb.literals import AGGREGATES
from drivers.abb.module import read_module
from drivers.programs.brands import ProgramBrand
from drivers.programs.errors import ProgramFileError
from drivers.programs.positions import CARTESIAN, JOINTS, Change, Frames, Positions, Remark
from drivers.programs.spans import Edit, Source, checked_rows, finest, written

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
    fixed: dict[int, str]  # targets that take no change, and why
    brand: str = "abb"

    def to_bytes(self) -> bytes:
        """Return the file as it stands."""
        return self.source.data

    def changed(self, change: Change) -> Self:
        """Return the file with new coordinates; see `drivers.programs.positions.ProgramFile`."""
        rows = checked_rows(self.source.name, self.positions, change)
        edits = [edit for k, row in enumerate(rows.tolist()) for edit in self._edits(k, row, change)]
        return type(self).read(self.source.name, self.source.edited(edits))

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
        return cls(
            source=source,
            name=module.name or PurePath(name).stem,
            positions=found.positions(order, user_frames, tools),
            remarks=tuple(sorted(found.remarks, key=lambda remark: remark.line)),
            frames=module.frames(),
            starts=np.array(found.starts, dtype=np.int64)[order],
            fixed={k: found.fixed[row] for k, row in enumerate(order.tolist()) if row in found.fixed},
        )

    def _edits(self, k: int, row: int, change: Change) -> Iterator[Edit]:
        frame_tip, joints = _given(change.frame_tip, k), _given(change.joints, k)
        configuration = _new(change.configurations, k, self.positions.configurations[row])
        frame = _new(change.user_frames, k, self.positions.user_frames[row] or "")
        if frame_tip is None and joints is None and configuration is None and frame is None:
            return
        kind = self.positions.kinds[row]
        if row in self.fixed:
            raise self._refusal(row, self.fixed[row])
        if frame is not None:
            raise self._refusal(row, "its work object stands in the moves, which are not rewritten")
        if (frame_tip is not None and kind != CARTESIAN) or (joints is not None and kind != JOINTS):
            raise self._refusal(row, f"it holds {kind} coordinates")
        shape = "jointtarget" if kind == JOINTS else "robtarget"
        found = AGGREGATES[shape].match(self.source.text, int(self.starts[row]))
        if frame_tip is not None:
            yield from self._pose_edits(row, found, frame_tip)
        if joints is not None:
            yield from self._joint_edits(row, found, joints)
        if configuration is not None:
            yield from self._configuration_edits(row, found, configuration)

    def _pose_edits(self, row: int, found: re.Match[str], frame_tip: Array) -> Iterator[Edit]:
        texts = found.groups()[:7]
        length, turn = finest(texts[:3], LEAST_LENGTH_DECIMALS), finest(texts[3:], LEAST_QUATERNION_DECIMALS)
        yield from self._number_edits(row, found, 0, frame_tip[:3, 3] * 1e3, length)
        old = np.array([float(text) for text in texts[3:]])
        old /= np.linalg.norm(old)
        new = quaternion_from_rotation(frame_tip[:3, :3])
        new = -new if new @ old < 0 else new  # q and -q are one orientation; the file keeps its own
        if np.abs(new - old).max() > 0.5 * 10.0**-turn:
            yield from self._number_edits(row, found, 3, new, turn)

    def _joint_edits(self, row: int, found: re.Match[str], joints: Array) -> Iterator[Edit]:
        old = self.positions.joints[row]
        if (np.isnan(old) & ~np.isnan(joints)).any():
            raise self._refusal(row, "an axis that it leaves out is given a value")
        given = ~np.isnan(joints)
        texts = [text for text, there in zip(found.groups()[:6], given.tolist(), strict=True) if there]
        values = np.where(given, np.rad2deg(joints), np.nan)
        yield from self._number_edits(row, found, 0, values, finest(texts, LEAST_ANGLE_DECIMALS))

    def _configuration_edits(self, row: int, found: re.Match[str], text: str) -> Iterator[Edit]:
        if numbers_of(text) is None:
            raise self._refusal(row, f"{text!r} is no configuration such as [0,-1,0,1]")
        for k, part in enumerate(text.strip()[1:-1].split(",")):
            yield *found.span(8 + k), part.strip()

    def _number_edits(
        self, row: int, found: re.Match[str], first: int, values: Array, decimals: int
    ) -> Iterator[Edit]:
        for k, value in enumerate(values.tolist()):
            if np.isnan(value):
                continue
            if not abs(value) < 1e7:
                raise self._refusal(row, f"no robot has the coordinate {value:.0f}")
            yield *found.span(first + k + 1), written(found[first + k + 1], value, decimals)

    def _refusal(self, row: int, why: str) -> ProgramFileError:
        return self.source.error(
            int(self.starts[row]),
            f"{self.positions.names[row]} cannot be changed: {why}.",
            remedy="Leave it out, or teach it on the robot.",
        )


def _given(values: Array | None, k: int) -> Array | None:
    return None if values is None or np.isnan(values[k]).all() else values[k]


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
)
