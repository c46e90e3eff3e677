r"""Programs that switch the check of configurations off: the arm goes to the nearest posture, whatever is written.

With ``ConfL\Off`` (MoveL, MoveC) and ``ConfJ\Off`` (MoveJ) confdata is not looked at (RAPID reference manual).
Programs that are made offline often carry one confdata in all targets, and rely on this.
"""

import re
from collections.abc import Sequence, Set

from cellcal.drivers.abb.program_files.instructions import MOVES
from cellcal.drivers.abb.program_files.literals import NAME

_HIDDEN = re.compile(r'"(?:[^"\n]++|"")*+"?+|![^\n]*+')  # strings and comments
_ROUTINE = re.compile(
    rf"^[ \t]*+(?:LOCAL\s++)?+(?:PROC|TRAP|FUNC\s++\w++)\s++({NAME})(.*?)^[ \t]*+END(?:PROC|TRAP|FUNC)\b",
    re.IGNORECASE | re.MULTILINE | re.DOTALL,
)
_OTHER_MOVE = re.compile(r"^[ \t]*+(?:Move|Trigg|Arc|Search)\w*+[ \t]", re.IGNORECASE | re.MULTILINE)
_WORD = re.compile(rf"(?<![\w.\x80-\xff]){NAME}|%", re.ASCII)
_CHECK_ON = re.compile(r"\bConf[LJ]\b(?!\s*+\\\s*+Off\b)", re.IGNORECASE)  # without an argument, too
_BLOCK_BEGINS = frozenset(("for", "while", "test"))
_BLOCK_ENDS = frozenset(("endif", "endfor", "endwhile", "endtest"))
# What may step over the statements below it, begins a handler, or calls a routine that a variable names.
_ENDS_STRAIGHT = frozenset(("goto", "error", "undo", "backward", "callbyvar", "%"))
_THEN = re.compile(r"\bTHEN\b", re.IGNORECASE)


def ignores_configurations(text: str) -> bool:
    """Return whether all moves of a module surely run with both checks switched off."""
    if "conf" not in text.lower():
        return False
    code = _HIDDEN.sub(" ", text)
    if _CHECK_ON.search(code) is not None:
        return False
    bodies = [(found[1].lower(), found[2]) for found in _ROUTINE.finditer(code)]
    words = [(name, {word.lower() for word in _WORD.findall(body)}) for name, body in bodies]
    moving = {
        name
        for (name, some), (_, body) in zip(words, bodies, strict=True)
        if not some.isdisjoint(MOVES) or _OTHER_MOVE.search(body)
    }
    if not moving:
        return False
    callers = _with_callers(moving, words)
    off = {name for name, body in bodies if _switches_off_first(body, callers)}
    return "main" in off or moving <= off


def _with_callers(moving: Set[str], words: Sequence[tuple[str, Set[str]]]) -> Set[str]:
    """Return routines that move, and those that call them, one through another."""
    found, before = set(moving), -1
    while len(found) != before:
        before = len(found)
        found |= {name for name, some in words if not some.isdisjoint(found)}
    return found


def _switches_off_first(body: str, moving: Set[str]) -> bool:
    """Return whether a routine switches both checks off in any case, before it moves or calls what moves."""
    other = _OTHER_MOVE.search(body)
    depth, place, only_if, left = 0, 0, 0, {"confl", "confj"}
    while left and (word := _WORD.search(body, place, len(body) if other is None else other.start())):
        name, place = word[0].lower(), word.end()
        if name in MOVES or name in moving or name in _ENDS_STRAIGHT:
            return False
        if name == "if":
            end = body.find(";", place)
            if _THEN.search(body, place, max(end, place)) is not None:
                depth += 1
            else:
                only_if = end  # one statement, without ENDIF
        elif name in _BLOCK_BEGINS:
            depth += 1
        elif name in _BLOCK_ENDS:
            depth -= 1
        elif not depth and word.start() >= only_if:
            left.discard(name)
    return not left
