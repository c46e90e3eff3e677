"""Positions of a file with what the other files of its batch say of them."""

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from pathlib import PurePath

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.barred import MOVED_FRAMES, SEEN_FROM_FLANGE, TURNED_BASE
from cellcal.drivers.programs.conditions import ConditionalBar, ProjectNeed
from cellcal.drivers.programs.file_declarations import (
    COPIED,
    VALUES_GIVEN,
    ExternalUses,
    MoveFrames,
    array_name_of,
    lower_name,
    settle_uncertain_tools,
)
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, Positions, Remark
from cellcal.drivers.programs.shifts import ProgramShift, ShiftAxes

_DIFFERENT = "it is used with different tools or frames, in {}"
_OTHERWISE = "it was taught with another tool or frame than {} moves there with"
_COPY_OTHERWISE = "it was taught in another frame than {} sets where it moves to a copy of it"
_UNUSED = "{} and {} more may be used by programs that were not given, with another tool or frame than is taken here."
_UNUSED_ALONE = (
    "{} may be used by a program that was not given, with another tool or frame than is taken here."
)


def settle_positions(
    positions: Positions,
    external_uses: ExternalUses,
    keys: Sequence[str],
    *,
    used: Set[int],
    taught: Set[int],
    routines: Mapping[int, str],
) -> tuple[Positions, tuple[Remark, ...]]:
    """Return a file's positions with what other files say of them, and what must be told of the others.

    ``keys`` names every row as other files do; rows ``used`` are moved to in this file, in ``routines`` where their
    tool or frame depends on it; rows ``taught`` hold their own tool and frame.
    """
    tools, frames, barred = list(positions.tools), list(positions.user_frames), dict(positions.barred)
    conditions = dict(positions.conditions)
    unused: list[int] = []
    for row, kind in enumerate(positions.kinds):
        if kind == JOINTS and row not in barred:
            values = {move_frames.why for move_frames, _ in external_uses.uses_of_name(keys[row])}
            barred |= dict.fromkeys(
                [row] if values & VALUES_GIVEN else (), "".join(sorted(values & VALUES_GIVEN)[:1])
            )
        if kind != CARTESIAN or row in barred:
            continue
        uses = external_uses.uses_of_name(keys[row])
        why = ""
        if row in taught:
            why = _taught_otherwise(MoveFrames(tools[row], frames[row]), uses, external_uses)
        elif uses:
            own = [(MoveFrames(tools[row], frames[row], routine=routines.get(row, "")), external_uses.file)]
            tools[row], frames[row], why = _agree_uses([*(own if row in used else ()), *uses], external_uses)
        elif row in used:
            why = external_uses.reached(external_uses.file, routines.get(row, ""))
        elif array_name_of(keys[row]) in external_uses.visible:
            unused.append(row)
        why = why or external_uses.doubt_reason(tools[row], frames[row])
        _settle_reason(positions, row, why, (barred, conditions))
    remarks = _unused_remarks(positions, unused)
    settled = replace(
        positions, tools=tuple(tools), user_frames=tuple(frames), barred=barred, conditions=conditions
    )
    return settled, remarks


def _settle_reason(
    positions: Positions, row: int, why: str, found: tuple[dict[int, str], dict[int, ConditionalBar]]
) -> None:
    barred, conditions = found
    if why in MOVED_FRAMES:
        conditions[row] = ConditionalBar.for_need(ProjectNeed.MOVED_FRAME, why)
    elif why and not (why == SEEN_FROM_FLANGE and row in positions.held_work):
        barred[row] = why


def _unused_remarks(positions: Positions, unused: Sequence[int]) -> tuple[Remark, ...]:
    if not unused:
        return ()
    first = positions.names[unused[0]]
    text = (
        make_message(_UNUSED, first, len(unused) - 1)
        if len(unused) > 1
        else make_message(_UNUSED_ALONE, first)
    )
    return (Remark(int(positions.lines[unused[0]]), "indirect", text),)


def _taught_otherwise(
    taught: MoveFrames, uses: Sequence[tuple[MoveFrames, str]], external_uses: ExternalUses
) -> str:
    """Return why a position is left that holds a tool and frame, and is moved to with others; or ""."""
    copied = [(move_frames, file) for move_frames, file in uses if move_frames.why == COPIED]
    uses = [(move_frames, file) for move_frames, file in uses if move_frames.why != COPIED]
    tool, frame, why = _agree_uses(uses, external_uses) if uses else (None, None, "")
    if why:
        return why
    if (tool or taught.tool, frame or taught.frame) != (taught.tool, taught.frame):
        return make_message(_OTHERWISE, PurePath(uses[0][1]).name)
    others = (
        file
        for move_frames, file in copied
        if move_frames.frame and lower_name(move_frames.frame) != lower_name(taught.frame)
    )
    other = next(others, None)
    return "" if other is None else make_message(_COPY_OTHERWISE, PurePath(other).name)


def _copied_otherwise(agreed: MoveFrames, uses: Sequence[tuple[MoveFrames, str]]) -> str:
    """Return why a position is left whose copy is moved to in another frame; or ""."""
    for one, file in uses:
        if one.why == COPIED and one.frame and lower_name(one.frame) != (lower_name(agreed.frame) or "0"):
            return make_message(_COPY_OTHERWISE, PurePath(file).name)
    return ""


def copies_with_other_tools(
    positions: Positions, external_uses: ExternalUses, keys: Sequence[str]
) -> list[ProgramShift]:
    """Return, as shifts of their rows, the moves to copies of positions with another tool than the position's own."""
    found: dict[tuple[int, str], ProgramShift] = {}
    for row, (kind, own) in enumerate(zip(positions.kinds, positions.tools, strict=True)):
        if kind != CARTESIAN or row in positions.barred or own is None:
            continue
        for one, file in external_uses.uses_of_name(keys[row]):
            if one.why == COPIED and one.tool and lower_name(one.tool) != lower_name(own):
                line, what = int(positions.lines[row]), PurePath(file).name
                shift = ProgramShift(line, what, ShiftAxes.USER_FRAME, (row,), other_tool=one.tool)
                found.setdefault((row, lower_name(one.tool)), shift)
    return list(found.values())


def _frames_there(use: MoveFrames) -> tuple[str, str, bool]:
    return lower_name(use.tool), lower_name(use.frame), use.why == TURNED_BASE


def _agree_uses(
    uses: Sequence[tuple[MoveFrames, str]], external_uses: ExternalUses
) -> tuple[str | None, str | None, str]:
    """Return the tool and frame that all uses of a position agree on, or why they do not."""
    some = [each for each in settle_uncertain_tools(uses) if each[0].why != COPIED]
    if not some:
        return None, None, COPIED
    whys = [
        external_uses.reached(file, move_frames.routine)
        if not move_frames.why or move_frames.why in MOVED_FRAMES
        else move_frames.why
        for move_frames, file in some
    ]
    why = next(filter(None, whys), "")
    if len({_frames_there(each) for each, _ in some}) > 1:
        files = sorted({PurePath(file).name for _, file in some if file})
        why = why or make_message(
            _DIFFERENT, ", ".join(files[:3]) + (" and others" if len(files) > 3 else "")
        )
    move_frames = some[0][0]
    why = why or _copied_otherwise(move_frames, uses)
    moved = next((each.why for each, _ in some if each.why in MOVED_FRAMES), "")
    return (None, None, why) if why else (move_frames.tool, move_frames.frame, moved)
