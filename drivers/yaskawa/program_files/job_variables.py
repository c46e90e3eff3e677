"""Position variables of a job: which get the place where the robot stands, and what the job computes from such.

A local variable LP012 has the number -13. Variables that no instruction here fills are those of other jobs.
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass, field

from cellcal.drivers.programs.call_graph import find_reached

TAKEN = re.compile(r"(?<!\$)\b(L?)P(?:X)?(\d{3,5})\b|\bC(\d{3,5})\b")
_HERE = frozenset(("GETS", "GETPOS"))
AMOUNTS = frozenset(
    ("SFTON", "MSHIFT", "SET", "SETE", "ADD", "SUB", "MUL", "DIV", "CNVRT", "MULMAT", "INVMAT")
)
FILLS = (AMOUNTS - {"SFTON"}) | _HERE | {"GETARG"}  # whose first variable gets a value
_SUMS = frozenset(("ADD", "SUB"))  # of coordinates, which go along with a shift; sums of joints do not
_PRODUCTS = frozenset(("MUL", "DIV", "MULMAT", "INVMAT"))
_IN_PULSES = re.compile(
    r"\$PX?0++\b|\bPULSE\b"
)  # $PX000 is where the robot stands in pulses, $PX001 in coordinates
_KEEPS_ANGLES = re.compile(
    r"\([ \t]*+(?:[123][ \t]*+\)|\d++[ \t]*+\)[ \t]*+-?+0++[ \t]*+$)"
)  # a length, or zero
Instruction = tuple[int, str, str]  # line, word, rest
WORDS_BEFORE = r"""(?:[^\n'"]|"[^\n"]*+")*?"""  # of an instruction: no remark, and nothing in quotes
# What names a user frame or a tool and leaves it as it is; any other instruction may make it.
_ONLY_USES = r"SFTON|MSHIFT|CNVRT|CALL|JUMP|PSTART|GET\w*|[A-Z]*MOV\w*"
MADE = re.compile(
    rf"^[ \t]*+(?!(?:{_ONLY_USES})\b)([A-Z]\w*+){WORDS_BEFORE}\b(UF|TL)#\((\d{{1,3}}|[A-Z])", re.MULTILINE
)


@dataclass
class ComputedVariables:
    """Variables by number."""

    from_here: set[int] = field(default_factory=set)  # that get where the robot was, or a taught position
    computed: set[int] = field(default_factory=set)  # of these, those that the job computes with
    set_in_part: set[int] = field(default_factory=set)  # of these, those of which SETE sets an element
    uncertain: set[int] = field(
        default_factory=set
    )  # of these, those that a shift of the place does not shift alike
    filled: set[int] = field(default_factory=set)  # that an instruction gives a value
    turned: set[int] = field(default_factory=set)  # amounts that may turn: by MSHIFT, or SETE of an angle


def numbers_in(rest: str) -> list[int]:
    """Return the variables that an instruction names, in their order."""
    return [number_of(each) for each in TAKEN.finditer(rest) if each[2]]


def number_of(taken: re.Match[str]) -> int:
    """Return a variable's number, below zero for a local one."""
    return -int(taken[2]) - 1 if taken[1] else int(taken[2])


def filled_variables(lines: Sequence[tuple[str, str, list[int]]], stated: Set[int]) -> set[int]:
    """Return the variables that instructions give a value, from nothing but stated or filled ones."""
    fills = [numbers for word, rest, numbers in lines if word in FILLS and numbers_in(rest.partition(" ")[0])]
    filled = {numbers[0] for numbers in fills}
    missing = {number for numbers in fills for number in numbers[1:]} - filled - stated
    return filled - spread_variables(missing, [(numbers[0], set(numbers[1:]) - stated) for numbers in fills])


def spread_variables(start: Set[int], copies: Iterable[tuple[int, Iterable[int]]]) -> set[int]:
    """Return the variables to start with, and each that gets its value from one of these.

    Each copy is the variable that gets a value, and those that the value comes from.
    """
    receivers = defaultdict[int, set[int]](set)
    for receiver, sources in copies:
        for source in sources:
            receivers[source].add(receiver)
    return set(find_reached(receivers, start))


def computed_variables(
    instructions: Iterable[Instruction], stated: Set[int] = frozenset()
) -> ComputedVariables:
    """Return what a job's instructions, in whatever order, make of where the robot stands."""
    written = [(word, rest, numbers) for _, word, rest in instructions if (numbers := numbers_in(rest))]
    lines = [one for one in written if one[0] in _HERE or one[0] in AMOUNTS]
    found = ComputedVariables(filled=filled_variables(written, stated), turned=turned_amounts(lines))
    for word, _, numbers in lines:
        found.from_here.update(numbers if word in _HERE else ())
    found.from_here = spread_variables(
        found.from_here, [(numbers[0], numbers[1:]) for word, _, numbers in lines if word in AMOUNTS]
    )
    computing = [one for one in lines if one[0] in AMOUNTS and found.from_here.intersection(one[2])]
    found.computed = {numbers[0] for _, _, numbers in computing}
    found.set_in_part = found.computed & {numbers[0] for word, _, numbers in lines if word == "SETE"}
    found.uncertain = found.computed & _not_shifted_alike(lines)
    return found


def turned_amounts(lines: Sequence[tuple[str, str, list[int]]]) -> set[int]:
    """Return the variables that a difference of two places, or an angle that is set, makes, and what gets them."""
    turned = {
        numbers[0]
        for word, rest, numbers in lines
        if word == "MSHIFT" or (word == "SETE" and not _KEEPS_ANGLES.search(rest))
    }
    return spread_variables(
        turned, [(numbers[0], numbers[1:]) for word, _, numbers in lines if word in AMOUNTS]
    )


def _not_shifted_alike(lines: Sequence[tuple[str, str, list[int]]]) -> set[int]:
    """Return the variables that sums of joints or products make, and their copies."""
    joints = {
        number
        for word, rest, numbers in lines
        if word == "GETPOS" or (word in ("GETS", "CNVRT") and _IN_PULSES.search(rest))
        for number in numbers[:1]
    }
    copies = [(word, numbers[0], numbers[1:]) for word, _, numbers in lines if word in ("SET", "CNVRT")]
    joints = spread_variables(joints, [(first, others) for word, first, others in copies if word == "SET"])
    uncertain = {
        numbers[0]
        for word, _, numbers in lines
        if word in _PRODUCTS or (word in _SUMS and joints.intersection(numbers))
    }
    return spread_variables(uncertain, [(first, others) for _, first, others in copies])
