"""What a program does with positions besides moving to them, and what it lacks.

Statements are looked at, never executed; remarks and disabled lines are passed over. German statements are
those of public programs of German controllers; other languages are not known. Registers PR[…] are the same in all.
"""

import re
from collections.abc import Iterator

from drivers.programs.positions import Positions, Remark

_TOKENS = re.compile(
    rb"""
    (?P<skipped>   ^[ \t]*+\d*+[ \t]*+:[ \t]*+(?://|!|--)[^\n]*+
                 | '[^'\n]*+'                                                   ) |
    (?P<indirect>  (?<![A-Z])PR?\[[ ]*+(?:[A-Za-z]{1,3}\[)[^\]\n]*+               ) |
    (?P<used>      (?<![A-Za-z])P\[[ ]*+\d{1,5}+                                  ) |
    (?P<vision>    \bVR\[ | \bVOFFSET\b | \bV_OFFSET\b | \bVISION\b ) |
    (?P<offset>    \b(?:Tool_)?+Offset\b | \b(?:TOOL_)?+OFFSET\b | \bTouch\ Offset\b | \bStitch\b ) |
    (?P<position_register> (?<![A-Z])PR\[[^\]\n]*+                               ) |
    (?P<relative>  \bINC\b | \bCOORD(?:\[\d{0,3}\])?                                ) |
    (?P<computed>  \b(?:UFRAME_NUM|UTOOL_NUM|BENUTZER_NUM|WKZ_NUM)[ ]*+=[ ]*+[A-Z]{1,3}\[
                 | \b(?:UFRAME|UTOOL)\[[^\]\n]{0,40}+\][ ]*+=  | \bSkip, | \bInterrupt,
                 | \b(?:SKIP|IRQ)\ (?:CONDITION|BEDINGUNG) | \bPALLETIZING | \bPAL_\d
                 | \b(?:TRACK|Track)\b                                             ) |
    (?P<foreign>   \b(?:CALL|AUFRUF|RUN)[ ]++(?P<callee>[A-Za-z_][A-Za-z0-9_]{0,40}+)  ) |
    (?P<comment>   (?<![A-Za-z])[A-Za-z]{1,5}\[[ ]*+\d{1,5}+[ ]*+:[^\]\n]{0,80}+\]     )
    """,
    re.VERBOSE | re.MULTILINE,
)

_TEXT = {
    "indirect": "a register chooses the position ({what}…]): which one, only the running program knows",
    "vision": "a camera shifts the motion ({what}): the taught position is not where the robot goes",
    "offset": "{what} shifts the motion by a register that is not in this file",
    "position_register": "{what}] is a position register: it is kept in the controller, not in this file",
    "relative": "{what} makes the motion depend on another position or group, not on the user frame alone",
    "computed": "{what} is set or decided while the program runs",
    "foreign": "{what} runs another program; its positions are in its own file",
}


def remarks_of(data: bytes, start: int, end: int, positions: Positions) -> tuple[Remark, ...]:
    """Return what the statements between two offsets say about positions; line numbers are the file's."""
    line, at = data.count(b"\n", 0, start) + 1, start
    used: dict[int, int] = {}
    said: set[tuple[object, str]] = set()
    remarks: list[Remark] = []
    for found in _TOKENS.finditer(data, start, end):
        kind = found.lastgroup or ""
        kind = "foreign" if kind == "callee" else kind
        line += data.count(b"\n", at, found.start())
        at = found.start()
        if kind == "used":
            used.setdefault(int(found[0].partition(b"[")[2]), line)
        elif kind in _TEXT:
            key = (found["callee"] or line, kind)
            if key not in said:
                said.add(key)
                what = found[0].decode("cp437").strip()
                remarks.append(Remark(line, kind, _TEXT[kind].format(what=what) + "."))
    remarks += _unused_and_missing(used, positions, any(remark.code == "indirect" for remark in remarks))
    return tuple(sorted(remarks, key=lambda remark: remark.line))


def _unused_and_missing(used: dict[int, int], positions: Positions, indirect: bool) -> Iterator[Remark]:
    recorded = {int(name[2:-1]) for name in positions.names}
    for number in sorted(used.keys() - recorded):
        yield Remark(used[number], "missing", f"P[{number}] is used here, but not recorded under /POS.")
    spare = sorted(recorded - used.keys())
    if spare and not indirect:
        shown = ", ".join(f"P[{number}]" for number in spare[:20]) + (" and more" if len(spare) > 20 else "")
        yield Remark(
            0, "unused", f"{len(spare)} positions are recorded, but no statement uses them: {shown}."
        )
