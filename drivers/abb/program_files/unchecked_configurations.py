r"""Programs that switch the check of configurations off: the arm goes to the nearest posture, whatever is written.

With ``ConfL\Off`` (MoveL, MoveC) and ``ConfJ\Off`` (MoveJ) confdata is not looked at (RAPID reference manual).
Programs that are made offline often carry one confdata in all targets, and rely on this.
"""

import re

_ROUTINE = re.compile(
    r"^[ \t]*+(?:LOCAL[ \t]++)?+PROC[ \t]++(\w++)(.*?)^[ \t]*+ENDPROC\b",
    re.IGNORECASE | re.MULTILINE | re.DOTALL,
)
_REMARK = re.compile(r"^[ \t]*+![^\n]*+", re.MULTILINE)
_MOVE = re.compile(r"^[ \t]*+(?:Move|Trigg|Arc|Search)\w*+[ \t]", re.IGNORECASE | re.MULTILINE)
_OFF = {word: re.compile(rf"^[ \t]*+Conf{word}[ \t]*+\\Off\b", re.IGNORECASE | re.MULTILINE) for word in "LJ"}
_ON = re.compile(r"^[ \t]*+Conf[LJ][ \t]*+\\On\b", re.IGNORECASE | re.MULTILINE)


def ignores_configurations(text: str) -> bool:
    """Tell whether all moves of a module surely run with both checks switched off."""
    if "conf" not in text.lower() or _ON.search(text) is not None:
        return False
    bodies = [(found[1].lower(), _REMARK.sub("", found[2])) for found in _ROUTINE.finditer(text)]
    off = [name for name, body in bodies if _off_before_moves(body)]
    moving = [name for name, body in bodies if _MOVE.search(body)]
    return bool(moving) and ("main" in off or set(moving) <= set(off))


def _off_before_moves(body: str) -> bool:
    move = _MOVE.search(body)
    until = len(body) if move is None else move.start()
    return all(pattern.search(body, 0, until) for pattern in _OFF.values())
