"""Amounts of SFTON across jobs: which variables get lengths only, and which may turn what they shift.

What a job says of this goes to the other jobs of its folder as texts under keys: `FileDeclarations.doubtful`.
"""

import re
from pathlib import PurePath

from cellcal.drivers.programs.file_declarations import BatchReasons
from cellcal.drivers.yaskawa.program_files.job_shared_variables import ANY, VARIABLE_LINES
from cellcal.drivers.yaskawa.program_files.job_text import split_instruction
from cellcal.drivers.yaskawa.program_files.job_variables import (
    AMOUNTS,
    filled_variables,
    numbers_in,
    turned_amounts,
)

_IN_TOOL = re.compile(r"\bTF\b")
_ANGLES = 3
_NO_ANGLE = re.compile(r"[+-]?0*\.?0*")
_STATED_ROW = re.compile(r"^P0*(\d{1,5})[ \t]*=([^\r\n]*)", re.MULTILINE)


def amount_marks(file: str, job: str, head: str, instructions: str) -> dict[str, str]:
    """Return by what a job shifts, and which variables it fills with lengths only or with what may turn."""
    folder = PurePath(file).parent
    lines = [
        (word, rest, numbers_in(rest))
        for word, rest in map(split_instruction, VARIABLE_LINES.findall(instructions))
    ]
    stated = dict(_STATED_ROW.findall(head))
    filled = filled_variables([one for one in lines if one[2]], {int(number) for number in stated})
    turned = turned_amounts([one for one in lines if one[0] in AMOUNTS and one[2]])
    turned |= {int(number) for number, text in stated.items() if _may_turn(text)}
    straight = (filled | {int(number) for number in stated}) - turned
    amounts = [numbers for word, rest, numbers in lines if word == "SFTON" and not _IN_TOOL.search(rest)]
    shared = sorted({number for numbers in amounts for number in numbers if number >= 0})
    is_uncertain = any(
        not numbers or any(number < 0 and number not in straight for number in numbers) for numbers in amounts
    )
    marks = {f"{folder} amount {number} {job}": job for number in (*shared, *(ANY,) * is_uncertain)}
    marks |= {f"{folder} straight {number} {job}": job for number in sorted(straight) if number >= 0}
    return marks | {f"{folder} turned {number} {job}": job for number in sorted(turned) if number >= 0}


def _may_turn(text: str) -> bool:
    """Return whether the numbers of a variable hold an angle, or are no pose."""
    angles = text.split(",")[_ANGLES : 2 * _ANGLES]
    return len(angles) < _ANGLES or any(_NO_ANGLE.fullmatch(each.strip()) is None for each in angles)


def is_straight_amount(file: str, number: int, marks: BatchReasons) -> bool:
    """Return whether a job of the folder gives a variable a value, and none one that may turn."""
    folder = PurePath(file).parent
    turning = (f"{folder} turned {number}", f"{folder} computes {ANY}")
    return bool(marks.rests_behind(f"{folder} straight {number}")) and not any(
        map(marks.rests_behind, turning)
    )


def may_shifts_turn(file: str, marks: BatchReasons) -> bool:
    """Return whether an amount of SFTON in the jobs of the folder may turn what it shifts."""
    amounts = {rest.partition(" ")[0] for rest in marks.rests_behind(f"{PurePath(file).parent} amount")}
    return any(each == ANY or not is_straight_amount(file, int(each), marks) for each in amounts)
