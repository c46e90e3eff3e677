"""Positions written with UF : F or UT : F, which stand in the frame or tool that is chosen when they are moved to."""

import re
from dataclasses import replace

from drivers.fanuc.ls_remarks import statements_of
from drivers.programs.barred import COMPUTED, LATER, SEVERAL
from drivers.programs.positions import CARTESIAN, Positions

_WORDS = {"frame": rb"(?:UFRAME_NUM|BENUTZER_NUM)", "tool": rb"(?:UTOOL_NUM|WKZ_NUM)"}
_CHOSEN = {which: re.compile(rb"\b" + word + rb"\b[^=;<>\n]{0,40}+=") for which, word in _WORDS.items()}
_ALONE = {
    which: re.compile(rb"^[ \t]*+\d*+[ \t]*+:[ \t]*+" + word + rb" *+= *+(\d{1,3}+) *+;", re.MULTILINE)
    for which, word in _WORDS.items()
}
_USED = re.compile(rb"P(?<![A-Za-z]P)\[ *+(\d{1,5}+)")
# Above the first of these, every statement is run, once and in order.
_BRANCHES = re.compile(rb"\b(?:IF|WENN|LBL|MARKE|JMP|SPRUNG|SELECT|FOR|WHILE|SKIP|ABORT|END|ENDE)\b")
_INDIRECT = re.compile(rb"P(?<![A-Za-z]P)\[ *+[A-Za-z]")

_CALL = re.compile(rb"\b(?:CALL|AUFRUF)\b")

_CALLED = "a program that its program calls may choose another frame or tool"


def with_chosen_frames(positions: Positions, data: bytes) -> Positions:
    """Return positions with the numbers that their program chooses for certain before it moves to them.

    Where it chooses none, positions stay without; where it is not certain which, they are left, with the reason.
    """
    if None not in positions.user_frames and None not in positions.tools:  # as in nearly all
        return positions
    open_ = [
        row
        for row, kind in enumerate(positions.kinds)
        if kind == CARTESIAN
        and positions.groups[row] == 1
        and (positions.user_frames[row] is None or positions.tools[row] is None)
    ]
    if not open_:
        return positions
    statements = statements_of(data)[1]
    uses, indirect = _first_uses(statements), _INDIRECT.search(statements)
    first_of_any = indirect.start() if indirect else len(statements)
    columns = {"frame": list(positions.user_frames), "tool": list(positions.tools)}
    barred = dict(positions.barred)
    for which, column in columns.items():
        number, place, why = _choice(which, statements)
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


def _choice(which: str, statements: bytes) -> tuple[str, int, str]:
    """Return the one number that a program chooses, where for certain, and why there is no such."""
    alone = list(_ALONE[which].finditer(statements))
    if len(alone) < len(_CHOSEN[which].findall(statements)):
        return "", 0, COMPUTED
    if not alone:
        return "", 0, ""
    if len({int(found[1]) for found in alone}) > 1:
        return "", 0, SEVERAL
    if _CALL.search(statements):
        return "", 0, _CALLED
    branch = _BRANCHES.search(statements)
    if branch is not None and branch.start() < alone[0].start():
        return "", 0, LATER
    return str(int(alone[0][1])), alone[0].start(), ""


def _first_uses(statements: bytes) -> dict[str, int]:
    """Return where each position is first moved to, one that a register chooses among them at every place."""
    found: dict[str, int] = {}
    for use in _USED.finditer(statements):
        found.setdefault(f"P[{int(use[1])}]", use.start())
    return found
