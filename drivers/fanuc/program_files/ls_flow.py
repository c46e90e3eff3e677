"""The ways through a listing: which statements may follow each one."""

import re
from collections import defaultdict
from collections.abc import Sequence

from cellcal.drivers.fanuc.program_files.ls_statements import Statement

_LABEL = re.compile(rb"(?:LBL|MARKE)\[[ \t]*+(\d++)", re.IGNORECASE)
_JUMPS = re.compile(rb"(?:LBL|MARKE)\[[ \t]*+(\d++|[A-Z])", re.IGNORECASE)
_GOES_ON_ELSEWHERE = re.compile(
    rb"(?:(?:JMP|SPRUNG)[ \t]++(?:LBL|MARKE)\[[^;\n]*+|END|ENDE|ABORT)", re.IGNORECASE
)
_LOOPS = re.compile(rb"(?:FOR|WHILE)\b", re.IGNORECASE)
_LOOP_ENDS = re.compile(rb"(?:ENDFOR|ENDWHILE)\b", re.IGNORECASE)
_PARTS = re.compile(rb"(?:IF|WENN)\b.*\b(?:THEN|DANN)", re.IGNORECASE | re.DOTALL)
_PART_ENDS = re.compile(rb"ENDIF", re.IGNORECASE)
_OTHER_PART = re.compile(rb"(?:ELSE|SONST)", re.IGNORECASE)


def ways_on(statements: Sequence[Statement]) -> list[set[int]]:
    """Return for each statement those that may be run next; the number of statements stands for the end."""
    texts = [each.text for each in statements]
    ways = [set() if _GOES_ON_ELSEWHERE.fullmatch(text) else {at + 1} for at, text in enumerate(texts)]
    _add_jumps(ways, texts)
    _add_blocks(ways, texts)
    return ways


def _add_jumps(ways: list[set[int]], texts: Sequence[bytes]) -> None:
    labels: dict[int, int] = {}
    for at, text in enumerate(texts):
        if found := _LABEL.match(text):
            labels.setdefault(int(found[1]), at)
    for at, text in enumerate(texts):
        for goal in _JUMPS.findall(text) if not _LABEL.match(text) else ():
            if goal.isdigit():
                ways[at] |= {labels[int(goal)]} if int(goal) in labels else set()
            else:  # a register chooses the label
                ways[at] |= set(labels.values())


def _add_blocks(ways: list[set[int]], texts: Sequence[bytes]) -> None:
    """Add the ways over and round the blocks of FOR, WHILE and IF."""
    opened: dict[str, list[int]] = defaultdict(list)
    for at, text in enumerate(texts):
        if _LOOPS.match(text):
            opened["loop"].append(at)
        elif _LOOP_ENDS.match(text) and opened["loop"]:
            begin = opened["loop"].pop()
            ways[at].add(begin)
            ways[begin].add(at + 1)
        elif _PARTS.fullmatch(text):
            opened["part"].append(at)
        elif _OTHER_PART.fullmatch(text) and opened["part"]:
            ways[opened["part"].pop()].add(at + 1)
            ways[at] = set()  # from above it goes on behind the end
            opened["part"].append(at)
        elif _PART_ENDS.fullmatch(text) and opened["part"]:
            ways[opened["part"].pop()].add(at)
