"""Data that a KRL routine gets by their name in a text, and may set (``SETVAR("BASE_DATA[1]",F)``, ``CWRITE``)."""

import re
from collections.abc import Iterator

from cellcal.drivers.kuka.program_files import patterns
from cellcal.drivers.kuka.program_files.frame_uses import UNKNOWN
from cellcal.drivers.kuka.program_files.krl_motions import KrlMotions
from cellcal.drivers.kuka.program_files.lines import KrlLine, find_item, without_strings
from cellcal.drivers.programs.barred import OVERWRITTEN

MAY_SET = re.compile(r'"|\bSET_?VAR', re.IGNORECASE)
_SETS = re.compile(rf'(?<![\w.$])SET_?VAR\w*+{patterns.B}*+\({patterns.B}*+("?+)', re.ASCII | re.IGNORECASE)
_ONLY_SHOWS = re.compile(r"(?<![\w.$])(?:MSG|VARSTATE|SET_KRL|STR)\w*+[ \t\r]*+\(", re.ASCII | re.IGNORECASE)
_TEXT = re.compile(r'"([^"\n]*+)"?+')
_ENTRY = re.compile(
    rf"\b(TOOL|BASE)_DATA\b(?:{patterns.B}*+\[{patterns.B}*+(\d{{1,8}}+){patterns.B}*+\])?+", re.IGNORECASE
)
_FRAMES = ("$TOOL", "$BASE")


def take_set_by_text(program: KrlMotions, line: KrlLine) -> None:
    """Take what a line may set by a name in a text: an entry in any call, a point or a frame in SETVAR."""
    text, routine = program.found.source.text, program.points.routines[-1]
    code = text[line.start : line.end]
    if "(" not in without_strings(code):
        return
    for which, number in _entries(code):
        program.tables.note_setting(which, number, routine, line.start, program.branches, UNKNOWN)
        program.points.set_tables.add(f"{which} {number}")
    for sets in _SETS.finditer(code):
        name = find_item(text, line.start + sets.end(), line.end) if sets[1] else None
        if name is None or name.name.upper() in patterns.TABLES:
            continue
        bare = name.name.upper()
        if bare in _FRAMES:
            use = routine.tool if bare == "$TOOL" else routine.base
            use.take_value(line.start, UNKNOWN, program.branches)
        elif bare[0] == "$":
            program.points.sets_root |= bare in patterns.ROOTS
        else:
            routine.assigned.add(bare)
            program.points.set_data.add(bare)
            program.note_use(name.name, name.index, line.start, OVERWRITTEN)


def _entries(code: str) -> Iterator[tuple[str, str]]:
    """Yield the entries, as ("BASE", "3") or with "*" for any, that a line may set by their names."""
    if _ONLY_SHOWS.search(code) is None:
        for text in _TEXT.findall(code):
            for which, number in _ENTRY.findall(text):
                yield which.upper(), str(int(number)) if number else "*"
    if any(not sets[1] for sets in _SETS.finditer(code)):  # by a name that is computed
        yield from (("TOOL", "*"), ("BASE", "*"))
