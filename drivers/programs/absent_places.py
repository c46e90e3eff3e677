"""Motions to places that no file of a batch declares: what the controller holds counts."""

import re
from collections.abc import Iterator, Mapping

from cellcal.drivers.programs.cross_file_uses import MoveFrames, array_name_of
from cellcal.drivers.programs.shifts import ProgramShift, ShiftAxes
from cellcal.drivers.programs.spans import ProgramText

_WORD_BEGINS = r"(?<![\w.$])"
_GIVE_IT = "Give the file that declares it, too, or teach it there."


def absent_places(
    source: ProgramText, absent: Mapping[str, frozenset[MoveFrames]], words: str = r"[A-Za-z]\w*"
) -> Iterator[ProgramShift]:
    """Yield the motions of a file to names that no file declares; ``words`` are the instructions that move there."""
    for name in sorted({array_name_of(name) for name in absent}):
        moves = {each for key, some in absent.items() if array_name_of(key) == name for each in some}
        frames = {
            None if each.why or (each.frame or "").startswith("FDAT ") else each.frame for each in moves
        }
        target = "".join(
            (r"^[ \t]*(?:", words, r")[ \t(][^;!\n]*?", _WORD_BEGINS, "(", re.escape(name), r")(?!\w)")
        )
        written = re.search(target, source.text, re.IGNORECASE | re.MULTILINE)
        if written is None or _is_filled(source.text, written[1]):
            continue
        yield ProgramShift(
            source.line_of(written.start(1)),
            "move",
            ShiftAxes.USER_FRAME,
            point=written[1],
            user_frame=frames.pop() if len(frames) == 1 else None,
            absent=_GIVE_IT,
        )


def _is_filled(text: str, name: str) -> bool:
    """Tell whether a name is a function's, or gets a whole value in this file: that says where it comes from."""
    some = re.escape(name)
    called = _WORD_BEGINS + some + r"[ \t]*\("
    assigned = r"^[ \t]*" + some + r"[ \t]*(?:\[[^\]\n]*\]|\{[^}\n]*\})?[ \t]*:?=(?!=)"
    return re.search("|".join((called, assigned)), text, re.IGNORECASE | re.MULTILINE) is not None
