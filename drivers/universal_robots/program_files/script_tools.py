"""Which tool a URScript program has where it goes to a place, and the numbers of its literals."""

import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Mapping, Sequence
from heapq import heappop, heappush
from itertools import accumulate

import numpy as np

from cellcal.calibration.geometry import Array, Pose
from cellcal.drivers.programs.positions import Remark
from cellcal.drivers.universal_robots.program_files.script_numbers import (
    LARGEST_RAD,
    LONGEST_M,
    poses_of,
    without_comments,
)
from cellcal.drivers.universal_robots.program_files.script_positions import PositionFinder, ScriptPlace
from cellcal.drivers.universal_robots.program_files.script_text import SIX_NUMBERS, ScriptLiteral, ScriptText

PROGRAM = re.compile(r"^[ \t]*def[ \t]+(\w+)[ \t]*\(", re.ASCII | re.MULTILINE)
_LOOP = re.compile(r"while\b", re.ASCII)
_THREAD = re.compile(r"thread\b", re.ASCII)
_DEEPEST = 100  # functions that call each other
_INVERSE = re.compile(r"\bget_inverse_kin[ \t]*\([ \t]*(?:x[ \t]*=[ \t]*)?(?:p[ \t]*\[)?[ \t]*\Z", re.ASCII)
_TOOL_NAMED = re.compile(r"\btcp[ \t]*=(?!=)", re.ASCII)
_TOOL_ARGUMENT = 4  # commas before it
_LONGEST_BEFORE, _LONGEST_CALL = 100, 2000  # characters


class ScriptTools:
    """The tool in force where the text goes to a place: the last ``set_tcp`` above it."""

    def __init__(self, source: ScriptText, finder: PositionFinder) -> None:
        self.calls = _merge_alike(source, finder.tool_settings())
        self.offsets = [offset for offset, _, _ in self.calls]
        self.several = len({name for _, name, _ in self.calls}) > 1
        self.line = finder.line_of
        self.text = source.text
        holding = [
            b for b in source.blocks if bisect_right(self.offsets, b[0]) < bisect_left(self.offsets, b[1])
        ]
        self.until = _block_ends(self.offsets, holding, len(source.text))
        ends = dict(source.blocks)
        self.functions = [  # where each begins and ends, and its calls
            (start, ends.get(start, start), [call for call in calls if call != function.end() - 1])
            for function in PROGRAM.finditer(source.text)
            for calls in (finder.found.calls.get(function[1], ()),)
            for start in (function.start() + len(function[0]) - len(function[0].lstrip()),)
        ]
        self.begins = [start for start, _, _ in self.functions]
        self.around = _innermost_functions(self.functions)
        self.set_before: dict[int, bool] = {}  # functions that surely run after a set_tcp
        self.setting = _calls_that_set(self.functions, self.offsets)
        self.set_at = sorted([*self.offsets, *self.setting])
        blocks = [
            b for b in source.blocks if bisect_right(self.set_at, b[0]) < bisect_left(self.set_at, b[1])
        ]
        self.set_until = list(accumulate(_block_ends(self.set_at, blocks, len(source.text)), max))
        again = {start for start, _ in source.blocks if _LOOP.match(source.text, start)}
        again |= {
            start
            for start, _, calls in self.functions
            if len(calls) > 1 or any(b[0] < call < b[1] and b[0] in again for call in calls for b in blocks)
        }
        self.repeated = [b for b in blocks if b[0] in again]
        self.beside = [b for b in holding if _THREAD.match(source.text, b[0])]
        self.flange_tip = frames_of(source, {name: pose for _, name, pose in self.calls if pose is not None})

    def tool_of(self, place: ScriptPlace) -> str | None:
        """Return the tool's name; None where the moves to a place do not agree, or no text says."""
        named = {name for name, _ in self._in_force(place)}
        return (named.pop() or None) if len(named) == 1 else None

    def barred_reason(self, place: ScriptPlace) -> str:
        """Return why the tool of a position cannot be determined though the text sets one; "" where it can."""
        found = self._in_force(place)
        if self._has_own_tool(place):
            return "the call that brings it to joints names a tool of its own"
        if len({name for name, _ in found}) > 1:
            return "the program goes to it with different tools"
        if any(not name for name, _ in found):
            return "its tool is computed, or set below the move to it"
        if not all(sure for _, sure in found):
            return "which tool the program has there depends on the way that it takes"
        return ""

    def _has_own_tool(self, place: ScriptPlace) -> bool:
        """Return whether a move to a place goes through ``get_inverse_kin`` with a tool, its fifth argument."""
        uses = place.used or ((place.pose.start,) if place.pose else ())
        return any(_names_tool(self.text, use) for use in uses)

    def _in_force(self, place: ScriptPlace) -> list[tuple[str, bool]]:
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
            beside = any(not begin < use < end for begin, end in self.beside)
            found.append((self.calls[at - 1][1] if at else "", sure and not beside))
            found += self._left_by_last_pass(use, since if sure else -1)
        return found

    def _left_by_last_pass(self, use: int, since: int) -> Iterator[tuple[str, bool]]:
        """Yield the tools that what repeats has set below a move when it comes there again."""
        for begin, end in self.repeated:
            if not begin < use < end or since > begin:
                continue
            for at in range(bisect_right(self.set_at, use), bisect_left(self.set_at, end)):
                number = bisect_left(self.offsets, self.set_at[at])
                is_call = number == len(self.offsets) or self.offsets[number] != self.set_at[at]
                yield ("", False) if is_call and self.several else (self.calls[number - is_call][1], True)

    def _is_set(self, use: int, depth: int = 0) -> bool:
        """Return whether a ``set_tcp``, or a call of a function with one, surely runs before what stands here."""
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

    def list_remarks(self, places: Sequence[ScriptPlace]) -> Iterator[Remark]:
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


def _calls_that_set(functions: Sequence[tuple[int, int, Sequence[int]]], offsets: Sequence[int]) -> list[int]:
    """Return in the order of the text the calls of functions that set a tool, themselves or by such a call."""
    found, before = list[int](), -1
    while len(found) > before:
        before, set_at = len(found), sorted([*offsets, *found])
        found = [
            call
            for start, end, calls in functions
            if bisect_right(set_at, start) < bisect_left(set_at, end)
            for call in calls
        ]
    return sorted(found)


def _names_tool(text: str, use: int) -> bool:
    """Return whether what stands at a place is the pose of a ``get_inverse_kin`` with a tool."""
    call = _INVERSE.search(text, max(0, use - _LONGEST_BEFORE), use)
    if call is None:
        return False
    begin = (
        text.find("]", use) + 1 if call[0].rstrip().endswith("[") else use
    )  # behind six numbers, or at a name
    deep, commas = 0, 0
    for at in range(begin, min(len(text), use + _LONGEST_CALL)):
        if text[at] in "([":
            deep += 1
        elif text[at] in ")]":
            deep -= 1
            if deep < 0 and text[at] == ")":
                return commas >= _TOOL_ARGUMENT or _TOOL_NAMED.search(text, begin, at) is not None
        elif text[at] == "," and deep <= 0:
            commas += 1
    return False


def _innermost_functions(functions: Sequence[tuple[int, int, Sequence[int]]]) -> list[int]:
    """Return the innermost function around each, -1 where there is none; functions in the order of the text."""
    open_, found = list[int](), list[int]()
    for index, (start, _, _) in enumerate(functions):
        while open_ and functions[open_[-1]][1] < start:
            open_.pop()
        found.append(open_[-1] if open_ else -1)
        open_.append(index)
    return found


def _block_ends(offsets: Sequence[int], blocks: Sequence[tuple[int, int]], last: int) -> list[int]:
    """Return where the innermost block around each offset ends; offsets in the order of the text."""
    waiting, open_, found = sorted(blocks, reverse=True), list[int](), list[int]()
    for at in offsets:
        while waiting and waiting[-1][0] < at:
            heappush(open_, waiting.pop()[1])
        while open_ and open_[0] < at:
            heappop(open_)
        found.append(open_[0] if open_ else last)
    return found


def _merge_alike(
    source: ScriptText, calls: Sequence[tuple[int, str, ScriptLiteral | None]]
) -> list[tuple[int, str, ScriptLiteral | None]]:
    """Return the calls, those that set one pose by the name and the literal of the first of them."""
    first: dict[tuple[float, ...], tuple[str, ScriptLiteral]] = {}
    same: list[tuple[int, str, ScriptLiteral | None]] = []
    sixes = numbers_of(source, [pose for _, _, pose in calls]).tolist()
    for (offset, name, pose), six in zip(calls, sixes, strict=True):
        first_call = (name, None) if pose is None else first.setdefault(tuple(six), (name, pose))
        same.append((offset, *first_call))
    return same


def numbers_of(source: ScriptText, literals: Sequence[ScriptLiteral | None]) -> Array:
    """Return (N, 6) numbers, NaN where there is no literal."""
    six = np.full((len(literals), 6), np.nan)
    rows = [row for row, literal in enumerate(literals) if literal]
    some = [literal for literal in literals if literal]
    if not some:
        return six
    texts = [without_comments(source.text[literal.start : literal.end]) for literal in some]
    try:
        values = np.array(list(map(float, ",".join(texts).split(",")))).reshape(-1, 6)
    except ValueError as wrong:
        bad = next(at for at, text in enumerate(texts) if not SIX_NUMBERS.fullmatch(" ".join(text.split())))
        raise source.error_at(
            some[bad].start,
            "one of these six is no number.",
            "Correct it on the robot, and save the program again.",
        ) from wrong
    limit = np.full((len(some), 6), LARGEST_RAD)
    limit[[literal.is_pose for literal in some], :3] = LONGEST_M
    beyond = ~(np.abs(values) <= limit).all(axis=1)
    if beyond.any():
        raise source.error_at(
            some[int(np.argmax(beyond))].start, "a coordinate is beyond what an arm can have.",
            "Lengths are in metres, angles in radians; correct it on the robot.",
        )  # fmt: skip
    six[rows] = values
    return six


def frames_of(source: ScriptText, literals: Mapping[str, ScriptLiteral]) -> dict[str, Pose]:
    """Return the poses of literals by their names."""
    poses = poses_of(numbers_of(source, list(literals.values())))
    return {name: Pose.from_matrix(pose) for name, pose in zip(literals, poses, strict=True)}
