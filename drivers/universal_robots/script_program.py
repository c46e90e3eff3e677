"""A URScript program, read and changed without losing a byte."""

import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from heapq import heappop, heappush
from itertools import accumulate
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from calibration.geometry import Array, Pose, is_rigid
from drivers.programs.errors import ProgramFileError
from drivers.programs.positions import CARTESIAN, JOINTS, UNREAD, Change, Frames, Positions, Remark
from drivers.universal_robots.script_numbers import (
    LARGEST_RAD,
    LONGEST_M,
    kept_steps,
    number_spans,
    poses_of,
    renewed,
    six_of,
)
from drivers.universal_robots.script_positions import BASE, CONFLICTS, Finder, Place
from drivers.universal_robots.script_shifts import ScriptShifts
from drivers.universal_robots.script_text import SIX_NUMBERS, Literal, ScriptText

_PROGRAM = re.compile(r"^[ \t]*def[ \t]+(\w+)[ \t]*\(", re.ASCII | re.MULTILINE)
_DEEPEST = 100  # functions that call each other
_BOTH = "Give the pose and the joints, for a script holds no kinematics; or change the .urp it came from."


@dataclass(frozen=True, eq=False)
class ScriptProgram:
    """One ``.script`` file."""

    file: str
    text: str  # a character a byte (latin-1)
    places: tuple[Place, ...]
    six_pose: Array  # (N, 6) as written, NaN where there is none [m, rad]
    positions: Positions
    remarks: tuple[Remark, ...]
    frames: Frames

    @classmethod
    def of(cls, file: str, text: str) -> Self:
        """Read a text with a character a byte; errors as `read_script`."""
        source = ScriptText(file, text)
        finder = Finder(source.statements(), _line_feeds(text), text)
        places = finder.places()
        pose = _numbers(source, [place.pose for place in places])
        joints = _numbers(source, [place.joints for place in places])
        tools = _Tools(source, finder)
        columns = _columns(source, finder, places, tools)
        columns["frame_tip"], columns["joints"] = _poses_or_nan(pose), joints
        unread = [row for row, place in enumerate(places) if place.unread]
        columns["frame_tip"][unread], columns["joints"] = np.nan, _without(joints, unread)
        shifts = ScriptShifts(text, finder, places)
        columns["shifts"] = shifts.all()
        columns["barred"] |= dict(shifts.barred())
        remarks = (*finder.remarks(), *tools.remarks(places))
        frames = Frames(_frames(source, finder.frames()) | {BASE: Pose((0.0, 0.0, 0.0))}, tools.flange_tip)
        return cls(file, text, tuple(places), pose, Positions(**columns), remarks, frames)

    @property
    def brand(self) -> str:
        """Return the brand's package name."""
        return "universal_robots"

    @cached_property
    def name(self) -> str:
        """Return the name of the first function, or of the file."""
        found = _PROGRAM.search(self.text)
        return found[1] if found else re.sub(r"^.*[/\\]|\.[^.]*$", "", self.file)

    def to_bytes(self) -> bytes:
        """Return the file."""
        return self.text.encode("latin-1")

    def changed(self, change: Change) -> Self:
        """Return the program with new poses and joints; a place that holds both needs both.

        Raises
        ------
        ProgramFileError
            A place that lacks what is given, or holds more than is given; numbers that are no coordinates.
        """
        edits = _Edits(self)
        rows = np.asarray(change.rows, dtype=np.intp)
        if change.configurations is not None or change.user_frames is not None:
            raise ProgramFileError(
                self.file, "a script holds no configurations and no frame numbers.",
                remedy="Give poses and joints only.",
            )  # fmt: skip
        pose, joints = _asked(change.frame_tip, rows, (4, 4)), _asked(change.joints, rows, (6,))
        with_pose, with_joints = _given(pose), _given(joints)
        for row, new_pose, new_joints in zip(rows.tolist(), with_pose, with_joints, strict=True):
            self._refuse(row, bool(new_pose), bool(new_joints))
        if with_pose.any() and not is_rigid(pose[with_pose]):
            raise ProgramFileError(
                self.file,
                "a new pose is no rigid transform.",
                remedy="Check what computed it; nothing was changed.",
            )
        edits.put_all(rows[with_pose], six_of(pose[with_pose], self.six_pose[rows[with_pose]]), poses=True)
        edits.put_all(rows[with_joints], joints[with_joints], poses=False)
        text = edits.text()
        return self if text == self.text else type(self).of(self.file, text)

    def _refuse(self, row: int, pose: bool, joints: bool) -> None:
        """Refuse what a place cannot hold."""
        place = self.places[row]
        if place.unread:
            raise ProgramFileError(
                self.file, f"{place.name} cannot be changed: {place.unread}.",
                line=int(self.positions.lines[row]), remedy="Leave it out, or teach it on the robot.",
            )  # fmt: skip
        has_pose, has_joints = place.pose is not None, place.joints is not None
        if (pose and not has_pose) or (joints and not has_joints):
            what = f"{place.name} holds a pose only, and was given more."
            cure = "Give a pose only."
            if pose and not has_pose:
                what = f"{place.name} holds joints only, and was given more."
                cure = "Give joints only."
        elif pose != joints and has_pose and has_joints:
            what = f"{place.name} holds a pose and its joints, and was given one of them."
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
    return ScriptProgram.of(name, data.decode("latin-1"))


class _Tools:
    """The tool in force where the text goes to a place: the last ``set_tcp`` above it."""

    def __init__(self, source: ScriptText, finder: Finder) -> None:
        self.calls = _alike(source, finder.tools())
        self.offsets = [offset for offset, _, _ in self.calls]
        self.several = len({name for _, name, _ in self.calls}) > 1
        self.line = finder.line
        holding = [
            b for b in source.blocks if bisect_right(self.offsets, b[0]) < bisect_left(self.offsets, b[1])
        ]
        self.until = _ends(self.offsets, holding, len(source.text))
        begun = {start for start, _ in holding}
        ends = dict(source.blocks)
        self.functions = [  # where each begins and ends, and its calls
            (start, ends.get(start, start), [call for call in calls if call != function.end() - 1])
            for function in _PROGRAM.finditer(source.text)
            for calls in (finder.found.calls.get(function[1], ()),)
            for start in (function.start() + len(function[0]) - len(function[0].lstrip()),)
        ]
        self.begins = [start for start, _, _ in self.functions]
        self.around = _around(self.functions)
        self.set_before: dict[int, bool] = {}  # functions that surely run after a set_tcp
        # calls of functions that set a tool
        self.setting = sorted(call for start, _, calls in self.functions if start in begun for call in calls)
        self.set_at = sorted([*self.offsets, *self.setting])
        blocks = [
            b for b in source.blocks if bisect_right(self.set_at, b[0]) < bisect_left(self.set_at, b[1])
        ]
        self.set_until = list(accumulate(_ends(self.set_at, blocks, len(source.text)), max))
        self.flange_tip = _frames(source, {name: pose for _, name, pose in self.calls if pose is not None})

    def of(self, place: Place) -> str | None:
        """Return the tool's name; None where the moves to a place do not agree, or no text says."""
        named = {name for name, _ in self._in_force(place)}
        return (named.pop() or None) if len(named) == 1 else None

    def barred(self, place: Place) -> str:
        """Return why nobody can tell the tool of a place though the text sets one; "" where nothing is in the way."""
        found = self._in_force(place)
        if len({name for name, _ in found}) > 1:
            return "the program goes to it with different tools"
        if any(not name for name, _ in found):
            return "its tool is computed, or set below the move to it"
        if not all(sure for _, sure in found) and (self.several or place.pose is not None):
            return "which tool the program has there depends on the way that it takes"
        return ""

    def _in_force(self, place: Place) -> list[tuple[str, bool]]:
        """Return for each move to a place the tool that stands last above it, and whether it surely holds there."""
        if not self.offsets:
            return []
        literal = place.pose or place.joints
        uses = place.used or ((literal.start,) if literal else ())
        found = []
        for use in uses:
            at = bisect_right(self.offsets, use)
            since = self.offsets[at - 1] if at else 0
            called = bisect_right(self.setting, since) < bisect_left(self.setting, use)
            ended = at > 0 and self.until[at - 1] < use
            sure = not called and not ended if self.several else not ended or self._is_set(use)
            found.append((self.calls[at - 1][1] if at else "", sure))
        return found

    def _is_set(self, use: int, depth: int = 0) -> bool:
        """Tell whether a ``set_tcp``, or a call of a function with one, surely runs before what stands here."""
        at = bisect_left(self.set_at, use)
        if at and self.set_until[at - 1] >= use:
            return True
        inside = bisect_left(self.begins, use) - 1
        while inside >= 0 and self.functions[inside][1] < use:
            inside = self.around[inside]
        if inside < 0 or depth == _DEEPEST:
            return False
        if inside not in self.set_before:
            self.set_before[inside] = False  # for one that calls itself
            calls = self.functions[inside][2]
            self.set_before[inside] = bool(calls) and all(self._is_set(call, depth + 1) for call in calls)
        return self.set_before[inside]

    def remarks(self, places: Sequence[Place]) -> Iterator[Remark]:
        """Yield what a person must know of the tools."""
        if self.several:
            yield Remark(
                self.line(self.offsets[1]), "computed",
                "more than one tool is set: each position has the one that stands last above its move in the text.",
            )  # fmt: skip
        if not self.calls and places:
            yield Remark(
                0, "foreign", "the tool is the one that is active on the robot: no set_tcp is in this file."
            )


def _around(functions: Sequence[tuple[int, int, Sequence[int]]]) -> list[int]:
    """Return the innermost function around each, -1 where there is none; functions in the order of the text."""
    open_, found = list[int](), list[int]()
    for index, (start, _, _) in enumerate(functions):
        while open_ and functions[open_[-1]][1] < start:
            open_.pop()
        found.append(open_[-1] if open_ else -1)
        open_.append(index)
    return found


def _ends(offsets: Sequence[int], blocks: Sequence[tuple[int, int]], last: int) -> list[int]:
    """Return where the innermost block around each offset ends; offsets in the order of the text."""
    waiting, open_, found = sorted(blocks, reverse=True), list[int](), list[int]()
    for at in offsets:
        while waiting and waiting[-1][0] < at:
            heappush(open_, waiting.pop()[1])
        while open_ and open_[0] < at:
            heappop(open_)
        found.append(open_[0] if open_ else last)
    return found


def _alike(
    source: ScriptText, calls: Sequence[tuple[int, str, Literal | None]]
) -> list[tuple[int, str, Literal | None]]:
    """Return the calls, those that set one pose by the name and the literal of the first of them."""
    first: dict[tuple[float, ...], tuple[str, Literal]] = {}
    same: list[tuple[int, str, Literal | None]] = []
    sixes = _numbers(source, [pose for _, _, pose in calls]).tolist()
    for (offset, name, pose), six in zip(calls, sixes, strict=True):
        known = (name, None) if pose is None else first.setdefault(tuple(six), (name, pose))
        same.append((offset, *known))
    return same


class _Edits:
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
                self._put(literal, six)

    def text(self) -> str:
        """Return the whole text, changed."""
        pieces, at = [], 0
        for start, end, new in sorted(self.spans):
            pieces += [self.program.text[at:start], new]
            at = end
        return "".join([*pieces, self.program.text[at:]])

    def _put(self, literal: Literal, values: list[float]) -> None:
        text = self.program.text
        spans = number_spans(text, literal.start, literal.end)
        try:
            new = renewed([text[start:end] for start, end in spans], values)
        except ValueError as wrong:
            line = text.count("\n", 0, literal.start) + 1
            raise ProgramFileError(
                self.program.file,
                f"{wrong}.",
                line=line,
                remedy="Nothing was changed; check what computed it.",
            ) from wrong
        self.spans += [(*span, number) for span, number in zip(spans, new, strict=True)]


def _numbers(source: ScriptText, literals: Sequence[Literal | None]) -> Array:
    """Return (N, 6) numbers, NaN where there is no literal."""
    six = np.full((len(literals), 6), np.nan)
    rows = [row for row, literal in enumerate(literals) if literal]
    some = [literal for literal in literals if literal]
    if not some:
        return six
    texts = [source.text[literal.start : literal.end] for literal in some]
    try:
        values = np.array(list(map(float, ",".join(texts).split(",")))).reshape(-1, 6)
    except ValueError as wrong:
        bad = next(at for at, text in enumerate(texts) if not SIX_NUMBERS.fullmatch(text))
        raise source.wrong(
            some[bad].start,
            "one of these six is no number.",
            "Correct it on the robot, and save the program again.",
        ) from wrong
    limit = np.full((len(some), 6), LARGEST_RAD)
    limit[[literal.is_pose for literal in some], :3] = LONGEST_M
    beyond = ~(np.abs(values) <= limit).all(axis=1)
    if beyond.any():
        raise source.wrong(
            some[int(np.argmax(beyond))].start, "a coordinate is beyond what an arm can have.",
            "Lengths are in metres, angles in radians; correct it on the robot.",
        )  # fmt: skip
    six[rows] = values
    return six


def _frames(source: ScriptText, literals: Mapping[str, Literal]) -> dict[str, Pose]:
    poses = poses_of(_numbers(source, list(literals.values())))
    return {name: Pose.from_matrix(pose) for name, pose in zip(literals, poses, strict=True)}


def _columns(source: ScriptText, finder: Finder, places: Sequence[Place], tools: _Tools) -> dict[str, Any]:
    """Return the columns of `Positions` but for the poses and the joints."""
    starts = [each.start for place in places if (each := place.pose or place.joints)]
    count = len(places)
    lines = np.searchsorted(np.array(finder.lines), np.array(starts, dtype=np.int64), side="left") + 1
    steps = _steps(source.text, places)
    return {
        "names": tuple(place.name for place in places),
        "kinds": tuple(_kind_of(place) for place in places),
        "lines": lines.astype(np.int64),
        "groups": np.ones(count, dtype=np.int64),
        "external": np.empty((count, 0)),
        "user_frames": tuple(place.frame for place in places),
        "tools": tuple(tools.of(place) for place in places),
        "configurations": ("",) * count,
        "resolution_m": steps,
        "resolution_rad": steps,
        "barred": {
            row: why for row, place in enumerate(places) if (why := _why_barred(place, finder, tools))
        },
    }


def _kind_of(place: Place) -> str:
    if place.unread:
        return UNREAD
    return CARTESIAN if place.pose else JOINTS


def _why_barred(place: Place, finder: Finder, tools: _Tools) -> str:
    """Return why a place is left, or ""."""
    if place.unread:
        return place.unread
    return CONFLICTS if finder.conflicts(place) else tools.barred(place)


def _without(joints: Array, rows: Sequence[int]) -> Array:
    """Return joints without those of some rows."""
    some = joints.copy()
    some[list(rows)] = np.nan
    return some


def _steps(text: str, places: Sequence[Place]) -> Array:
    """Return (N,) the coarsest step to which any number of a place is kept [m and rad]."""
    steps = np.zeros(len(places))
    for literals in ([place.pose for place in places], [place.joints for place in places]):
        rows = [row for row, literal in enumerate(literals) if literal]
        if rows:
            found = kept_steps([text[each.start : each.end] for each in literals if each])
            steps[rows] = np.maximum(steps[rows], found)
    return steps


def _line_feeds(text: str) -> NDArray[np.intp]:
    return np.flatnonzero(np.frombuffer(text.encode("latin-1"), dtype=np.uint8) == 10)


def _poses_or_nan(six: Array) -> Array:
    poses = np.full((len(six), 4, 4), np.nan)
    there = ~np.isnan(six[:, 0])
    poses[there] = poses_of(six[there])
    return poses


def _asked(values: Array | None, rows: NDArray[np.intp], shape: tuple[int, ...]) -> Array:
    return np.full((len(rows), *shape), np.nan) if values is None else np.asarray(values, dtype=float)


def _given(values: Array) -> NDArray[np.bool_]:
    """Return (K,): whether a row is there; a row with some NaN is there, and will be refused."""
    there = ~np.isnan(values)
    return np.asarray(there.any(axis=tuple(range(1, there.ndim))), dtype=bool)
