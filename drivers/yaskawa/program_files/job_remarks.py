"""What a job's instructions do to positions that no coordinate of the file shows. Nothing is executed."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.positions import Remark
from cellcal.drivers.yaskawa.program_files.job_text import YaskawaJob, split_instruction

MOVES = frozenset(("MOVJ", "MOVL", "MOVC", "MOVS", "SMOVJ", "SMOVL", "SMOVC", "MOV", "REFP"))
_VARIABLE = re.compile(r"(?<!\$)\b(L?)P(X?)(\d{3,5})\b")
_NUMBERED = re.compile(r"\b(C|P)(\d{3,5})\b")
_ROBOT = re.compile(r"\bRB([1-9])")
_TOGETHER = re.compile(r"\+S?MOV")
_INDIRECT = re.compile(r"\bL?(?:P|BP|EX)X?\[")
_CONVEYED = ("SYSTART", "SYMOVJ", "SYMOVL", "SYMOVC")
_SHIFTS = {
    "SFTON": "{} shifts every point that follows, until SFTOF; its amount stays as written.",
    "MSHIFT": "{} computes a shift from taught points; its amount stays as written.",
    "IMOV": "{} moves by an increment, from wherever the arm is; its amount stays as written.",
    **dict.fromkeys(
        _CONVEYED,
        "{} follows a conveyor: points hold for one place of the conveyor only; its amount stays as written.",
    ),
}
_COMPUTES = frozenset(
    (
        "SETE",
        "GETE",
        "SET",
        "ADD",
        "SUB",
        "MUL",
        "DIV",
        "GETS",
        "GETPOS",
        "CNVRT",
        "MULMAT",
        "INVMAT",
        "MFRAME",
    )
)
_SETS_FRAMES = frozenset(("MFRAME", "SETTOOL", "SETUF", "SETUFRM"))
_LOOKS = ("VISION", "CALIB", "SEARCH", "ARCSNS", "COMARC")
_OTHERS = frozenset(("CALL", "PSTART"))
_WORTH_A_LOOK = re.compile(
    r"\bL?(?:P|BP|EX)X?(?=\d{3}|\[)|\+S?MOV|"
    rf"\b(?:{'|'.join((*_SHIFTS, *sorted(_SETS_FRAMES), *_LOOKS, *sorted(_OTHERS)))})\b"
)


@dataclass(frozen=True, slots=True)
class UsedVariables:
    """Variables by number: those that moves of this job go to, and those that are used in any other way."""

    points: frozenset[int]
    others: frozenset[int]
    robot_places: Mapping[tuple[str, int], int]  # by row that a further robot goes to: which of the robots
    robots: tuple[int, ...] = ()  # that the job moves, as its header names them: RB1, RB2

    def robot_of(self, kind: str, number: int) -> int:
        """Return the number of the robot that goes to a row; a job that names none moves the first one."""
        robots = self.robots or (1,)
        return robots[min(self.robot_places.get((kind, number), 0), len(robots) - 1)]


def remarks_of(job: YaskawaJob) -> tuple[tuple[Remark, ...], UsedVariables]:
    """Return what else carries or changes positions, and how position variables are used."""
    remarks = list(_header_remarks(job))
    points: set[int] = set()
    others: set[int] = set()
    places: dict[tuple[str, int], int] = {}
    robots = [
        int(number)
        for _, word, rest in job.header
        if word.startswith("GROUP")
        for number in _ROBOT.findall(rest)
    ]
    for line, text in _notable_lines(job):
        word, _, rest = text.partition(" ")
        variables = _VARIABLE.findall(rest)
        used = {int(number) for local, _, number in variables if not local}
        (points if word in MOVES else others).update(used)
        remarks += _instruction_remarks(line, word, rest, bool(variables))
        if len(robots) > 1 and (plus := _TOGETHER.search(rest)) is not None:
            parts = [
                part for each in _TOGETHER.split(rest[plus.end() :]) if (part := _NUMBERED.findall(each))
            ]
            for place, part in enumerate(parts, 1):
                places |= {(kind, int(number)): place for kind, number in part}
    used_variables = UsedVariables(frozenset(points - others), frozenset(others), places, tuple(robots))
    return tuple(remarks), used_variables


def _notable_lines(job: YaskawaJob) -> Iterable[tuple[int, str]]:
    """Yield the instructions, without comments, that name a variable or do more than move to a taught point."""
    text, line, counted, after = job.instructions, job.first_line, 0, 0
    for found in _WORTH_A_LOOK.finditer(text):
        if found.start() < after:
            continue
        start, stop = text.rfind("\n", 0, found.start()) + 1, text.find("\n", found.start())
        after = stop if stop >= 0 else len(text)
        line += text.count("\n", counted, start)
        counted = start
        word, rest = split_instruction(text[start:after])
        if word:
            yield line, f"{word} {rest}"


def _header_remarks(job: YaskawaJob) -> Iterable[Remark]:
    for line, word, rest in job.header:
        if word == "ATTR" and "RJ" in (part.strip() for part in rest.split(",")):
            yield Remark(
                line, "relative", "This is a relative job: its points stand in a frame, not in pulses."
            )
        elif word == "FRAME":
            yield Remark(
                line,
                "relative",
                make_message("The points of this relative job belong to the frame {rest}.", rest=rest),
            )
        elif re.match(r"GROUP[2-9]", word):
            yield Remark(
                line,
                "foreign",
                make_message("A second control group ({rest}) moves with this job.", rest=rest),
            )


def _instruction_remarks(line: int, word: str, rest: str, uses_variable: bool) -> Iterable[Remark]:
    if _INDIRECT.search(rest):
        yield Remark(
            line,
            "indirect",
            make_message("{word} takes a position by a number that is known at run time only.", word=word),
        )
    if word in _SHIFTS:
        code = "relative" if word in ("IMOV", *_CONVEYED) else "offset"
        yield Remark(line, code, make_message(_SHIFTS[word], f"{word} {rest.strip()}"))
    elif word in _SETS_FRAMES or (word in _COMPUTES and uses_variable):
        yield Remark(
            line,
            "computed",
            make_message(
                "{word} {rest} computes a position, frame or tool at run time.", word=word, rest=rest.strip()
            ),
        )
    elif word in MOVES and uses_variable:
        yield Remark(
            line,
            "position_register",
            make_message(
                "{word} goes to a position variable: the controller's value counts, which other jobs may "
                "change.",
                word=word,
            ),
        )
    elif word in _LOOKS:
        yield Remark(
            line,
            "vision",
            make_message(
                "{word} {rest} corrects positions by what a sensor finds.", word=word, rest=rest.strip()
            ),
        )
    if word in MOVES and _TOGETHER.search(rest):
        yield Remark(
            line, "foreign", make_message("{word} moves together with another control group.", word=word)
        )
    if word in _OTHERS:
        yield Remark(
            line,
            "foreign",
            make_message(
                "{word} {rest}: the positions of that job are in its own file.", word=word, rest=rest.strip()
            ),
        )
