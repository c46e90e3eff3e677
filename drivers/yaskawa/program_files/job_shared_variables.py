"""Position variables across jobs: all jobs of a controller share them, so one may change what another goes to.

What a job says of this goes to the other jobs of its folder as texts under keys: `FileDeclarations.doubtful`.
"""

import re
from pathlib import PurePath

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.file_declarations import BatchReasons
from cellcal.drivers.yaskawa.program_files.job_remarks import MOVES
from cellcal.drivers.yaskawa.program_files.job_text import split_instruction
from cellcal.drivers.yaskawa.program_files.job_variables import FILLS, numbers_in, spread_variables

ANY = "*"  # in place of a number: a register chooses the variable
VARIABLE_LINES = re.compile(r"^[^\n]*?\bL?PX?(?:\d{3,5}\b|\[)[^\n]*", re.MULTILINE)
_CHOSEN_FIRST = re.compile(r"PX?\[")  # the variable that gets the value
_COMPUTED_BY = "job {} computes with this variable, or uses it as an amount"
_MAY_BE_COMPUTED_BY = "a register chooses the variables that job {} computes, and this may be one of them"
_ONLY_FILL = frozenset(("GETS", "GETPOS", "GETARG", "SETE"))  # whose first variable is not read
_STATED = re.compile(r"^P0*(\d{1,5})[ \t]*=", re.MULTILINE)


def variable_marks(file: str, job: str, head: str, instructions: str) -> dict[str, str]:
    """Return which variables a job computes with, and which of those that it states it only goes to."""
    folder, goes_to, others = PurePath(file).parent, set[int](), set[int]()
    filled, used, chosen = set[int](), set[int](), False
    copies: list[tuple[int, list[int]]] = []  # a variable, and what SET copies into it
    for line in VARIABLE_LINES.findall(instructions):
        word, rest = split_instruction(line)
        named = numbers_in(rest)
        (goes_to if word in MOVES else others).update(named)
        first = numbers_in(rest.partition(" ")[0]) if word in FILLS else []
        chosen = chosen or (word in FILLS and _CHOSEN_FIRST.match(rest) is not None)
        filled.update(first)
        if word == "SET":
            copies += [(number, named[1:]) for number in first]
        elif word not in MOVES and word != "GETE":
            used.update(named[len(first) :] if word in _ONLY_FILL else named)
    # a copy of a place may be an amount, and then the place is
    used = spread_variables(used, [(source, (number,)) for number, sources in copies for source in sources])
    computes = {str(number) for number in filled | used if number >= 0}
    stated = {int(number) for number in _STATED.findall(head)} if goes_to else set[int]()
    marks = {f"{folder} computes {number} {job}": job for number in (*sorted(computes), *(ANY,) * chosen)}
    return marks | {f"{folder} places {number} {job}": job for number in sorted((stated & goes_to) - others)}


def computed_elsewhere(file: str, job: str, number: int, marks: BatchReasons) -> str:
    """Return which other job computes with a variable or uses it as an amount, as a reason; "" where none does."""
    for form, chosen in ((_COMPUTED_BY, str(number)), (_MAY_BE_COMPUTED_BY, ANY)):
        for name in marks.rests_behind(f"{PurePath(file).parent} computes {chosen}"):
            if name != job:
                return make_message(form, name)
    return ""


def is_placed(file: str, number: str, marks: BatchReasons) -> bool:
    """Return whether a job of the folder states a variable and goes to it."""
    return bool(marks.rests_behind(f"{PurePath(file).parent} places {number}"))
