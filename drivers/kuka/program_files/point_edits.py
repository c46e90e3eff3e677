"""Edits of the text of KUKA points: new numbers in the places of the old ones."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isnan, radians

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import values_from
from cellcal.drivers.kuka.program_files.collected_positions import change_error
from cellcal.drivers.kuka.program_files.configuration import parts_of
from cellcal.drivers.kuka.program_files.literals import (
    AXIS_FIELDS,
    EXTERNAL_FIELDS,
    POSE_FIELDS,
    STATE_FIELDS,
    field_spans,
)
from cellcal.drivers.kuka.program_files.written_numbers import (
    LEAST_ANGLE_DECIMALS,
    LEAST_LENGTH_DECIMALS,
    LEAST_TURN,
    WrittenPoints,
)
from cellcal.drivers.programs.columns import BEYOND
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, PositionChange, Positions
from cellcal.drivers.programs.spans import Edit, ProgramText, RequestedChange, finest_decimals, write_number

Spans = dict[str, tuple[int, int]]


@dataclass(frozen=True, eq=False)
class PointEdits:
    """The points of one file, and what of them takes a change."""

    source: ProgramText
    positions: Positions
    written: WrittenPoints
    fixed: Mapping[int, str]  # positions that take no change, and why

    def make_edits(self, rows: NDArray[np.int64], change: PositionChange) -> Iterator[Edit]:
        """Yield the edits of some rows, one after the other.

        Raises
        ------
        ProgramFileError
            A position does not take its change.
        """
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
