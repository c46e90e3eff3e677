"""Positions of a RAPID module while it is read, row by row, and the columns that come of them."""

import re
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, Pose, homogeneous_matrix, rotation_from_quaternion
from cellcal.calibration.message import make_message
from cellcal.drivers.abb.program_files.usual import GAPS, NUMBERS
from cellcal.drivers.abb.program_files.written_numbers import (
    LEAST_LENGTH_DECIMALS,
    LEAST_QUATERNION_DECIMALS,
    WrittenTargets,
)
from cellcal.drivers.programs.conditions import ExternalColumn
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, UNREAD, UNTAUGHT, Positions, Remark
from cellcal.drivers.programs.shifts import ProgramShift, renumber_shifts
from cellcal.drivers.programs.spans import ProgramText, finest_decimals, unique_names

LEAST_ANGLE_DECIMALS = 4  # of a degree: what a changed coordinate is written with at least
UNUSED = (
    1e9  # the maker writes 9E9 for an axis that is not there, others 1E10, or 8.99999E9 in single precision
)
UNIT_WITHIN = 1e-3  # what rounding to three digits does to a quaternion's length
_USUAL, _USUAL_DIGITS = 1e6, 20  # what lies beyond is looked at closer
_NOTHING = (np.nan,) * 7
_NO_AXES = (np.nan,) * 6
_EXTERNAL_COLUMNS = tuple(ExternalColumn(f"eax_{letter}") for letter in "abcdef")
NO_COORDINATES = "it has no coordinates"
_NO_ORIENTATION = "its orientation is zero, so it was never taught"
_LEAST_STEPS = (10.0**-LEAST_LENGTH_DECIMALS * 1e-3, float(np.deg2rad(10.0**-LEAST_ANGLE_DECIMALS)))
_T = TypeVar("_T")

_EXTERNAL = (
    "{} holds values of external axes. Whether they are millimetres or degrees stands in the configuration; "
    "what they move stands in the project."
)


@dataclass
class RapidPositions:
    """The positions that were found so far."""

    source: ProgramText
    names: list[str] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    starts: "array[int]" = field(default_factory=lambda: array("q"))
    values: "array[float]" = field(default_factory=lambda: array("d"))  # 7 a row: x y z q1..q4, or six axes
    external: "array[float]" = field(default_factory=lambda: array("d"))
    states: list[str] = field(default_factory=list)
    steps: "array[float]" = field(default_factory=lambda: array("d"))  # resolution in m and rad
    fixed: dict[int, str] = field(default_factory=dict)  # rows that take no change, and why
    remarks: list[Remark] = field(default_factory=list)
    external_seen: bool = False
    known_axes: dict[str, "array[float]"] = field(default_factory=dict)  # by text: most have the same
    usual_rows: "array[int]" = field(default_factory=lambda: array("q"))  # written as the controller does
    usual_texts: list[str] = field(default_factory=list)  # seven for each

    def add_remark(self, place: int, code: str, text: str) -> None:
        """Note something that a person must know."""
        self.remarks.append(Remark(self.source.line_of(place), code, text))

    def add_robtarget(self, name: str, found: re.Match[str]) -> None:
        """Take a Cartesian target."""
        texts = found.groups()
        values = [float(text) for text in texts[:7]]
        if max(map(abs, values)) >= _USUAL or max(map(len, texts[:7])) > _USUAL_DIGITS:
            values = [self._parse_number(found, k) for k in range(7)]
        norm = float(np.sqrt(sum(value * value for value in values[3:])))
        taught = norm > 0.0
        if taught and abs(norm - 1.0) > UNIT_WITHIN:
            raise self._no_quaternion(found.start(4), norm)
        self._start_row(name, CARTESIAN if taught else UNTAUGHT, found.start(), f"[{','.join(texts[7:11])}]")
        if not taught:
            self.fixed[len(self.names) - 1] = _NO_ORIENTATION
            return
        self.values[-7:] = array("d", [*values[:3], *(value / norm for value in values[3:])])
        self.steps[-2] = 10.0 ** -finest_decimals(texts[:3], LEAST_LENGTH_DECIMALS) * 1e-3
        self.steps[-1] = 2.0 * 10.0 ** -finest_decimals(texts[3:7], LEAST_QUATERNION_DECIMALS)
        self._add_external(name, found, 11)

    def add_usual(self, found: re.Match[str]) -> bool:
        """Take a target as `usual` finds it; tell whether it was: the axes beside it must be known."""
        axes = self.known_axes.get(found["axes"])
        if axes is None:
            return False
        self.usual_rows.append(len(self.names))
        self.usual_texts += found.group(*NUMBERS)
        self.names.append(found["name"])
        self.kinds.append(CARTESIAN)
        self.starts.append(found.start("open"))
        self.values.extend(_NOTHING)
        self.external.extend(axes)
        self.states.append(found["state"])
        self.steps.extend(_LEAST_STEPS)
        return True

    def compute_usual(self) -> WrittenTargets:
        """Fill the columns of the targets that are written as the controller does; return how those are written.

        Raises
        ------
        ProgramFileError
            A quaternion's length is not 1.
        """
        rows = np.array(self.usual_rows, dtype=np.int64)
        written = WrittenTargets.without_rows(len(self.names))
        written.fill_rows(rows, self.usual_texts)
        numbers = written.values[rows]
        norms = np.sqrt((numbers[:, 3:] ** 2).sum(axis=1))
        for k in np.flatnonzero(np.abs(norms - 1.0) > UNIT_WITHIN).tolist():
            row = int(rows[k])
            if norms[k] > 0.0:
                before = int(written.widths[row, :3].sum()) + sum(GAPS[:4])
                raise self._no_quaternion(self.starts[row] + before, float(norms[k]))
            self.kinds[row] = UNTAUGHT
            self.fixed[row] = _NO_ORIENTATION
        taught = norms > 0.0
        rows, numbers = rows[taught], numbers[taught]
        numbers[:, 3:] /= norms[taught, None]
        np.frombuffer(self.values).reshape(-1, 7)[rows] = numbers
        last_digits = 10.0 ** -written.decimals[rows].astype(float)
        np.frombuffer(self.steps).reshape(-1, 2)[rows] = last_digits * (1e-3, 2.0)
        return written

    def add_jointtarget(self, name: str, found: re.Match[str]) -> None:
        """Take a target of axes."""
        texts = found.groups()
        values = [self._parse_axis(found, k) for k in range(6)]
        taught = any(value == value for value in values)  # noqa: PLR0124  # not NaN
        self._start_row(name, JOINTS if taught else UNTAUGHT, found.start(), "")
        if not taught:
            self.fixed[len(self.names) - 1] = "none of its axes has a value"
        self.values[-7:-1] = array("d", values)
        stated_axes = [text for text, value in zip(texts[:6], values, strict=True) if value == value]  # noqa: PLR0124
        self.steps[-1] = np.deg2rad(10.0 ** -finest_decimals(stated_axes or ["0"], LEAST_ANGLE_DECIMALS))
        self._add_external(name, found, 6)

    def add_untaught(self, name: str, place: int) -> None:
        """Take a target that is declared without a value."""
        self.fixed[len(self.names)] = NO_COORDINATES
        self._start_row(name, UNTAUGHT, place, "")

    def add_unread(self, name: str, place: int, why: str) -> None:
        """Take a position that stands in the file and is not changed."""
        self.fixed[len(self.names)] = why
        self._start_row(name, UNREAD, place, "")

    def drop_coordinates(self, row: int, why: str) -> None:
        """Take the coordinates of a row away: they are not what they look like."""
        self.kinds[row] = UNTAUGHT
        self.values[7 * row : 7 * row + 7] = array("d", _NOTHING)
        self.fixed[row] = why

    def to_positions(
        self,
        order: NDArray[np.int64],
        user_frames: list[str | None],
        tools: list[str | None],
        barred: Mapping[int, str],
        shifts: Sequence[ProgramShift] = (),
    ) -> Positions:
        """Return the columns in the order of the file; barred rows and shifts are counted as they were read."""
        reasons = {**self.fixed, **barred}
        lines = self.source.lines.lines_of(np.array(self.starts, dtype=np.int64)[order])
        kinds = _take_rows(self.kinds, order)
        values = np.array(self.values).reshape(-1, 7)[order]
        external = np.array(self.external).reshape(-1, 6)[order] * 1e-3
        cartesian = np.array([kind == CARTESIAN for kind in kinds], dtype=bool)
        of_axes = np.array([kind == JOINTS for kind in kinds], dtype=bool)
        frame_tip = np.full((len(kinds), 4, 4), np.nan)
        frame_tip[cartesian] = homogeneous_matrix(
            rotation_from_quaternion(values[cartesian, 3:]), values[cartesian, :3] * 1e-3
        )
        joints = np.full((len(kinds), 6 if of_axes.any() else 0), np.nan)
        if joints.size:
            joints[of_axes] = np.deg2rad(values[of_axes, :6])
        used = np.flatnonzero(~np.isnan(external).all(axis=0))
        steps = np.array(self.steps).reshape(-1, 2)[order]
        return Positions(
            names=unique_names(_take_rows(self.names, order), lines),
            kinds=tuple(kinds),
            lines=lines,
            groups=np.ones(len(kinds), dtype=np.int64),
            frame_tip=frame_tip,
            joints=joints,
            external=external[:, : int(used[-1]) + 1 if len(used) else 0],
            user_frames=tuple(_take_rows(user_frames, order)),
            tools=tuple(_take_rows(tools, order)),
            configurations=tuple(_take_rows(self.states, order)),
            resolution_m=steps[:, 0],
            resolution_rad=steps[:, 1],
            barred={k: reasons[row] for k, row in enumerate(order.tolist()) if row in reasons},
            shifts=renumber_shifts(shifts, {row: k for k, row in enumerate(order.tolist())})
            if shifts
            else (),
            external_columns=_EXTERNAL_COLUMNS[: int(used[-1]) + 1 if len(used) else 0],
        )

    def _start_row(self, name: str, kind: str, start: int, state: str) -> None:
        self.names.append(name)
        self.kinds.append(kind)
        self.starts.append(start)
        self.values.extend(_NOTHING)
        self.external.extend(_NO_AXES)
        self.states.append(state)
        self.steps.extend(_LEAST_STEPS)

    def _no_quaternion(self, place: int, norm: float) -> ProgramFileError:
        return self.source.error_at(
            place,
            make_message("the quaternion has the length {norm:.4f}, not 1.", norm=norm),
            remedy="Correct it, or teach the target again.",
        )

    def _parse_number(self, found: re.Match[str], k: int) -> float:
        text = found[k + 1]
        value = float(text)
        if abs(value) < _USUAL and len(text) <= _USUAL_DIGITS:
            return value
        return self.source.parse_number(found.start(k + 1), text)

    def _parse_axis(self, found: re.Match[str], k: int) -> float:
        return np.nan if abs(float(found[k + 1])) >= UNUSED else self._parse_number(found, k)

    def _add_external(self, name: str, found: re.Match[str], first: int) -> None:
        texts = found.groups()[first:]
        text = f"[{','.join(texts)}]"
        values = self.known_axes.get(text)
        if values is None:
            values = self.known_axes[text] = array(
                "d", [self._parse_axis(found, first + k) for k in range(6)]
            )
        self.external[-6:] = values
        if not self.external_seen and any(value == value and value for value in values):  # noqa: PLR0124
            self.external_seen = True
            self.add_remark(found.start(), "foreign", make_message(_EXTERNAL, name))


def pose_of(texts: tuple[str, ...]) -> Pose | None:
    """Return a pose from seven numbers [mm, 1]; None where they are none."""
    values: Array = np.array([float(text) for text in texts])
    if not np.abs(values).max() < _USUAL:
        return None
    norm = float(np.linalg.norm(values[3:]))
    if not abs(norm - 1.0) <= UNIT_WITHIN:
        return None
    try:
        return Pose(tuple((values[:3] * 1e-3).tolist()), tuple((values[3:] / norm).tolist()))
    except CalibrationError:
        return None


def _take_rows(values: list[_T], order: NDArray[np.int64]) -> list[_T]:
    return [values[row] for row in order.tolist()]
