"""User frames and tools that a listing sets to numbers: which ones hold at each motion.

RoboDK and other post-processors write ``PR[9,1]=807.8`` to ``PR[9,6]=30``, then ``UFRAME[9]=PR[9]``, for each frame
anew. Where each way to the motions of a position goes through the same numbers, it stands in these.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from cellcal.calibration.geometry import Pose, homogeneous_matrix
from cellcal.calibration.orientation import rotation_from
from cellcal.drivers.fanuc.program_files.ls_computed import places_named
from cellcal.drivers.fanuc.program_files.ls_flow import ways_on
from cellcal.drivers.fanuc.program_files.ls_statements import (
    BESIDE_WORDS,
    Statement,
    before_positions,
    macro_of,
    motion_of,
    read_statements,
)
from cellcal.drivers.programs.positions import Positions, ProgramFrames

NUMBERS = "={"  # between a number and the coordinates that it is set to
_COORDINATES = 6
_GROUP = rb"(?:GP *+1 *+: *+)?+"
_ELEMENT = re.compile(
    rb"PR\[ *+" + _GROUP + rb"(\d{1,5}+) *+, *+(\d) *+\] *+= *+\(? *+(-?+(?:\d++(?:\.\d*+)?+|\.\d++)) *+\)?"
)
_TAKEN = re.compile(
    rb"(UFRAME|BENUTZER|UTOOL|WKZ)\[ *+"
    + _GROUP
    + rb"(\d{1,3}+) *+\] *+= *+PR\[ *+"
    + _GROUP
    + rb"(\d{1,5}+) *+\]"
)
_SETS_FRAME = re.compile(rb"\b(?:UFRAME|BENUTZER|UTOOL|WKZ)\[|\$MNUFRAME\[|\$MNUTOOL\[", re.IGNORECASE)
_NAMES_REGISTER = re.compile(rb"PR(?<![A-Z]PR)\[")
_CALLS = re.compile(rb"\b(?:CALL|AUFRUF)\b", re.IGNORECASE)
_BESIDE = re.compile(rb"\b(?:" + BESIDE_WORDS + rb")\b", re.IGNORECASE)
_OF_FRAMES = (b"UFRAME", b"BENUTZER")
Coordinates: TypeAlias = tuple[float, ...]
_Key: TypeAlias = tuple[str, int, int]  # "register" with its element, "frame" or "tool" with none
_State: TypeAlias = Mapping[_Key, Coordinates]


@dataclass
class WrittenFrames:
    """The frames and tools of positions that a listing sets to numbers, by what positions name them."""

    names: dict[tuple[str, int], str] = field(default_factory=dict)  # by "frame" or "tool", and row
    frames: ProgramFrames = field(default_factory=ProgramFrames)

    def rename(self, positions: Positions) -> Positions:
        """Return positions that name their frames and tools with the numbers."""
        if not self.names:
            return positions
        columns = {"frame": list(positions.user_frames), "tool": list(positions.tools)}
        for (which, row), name in self.names.items():
            columns[which][row] = name
        return replace(positions, user_frames=tuple(columns["frame"]), tools=tuple(columns["tool"]))


def written_frames(
    positions: Positions, data: bytes, *, others_set: bool, by_macro: bool = False
) -> WrittenFrames:
    """Return the frames and tools that a listing surely sets to numbers before its motions.

    ``others_set`` says that other programs of the controller set some, which a call may then do; ``by_macro`` that
    such a program is called by no name, so that a macro, which has its own, may mean it.
    """
    before = before_positions(data)
    if not _SETS_FRAME.search(before) or not _NAMES_REGISTER.search(before):
        return WrittenFrames()
    statements = list(read_statements(data))
    if any(_BESIDE.search(each.text) for each in statements):
        return WrittenFrames()
    others_set |= by_macro and any(macro_of(each) for each in statements)
    states = _states_before(statements, others_set=others_set)
    found = WrittenFrames()
    poses: dict[str, dict[str, Pose]] = {"frame": {}, "tool": {}}
    uses = _uses_of_rows(positions, statements)
    for which, column in (("frame", positions.user_frames), ("tool", positions.tools)):
        for row, at in uses.items():
            number = column[row]
            if number is None or not number.isdigit():
                continue
            values = {states[each].get((which, int(number), 0)) for each in at}
            coordinates = values.pop() if len(values) == 1 else None
            if coordinates is not None:
                name = f"{number}{NUMBERS}{','.join(repr(each + 0.0).removesuffix('.0') for each in coordinates)}}}"
                found.names[which, row] = name
                poses[which][name] = _pose_of(coordinates)
    return replace(found, frames=ProgramFrames(base_frame=poses["frame"], flange_tip=poses["tool"]))


def _uses_of_rows(positions: Positions, statements: Sequence[Statement]) -> dict[int, list[int]]:
    """Return the motions to each position of the first group; none of one that is copied or may not be moved to."""
    rows = {
        int(name[2:-1]): row
        for row, (name, group) in enumerate(zip(positions.names, positions.groups.tolist(), strict=True))
        if group == 1
    }
    numbers: dict[int, list[int]] = {number: [] for number in rows}
    copied = set[int]()
    for at, statement in enumerate(statements):
        if not statement.is_motion:
            copied |= places_named(statement.text)[0]
            continue
        motion = motion_of(statement)
        for number in numbers if motion.any_target else motion.targets:
            if number in numbers:
                numbers[number].append(at)
    return {rows[number]: some for number, some in numbers.items() if some and number not in copied}


def _states_before(statements: Sequence[Statement], *, others_set: bool) -> list[_State]:
    """Return what is known before each statement, whatever the way to it."""
    ways = ways_on(statements)
    known: list[_State | None] = [{}, *([None] * len(statements))]
    waiting = [0]
    while waiting:
        at = waiting.pop()
        before = known[at]
        if at == len(statements) or before is None:
            continue
        behind = _state_behind(before, statements[at], others_set=others_set)
        for goal in ways[at]:
            there = known[goal]
            met = behind if there is None else _common(there, behind)
            if met is not there:
                known[goal] = met
                waiting.append(goal)
    return [each or {} for each in known]


def _common(one: _State, other: _State) -> _State:
    """Return what two ways agree on; the first itself, where the second takes nothing away."""
    if one is other:
        return one
    both = {key: value for key, value in one.items() if other.get(key) == value}
    return one if len(both) == len(one) else both


def _state_behind(before: _State, statement: Statement, *, others_set: bool) -> _State:
    text = statement.text
    if (element := _ELEMENT.fullmatch(text)) is not None:
        key = ("register", int(element[1]), int(element[2]))
        return {**before, key: (float(element[3]),)}
    if (taken := _TAKEN.fullmatch(text)) is not None:
        key = ("frame" if taken[1] in _OF_FRAMES else "tool", int(taken[2]), 0)
        parts = [before.get(("register", int(taken[3]), each)) for each in range(1, _COORDINATES + 1)]
        rest = {one: value for one, value in before.items() if one != key}
        whole = [part[0] for part in parts if part is not None]
        return {**rest, key: tuple(whole)} if len(whole) == _COORDINATES else rest
    calls = _CALLS.search(text) is not None or macro_of(statement) != ""
    gone = {
        "register": calls or _NAMES_REGISTER.search(text) is not None,
        "frame": _SETS_FRAME.search(text) is not None or (calls and others_set),
    }
    if not any(gone.values()):
        return before
    return {
        key: value
        for key, value in before.items()
        if not gone["register" if key[0] == "register" else "frame"]
    }


def _pose_of(coordinates: Coordinates) -> Pose:
    place = np.array(coordinates[:3]) * 1e-3
    turn = rotation_from("fanuc_wpr", np.radians(coordinates[3:]))
    return Pose.from_matrix(homogeneous_matrix(turn, place))
