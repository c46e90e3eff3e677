"""Targets and moves as the controller itself writes them: nearly all of a large module, each read with one match.

They say what `module` and `instructions` make of them; what is written otherwise in any way is read there.
"""

import re

GAPS = (2, 1, 1, 3, 1, 1, 1)  # characters before each of a target's seven numbers, from its first bracket on
_NUMBER = r"-?\d{1,5}+(?:\.\d{1,12}+)?+"  # none is too large or too long
_NAME = r"[A-Za-z]\w*+(?![\x80-\xff])"
_BEFORE = r"[ \t\r\n;]*+"

USUAL = re.compile(
    rf"{_BEFORE}(?:"
    rf"(?P<a_target>(?:CONST|PERS) robtarget (?P<name>{_NAME}):="
    rf"(?P<open>\[)\[{','.join([f'({_NUMBER})'] * 3)}\],\[{','.join([f'({_NUMBER})'] * 4)}\],"
    rf"(?P<state>\[-?\d,-?\d,-?\d,-?\d\]),(?P<axes>\[[\d.,E+-]*+\])\](?=;))"
    rf"|(?P<a_move>Move[LJ] (?P<to>{_NAME}),\w++,\w++,(?P<tool>{_NAME})(?:\\WObj:=(?P<frame>{_NAME}))?+;)"
    r")",
    re.ASCII,
)
NUMBERS = tuple(range(USUAL.groupindex["open"] + 1, USUAL.groupindex["open"] + 8))
