"""What a job's motions do to its positions: increments, led motions, shifts, frames made while it runs, row by row.

Nothing is executed. A shift holds from SFTON to SFTOF in the order of the lines; where the job jumps, or
switches it in a branch or a loop, everywhere.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, Positions
from cellcal.drivers.programs.shifts import NO_TURN, ProgramShift, Quaternion, ShiftAxes
from cellcal.drivers.yaskawa.program_files.job_axis_rows import axis_rows_of, groups_without_rows
from cellcal.drivers.yaskawa.program_files.job_columns import SHIFT
from cellcal.drivers.yaskawa.program_files.job_text import (
    ROBOT_ROWS,
    JobRow,
    YaskawaJob,
    iterate_instructions,
    shifts_in_blocks,
)
from cellcal.drivers.yaskawa.program_files.job_variables import (
    AMOUNTS,
    FILLS,
    MADE,
    TAKEN,
    WORDS_BEFORE,
    ComputedVariables,
    computed_variables,
    number_of,
    numbers_in,
)

_SEVEN = 7  # numbers of a row with a seventh axis
Key = tuple[str, int]  # C or P, and its number
_Effect = tuple[str, ShiftAxes, Quaternion | None]  # all that a point's finding says of a shift but its line
_MOST_SHIFTS = 16  # by further variables that no file fills, shifts are one
_INCREMENT = "it is an increment: {} in line {} adds it to where the robot is"
_LED_MOTION = "another control group leads the motion there ({} in line {})"
_ON_CONVEYOR = "the motion there follows a conveyor ({} in line {})"
_OTHER_MOTION = "its motion is about a point in the cell that the job does not state ({} in line {})"
_ANY_AMOUNT = "a register chooses the variables that {} in line {} uses as amounts"
_SET_HERE = "its job makes its user frame or tool while it runs ({} in line {})"
_NOT_KNOWN = "line {line} names it behind {word}, and what that does with it is not known"
_IN_TOOL = "it is stated along the axes of the tool: an amount, and no place"
_VARIABLE_AMOUNT = (
    "no move of its job goes to this variable, or the job computes with it: it may be an amount"
)
_NO_GROUP_ROWS = "the job moves {} too, and holds no position of it"
_IN_MASTER = "it is stated in the tool of a master robot, which carries the work"
_OTHER_RELATIVE = "its row stands in {}, and the relative job in {}: which one counts, the job does not say"
_DECIMAL_COMMA = (
    "its row holds seven numbers, some of them without decimals: a comma may be a decimal mark there"
)
_OTHERS = "what other jobs go to while it holds"
UNFILLED_AMOUNT = re.compile(r"[A-Z]+ P(\d+)")  # how a shift by a variable without a value here is named
_PLAIN = frozenset(("MOVJ", "MOVL", "MOVC", "MOVS", "REFP"))
_MOTION = re.compile(r"[A-Z]*MOV[A-Z]*|REFP|SYSTART")
_GOES_ON_ELSEWHERE = re.compile(r"CALL\b|MACRO\d*\b|JUMP JOB:")
_CHOSEN = re.compile(r"\bL?PX?\[")
_CHOSEN_TARGET = re.compile(r"\s*L?PX?\[[^\]]*\]?")  # one of all the controller's variables
_FRAME = re.compile(r"\b(BF|RF|TF|MTF|UF#)")
_SECOND = re.compile(r"\+S?MOV")
_TEACH_THERE = "Teach it there, or write its value into the job."
_KNOWN = "|".join(("REFP", "MFRAME", "GETE", *sorted(FILLS)))  # to leave taught positions as they are
_USED_OTHERWISE = re.compile(  # a taught position that is named by what is no motion
    rf"^[ \t]*+(?![A-Z]*MOV|(?:{_KNOWN})\b)[A-Z]\w*+{WORDS_BEFORE}(?<![*:\w])C\d{{3,5}}\b", re.MULTILINE
)
_JUMPS = re.compile(r"^[ \t]*(?:JUMP\b|\*)", re.MULTILINE)
_SPECIAL = re.compile(
    r"\b(?:SFTON|MFRAME|GETS|GETPOS|SYSTART|[A-Z]+MOV[A-Z]*)\b|\bL?PX?\[|\b(?:UF|TL)#\("
    r"|\b(?:MOV[JLCS]|REFP)[ \t]++(?:\d++[ \t]++)?+L?PX?\d"
)
_CAUSE_OF_INSTRUCTION = (
    ("IMOV", _INCREMENT),
    ("EIMOV", _INCREMENT),
    ("SY", _ON_CONVEYOR),
    ("SMOV", _LED_MOTION),
)


@dataclass
class _JobFindings:
    barred: dict[Key, str] = field(default_factory=dict)
    all_variables: str = ""  # why every variable is left
    made: dict[tuple[str, str], str] = field(default_factory=dict)  # UF or TL, its number: why
    shifts: list[tuple[Key | None, ProgramShift]] = field(default_factory=list)
    variables: ComputedVariables = field(default_factory=ComputedVariables)
    absent: set[str] = field(default_factory=set)  # variables gone to of which the file holds no value


def motions_in(
    jobs: Iterable[YaskawaJob], positions: Positions
) -> tuple[dict[int, str], tuple[ProgramShift, ...]]:
    """Return which rows of a file's jobs no command may change, and why; and the shifts of their points."""
    barred: dict[int, str] = {}
    shifts: list[ProgramShift] = []
    first = 0
    for job in jobs:
        rows = [row for row in job.rows if row.kind in ROBOT_ROWS]
        barred |= {first + i: why for i, row in enumerate(rows) if (why := _stated_reason(row, job))}
        if _SPECIAL.search(job.instructions) or _USED_OTHERWISE.search(job.instructions):
            found = _find_motions(job, {(row.kind, int(row.number)): row for row in rows})
            barred |= {
                first + i: why
                for i, row in enumerate(rows)
                if first + i not in barred and (why := _barred_reason(row, found))
            }
            keys = {(row.kind, int(row.number)): first + i for i, row in enumerate(rows)}
            shifts += _of_rows(found.shifts, keys, positions)
        uncertain_axes = axis_rows_of(job).reasons
        for i, row in enumerate(rows) if uncertain_axes else ():
            if reason := uncertain_axes.get((row.kind, int(row.number))):
                barred.setdefault(first + i, reason)
        if groups := groups_without_rows(job):
            barred = {first + i: make_message(_NO_GROUP_ROWS, groups) for i in range(len(rows))} | barred
        first += len(rows)
    amounts = {i: _VARIABLE_AMOUNT for i, kind in enumerate(positions.kinds) if kind == SHIFT}
    return {**amounts, **barred}, tuple(shifts)


def _stated_reason(row: JobRow, job: YaskawaJob) -> str:
    state = row.state
    if why := {"TOOL": _IN_TOOL, "MTOOL": _IN_MASTER}.get(state.postype, ""):
        return why
    if state.mode == "RECTAN" and row.text.count(",") == _SEVEN - 1 and row.text.count(".") < _SEVEN:
        return _DECIMAL_COMMA  # controllers write all of them with decimals
    relative = next((rest for _, word, rest in job.header if word == "FRAME"), "")
    its_own = f"USER {state.user}" if state.postype == "USER" else state.postype
    if row.kind == "P" or not relative or state.mode != "RECTAN" or _same_frame(its_own, relative):
        return ""
    return make_message(_OTHER_RELATIVE, its_own, relative)


def _same_frame(one: str, other: str) -> bool:
    return one == re.sub(r"\s+0*(?=\d)", " ", other.strip())


def _barred_reason(row: JobRow, found: _JobFindings) -> str:
    if why := found.barred.get((row.kind, int(row.number))):
        return why
    if row.kind == "P" and found.all_variables:
        return found.all_variables
    if row.state.mode != "RECTAN":
        return ""
    user = row.state.user if row.state.postype == "USER" else None
    for (what, number), why in found.made.items():
        active_number = user if what == "UF" else row.state.tool
        if active_number is not None and (not number.isdigit() or int(number) == int(active_number)):
            return why
    return ""


def _of_rows(
    shifts: Iterable[tuple[Key | None, ProgramShift]], rows: dict[Key, int], positions: Positions
) -> Iterator[ProgramShift]:
    for key, shift in shifts:
        row = rows.get(key) if key is not None else None
        if row is None:
            yield shift
        elif positions.kinds[row] in (CARTESIAN, JOINTS) and positions.groups[row] == 1:
            yield ProgramShift(
                shift.line, shift.what, shift.axes, (row,), translation_m=shift.translation_m,
                quaternion=shift.quaternion,
            )  # fmt: skip


def _find_motions(job: YaskawaJob, rows: dict[Key, JobRow]) -> _JobFindings:
    lines = list(iterate_instructions(job))
    found = _JobFindings(
        variables=computed_variables(lines, {number for kind, number in rows if kind == "P"})
    )
    variables = found.variables
    jumps = _JUMPS.search(job.instructions) is not None
    everywhere = jumps or shifts_in_blocks(word for _, word, _ in lines)
    anywhere: dict[_Effect, ProgramShift] = {}
    for line, word, rest in (one for one in lines if everywhere and one[1] == "SFTON"):
        _switch_on(anywhere, _shift_of(line, word, rest, variables, rows))
    active: dict[_Effect, ProgramShift] = {}
    for line, word, rest in lines:
        if word == "SFTON":
            _switch_on(active, _shift_of(line, word, rest, variables, rows))
        elif word == "SFTOF":
            active = {}
        shifts = list((anywhere or active).values())
        if _GOES_ON_ELSEWHERE.match(f"{word} {rest}"):
            # the called job's points are in its own file, and may not be here
            found.shifts += [(None, replace(shift, point=_OTHERS)) for shift in shifts]
        elif _MOTION.fullmatch(word):
            _take_motion(found, (line, word, rest), shifts, rows)
        else:
            _take_computation(found, (line, word, rest))
    found.shifts = list(dict.fromkeys(found.shifts))
    return found


def _switch_on(shifts: dict[_Effect, ProgramShift], shift: ProgramShift | None) -> None:
    """Add a shift that may be on, unless one does the same: a job may switch thousands."""
    if shift is None:
        return
    is_further = shift.quaternion is None and len(shifts) >= _MOST_SHIFTS
    what = shift.what.partition(" ")[0] if is_further else shift.what  # without the variable
    effect = what, shift.axes, shift.quaternion
    if effect not in shifts:
        shifts[effect] = replace(shift, what=what)


def _shift_of(
    line: int, word: str, rest: str, variables: ComputedVariables, rows: dict[Key, JobRow]
) -> ProgramShift | None:
    """Return the shift of SFTON or IMOV; None for one along the axes of the tool, which turns with its point."""
    frame = _FRAME.search(rest)
    if frame is not None and frame[1] == "TF":
        return None
    axes = ShiftAxes.USER_FRAME if frame is not None and frame[1] == "UF#" else ShiftAxes.BASE
    turn = _turn_of(rest, rows)
    numbers = numbers_in(rest)
    if (variables.from_here | variables.turned).intersection(numbers):
        turn = None  # the amount itself changes with the points, or turns
    elif unfilled := [one for one in numbers if ("P", one) not in rows and one not in variables.filled]:
        turn = None  # what the controller has there may turn
        word = f"{word} P{unfilled[0]:03d}" if unfilled[0] >= 0 else word
    elif _CHOSEN.search(rest):
        turn = None
    return ProgramShift(line, word, axes, point=_amount_text(rest), quaternion=turn)


def _amount_text(rest: str) -> str:
    found = TAKEN.search(rest)
    return found[0] if found else rest.partition(" ")[0]


def _turn_of(rest: str, rows: dict[Key, JobRow]) -> Quaternion | None:
    """Return no turn, or None where the job states an amount that also turns."""
    found = TAKEN.search(rest)
    row = rows.get(("P", int(found[2]))) if found is not None and found[2] and not found[1] else None
    if row is None or row.state.mode != "RECTAN":
        return NO_TURN
    return None if row.broken or any(float(text) for text in row.text.split(",")[3:6]) else NO_TURN


def _take_motion(
    found: _JobFindings,
    instruction: tuple[int, str, str],
    active: list[ProgramShift],
    rows: dict[Key, JobRow],
) -> None:
    line, word, rest = instruction
    own = rest[: second.start()] if (second := _SECOND.search(rest)) else rest
    why = "" if word in _PLAIN else make_message(_why_no_place(word), word, line)
    _take_chosen(found, (line, word, own), is_amount=bool(why))
    for taken in TAKEN.finditer(own):
        key = _row_key(taken)
        if why:
            found.barred |= {} if key is None or key in found.barred else {key: why}
        elif key in rows:
            found.shifts += [(key, shift) for shift in active]
        elif taken[2] and number_of(taken) in found.variables.computed:
            is_set = number_of(taken) in found.variables.set_in_part  # to a value that no change reaches
            turn = None if is_set or number_of(taken) in found.variables.uncertain else NO_TURN
            computed = ProgramShift(line, word, ShiftAxes.BASE, point=taken[0], quaternion=turn, sets=is_set)
            found.shifts.append((None, computed))
        elif taken[2] and number_of(taken) not in found.variables.from_here:
            _go_to_absent(found, line, word, taken[0])
    if "IMOV" in word and (shift := _shift_of(line, word, own, found.variables, rows)) is not None:
        named_row = TAKEN.search(own)
        found.shifts += [] if named_row is not None and _row_key(named_row) in rows else [(None, shift)]


def _take_chosen(found: _JobFindings, instruction: tuple[int, str, str], *, is_amount: bool) -> None:
    """Take a variable that a number chooses: an amount leaves every variable, a place is the controller's."""
    line, word, own = instruction
    if is_amount and _CHOSEN.search(own):
        found.all_variables = found.all_variables or make_message(_ANY_AMOUNT, word, line)
    elif not is_amount and word != "REFP" and (chosen := _CHOSEN_TARGET.match(own)):
        _go_to_absent(found, line, word, chosen[0])


def _go_to_absent(found: _JobFindings, line: int, word: str, variable: str) -> None:
    """Note a motion to a variable of which the file holds no value, once."""
    if variable not in found.absent:
        found.absent.add(variable)
        place = ProgramShift(line, word, ShiftAxes.USER_FRAME, point=variable, absent=_TEACH_THERE)
        found.shifts.append((None, place))


def _row_key(taken: re.Match[str]) -> Key | None:
    """Return the row that an instruction names; None for a variable of its own."""
    if taken[1]:
        return None
    return ("C", int(taken[3])) if taken[3] else ("P", int(taken[2]))


def _why_no_place(word: str) -> str:
    return next((text for begins, text in _CAUSE_OF_INSTRUCTION if word.startswith(begins)), _OTHER_MOTION)


def _take_computation(found: _JobFindings, instruction: tuple[int, str, str]) -> None:
    line, word, rest = instruction
    if word in AMOUNTS and _CHOSEN.search(rest):
        found.all_variables = found.all_variables or make_message(_ANY_AMOUNT, word, line)
    elif (made := MADE.match(f"{word} {rest}")) is not None:
        found.made.setdefault((made[2], made[3]), make_message(_SET_HERE, word, line))
    elif word == "MFRAME":
        found.made.setdefault(("UF", "?"), make_message(_SET_HERE, word, line))
    if _USED_OTHERWISE.match(f"{word} {rest}"):
        rows = [key for taken in TAKEN.finditer(rest) if taken[3] and (key := _row_key(taken)) is not None]
        found.barred |= {key: make_message(_NOT_KNOWN, line=line, word=word) for key in rows}
