"""KUKA programs and data lists as `ProgramFile`: lossless, span by span."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import PurePath
from typing import Self

import numpy as np
from numpy.typing import NDArray

from calibration.geometry import Array
from calibration.orientation import values_from
from drivers.kuka.collected import (
    LEAST_ANGLE_DECIMALS,
    LEAST_LENGTH_DECIMALS,
    Collected,
    poses,
    refusal,
)
from drivers.kuka.configuration import KukaConfigurations, parts_of
from drivers.kuka.data_list import read_data_list
from drivers.kuka.literals import AXIS_FIELDS, POSE_FIELDS, STATE_FIELDS, field_spans
from drivers.kuka.program import read_program
from drivers.programs.brands import ProgramBrand
from drivers.programs.errors import ProgramFileError
from drivers.programs.positions import CARTESIAN, JOINTS, Change, Frames, Positions, Remark
from drivers.programs.spans import Edit, Source, checked_rows, finest, written

_DEFINED = re.compile(
    r"^[ \t]*+(?:GLOBAL[ \t]++)?+(?:DEFDAT|DEFFCT[ \t]++\w++|DEF)[ \t]++(\w++)", re.IGNORECASE | re.MULTILINE
)
_DEFINED_BYTES = re.compile(
    rb"^(?:\xef\xbb\xbf)?[ \t]*+(?:GLOBAL[ \t]++)?+(?:DEFDAT|DEFFCT|DEF)\b|^&[A-Z]", re.I | re.M
)
_LOOKED_AT = 1 << 16  # bytes in which a program names itself


@dataclass(frozen=True, eq=False)
class KukaFile:
    """One .src or .dat file."""

    source: Source
    name: str
    positions: Positions
    remarks: tuple[Remark, ...]
    frames: Frames
    starts: NDArray[np.int64]  # (N,) where each position's struct opens
    fixed: dict[int, str]  # positions that take no change, and why
    brand: str = "kuka"

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
            A position is not understood, or the file is none of these.
        """
        source = Source(name, data)
        if b"\n" not in data and b"\r" in data:
            raise ProgramFileError(name, "its lines do not end as KUKA's do.", remedy="Save it with CR LF.")
        is_data = PurePath(name).suffix.lower() == ".dat"
        reader: Callable[[Source], _Read] = _read_data if is_data else _read_src
        found, frames = reader(source)
        rows = found.rows()
        own = _DEFINED.search(source.text, 0, _LOOKED_AT)
        return cls(
            source=source,
            name=own[1] if own else PurePath(name).stem,
            positions=found.positions(rows),
            remarks=tuple(sorted(found.remarks, key=lambda remark: remark.line)),
            frames=frames,
            starts=np.array(found.starts, dtype=np.int64)[rows],
            fixed={k: found.fixed[row] for k, row in enumerate(rows.tolist()) if row in found.fixed},
        )

    def _edits(self, k: int, row: int, change: Change) -> Iterator[Edit]:
        frame_tip = _given(change.frame_tip, k)
        joints = _given(change.joints, k)
        configuration = self._new_text(change.configurations, k, self.positions.configurations[row])
        base = self._new_text(change.user_frames, k, self.positions.user_frames[row] or "")
        if frame_tip is None and joints is None and configuration is None and base is None:
            return
        kind = self.positions.kinds[row]
        if row in self.fixed:
            raise self._refusal(row, self.fixed[row])
        if base is not None:
            raise self._refusal(row, "its base stands in its FDAT, which is not rewritten")
        if (frame_tip is not None and kind != CARTESIAN) or (joints is not None and kind != JOINTS):
            raise self._refusal(row, f"it holds {kind} coordinates")
        text = self.source.text
        spans = field_spans(text, int(self.starts[row]), len(text))
        if frame_tip is not None:
            yield from self._pose_edits(row, spans, frame_tip)
        if joints is not None:
            yield from self._joint_edits(row, spans, joints)
        if configuration is not None:
            yield from self._state_edits(row, spans, configuration)

    def _pose_edits(self, row: int, spans: dict[str, tuple[int, int]], frame_tip: Array) -> Iterator[Edit]:
        texts = [self.source.text[slice(*spans[name])] for name in POSE_FIELDS]
        length, angle = finest(texts[:3], LEAST_LENGTH_DECIMALS), finest(texts[3:], LEAST_ANGLE_DECIMALS)
        old = np.array([[float(text) for text in texts]])
        moved = bool(np.abs(frame_tip[:3, 3] * 1e3 - old[0, :3]).max() > 0.5 * 10.0**-length * (1 - 1e-9))
        turned = bool(np.abs(frame_tip - poses(old)[0])[:3, :3].max() > 1e-12)
        if moved:
            yield from self._number_edits(row, spans, POSE_FIELDS[:3], frame_tip[:3, 3] * 1e3, length)
        if turned:  # A, B and C have a second spelling, which must not come of an unchanged orientation
            angles = np.rad2deg(values_from("kuka_abc", frame_tip[:3, :3]))
            yield from self._number_edits(row, spans, POSE_FIELDS[3:], angles, angle)

    def _joint_edits(self, row: int, spans: dict[str, tuple[int, int]], joints: Array) -> Iterator[Edit]:
        if np.isnan(joints).any():
            raise self._refusal(row, "some of its new joints are not given")
        texts = [self.source.text[slice(*spans[name])] for name in AXIS_FIELDS]
        yield from self._number_edits(
            row, spans, AXIS_FIELDS, np.rad2deg(joints), finest(texts, LEAST_ANGLE_DECIMALS)
        )

    def _number_edits(
        self,
        row: int,
        spans: dict[str, tuple[int, int]],
        names: tuple[str, ...],
        values: Array,
        decimals: int,
    ) -> Iterator[Edit]:
        for name, value in zip(names, values.tolist(), strict=True):
            start, end = spans[name]
            if not abs(value) < 1e7:
                raise self._refusal(row, f"no robot has the coordinate {name} {value:.0f}")
            yield start, end, written(self.source.text[start:end], value, decimals)

    def _state_edits(self, row: int, spans: dict[str, tuple[int, int]], text: str) -> Iterator[Edit]:
        parts = parts_of(text)
        if parts is None or any((name in parts) != (name in spans) for name in STATE_FIELDS):
            raise self._refusal(row, f"{text!r} does not take the place of its S and T")
        for name, value in parts.items():
            yield *spans[name], value

    @staticmethod
    def _new_text(texts: object, k: int, old: str) -> str | None:
        if not isinstance(texts, (tuple, list)) or texts[k] == old:
            return None
        return str(texts[k])

    def _refusal(self, row: int, why: str) -> ProgramFileError:
        return refusal(self.source, int(self.starts[row]), self.positions.names[row], why)


_Read = tuple[Collected, Frames]


def _read_data(source: Source) -> _Read:
    data = read_data_list(source)
    return data.found, data.frames()


def _read_src(source: Source) -> _Read:
    program = read_program(source)
    return program.found, program.frames()


def _given(values: Array | None, k: int) -> Array | None:
    return None if values is None or np.isnan(values[k]).all() else values[k]


def writes_program(data: bytes) -> bool:
    """Tell whether a .dat or .src file is KUKA's: others use these suffixes, too."""
    return _DEFINED_BYTES.search(data, 0, _LOOKED_AT) is not None


BRAND = ProgramBrand(
    brand="kuka",
    suffixes=(".src", ".dat"),
    read=KukaFile.read,
    configurations=KukaConfigurations(),
    writes_program=writes_program,
)
