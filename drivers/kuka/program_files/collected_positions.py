"""Positions of a KRL file while it is read, row by row, and the columns that come of them."""

import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array, Pose, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import rotation_from
from cellcal.drivers.kuka.program_files.literals import (
    EXTERNAL_FIELDS,
    POSE_FIELDS,
    KrlLiteral,
    KrlLiteralError,
    field_spans,
    read_literal,
)
from cellcal.drivers.kuka.program_files.written_numbers import (
    LEAST_ANGLE_DECIMALS,
    LEAST_LENGTH_DECIMALS,
    WrittenPoints,
)
from cellcal.drivers.programs.columns import widths_and_decimals
from cellcal.drivers.programs.conditions import ConditionalBar, ExternalColumn, ProjectNeed
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import (
    CARTESIAN,
    JOINTS,
    NO_NUMBER,
    UNREAD,
    UNTAUGHT,
    Positions,
    Remark,
)
from cellcal.drivers.programs.shifts import ProgramShift, renumber_shifts
from cellcal.drivers.programs.spans import ProgramText, finest_decimals, unique_names

NO_VALUE = "it has no coordinates"
INSIDE = "it stands inside other data, or is computed in part, and is not read"
_COMPUTED = "The coordinates of this position are computed; it is not changed."
_BROKEN = "A coordinate of this position is no number; it is not changed."
_DAMAGED = "This position is not understood, or does not end; it is not changed."
NOT_UNDERSTOOD = "it is not understood, or does not end, and is not read"
_NOTHING = (np.nan,) * 6
_NO_EXTERNAL = (None,) * 6
_EXTERNAL_COLUMNS = tuple(ExternalColumn(name) for name in EXTERNAL_FIELDS)
_LEAST_DECIMALS = (LEAST_LENGTH_DECIMALS, LEAST_ANGLE_DECIMALS)
_T = TypeVar("_T")

_PARTIAL = "{} leaves coordinates to what the robot has at that moment; it is not changed."
_EXTERNAL = (
    "{} holds values of external axes. Whether they are millimetres or degrees stands in the machine data; "
    "what they move stands in the project."
)


@dataclass
class KrlPositions:
    """The positions that were found so far."""

    source: ProgramText
    names: list[str] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    starts: "array[int]" = field(default_factory=lambda: array("q"))  # of the struct, or of the bare name
    main: "array[float]" = field(default_factory=lambda: array("d"))
    external: "array[float]" = field(default_factory=lambda: array("d"))
    states: list[str] = field(default_factory=list)
    decimals: "array[int]" = field(default_factory=lambda: array("q"))  # length, angle
    user_frames: list[str | None] = field(default_factory=list)
    tools: list[str | None] = field(default_factory=list)
    fixed: dict[int, str] = field(default_factory=dict)  # rows that take no change, and why
    barred: dict[int, str] = field(
        default_factory=dict
    )  # rows whose tool or base cannot be determined, and why
    remarks: list[Remark] = field(default_factory=list)
    external_seen: bool = False
    held_work: set[int] = field(default_factory=set)  # rows that are seen from the work in the gripper
    conditions: dict[int, ConditionalBar] = field(default_factory=dict)
    usual_rows: "array[int]" = field(default_factory=lambda: array("q"))  # written as the controller does
    usual_texts: list[str] = field(default_factory=list)  # six for each
    known_axes: dict[str, "array[float]"] = field(default_factory=dict)  # most points have the same

    def read_literal(self, start: int, end: int, *, is_last: bool = False) -> KrlLiteral | None:
        """Read the struct at a place; None where it is computed or broken, which is remarked.

        ``is_last``: nothing follows it before ``end``, so that one that is not understood costs no other position.

        Raises
        ------
        ProgramFileError
            It is not understood.
        """
        try:
            return read_literal(self.source.text, start, end)
        except KrlLiteralError as error:
            if not (error.computed or error.broken or error.closed or is_last):
                raise self.source.error_at(
                    error.place, str(error), remedy="Correct it on the controller, or leave this program out."
                ) from None
            text = _BROKEN if error.broken else _COMPUTED if error.computed else _DAMAGED
            self.add_remark(start, "computed", text)
            return None

    def add_position(
        self, name: str, literal: KrlLiteral, *, user_frame: str | None = None, tool: str | None = None
    ) -> None:
        """Take a position."""
        if not literal.is_whole:
            self.add_remark(literal.start, "computed", make_message(_PARTIAL, name))
            self.bar_row(len(self.names), "it leaves coordinates to what the robot has at that moment")
            self._start_row(name, UNTAUGHT, literal.start, literal.configuration_text)
            # A move of external axes alone: the points behind it stand there.
            self._add_external(name, literal)
            return
        main = [text for text in literal.main if text is not None]
        self._start_row(
            name, JOINTS if literal.axes else CARTESIAN, literal.start, literal.configuration_text
        )
        self.user_frames[-1], self.tools[-1] = user_frame, tool
        self.main[-6:] = array("d", self._parse_values(main, literal))
        if literal.axes:
            self.decimals[-1] = finest_decimals(main, LEAST_ANGLE_DECIMALS)
        else:
            self.decimals[-2] = finest_decimals(main[:3], LEAST_LENGTH_DECIMALS)
            self.decimals[-1] = finest_decimals(main[3:], LEAST_ANGLE_DECIMALS)
        self._add_external(name, literal)

    def add_usual(self, point: re.Match[str]) -> None:
        """Take a position as `drivers.kuka.program_files.usual` finds it."""
        texts = point.group(*POSE_FIELDS)
        self.usual_rows.append(len(self.names))
        self.usual_texts += texts
        self.names.append(point["name"])
        self.kinds.append(CARTESIAN)
        self.starts.append(point.start("brace"))
        self.main.extend(map(float, texts))
        self.states.append(point["state"][1:])
        self.decimals.extend(_LEAST_DECIMALS)
        self.user_frames.append(None)
        self.tools.append(None)
        if (axes := self.known_axes.get(point["external"])) is not None:
            self.external.extend(axes)
            return
        self.external.extend(_NOTHING)
        literal = self.read_literal(point.start("brace"), point.end())
        assert literal is not None  # numbers
        self._add_external(point["name"], literal)
        self.known_axes[point["external"]] = self.external[-6:]

    def literal_or_none(self, start: int, end: int) -> KrlLiteral | None:
        """Return the struct at a place, None where it is computed or none."""
        try:
            return read_literal(self.source.text, start, end)
        except KrlLiteralError:
            return None

    def why_unread(self, start: int, end: int) -> str:
        """Return why the struct at a place is not read."""
        try:
            read_literal(self.source.text, start, end)
        except KrlLiteralError as error:
            return NO_NUMBER if error.broken else INSIDE if error.computed else NOT_UNDERSTOOD
        return INSIDE

    def add_unread(self, name: str, place: int, why: str) -> None:
        """Take a position that stands in the file and is not changed."""
        self.bar_row(len(self.names), why)
        self._start_row(name, UNREAD, place, "")

    def add_untaught(self, name: str, place: int) -> None:
        """Take a position that holds no coordinates."""
        self.bar_row(len(self.names), NO_VALUE)
        self._start_row(name, UNTAUGHT, place, "")

    def drop_coordinates(self, row: int, why: str) -> None:
        """Take the coordinates of a row away: they are not what they look like."""
        self.kinds[row] = UNTAUGHT
        self.main[6 * row : 6 * row + 6] = array("d", _NOTHING)
        self.user_frames[row] = self.tools[row] = None
        self.bar_row(row, why)

    def hold_work(self, row: int, why: str) -> None:
        """Note that a row is the pose of a tool that stands in the cell, seen from the work in the gripper."""
        self.held_work.add(row)
        self.conditions[row] = ConditionalBar.for_need(ProjectNeed.STANDING_TOOL, why)

    def bar_row(self, row: int, why: str) -> None:
        """Say that a row takes no change."""
        self.fixed[row] = why

    def add_remark(self, place: int, code: str, text: str) -> None:
        """Note something that a person must know."""
        self.remarks.append(Remark(self.source.line_of(place), code, text))

    def pose_of(self, literal: KrlLiteral) -> Pose | None:
        """Return a tool or base; None where coordinates are missing."""
        if not literal.is_whole or literal.axes:
            return None
        values = np.array([self._parse_values([text for text in literal.main if text is not None], literal)])
        return Pose.from_matrix(poses_of_rows(values)[0])

    def counted_rows(self) -> NDArray[np.int64]:
        """Return the rows that count, in the order of the file: a declaration whose value comes later is none."""
        valued = {name.upper() for row, name in enumerate(self.names) if self.fixed.get(row) != NO_VALUE}
        keep = [
            row
            for row, name in enumerate(self.names)
            if self.fixed.get(row) != NO_VALUE or name.upper() not in valued
        ]
        starts = np.array(self.starts, dtype=np.int64)[keep]
        return np.array(keep, dtype=np.int64)[np.argsort(starts, kind="stable")]

    def written_numbers(self, keep: NDArray[np.int64]) -> WrittenPoints:
        """Return how some rows are written; a position written otherwise shares no column."""
        widths = np.zeros((len(self.names), 6), dtype=np.int64)
        decimals = np.array(self.decimals).reshape(-1, 2)
        widths[self.usual_rows], finest_of = widths_and_decimals(self.usual_texts, (3, 3))
        decimals[self.usual_rows] = np.maximum(finest_of, _LEAST_DECIMALS)
        widths[list(self.fixed)] = 0
        return WrittenPoints(
            np.array(self.starts, dtype=np.int64)[keep],
            widths[keep],
            np.array(self.main).reshape(-1, 6)[keep],
            decimals[keep],
        )

    def to_positions(
        self, keep: NDArray[np.int64], written: WrittenPoints, shifts: Sequence[ProgramShift] = ()
    ) -> Positions:
        """Return the columns of some rows."""
        reasons = {**self.barred, **self.fixed}
        lines = self.source.lines.lines_of(written.starts)
        kinds = tuple(np.array(self.kinds, dtype=object)[keep])
        main = written.values
        external = np.array(self.external).reshape(-1, 6)[keep] * 1e-3
        cartesian = np.array([kind == CARTESIAN for kind in kinds], dtype=bool)
        taught_joints = np.array([kind == JOINTS for kind in kinds], dtype=bool)
        frame_tip = np.full((len(kinds), 4, 4), np.nan)
        frame_tip[cartesian] = poses_of_rows(main[cartesian])
        joints = np.full((len(kinds), 6 if taught_joints.any() else 0), np.nan)
        if joints.size:
            joints[taught_joints] = np.deg2rad(main[taught_joints])
        steps = 10.0 ** -written.decimals.astype(float)
        used = np.flatnonzero(~np.isnan(external).all(axis=0))
        return Positions(
            names=unique_names(_select_rows(self.names, keep), lines),
            kinds=kinds,
            lines=lines,
            groups=np.ones(len(kinds), dtype=np.int64),
            frame_tip=frame_tip,
            joints=joints,
            external=external[:, : int(used[-1]) + 1 if len(used) else 0],
            user_frames=tuple(
                None if self.kinds[row] == JOINTS else self.user_frames[row] for row in keep.tolist()
            ),
            tools=tuple(_select_rows(self.tools, keep)),
            configurations=tuple(_select_rows(self.states, keep)),
            resolution_m=steps[:, 0] * 1e-3,
            resolution_rad=np.deg2rad(steps[:, 1]),
            barred={k: reasons[row] for k, row in enumerate(keep.tolist()) if row in reasons},
            shifts=renumber_shifts(shifts, {row: k for k, row in enumerate(keep.tolist())}) if shifts else (),
            external_columns=_EXTERNAL_COLUMNS[: int(used[-1]) + 1 if len(used) else 0],
            conditions={
                k: self.conditions[row] for k, row in enumerate(keep.tolist()) if row in self.conditions
            },
            held_work=frozenset(k for k, row in enumerate(keep.tolist()) if row in self.held_work),
        )

    def _start_row(self, name: str, kind: str, start: int, state: str) -> None:
        self.names.append(name)
        self.kinds.append(kind)
        self.starts.append(start)
        self.main.extend(_NOTHING)
        self.external.extend(_NOTHING)
        self.states.append(state)
        self.decimals.extend(_LEAST_DECIMALS)
        self.user_frames.append(None)
        self.tools.append(None)

    def _parse_values(self, texts: list[str], literal: KrlLiteral) -> list[float]:
        values = [float(text) for text in texts]
        if (
            max(map(abs, values)) >= 1e6 or max(map(len, texts)) > 20
        ):  # rare, so the places are found here only
            for start, end in field_spans(self.source.text, literal.start, literal.end).values():
                text = self.source.text[start:end]
                if text[0] not in "'}":
                    self.source.parse_number(start, text)
        return values

    def _add_external(self, name: str, literal: KrlLiteral) -> None:
        if literal.external == _NO_EXTERNAL:
            return
        self._parse_values([text for text in literal.external if text is not None], literal)
        values = [np.nan if text is None else float(text) for text in literal.external]
        self.external[-6:] = array("d", values)
        if not self.external_seen and any(value for value in values if value == value):  # noqa: PLR0124  # not NaN
            self.external_seen = True
            self.add_remark(literal.start, "foreign", make_message(_EXTERNAL, name))


def poses_of_rows(values: Array) -> Array:
    """Return (N, 4, 4) from rows X Y Z A B C [mm, deg]."""
    return homogeneous_matrix(rotation_from("kuka_abc", np.deg2rad(values[:, 3:])), values[:, :3] * 1e-3)


def change_error(source: ProgramText, place: int, name: str, why: str) -> ProgramFileError:
    """Return the error of a position that takes no change."""
    return source.error_at(
        place,
        make_message("{names} cannot be changed: {why}.", names=name, why=why),
        remedy="Leave it out, or teach it on the robot.",
    )


def _select_rows(values: list[_T], keep: NDArray[np.int64]) -> list[_T]:
    return [values[row] for row in keep.tolist()]
