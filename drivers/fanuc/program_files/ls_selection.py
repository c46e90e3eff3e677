"""Frames, tools and motion groups that a program selects, held against those that its positions were taught with.

Where they differ for certain, the controller stops at the motion; the listing does not say which of them is meant.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import TypeAlias

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.ls_statements import (
    BESIDE_WORDS,
    Statement,
    before_positions,
    motion_of,
    read_statements,
)
from cellcal.drivers.programs.positions import CARTESIAN, Positions

_OTHER_FRAME = "line {} goes there with {} {}, and it was taught with {}: the controller stops there"
_OTHER_GROUP = "its program runs without motion group 1, which it was taught in: the controller stops there"
_MISSING_GROUP = "its program runs motion group {}, in which it was not taught: the controller stops there"
_WORDS = rb"(?<!\w)(UFRAME_NUM|BENUTZER_NUM|UTOOL_NUM|WKZ_NUM|\$MNUFRAMENUM|\$MNUTOOLNUM)"
_SELECTED = re.compile(rb"\A" + _WORDS + rb"[ \t]*+(?:\[ *+(?:GP *+)?+1 *+\][ \t]*+)?+=[ \t]*+(\d{1,3}+)?")
_SELECTION = re.compile(
    rb"\b(?:UFRAME_NUM|BENUTZER_NUM|UTOOL_NUM|WKZ_NUM)\b|MNUFRAMENUM|MNUTOOLNUM", re.IGNORECASE
)
_FORGETS = re.compile(
    rb"\b(?:LBL|MARKE|ELSE|SONST|ENDIF|FOR|ENDFOR|WHILE|ENDWHILE|CASE|CALL|AUFRUF|" + BESIDE_WORDS + rb")\b"
    rb"|\A[A-Za-z]\w*+(?:[ \t]++\w++)*+\Z"
)
_CALL = re.compile(rb"(?:CALL|AUFRUF)[ \t]++([A-Za-z_]\w*+)[ \t]*+(?:\([^;]*\))?[ \t]*+", re.IGNORECASE)
_FRAMES = (b"UFRAME_NUM", b"BENUTZER_NUM", b"$MNUFRAMENUM")
_MASK = re.compile(rb"^DEFAULT_GR[A-Z]*+[ \t]*+=[ \t]*+([1*](?:[ \t]*+,[ \t]*+[1*])*+)", re.MULTILINE)


Left: TypeAlias = Mapping[str, tuple[str | None, str | None]]  # as `ExternalUses.surely_left`


def with_selections(positions: Positions, data: bytes, left: Left) -> Positions:
    """Return positions with those barred at which the controller would stop.

    ``left`` says what is selected when programs end that may be called.
    """
    barred = dict(positions.barred)
    mask = _MASK.search(data, 0, max(data.find(b"/MN"), 0))
    if mask is not None and b"1" in mask[1] and not mask[1].startswith(b"1"):
        for row in range(len(positions)):
            if positions.groups[row] == 1:
                barred.setdefault(row, _OTHER_GROUP)
    for row, group in _groups_missing(positions, mask[1] if mask is not None else b"").items():
        barred.setdefault(row, make_message(_MISSING_GROUP, group))
    if _may_differ(positions, data, left):
        _bar_others(positions, data, barred, left)
    return replace(positions, barred=barred) if len(barred) > len(positions.barred) else positions


def is_told_by_called(data: bytes, left: Left) -> bool:
    """Return whether what programs leave selected that are called says more of its motions."""
    behind = _left_by_called(data, left)
    return any(any(each) for each in behind) or (bool(behind) and _SELECTION.search(data) is not None)


def _left_by_called(data: bytes, left: Left) -> set[tuple[str | None, str | None]]:
    names = (
        {name.decode("cp437").upper() for name in _CALLED.findall(before_positions(data))}
        if left
        else set[str]()
    )
    return {left[name] for name in names if name in left}


def _groups_missing(positions: Positions, mask: bytes) -> dict[int, int]:
    """Return the rows of group 1 whose position lacks another group that the program runs, and that group."""
    required_groups = [
        group for group, word in enumerate(mask.split(b","), 1) if group > 1 and word.strip() == b"1"
    ]
    if not required_groups:
        return {}
    present_groups = set(zip(positions.names, positions.groups.tolist(), strict=True))
    missing = {
        row: next((group for group in required_groups if (name, group) not in present_groups), 0)
        for row, name in enumerate(positions.names)
        if positions.groups[row] == 1
    }
    return {row: group for row, group in missing.items() if group}


def _may_differ(positions: Positions, data: bytes, left: Left) -> bool:
    """Return whether a program, or one that it calls, selects another number than all its positions hold.

    Nearly none does.
    """
    selected: set[tuple[bool, bytes]] = set()
    statements = before_positions(data)
    if _SELECTION.search(statements):
        numbers = _NUMBERS.findall(statements.upper())
        selected = {(word in _FRAMES, b"%d" % int(number)) for word, number in numbers}
    for tool, frame in _left_by_called(data, left):
        selected |= {(is_frame, one.encode()) for is_frame, one in ((True, frame), (False, tool)) if one}
    if not selected:
        return False
    taught_with = {
        (frames, str(int(name)).encode() if name and name.isdigit() else b"")
        for frames, column in ((True, positions.user_frames), (False, positions.tools))
        for name in set(column)
    }
    return any(
        number != other for frame, number in selected for which, other in taught_with if which is frame
    )


_CALLED = re.compile(rb"\b(?:CALL|AUFRUF)[ \t]++(\w++)", re.IGNORECASE)
_NUMBERS = re.compile(_WORDS + rb"[ \t]*+(?:\[ *+(?:GP *+)?+1 *+\][ \t]*+)?+=[ \t]*+(\d{1,3}+)")


def _bar_others(positions: Positions, data: bytes, barred: dict[int, str], left: Left) -> None:
    selected: dict[str, int | None] = {"user frame": None, "tool": None}
    rows: dict[int, list[int]] = {}
    for row, name in enumerate(positions.names):
        if positions.kinds[row] == CARTESIAN and positions.groups[row] == 1:
            rows.setdefault(int(name[2:-1]), []).append(row)
    for statement in read_statements(data):
        if statement.is_motion:
            motion = motion_of(statement)
            for row in (row for number in motion.targets for row in rows.get(number, ())):
                if why := _other_selection(positions, row, selected, motion.line):
                    barred.setdefault(row, why)
        _follow_selection(statement, selected, left)


def _other_selection(positions: Positions, row: int, selected: dict[str, int | None], line: int) -> str:
    for what, name in (("user frame", positions.user_frames[row]), ("tool", positions.tools[row])):
        number = selected[what]
        if number is not None and name is not None and name.isdigit() and int(name) != number:
            return make_message(_OTHER_FRAME, line, what, number, int(name))
    return ""


def _follow_selection(statement: Statement, selected: dict[str, int | None], left: Left) -> None:
    if (call := _CALL.fullmatch(statement.text)) is not None:
        behind = left.get(call[1].decode("cp437").upper(), (None, None))
        for which, number in zip(("tool", "user frame"), behind, strict=True):
            if number != "":
                selected[which] = int(number) if number is not None and number.isdigit() else None
    elif found := _SELECTED.match(statement.text):
        whole = found[2] is not None and found.end() == len(statement.text)
        selected["user frame" if found[1] in _FRAMES else "tool"] = int(found[2]) if whole else None
    elif _FORGETS.search(statement.text) or _SELECTION.search(statement.text):
        selected.update(dict.fromkeys(selected))
