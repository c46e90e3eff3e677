"""Targets, tools and work objects that a RAPID module passes to functions whose file is not given.

Such a function may move to the target, or give any of them another value. A procedure that is not given is a finding.
"""

import re
from collections.abc import Iterator, Sequence

from cellcal.drivers.abb.program_files.frame_facts import BARRED_SET
from cellcal.drivers.abb.program_files.literals import NAME, decode_name
from cellcal.drivers.abb.program_files.reading_routines import is_of_robotware
from cellcal.drivers.programs.file_declarations import BatchReasons
from cellcal.drivers.programs.positions import Positions

HAS_ROUTINE = "has routine"  # before a routine and its file
PASSED = "a function whose file is not given gets it, or its tool or work object, and may change that"
_PASSES = "passes"  # before a function, what it gets, and the file
_SILENT = re.compile(r'![^\n]*+|"(?:[^"\n]++|"")*+"')
_HEADER = re.compile(r"\b(?:PROC|FUNC[ \t]++\w++)[ \t]++\w++[ \t\r\n]*+\([^()]*+\)", re.ASCII | re.IGNORECASE)
_SIGN = re.compile(rf"(?<![\w.%])(?P<called>{NAME})\s*+\(|[(){{}}\[\];,]", re.ASCII)
_ARGUMENT = re.compile(
    rf"\s*+(?:\\?\s*+{NAME}\s*+:=\s*+)?+({NAME})\s*+(?:\{{[^{{}}]*+\}}\s*+)?+(?:\.[\w.\s]*+)?+(?:\\[^,]*+)?+",
    re.ASCII,
)


def marks_of_passed(text: str, file: str) -> dict[str, str]:
    """Return what a file says to all of the data that it passes to functions which may be any."""
    if "(" not in text:
        return {}
    silent = _SILENT.sub(lambda found: " " * len(found[0]), text)
    silent = _HEADER.sub(lambda found: " " * len(found[0]), silent)
    return {
        f"{_PASSES} {callee} {name} {file}": BARRED_SET for callee, name in sorted(set(_passed_in(silent)))
    }


def _passed_in(silent: str) -> Iterator[tuple[str, str]]:
    """Yield the functions that are called, none of the language, and the data that each gets, in one pass."""
    opened: list[
        tuple[str, int]
    ] = []  # what the brackets that are open belong to, "" for none, and an argument's begin
    for sign in _SIGN.finditer(silent):
        if sign[0] == ";":
            opened.clear()
        elif sign["called"] is not None or sign[0] in "({[":
            opened.append(((sign["called"] or "").lower(), sign.end()))
        elif opened:
            callee, start = opened.pop()
            named = _ARGUMENT.fullmatch(silent, start, sign.start()) if callee else None
            if named is not None and not is_of_robotware(callee):
                yield decode_name(callee), decode_name(named[1]).lower()
            if sign[0] == ",":
                opened.append((callee, sign.end()))


def rows_of_passed(positions: Positions, keys: Sequence[str], marks: BatchReasons) -> dict[int, str]:
    """Return the positions that a function which no file has gets, or whose tool or work object it gets, and why."""
    passed = marks.derive_once(_PASSES, lambda: _passed_to_missing(marks))
    if not passed:
        return {}
    found = {}
    for row, key in enumerate(keys):
        frames = [
            (name or "").lower().partition("=")[0]
            for name in (positions.tools[row], positions.user_frames[row])
        ]
        if passed.intersection((key.rpartition(":")[2].partition("{")[0], *frames)):
            found[row] = PASSED
    return found


def _passed_to_missing(marks: BatchReasons) -> frozenset[str]:
    found = set()
    for rest in marks.rests_behind(_PASSES):
        callee, _, behind = rest.partition(" ")
        if not marks.rests_behind(f"{HAS_ROUTINE} {callee}"):
            found.add(behind.partition(" ")[0])
    return frozenset(found)
