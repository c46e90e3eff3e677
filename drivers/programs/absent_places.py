"""Motions to places that no file of a batch declares: what the controller holds counts."""

import re
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping

from cellcal.drivers.programs.barred import OVERWRITTEN
from cellcal.drivers.programs.file_declarations import MoveFrames, array_name_of
from cellcal.drivers.programs.shifts import ProgramShift, ShiftAxes
from cellcal.drivers.programs.spans import ProgramText

_WORD_BEGINS = r"(?<![\w.$])"
_WORD = re.compile(rf"{_WORD_BEGINS}([A-Za-z_$]\w*+)")
_ELEMENT = r"[ \t]*(?:\[[^\]\n]*\]|\{[^}\n]*\})?"
_COMPONENT = rf"{_ELEMENT}((?:\.\w++)*+)"  # of a record: what is moved to, or gets a value
_FILLED = re.compile(
    rf"{_WORD_BEGINS}([A-Za-z_$]\w*+)[ \t]*\(|^[ \t]*([A-Za-z_$]\w*+){_COMPONENT}{_ELEMENT}[ \t]*:?=(?!=)",
    re.MULTILINE,
)
_MOVED_TO = re.compile(_WORD.pattern + _COMPONENT)
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
    if not uses:
        return
    code = _without_comments(source.text, comment)
    motion = rf"{_WORD_BEGINS}(?:{'|'.join(sorted(words))})[\s(][^{re.escape(statement_end)}]*?"
    index = _WordIndex(code, motion)
    for name, moves in sorted(uses.items()):
        found = index.first_moved_to(name)
        if found is None and all(each.why == OVERWRITTEN for each in moves):
            continue
        place, written = found or index.first_place(name) or (0, name)
        if index.is_filled(written):
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


class _WordIndex:
    """The words of a text, found in one pass: where each stands and is moved to first, and whether it is filled."""

    def __init__(self, code: str, motion: str) -> None:
        self._code, self._motion = code, motion
        self._first: dict[str, tuple[int, str]] = {}
        self._moved_to: dict[str, tuple[int, str]] = {}
        self._components: dict[str, set[str]] = defaultdict(set)  # that motions go to; "" for the whole
        self._filled: dict[str, set[str]] = defaultdict(set)
        for found in _FILLED.finditer(code):
            self._filled[(found[1] or found[2]).lower()].add((found[3] or "").lower())
        for found in _WORD.finditer(code):
            self._first.setdefault(found[1].lower(), (found.start(1), found[1]))
        for statement in re.finditer(motion.removesuffix("?"), code, re.IGNORECASE):
            for found in _MOVED_TO.finditer(code, statement.start() + 1, statement.end()):
                self._moved_to.setdefault(found[1].lower(), (found.start(1), found[1]))
                self._components[found[1].lower()].add(found[2].lower())

    def first_moved_to(self, name: str) -> tuple[int, str] | None:
        """Return where a motion first goes to a name, and how it is written; None for nowhere."""
        return (
            self._moved_to.get(name.lower())
            if name.isascii()
            else _first_place(self._code, self._motion, name)
        )

    def first_place(self, name: str) -> tuple[int, str] | None:
        """Return where a name first stands, and how it is written; None for nowhere."""
        return self._first.get(name.lower()) if name.isascii() else _first_place(self._code, "", name)

    def is_filled(self, name: str) -> bool:
        """Return whether a name is a function's, or gets a whole value in this file, which says where it is from.

        Of a record it is enough that the components get one that motions go to.
        """
        if not name.isascii():
            return _is_filled(self._code, name)
        filled = self._filled.get(name.lower(), set())
        return "" in filled or (bool(filled) and self._components.get(name.lower(), {""}) <= filled)


def _is_filled(code: str, name: str) -> bool:
    """Return whether a name is a function's, or gets a whole value in this file: that says where it comes from."""
    some = re.escape(name)
    called = _WORD_BEGINS + some + r"[ \t]*\("
    assigned = r"^[ \t]*" + some + r"[ \t]*(?:\[[^\]\n]*\]|\{[^}\n]*\})?[ \t]*:?=(?!=)"
    return re.search("|".join((called, assigned)), code, re.IGNORECASE | re.MULTILINE) is not None
