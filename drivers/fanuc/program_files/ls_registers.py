"""Position registers that a listing uses: as places to go to, and in any other way."""

import re
from dataclasses import dataclass

from cellcal.drivers.fanuc.program_files.ls_remarks import statements_of
from cellcal.drivers.fanuc.program_files.ls_statements import motion_of, read_statements

UNSURE = "?"
_NUMBERED = re.compile(rb"[ \t]*+\d*+[ \t]*+:?[ \t]*+")
_GOES_TO = re.compile(rb"[JLCAS][ \t]++PR\[[ \t]*+(\d{1,5})[ \t]*+\][^\n]*+")
_USED = re.compile(rb"PR(?<![A-Z]PR)\[[ \t]*+(?:GP\d[ \t]*+:[ \t]*+)?(\d{1,5})")
_SETS = re.compile(
    rb"(UFRAME_NUM|BENUTZER_NUM|UTOOL_NUM|WKZ_NUM|MNUFRAMENUM|MNUTOOLNUM)"
    rb"[ \t]*+(?:\[ *+(?:GP *+)?+1 *+\][ \t]*+)?+=[ \t]*+(\d{1,3}+)?"
)
_FRAME_WORDS = (b"UFRAME_NUM", b"BENUTZER_NUM", b"MNUFRAMENUM")
_JUMPS = re.compile(rb"\b(?:LBL|JMP|CALL|AUFRUF|SPRUNG)\b")


@dataclass(frozen=True, slots=True)
class RegisterUse:
    """One use of a position register."""

    number: int
    line: int  # of the file, from 1
    goes_there: bool  # a motion's target and nothing else: it is a place, not a shift or a value
    user_frame: str | None  # in force there; None where no line sets one, UNSURE where it cannot be told
    tool: str | None


def registers_used(data: bytes) -> tuple[RegisterUse, ...]:
    """Return the uses of PR[n] in a listing, in the order of its lines.

    The frame and the tool are those set last above; where a program sets several and also jumps or calls, which one
    holds is not sure.
    """
    first, statements = statements_of(data)
    surely = not _JUMPS.search(statements)
    set_once = {word: _sets_one_number(statements, words) for word, words in _WORDS.items()}
    no_places = _lines_of_no_places(data)
    now: dict[str, str | None] = {"frame": None, "tool": None}
    found = []
    for at, line in enumerate(statements.split(b"\n"), first):
        for setting in _SETS.finditer(line):
            word = "frame" if setting[1] in _FRAME_WORDS else "tool"
            number = setting[2].decode() if setting[2] else None
            now[word] = number if number and (surely or set_once[word]) else UNSURE
        body = line[end.end() :] if (end := _NUMBERED.match(line)) else line
        target = _GOES_TO.match(body)
        uses = [int(use[1]) for use in _USED.finditer(body)]
        found += [
            RegisterUse(
                number,
                at,
                bool(target and len(uses) == 1 and int(target[1]) == number and at not in no_places),
                now["frame"],
                now["tool"],
            )
            for number in uses
        ]
    return tuple(found)


def indirect_line(data: bytes) -> int:
    """Return a line in which a register chooses the PR that is used otherwise than gone to; 0 where none does."""
    for statement in read_statements(data):
        if found := _CHOSEN.search(statement.text):
            goes_there = (
                statement.is_motion and _STARTS.match(statement.text) and motion_of(statement).is_place
            )
            if not goes_there or _CHOSEN.search(statement.text, found.end()):
                return statement.line
    return 0


def _lines_of_no_places(data: bytes) -> set[int]:
    """Return the lines of motions whose target is an increment, is led or is shifted."""
    return {
        line
        for statement in read_statements(data)
        if statement.is_motion and not motion_of(statement).is_place
        for line in range(statement.line, statement.line + statement.text.count(b"\n") + 1)
    }


_CHOSEN = re.compile(rb"PR(?<![A-Z]PR)\[[ \t]*+(?:GP\d[ \t]*+:[ \t]*+)?+[A-Za-z]{1,3}+\[")
_STARTS = re.compile(rb"[JLCAS][ \t]++PR\[[ \t]*+(?:GP\d[ \t]*+:[ \t]*+)?+[A-Za-z]{1,3}+\[")
_WORDS = {"frame": _FRAME_WORDS, "tool": (b"UTOOL_NUM", b"WKZ_NUM", b"MNUTOOLNUM")}


def _sets_one_number(statements: bytes, words: tuple[bytes, ...]) -> bool:
    """Tell whether a program sets one number, however often."""
    return len({found[2] for found in _SETS.finditer(statements) if found[1] in words}) == 1
