"""Position variables across jobs: all jobs of a controller share them, so one may change what another goes to.

What a job says of this goes to the other jobs of its folder as texts under keys: `FileDeclarations.doubtful`.
"""

import re
from collections.abc import Mapping
from pathlib import PurePath

from cellcal.calibration.message import make_message
from cellcal.drivers.yaskawa.program_files.job_remarks import MOVES
from cellcal.drivers.yaskawa.program_files.job_text import split_instruction
from cellcal.drivers.yaskawa.program_files.job_variables import FILLS, numbers_in

ANY = "*"  # in place of a number: a register chooses the variable
_LINES = re.compile(r"^[^\n]*?\bPX?(?:\d{3,5}\b|\[)[^\n]*", re.MULTILINE)
_CHOSEN_FIRST = re.compile(r"PX?\[")  # the variable that gets the value
_COMPUTED_BY = "job {} computes with this variable, or uses it as an amount"
_MAY_BE_COMPUTED_BY = "a register chooses the variables that job {} computes, and this may be one of them"
_STATED = re.compile(r"^P0*(\d{1,5})[ \t]*=", re.MULTILINE)


def variable_marks(file: str, job: str, head: str, instructions: str) -> dict[str, str]:
    """Return which variables a job computes with, and which of those that it states it only goes to."""
    folder, goes_to, computes = PurePath(file).parent, set[str](), set[str]()
    for line in _LINES.findall(instructions):
        word, rest = split_instruction(line)
        named = {str(number) for number in numbers_in(rest) if number >= 0}
        (goes_to if word in MOVES else computes).update(named)
        if word in FILLS and _CHOSEN_FIRST.match(rest):
            computes.add(ANY)
    stated = set(_STATED.findall(head)) if goes_to else set[str]()
    marks = {f"{folder} computes {job} {number}": job for number in computes}
    return marks | {f"{folder} places {job} {number}": job for number in (stated & goes_to) - computes}


def computed_elsewhere(file: str, job: str, number: int, marks: Mapping[str, str]) -> str:
    """Return which other job computes with a variable or uses it as an amount, as a reason; "" where none does."""
    others = [(name, which) for name, which in _marked(file, "computes", marks) if name != job]
    for form, chosen in ((_COMPUTED_BY, str(number)), (_MAY_BE_COMPUTED_BY, ANY)):
        for name, which in others:
            if which == chosen:
                return make_message(form, name)
    return ""


def placed_variables(file: str, marks: Mapping[str, str]) -> frozenset[str]:
    """Return the variables that a job of the folder states and goes to, by number."""
    return frozenset(number for _, number in _marked(file, "places", marks))


def _marked(file: str, what: str, marks: Mapping[str, str]) -> list[tuple[str, str]]:
    begins = f"{PurePath(file).parent} {what} "
    pairs = (key.removeprefix(begins).split(" ") for key in marks if key.startswith(begins))
    return [(name, number) for name, number in pairs]
