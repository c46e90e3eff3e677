"""Text of a Yaskawa job (.JBI), taken apart: pseudo instructions, rows of numbers, instructions.

::

    /JOB
    //NAME TESTTCPX
    ///FOLDERNAME FOLDER001                 a YRC1000's folder of jobs
    //POS
    ///NPOS 1,0,0,1,0,0                      how many C, BC, EC, P, BP, EX follow
    ///TOOL 13
    ///POSTYPE PULSE
    ///PULSE
    C00000=76697,-73189,-80544,374,-78336,86207
    ///USER 8
    ///POSTYPE USER
    ///RECTAN
    ///RCONF 0,0,0,0,1,0,0,0                 from here on
    P0010=0.000,0.000,10.205,0.00,0.00,0.00
    //INST
    ///DATE 2012/04/25 14:11
    NOP
    MOVL P010 V=50.0
    END

Between //POS and //INST may stand //ARGINFO: what the job is called with, and a line of free text for each.
What a pseudo instruction says holds until the next one of its kind. A file may hold several jobs.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from math import inf

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.yaskawa.program_files.job_capitals import in_capitals

ROBOT_ROWS = ("C", "P")
COUNTED = ("C", "BC", "EC", "P", "BP", "EX")  # in the order of ///NPOS
MODES = ("PULSE", "RECTAN", "ANGLE")
MAX_BYTES = 256 * 2**20
MAX_LINE = 2000
_NUMBER = r"[+-]?(?:\d{1,12}(?:\.\d{0,9})?|\.\d{1,9})"
_LINE = re.compile(
    rf"(?:(C|P|BC|EC|BP|EP|EX)(\d{{1,6}})[ \t]*=[ \t]*({_NUMBER}(?:[ \t]*,[ \t]*{_NUMBER}){{0,11}})"
    r"|(/[^\r\n]*)|(?:'[^\r\n]*)?|[ \t]+(?:'[^\r\n]*)?)[ \t]*\r?(?:\n|\Z)"
)
_BROKEN_ROW = re.compile(r"(C|P|BC|EC|BP|EP|EX)(\d{1,6})[ \t]*=([^\r\n=]*)\r?(?:\n|\Z)")  # no number, too few
_POSE_COMMAS = 5
_ZEROS = ",".join("0" * 6)
_BEYOND = f"{inf}"  # of axes that are no number: nothing counts them as standing at zero
_END_OF_FILE = "\x1a"  # which tools of DOS put behind a text
_WORD = re.compile(r"(/{1,4})([A-Z]\w*)(?:[ \t]+(.*?))?[ \t]*\Z")
# Not an instruction that is switched off.
_SLASHED = re.compile(r"^(?!//(?!/|NAME\b|POS\b|INST\b|ARGINFO\b))/[^\r\n]*", re.MULTILINE)
_WHOLE = re.compile(r"\d{1,9}\Z")
_SIGNED = re.compile(r"[+-]?\d{1,9}\Z")  # as tools write turns of an axis that no RCONF states
BLOCK_BEGINS, BLOCK_ENDS = r"IFTHEN\w*|SWITCH\w*|WHILE\w*|FOR", "ENDIF|ENDSWITCH|ENDWHILE|NEXT"
_OPENS = re.compile(BLOCK_BEGINS)
_CLOSES = frozenset(BLOCK_ENDS.split("|"))
_REMARK = re.compile(r"[ \t]*(?:'|//).*", re.DOTALL)
_TOOL_PER_GROUP = re.compile(r"\d{1,3}(?:[ \t]*,[ \t]*\d{1,3})+\Z")
_POSTYPES = ("PULSE", "ANGLE", "BASE", "ROBOT", "TOOL", "USER", "MTOOL")
_CURE = "Save the job on the controller again, or correct the line; the file was not changed."


@dataclass(frozen=True, slots=True)
class RowState:
    """The state that pseudo instructions set for the rows that follow."""

    tool: str | None = None
    user: str | None = None
    postype: str = ""
    mode: str = ""
    configuration: str = ""
    switched_on: tuple[str, ...] = ()  # words of which no document is known


@dataclass(slots=True)
class JobRow:
    """One line of numbers: its kind, its number as written, where its numbers begin, and what holds for it."""

    kind: str
    number: str
    start: int
    text: str  # "1.000,2.000,…"
    line: int
    state: RowState
    broken: bool = False  # a number is none; zeros stand in `text`, inf in that of axes


@dataclass(slots=True)
class YaskawaJob:
    """One job of a file."""

    line: int
    name: str = ""
    counts: tuple[int, ...] | None = None
    rows: list[JobRow] = field(default_factory=list)
    header: list[tuple[int, str, str]] = field(default_factory=list)  # line, word, rest; of the //INST part
    instructions: str = ""
    first_line: int = 0  # of the instructions
    row_keys: set[tuple[str, int]] = field(default_factory=set)  # rows so far, by kind and number


def jobs_of(name: str, text: str) -> list[YaskawaJob]:
    """Take a file apart.

    Raises
    ------
    ProgramFileError
        A line is not understood, with its place; a count does not fit; there is no job.
    """
    if len(text) > MAX_BYTES:
        raise ProgramFileError(
            name,
            make_message("{text_count} MB is no job.", text_count=len(text) >> 20),
            remedy="Give the job itself.",
        )
    if "\n" not in text and text.count("\r") > 1:
        raise ProgramFileError(
            name,
            "its lines end with a carriage return alone, which no controller writes.",
            remedy="Save it with the line ends of Windows.",
        )
    reader = _JobReader(name, text)
    widths = list(map(len, text.split("\n")))
    if max(widths) > MAX_LINE:
        line = next(i for i, width in enumerate(widths, 1) if width > MAX_LINE)
        raise reader.error_at(
            line, MAX_LINE, make_message("the line has {line_count} characters.", line_count=widths[line - 1])
        )
    reader.read_jobs()
    return reader.jobs


class _JobReader:
    def __init__(self, file: str, text: str) -> None:
        self.file, self.text = file, text
        self.jobs: list[YaskawaJob] = []
        self.part = ""
        self.row_state = RowState()
        self.passed = {
            "ARGINFO": self._pass_arguments,
            "INST": self._take_instructions,
        }  # parts of other lines

    def error_at(self, line: int, column: int, message: str) -> ProgramFileError:
        return ProgramFileError(self.file, message, line=line, column=column, remedy=_CURE)

    def read_jobs(self) -> None:
        at, line, end = 0, 1, len(self.text)
        while at < end:
            found = _LINE.match(self.text, at)
            if found is None:
                found = self._take_broken_row(line, at)
            elif found[1] is not None:
                self._take_row(line, found)
            elif found[4] is not None:
                self._take_word(line, found[4])
            at, line = found.end(), line + 1
            if (passed := self.passed.get(self.part)) is not None:
                at, line = passed(at, line)
        if not self.jobs:
            raise ProgramFileError(self.file, "there is no /JOB in it.", remedy="Give a job saved as .JBI.")
        if self.part or not self.jobs[-1].first_line:
            raise self.error_at(self.jobs[-1].line, 1, "the job ends before its instructions (//INST).")

    def _take_broken_row(self, line: int, at: int) -> re.Match[str]:
        """Take a row whose numbers are not understood; return its line."""
        found = _BROKEN_ROW.match(self.text, at) if self.part == "POS" else None
        if found is None:
            rest = self.text[at : at + 40].partition("\n")[0]
            raise self.error_at(line, 1, make_message("{full_name!r} is not understood.", full_name=rest))
        self._take_row(line, found, broken=True)
        return found

    def _pass_arguments(self, start: int, line: int) -> tuple[int, int]:
        """Pass what a job says of its arguments; return where its instructions are announced."""
        stop = self.text.find("\n//INST", start - 1) + 1 or len(self.text)
        return stop, line + self.text.count("\n", start, stop)

    def _take_instructions(self, start: int, line: int) -> tuple[int, int]:
        """Take what follows //INST up to the next job; return where that begins."""
        job = self.jobs[-1]
        stop = self.text.find("\n/JOB", start - 1) + 1 or len(self.text)
        job.instructions, job.first_line = in_capitals(self.text[start:stop]), line
        for found in _SLASHED.finditer(job.instructions):
            where = line + job.instructions.count("\n", 0, found.start())
            word = _WORD.match(found[0])
            if word is None or len(word[1]) < 3:
                raise self.error_at(
                    where, 1, make_message("{full_name!r} is not understood.", full_name=found[0][:40])
                )
            job.header.append((where, word[2], word[3] or ""))
        if _last_instruction(job.instructions.rstrip(_END_OF_FILE)) != "END":
            raise self.error_at(job.line, 1, "the job ends without END; it is cut short.")
        self._refuse_other_counts(job)
        self.part = ""
        return stop, line + job.instructions.count("\n")

    def _refuse_other_counts(self, job: YaskawaJob) -> None:
        kinds = ["EX" if row.kind == "EP" else row.kind for row in job.rows]
        if job.counts is None and kinds:
            raise self.error_at(job.line, 1, "the job holds positions and no ///NPOS.")
        for kind, stated_count in zip(COUNTED, job.counts or (0,) * len(COUNTED), strict=True):
            there = kinds.count(kind)
            if stated_count != there:
                raise self.error_at(
                    job.line,
                    1,
                    make_message(
                        "///NPOS says {stated_count} {kind} positions, {there} are there.",
                        stated_count=stated_count,
                        kind=kind,
                        there=there,
                    ),
                )

    def _take_word(self, line: int, content: str) -> None:
        found = _WORD.match(content)
        if found is None:
            raise self.error_at(
                line, 1, make_message("{full_name!r} is not understood.", full_name=content[:40])
            )
        depth, word, rest = len(found[1]), found[2], found[3] or ""
        if depth == 1:
            self._take_job(line, word, rest)
        elif not self.jobs:
            raise self.error_at(
                line, 1, make_message("{content!r} stands before /JOB.", content=content[:40])
            )
        elif depth == 2:
            self._take_part(line, word, rest)
        elif word == "FOLDERNAME" and not self.part and not self.jobs[-1].first_line:
            return  # where the pendant lists the job
        elif self.part == "POS":
            self._take_state(line, found.start(3) + 1, word, rest)
        else:
            raise self.error_at(
                line,
                1,
                make_message(
                    "{content!r} stands neither under //POS nor under //INST.", content=content[:40]
                ),
            )

    def _take_job(self, line: int, word: str, rest: str) -> None:
        if word != "JOB" or rest or self.part or (self.jobs and not self.jobs[-1].first_line):
            raise self.error_at(line, 1, make_message("/{word} is not understood here.", word=word))
        self.jobs.append(YaskawaJob(line))
        self.row_state = RowState()

    def _take_part(self, line: int, word: str, rest: str) -> None:
        job = self.jobs[-1]
        if word == "NAME" and rest and not job.name and not self.part and not job.first_line:
            job.name = rest
        elif (self.part, word) in (
            ("", "POS"),
            ("POS", "INST"),
            ("", "INST"),
            ("POS", "ARGINFO"),
            ("ARGINFO", "INST"),
        ) and not (rest or job.first_line):
            self.part = word
        else:
            raise self.error_at(line, 1, make_message("//{word} is not understood here.", word=word))

    def _take_counts(self, line: int, column: int, rest: str) -> None:
        job, counts = self.jobs[-1], rest.split(",")
        if (
            job.counts is not None
            or len(counts) != 6
            or not all(_WHOLE.match(n.strip(" \t")) for n in counts)
        ):
            raise self.error_at(
                line,
                max(column, 1),
                make_message("///NPOS {rest} does not give six counts once.", rest=rest[:40]),
            )
        job.counts = tuple(int(n.strip(" \t")) for n in counts)

    def _take_state(self, line: int, column: int, word: str, rest: str) -> None:
        row_state = self.row_state
        if word == "NPOS":
            self._take_counts(line, column, rest)
        elif word in ("TOOL", "USER"):
            per_group = word == "TOOL" and _TOOL_PER_GROUP.match(rest)  # no project has a tool of that name
            if not (_WHOLE.match(rest) or per_group):
                raise self.error_at(
                    line,
                    max(column, 1),
                    make_message("///{word} {rest} names no number.", word=word, rest=rest[:40]),
                )
            number = rest if per_group else str(int(rest))
            tool, user = (number, row_state.user) if word == "TOOL" else (row_state.tool, number)
            self.row_state = replace(row_state, tool=tool, user=user)
        elif word == "POSTYPE" and rest in _POSTYPES:
            self.row_state = replace(row_state, postype=rest)
        elif word in MODES and not rest:
            self.row_state = replace(row_state, mode=word)
        elif word == "RCONF" and rest and all(_SIGNED.match(n.strip(" \t")) for n in rest.split(",")):
            self.row_state = replace(row_state, configuration=rest)
        elif rest == "ON" or (rest == "OFF" and (word in row_state.switched_on or not row_state.switched_on)):
            words = (*(each for each in row_state.switched_on if each != word), word)
            self.row_state = replace(row_state, switched_on=words if rest == "ON" else words[:-1])
        else:
            raise self.error_at(
                line,
                1,
                make_message(
                    "///{word} {rest} is not understood among positions.", word=word, rest=rest[:40]
                ),
            )

    def _take_row(self, line: int, found: re.Match[str], *, broken: bool = False) -> None:
        row_state = self.row_state
        if self.part != "POS":
            raise self.error_at(
                line,
                1,
                make_message(
                    "{row_letters}{row_number} stands outside of //POS.",
                    row_letters=found[1],
                    row_number=found[2],
                ),
            )
        pulses = (
            row_state.mode == "PULSE"
            if row_state.postype == "PULSE"
            else row_state.mode in ("RECTAN", "ANGLE")
        )
        if not row_state.mode or not row_state.postype or not pulses:
            stated = f"///POSTYPE {row_state.postype or 'missing'}, ///{row_state.mode or '(PULSE, RECTAN) missing'}"
            raise self.error_at(
                line, 1, make_message("what this position holds is not said: {stated}.", stated=stated)
            )
        if row_state.postype == "USER" and row_state.user is None:
            raise self.error_at(line, 1, "the position is in a user frame, and ///USER does not say which.")
        job, key = self.jobs[-1], (found[1], int(found[2]))
        if key in job.row_keys:
            raise self.error_at(
                line,
                1,
                make_message(
                    "{row_letters}{row_number} is there a second time.",
                    row_letters=found[1],
                    row_number=found[2],
                ),
            )
        job.row_keys.add(key)
        broken = broken or _has_too_few(found, row_state)
        text = found[3] if not broken else _ZEROS if found[1] in ROBOT_ROWS else _BEYOND
        job.rows.append(JobRow(found[1], found[2], found.start(3), text, line, row_state, broken))


def _has_too_few(found: re.Match[str], state: RowState) -> bool:
    """Return whether a row of a robot lacks numbers of a pose."""
    return found[1] in ROBOT_ROWS and state.mode == "RECTAN" and found[3].count(",") < _POSE_COMMAS


def split_instruction(line: str) -> tuple[str, str]:
    """Return the word and the rest of an instruction without comments; two empty texts where none stands there."""
    content = " ".join(_REMARK.sub("", line).split())
    if content.startswith(("/", "COMM ")):  # COMM: an instruction that is switched off
        return "", ""
    word, _, rest = content.partition(" ")
    return word, rest


def iterate_instructions(job: YaskawaJob) -> Iterator[tuple[int, str, str]]:
    """Yield line, word and rest of each instruction of a job."""
    for line, text in enumerate(job.instructions.split("\n"), job.first_line):
        word, rest = split_instruction(text)
        if word:
            yield line, word, rest


def shifts_in_blocks(words: Iterable[str]) -> bool:
    """Return whether a shift is switched in a branch or a loop, where the order of lines does not say if it is on."""
    depth = 0
    for word in words:
        if _OPENS.fullmatch(word):
            depth += 1
        elif word in _CLOSES:
            depth -= 1
        elif depth > 0 and word in ("SFTON", "SFTOF"):
            return True
    return False


def _last_instruction(instructions: str) -> str:
    end = len(instructions)
    while end > 0:
        start = instructions.rfind("\n", 0, end) + 1
        text = instructions[start:end].strip()
        if text and not text.startswith("'"):
            return text
        end = start - 1
    return ""
