"""Frames and tools that a program selects or sets: those of its positions, and when they cannot be determined.

Positions with UF : F or UT : F stand in the frame or tool that is chosen when they are moved to.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import PurePath

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.ls_computed import computed_places
from cellcal.drivers.fanuc.program_files.ls_frames_left import frame_left_by, tool_left_by
from cellcal.drivers.fanuc.program_files.ls_remarks import statements_of
from cellcal.drivers.fanuc.program_files.ls_statements import (
    BEFORE_NAME,
    BESIDE_WORDS,
    MACRO_ARGUMENTS,
    MACRO_WORDS,
    NO_MACRO,
)
from cellcal.drivers.programs.barred import COMPUTED, LATER, SEVERAL
from cellcal.drivers.programs.file_declarations import BatchReasons, ExternalUses, RoutineEffects
from cellcal.drivers.programs.positions import CARTESIAN, Positions
from cellcal.drivers.programs.shifts import ProgramShift, ShiftAxes

_WORDS = {
    "frame": rb"(?:UFRAME_NUM|BENUTZER_NUM|MNUFRAMENUM)",
    "tool": rb"(?:UTOOL_NUM|WKZ_NUM|MNUTOOLNUM)",
}
_CHOSEN = {which: re.compile(rb"\b" + word + rb"\b[^=;<>\n]{0,40}+=") for which, word in _WORDS.items()}
_ALONE = {
    which: re.compile(rb"^[ \t]*+\d*+[ \t]*+:[ \t]*+" + word + rb" *+= *+(\d{1,3}+) *+;", re.MULTILINE)
    for which, word in _WORDS.items()
}
_NUMBER = rb"((?:[^\[\]\n]|\[[^\[\]\n]{0,20}+\]){1,40}+)\](?:\.[$\w]++)*+ *+="
# The group is named first, or a register has its number: $MNUFRAME[1,3] is UFRAME[3] of group 1.
_GROUP = rb"\[ *+(?![2-9] *+,)(?:[^\[\],\n]|\[[^\[\]\n]{0,20}+\]){1,20}+,"
_SET = {
    "frame": re.compile(rb"(?:\b(?:UFRAME|BENUTZER)\[|\$MNUFRAME" + _GROUP + rb")" + _NUMBER),
    "tool": re.compile(rb"(?:\b(?:UTOOL|WKZ)\[|\$MNUTOOL" + _GROUP + rb")" + _NUMBER),
}
_SET_BY = "{} sets its frame or tool while it runs"
_SETTABLE = (b"UFRAME[", b"BENUTZER[", b"UTOOL[", b"WKZ[", b"MNUFRAME[", b"MNUTOOL[")
_UNKNOWN = "*"  # a number that only the running program knows
_USED = re.compile(rb"P(?<![A-Za-z]P)\[ *+(\d{1,5}+)")
# Above the first of these, every statement is run, once and in order.
_BRANCHES = re.compile(rb"\b(?:IF|WENN|LBL|MARKE|JMP|SPRUNG|SELECT|FOR|WHILE|SKIP|ABORT|END|ENDE)\b")
_INDIRECT = re.compile(rb"P(?<![A-Za-z]P)\[ *+[A-Za-z]")

# A register that names the program is a name that no program has.
_CALL = re.compile(rb"\b(?:CALL|AUFRUF|" + BESIDE_WORDS + rb")" + BEFORE_NAME + rb"([^\s;(,]{1,80}+)")
_MACRO_HEAD = re.compile(rb"/PROG[ \t]++\S++[ \t]++Macro\b", re.IGNORECASE)
_MACROS = re.compile(
    rb"^[ \t]*+\d++[ \t]*+:[ \t]*+(" + MACRO_WORDS + rb")[ \t]*+" + MACRO_ARGUMENTS + rb";", re.MULTILINE
)
_BESIDE = re.compile(rb"\b(?:" + BESIDE_WORDS + rb")" + BEFORE_NAME + rb"([^\s;(,]{1,80}+)")


def routine_effects_of(data: bytes) -> RoutineEffects:
    """Return which frames and tools a program chooses anywhere, and what it calls."""
    statements = statements_of(data)[1]
    return RoutineEffects(
        tools=frozenset(_set_numbers("tool", statements)),
        frames=frozenset(_set_numbers("frame", statements)),
        calls=frozenset(_called_programs(statements)),
        likely_calls=frozenset(_possible_programs(statements)),
        by_macro=_MACRO_HEAD.search(data) is not None,
        computes=computed_places(data),
        frame_left=frame_left_by(data),
        tool_left=tool_left_by(data),
        beside=frozenset(name.decode("cp437").upper() for name in _BESIDE.findall(statements)),
    )


def with_chosen_frames(
    positions: Positions, data: bytes, name: str, external_uses: ExternalUses
) -> Positions:
    """Return positions with the numbers that their program chooses for certain before it moves to them.

    Where it chooses none, positions stay without; where it is not certain which, they are left, with the reason.
    """
    open_ = rows_without_frames(positions)
    statements = statements_of(data)[1]
    uses, indirect = _first_uses(statements), _INDIRECT.search(statements)
    first_of_any = indirect.start() if indirect else len(statements)
    columns = {"frame": list(positions.user_frames), "tool": list(positions.tools)}
    barred = dict(positions.barred)
    for which, column in columns.items():
        number, place, why = _chosen_number(which, statements)
        why = why or external_uses.reached(
            external_uses.file, name, tool=which == "tool", frame=which == "frame"
        )
        for row in open_:
            if column[row] is not None or not (number or why):
                continue
            used = min(uses.get(positions.names[row], len(statements)), first_of_any)
            its_why = why or ("" if used > place else LATER)
            if its_why:
                barred.setdefault(row, its_why)
            else:
                column[row] = number
    return replace(
        positions, user_frames=tuple(columns["frame"]), tools=tuple(columns["tool"]), barred=barred
    )


def frames_set(file: str, name: str, data: bytes) -> dict[str, str]:
    """Return which frames and tools a program sets itself, and what to say of positions in them.

    The keys begin with the folder: programs of one controller lie together.
    """
    capitals = data.upper()
    if not any(word in capitals for word in _SETTABLE):  # as in nearly all
        return {}
    statements = statements_of(data)[1]
    frame_reasons = {
        (which, found.partition(b":")[0].strip())
        for which in _SET
        for found in _SET[which].findall(statements)
    }
    return {
        _register_key(file, which, str(int(number)) if number.isdigit() else _UNKNOWN): make_message(
            _SET_BY, name
        )
        for which, number in frame_reasons
    }


def mark_of_setter(file: str, name: str) -> dict[str, str]:
    """Return what a program that sets any frame or tool says of itself to those beside it."""
    return {f"{_setters(file)} {name}": make_message(_SET_BY, name)}


def setters_beside(file: str, marks: BatchReasons) -> Sequence[str]:
    """Return the programs of a file's folder that set any frame or tool, and that others call, or may."""
    return marks.rests_behind(_setters(file))


def is_made_alone(file: str, name: str, marks: BatchReasons) -> bool:
    """Return whether another program of a file's folder sets a frame or a tool that none calls by its name."""
    frames = (rest.partition(" ")[2] for rest in marks.rests_behind(_alone(file)))
    return any(other != name for other in (*frames, *marks.rests_behind(_tools_alone(file))))


def mark_of_starter(file: str, name: str) -> dict[str, str]:
    """Return what a program that lets others run beside it says of itself to those of its folder."""
    return {f"{_starters(file)} {name}": ""}


def is_run_beside(file: str, marks: BatchReasons) -> bool:
    """Return whether programs of a file's folder run beside others."""
    return bool(marks.rests_behind(_starters(file)))


def without_set_frames(positions: Positions, file: str, set_by_whom: Mapping[str, str]) -> Positions:
    """Return positions of which those are left whose frame or tool a program sets: the cell has another."""
    barred = dict(positions.barred)
    for which, column in (("frame", positions.user_frames), ("tool", positions.tools)):
        any_ = set_by_whom.get(_register_key(file, which, _UNKNOWN), "")  # a register says which
        whys = {name: set_by_whom.get(_register_key(file, which, name or ""), any_) for name in set(column)}
        for row, name in enumerate(column) if any(whys.values()) else ():
            if positions.kinds[row] == CARTESIAN and whys[name]:
                barred.setdefault(row, whys[name])
    return replace(positions, barred=barred) if len(barred) > len(positions.barred) else positions


def frames_made_alone(file: str, name: str, doubtful: Mapping[str, str]) -> dict[str, str]:
    """Return the user frames among what `frames_set` found, and whether tools are, as marks for other programs."""
    folder = PurePath(file).parent
    numbers = (key.removeprefix(f"{folder} frame ") for key in doubtful if key.startswith(f"{folder} frame "))
    of_tools = any(key.startswith(f"{folder} tool ") for key in doubtful)
    tools = {f"{_tools_alone(file)} {name}": ""} if of_tools else {}
    return {f"{_alone(file)} {number} {name}": "" for number in numbers} | tools


def with_frames_of_people(positions: Positions, file: str, name: str, marks: BatchReasons) -> Positions:
    """Return positions with a finding for each frame of theirs that another program makes when a person runs it."""
    made = sorted(rest.split(" ", 1) for rest in marks.rests_behind(_alone(file)))
    first_rows = {
        frame: row
        for row, frame in reversed(list(enumerate(positions.user_frames)))
        if frame is not None and positions.kinds[row] == CARTESIAN
    }
    found = [
        ProgramShift(
            int(positions.lines[row]), f"UFRAME[{frame}]=", ShiftAxes.USER_FRAME,
            point=f"UFRAME[{frame}]", user_frame=frame, made_by=maker,
        )
        for number, maker in made
        for frame, row in first_rows.items()
        if number in (frame, _UNKNOWN) and maker != name
    ]  # fmt: skip
    return replace(positions, shifts=(*positions.shifts, *found)) if found else positions


def _setters(file: str) -> str:
    return f"{PurePath(file).parent} setter"


def _starters(file: str) -> str:
    return f"{PurePath(file).parent} starter"


def _alone(file: str) -> str:
    return f"{PurePath(file).parent} alone"


def _tools_alone(file: str) -> str:
    return f"{PurePath(file).parent} tools alone"


def _register_key(file: str, which: str, number: str) -> str:
    return f"{PurePath(file).parent} {which} {number}"


def rows_without_frames(positions: Positions) -> list[int]:
    """Return the rows whose frame or tool is not written beside them."""
    if None not in positions.user_frames and None not in positions.tools:  # as in nearly all
        return []
    return [
        row
        for row, kind in enumerate(positions.kinds)
        if kind == CARTESIAN
        and positions.groups[row] == 1
        and (positions.user_frames[row] is None or positions.tools[row] is None)
    ]


def _chosen_number(which: str, statements: bytes) -> tuple[str, int, str]:
    """Return the one number that a program chooses, where for certain, and why there is no such."""
    numbers = _set_numbers(which, statements)
    if _UNKNOWN in numbers:
        return "", 0, COMPUTED
    if not numbers:
        return "", 0, ""
    if len(numbers) > 1:
        return "", 0, SEVERAL
    first = _ALONE[which].search(statements)
    branch = _BRANCHES.search(statements)
    place = first.start() if first else 0
    if branch is not None and branch.start() < place:
        return "", 0, LATER
    return next(iter(numbers)), place, ""


def _set_numbers(which: str, statements: bytes) -> set[str]:
    alone = [str(int(number)) for number in _ALONE[which].findall(statements)]
    return {*alone, *([_UNKNOWN] if len(alone) < len(_CHOSEN[which].findall(statements)) else ())}


def _called_programs(statements: bytes) -> set[str]:
    named = {name.decode("cp437").upper() for name in _CALL.findall(statements)}
    return named | {f"macro {text}" for text in _macros_in(statements)}


def _possible_programs(statements: bytes) -> set[frozenset[str]]:
    """Return of each call whose program no listing tells its likely names: most macros are called as theirs.

    A register may have any name.
    """
    of_macros = {
        frozenset(text.strip().upper().replace(" ", gap) for gap in ("", "_"))
        for text in _macros_in(statements)
    }
    return of_macros | {frozenset[str]() for name in _CALL.findall(statements) if b"[" in name}


def _macros_in(statements: bytes) -> set[str]:
    return {words.decode() for words in _MACROS.findall(statements) if NO_MACRO.match(words) is None}


def _first_uses(statements: bytes) -> dict[str, int]:
    """Return where each position is first moved to, one that a register chooses among them at every place."""
    found: dict[str, int] = {}
    for use in _USED.finditer(statements):
        found.setdefault(f"P[{int(use[1])}]", use.start())
    return found
