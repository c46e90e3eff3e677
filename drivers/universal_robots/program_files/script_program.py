"""A URScript program, read and changed without losing a byte."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array, Pose, is_rigid
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.file_declarations import ExternalUses, FileDeclarations
from cellcal.drivers.programs.line_numbers import LineNumbers
from cellcal.drivers.programs.positions import (
    CARTESIAN,
    JOINTS,
    UNREAD,
    PositionChange,
    Positions,
    ProgramFrames,
    Remark,
)
from cellcal.drivers.universal_robots.program_files.feature_variables import (
    FEATURE_VARIABLE,
    declare_features,
)
from cellcal.drivers.universal_robots.program_files.script_lines import with_one_statement_a_line
from cellcal.drivers.universal_robots.program_files.script_numbers import (
    DOUBLE_STEP,
    kept_steps,
    number_spans,
    poses_of,
    renew_numbers,
    six_of,
    without_comments,
)
from cellcal.drivers.universal_robots.program_files.script_positions import (
    BASE,
    CONFLICTS,
    PositionFinder,
    ScriptPlace,
)
from cellcal.drivers.universal_robots.program_files.script_remarks import list_remarks
from cellcal.drivers.universal_robots.program_files.script_shifts import ScriptShifts
from cellcal.drivers.universal_robots.program_files.script_steps import ScriptSteps
from cellcal.drivers.universal_robots.program_files.script_text import ScriptLiteral, ScriptText
from cellcal.drivers.universal_robots.program_files.script_tools import (
    PROGRAM,
    ScriptTools,
    frames_of,
    numbers_of,
)

_BOTH = "Give the pose and the joints, for a script holds no kinematics; or change the .urp it came from."


@dataclass(frozen=True, eq=False)
class ScriptProgram:
    """One ``.script`` file."""

    file: str
    text: str  # a character a byte (latin-1)
    places: tuple[ScriptPlace, ...]
    six_pose: Array  # (N, 6) as written, NaN where there is none [m, rad]
    positions: Positions
    remarks: tuple[Remark, ...]
    frames: ProgramFrames

    @classmethod
    def from_text(cls, file: str, text: str) -> Self:
        """Read a text with a character a byte; errors as `read_script`."""
        spread = with_one_statement_a_line(text)
        source = ScriptText(file, spread, text)
        finder = PositionFinder(source.read_statements(), spread, LineNumbers(text))
        places = finder.list_places()
        pose = numbers_of(source, [place.pose for place in places])
        joints = numbers_of(source, [place.joints for place in places])
        tools = ScriptTools(source, finder)
        columns = _position_columns(source, finder, places, tools)
        columns["frame_tip"], columns["joints"] = _poses_or_nan(pose), joints
        unread = [row for row, place in enumerate(places) if place.unread]
        columns["frame_tip"][unread], columns["joints"] = np.nan, _without_joints(joints, unread)
        shifts = ScriptShifts(spread, finder, places)
        columns["shifts"] = (*shifts.all_shifts(), *ScriptSteps(spread, finder, places).list_shifts())
        columns["barred"] |= dict(shifts.barred_places())
        remarks = (*list_remarks(finder), *tools.list_remarks(places))
        frames = ProgramFrames(
            frames_of(source, finder.frame_literals()) | {BASE: Pose((0.0, 0.0, 0.0))},
            tools.flange_tip,
            sets_tools=True,
        )
        return cls(file, text, tuple(places), pose, Positions(**columns), remarks, frames)

    @cached_property
    def declarations(self) -> FileDeclarations:
        """Return what counts for other files, which may hold this one in a node."""
        return declare_features(FEATURE_VARIABLE.findall(self.text), calls=True)

    def with_external_uses(self, external_uses: ExternalUses) -> Self:
        """Return the program itself: its places are in frames of its own."""
        return self

    @property
    def brand(self) -> str:
        """Return the brand's package name."""
        return "universal_robots"

    @cached_property
    def name(self) -> str:
        """Return the name of the first function, or of the file."""
        found = PROGRAM.search(self.text)
        return found[1] if found else re.sub(r"^.*[/\\]|\.[^.]*$", "", self.file)

    def to_bytes(self) -> bytes:
        """Return the file."""
        return self.text.encode("latin-1")

    def with_changes(self, change: PositionChange) -> Self:
        """Return the program with new poses and joints; a place that holds both needs both.

        Raises
        ------
        ProgramFileError
            A place that lacks what is given, or holds more than is given; numbers that are no coordinates.
        """
        edits = _ScriptEdits(self)
        rows = np.asarray(change.rows, dtype=np.intp)
        if change.configurations is not None or change.user_frames is not None:
            raise ProgramFileError(
                self.file, "a script holds no configurations and no frame numbers.",
                remedy="Give poses and joints only.",
            )  # fmt: skip
        pose, joints = (
            _requested_values(change.frame_tip, rows, (4, 4)),
            _requested_values(change.joints, rows, (6,)),
        )
        with_pose, with_joints = _is_given(pose), _is_given(joints)
        for row, new_pose, new_joints in zip(rows.tolist(), with_pose, with_joints, strict=True):
            self._refuse_row(row, bool(new_pose), bool(new_joints))
        if with_pose.any() and not is_rigid(pose[with_pose]):
            raise ProgramFileError(
                self.file,
                "a new pose is no rigid transform.",
                remedy="Check what computed it; nothing was changed.",
            )
        edits.put_all(rows[with_pose], six_of(pose[with_pose], self.six_pose[rows[with_pose]]), poses=True)
        edits.put_all(rows[with_joints], joints[with_joints], poses=False)
        text = edits.edited_text()
        return self if text == self.text else type(self).from_text(self.file, text)

    def _refuse_row(self, row: int, pose: bool, joints: bool) -> None:
        """Refuse what a place cannot hold."""
        place = self.places[row]
        if place.unread:
            raise ProgramFileError(
                self.file, make_message("{names} cannot be changed: {why}.", names=place.name, why=place.unread),
                line=int(self.positions.lines[row]), remedy="Leave it out, or teach it on the robot.",
            )  # fmt: skip
        has_pose, has_joints = place.pose is not None, place.joints is not None
        if (pose and not has_pose) or (joints and not has_joints):
            what = make_message("{place_name} holds a pose only, and was given more.", place_name=place.name)
            cure = "Give a pose only."
            if pose and not has_pose:
                what = make_message(
                    "{place_name} holds joints only, and was given more.", place_name=place.name
                )
                cure = "Give joints only."
        elif pose != joints and has_pose and has_joints:
            what = make_message(
                "{place_name} holds a pose and its joints, and was given one of them.", place_name=place.name
            )
            cure = _BOTH
        else:
            return
        raise ProgramFileError(self.file, what, line=int(self.positions.lines[row]), remedy=cure)


def read_script(name: str, data: bytes) -> ScriptProgram:
    """Read a ``.script`` file.

    Raises
    ------
    ProgramFileError
        Text that is not URScript, is damaged, or holds numbers that are no coordinates.
    """
    return ScriptProgram.from_text(name, data.decode("latin-1"))


class _ScriptEdits:
    """New texts for numbers of a program."""

    def __init__(self, program: "ScriptProgram") -> None:
        self.program = program
        self.spans: list[tuple[int, int, str]] = []

    def put_all(self, rows: NDArray[np.intp], values: Array, *, poses: bool) -> None:
        """Write poses (K, 6) or joints (K, 6) into these rows."""
        for row, six in zip(rows.tolist(), values.tolist(), strict=True):
            place = self.program.places[row]
            literal = place.pose if poses else place.joints
            if literal is not None:
                self._replace_numbers(literal, six)

    def edited_text(self) -> str:
        """Return the whole text, changed."""
        pieces, at = [], 0
        for start, end, new in sorted(self.spans):
            pieces += [self.program.text[at:start], new]
            at = end
        return "".join([*pieces, self.program.text[at:]])

    def _replace_numbers(self, literal: ScriptLiteral, values: list[float]) -> None:
        text = self.program.text
        spans = number_spans(text, literal.start, literal.end)
        try:
            new = renew_numbers([text[start:end] for start, end in spans], values)
        except ValueError as wrong:
            line = text.count("\n", 0, literal.start) + 1
            raise ProgramFileError(
                self.program.file,
                make_message("{wrong}.", wrong=wrong),
                line=line,
                remedy="Nothing was changed; check what computed it.",
            ) from wrong
        self.spans += [(*span, number) for span, number in zip(spans, new, strict=True)]


def _position_columns(
    source: ScriptText, finder: PositionFinder, places: Sequence[ScriptPlace], tools: ScriptTools
) -> dict[str, Any]:
    """Return the columns of `Positions` but for the poses and the joints."""
    starts = [place.start_offset for place in places]
    count = len(places)
    steps = _number_steps(source.text, places)
    return {
        "names": tuple(place.name for place in places),
        "kinds": tuple(_kind_of(place) for place in places),
        "lines": finder.lines.lines_of(np.array(starts, dtype=np.int64)),
        "groups": np.ones(count, dtype=np.int64),
        "external": np.empty((count, 0)),
        "user_frames": tuple(place.frame for place in places),
        "tools": tuple(tools.tool_of(place) for place in places),
        "configurations": ("",) * count,
        "resolution_m": steps,
        "resolution_rad": steps,
        "posture_hints": frozenset(row for row, place in enumerate(places) if place.is_hint),
        "barred": {
            row: why for row, place in enumerate(places) if (why := _barred_reason(place, finder, tools))
        },
    }


def _kind_of(place: ScriptPlace) -> str:
    if place.unread:
        return UNREAD
    return CARTESIAN if place.pose else JOINTS


def _barred_reason(place: ScriptPlace, finder: PositionFinder, tools: ScriptTools) -> str:
    """Return why a place is left, or ""."""
    if place.unread:
        return place.unread
    return CONFLICTS if finder.has_conflict(place) else tools.barred_reason(place)


def _without_joints(joints: Array, rows: Sequence[int]) -> Array:
    """Return joints without those of some rows."""
    some = joints.copy()
    some[list(rows)] = np.nan
    return some


def _number_steps(text: str, places: Sequence[ScriptPlace]) -> Array:
    """Return (N,) the coarsest step to which any number of a place is kept [m and rad]."""
    steps = np.zeros(len(places))
    for literals in ([place.pose for place in places], [place.joints for place in places]):
        rows = [row for row, literal in enumerate(literals) if literal]
        if rows:
            found = kept_steps([without_comments(text[each.start : each.end]) for each in literals if each])
            steps[rows] = np.maximum(steps[rows], found)
    return np.where(steps > 0.0, steps, DOUBLE_STEP)  # what is no number has no decimals


def _poses_or_nan(six: Array) -> Array:
    poses = np.full((len(six), 4, 4), np.nan)
    there = ~np.isnan(six[:, 0])
    poses[there] = poses_of(six[there])
    return poses


def _requested_values(values: Array | None, rows: NDArray[np.intp], shape: tuple[int, ...]) -> Array:
    return np.full((len(rows), *shape), np.nan) if values is None else np.asarray(values, dtype=float)


def _is_given(values: Array) -> NDArray[np.bool_]:
    """Return (K,): whether a row is there; a row with some NaN is there, and will be refused."""
    there = ~np.isnan(values)
    return np.asarray(there.any(axis=tuple(range(1, there.ndim))), dtype=bool)
