"""Motions to places that no file of a batch declares: what the controller holds counts."""

import re
from collections.abc import Collection, Iterator, Mapping

from cellcal.drivers.programs.barred import OVERWRITTEN
from cellcal.drivers.programs.file_declarations import MoveFrames, array_name_of
from cellcal.drivers.programs.shifts import ProgramShift, ShiftAxes
from cellcal.drivers.programs.spans import ProgramText

_WORD_BEGINS = r"(?<![\w.$])"
_GIVE_IT = "Give the file that declares it, too, or teach it there."


def absent_places(
    source: ProgramText,
    absent: Mapping[str, frozenset[MoveFrames]],
    words: Collection[str],
    *,
    comment: str,
    statement_end: str,
) -> Iterator[ProgramShift]:
    """Yield the motions of a file to names that no file declares.

    ``words`` are the instructions that move there; ``comment`` begins a comment, and ``statement_end`` ends a
    statement.
    """
    uses: dict[str, set[MoveFrames]] = {}
    for name, some in absent.items():
        uses.setdefault(array_name_of(name), set()).update(some)
    code = _without_comments(source.text, comment) if uses else ""
    motion = rf"{_WORD_BEGINS}(?:{'|'.join(sorted(words))})[\s(][^{re.escape(statement_end)}]*?"
    for name, moves in sorted(uses.items()):
        found = _first_place(code, motion, name)
        if found is None and all(each.why == OVERWRITTEN for each in moves):
            continue
        place, written = found or _first_place(code, "", name) or (0, name)
        if _is_filled(code, written):
            continue
        frames = {
            None if each.why or (each.frame or "").startswith("FDAT ") else each.frame for each in moves
        }
        yield ProgramShift(
            source.line_of(place),
            "move",
            ShiftAxes.USER_FRAME,
            point=_decode(written),
            user_frame=frames.pop() if len(frames) == 1 else None,
            absent=_GIVE_IT,
        )


def _without_comments(text: str, comment: str) -> str:
    """Return a text with blanks in place of comments and strings, of the same length."""
    hidden = rf'"(?:[^"\n]|"")*+"?+|{re.escape(comment)}[^\n]*+'
    return re.sub(hidden, lambda found: " " * len(found[0]), text)


def _first_place(code: str, before: str, name: str) -> tuple[int, str] | None:
    """Return where a name first stands behind what a pattern matches, and how it is written; None for nowhere."""
    for spelled in dict.fromkeys((name, name.encode().decode("latin-1"))):
        found = re.search(rf"{before}{_WORD_BEGINS}({re.escape(spelled)})(?!\w)", code, re.IGNORECASE)
        if found is not None:
            return found.start(1), found[1]
    return None


def _decode(written: str) -> str:
    """Return a name as it is read where its file is written in UTF-8."""
    try:
        return written.encode("latin-1").decode()
    except UnicodeError:
        return written


def _is_filled(code: str, name: str) -> bool:
    """Tell whether a name is a function's, or gets a whole value in this file: that says where it comes from."""
    some = re.escape(name)
    called = _WORD_BEGINS + some + r"[ \t]*\("
    assigned = r"^[ \t]*" + some + r"[ \t]*(?:\[[^\]\n]*\]|\{[^}\n]*\})?[ \t]*:?=(?!=)"
    return re.search("|".join((called, assigned)), code, re.IGNORECASE | re.MULTILINE) is not None
