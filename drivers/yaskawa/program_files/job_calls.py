"""Shifts that hold across jobs: SFTON stays on in a job that is called, and in the caller of a job that leaves it on.

What a job says of this goes to the other jobs of its folder as texts under keys: `FileDeclarations.doubtful`.
"""

import re
from pathlib import PurePath

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.file_declarations import BatchReasons, FileDeclarations
from cellcal.drivers.yaskawa.program_files.job_amounts import amount_marks
from cellcal.drivers.yaskawa.program_files.job_capitals import in_capitals
from cellcal.drivers.yaskawa.program_files.job_shared_variables import variable_marks
from cellcal.drivers.yaskawa.program_files.job_text import (
    BLOCK_BEGINS,
    BLOCK_ENDS,
    shifts_in_blocks,
)
from cellcal.drivers.yaskawa.program_files.job_variables import MADE

_JOB = re.compile(r"^//NAME[ \t]+(\S+)(.*?)^//INST(.*?)(?=^/JOB|\Z)", re.MULTILINE | re.DOTALL)
_CALLED = re.compile(r"\bJOB:[ \t]*(\S+)")
_LINES = re.compile(
    rf"^[ \t]*(SFTON|SFTOF|CALL|PSTART|MACRO|JUMP|\*|(?:{BLOCK_BEGINS}|{BLOCK_ENDS})\b)([^\n]*)", re.MULTILINE
)
_IN_FRAME = re.compile(r"\bUF#\((\d{1,3}|[A-Z])")  # in which user frame a relative job is to run
_SAYS = re.compile(rb"JOB:|\b(?:SFTON|MACRO|MFRAME|UF#|TL#)|\bPX?(?:\d{3,5}\b|\[)", re.IGNORECASE)
_IS_MACRO = re.compile(r"^///ATTR\b[^\r\n]*\bMC\b", re.MULTILINE)
_SHIFTED = "SFTON of {}"


def declarations_of(file: str, data: bytes) -> FileDeclarations:
    """Return which jobs a file's jobs call, which of them while a shift is on, and which of its jobs leave one on.

    Also which frames and tools they make, and what they do with position variables.

    The file need not be a sound one.
    """
    folder, marks = PurePath(file).parent, dict[str, str]()
    jobs = _JOB.findall(data.decode("latin-1")) if _SAYS.search(data) else ()
    for name, head, written in jobs:
        instructions = in_capitals(written)
        marks |= variable_marks(file, name, head, instructions) | amount_marks(file, name, head, instructions)
        marks |= _call_marks(f"{folder}", name, instructions)
        if _IS_MACRO.search(written):
            marks[f"{folder} macro {name}"] = name
        for _, what, number in MADE.findall(instructions):
            marks[f"{folder} makes {name} {what} {number}"] = name
    return FileDeclarations(PurePath(file).stem, doubtful=marks)


def _call_marks(folder: str, name: str, instructions: str) -> dict[str, str]:
    """Return which jobs a job calls, and in which its shift is on."""
    marks: dict[str, str] = {}
    found = _LINES.findall(instructions)
    jumps = any(word in ("JUMP", "*") for word, _ in found) or shifts_in_blocks(word for word, _ in found)
    on = jumps and any(word == "SFTON" for word, _ in found)
    for word, rest in found:
        on = word == "SFTON" or (on and (jumps or word != "SFTOF"))
        called = _CALLED.search(rest) if word in ("CALL", "PSTART", "JUMP") else None
        for called_name in (
            (called[1], called[1].upper()) if called else ()
        ):  # small letters may be an editor's
            if (in_frame := _IN_FRAME.search(rest)) is not None:
                marks[f"{folder} frame {called_name} {in_frame[1]}"] = name
            marks[f"{folder} call {name} {called_name}"] = name
            marks |= {f"{folder} shifted {called_name}": name} if on else {}
    marks |= {f"{folder} leaves {name}": name} if on else {}
    return marks | ({f"{folder} runs {name}": name} if any(word == "MACRO" for word, _ in found) else {})


def shift_from_others(file: str, job: str, marks: BatchReasons) -> str:
    """Return the SFTON of another job that may be on in a job, as an instruction is named; "" where none is."""
    folder = f"{PurePath(file).parent}"
    shifted = marks.derive_once(f"{folder} shifted", lambda: _shifted_jobs(folder, marks))
    return make_message(_SHIFTED, shifted[job]) if job in shifted else ""


def _shifted_jobs(folder: str, marks: BatchReasons) -> dict[str, str]:
    """Return the jobs of a folder in which another's SFTON may be on, and which job's."""
    calls = [
        (caller, called)
        for caller, _, called in (pair.partition(" ") for pair in marks.rests_behind(f"{folder} call"))
    ]
    calls += [
        (caller, macro)
        for caller in marks.rests_behind(f"{folder} runs")
        for macro in marks.rests_behind(f"{folder} macro")  # only the controller's table says which one runs
    ]
    shifted = {
        called: marks[f"{folder} shifted {called}"] for called in marks.rests_behind(f"{folder} shifted")
    }
    leaving = set(marks.rests_behind(f"{folder} leaves"))
    before = -1
    while len(shifted) + len(leaving) > max(before, 0):
        before = len(shifted) + len(leaving)
        for caller, called in calls:
            if caller in shifted:
                shifted.setdefault(called, shifted[caller])
            if called in leaving:
                leaving.add(caller)
                shifted.setdefault(caller, called)
    return shifted


def frames_from_others(file: str, job: str, marks: BatchReasons) -> dict[tuple[str, str], str]:
    """Return user frames and tools that other jobs make while the cell works, by UF or TL and number; and which job.

    A job that calls none and that none calls is one to set up the cell, which a person runs.
    """
    made = _made_frames(file, marks)
    return {(what, number): name for name, what, number, works in made if works and name != job}


def frames_of_people(file: str, job: str, marks: BatchReasons) -> dict[tuple[str, str], str]:
    """Return user frames and tools, as ``frames_from_others``, that jobs make when a person runs them."""
    made = _made_frames(file, marks)
    return {(what, number): name for name, what, number, works in made if not works and name != job}


def _made_frames(file: str, marks: BatchReasons) -> list[tuple[str, str, str, bool]]:
    folder = f"{PurePath(file).parent}"
    return marks.derive_once(f"{folder} makes", lambda: _made_by_jobs(folder, marks))


def frames_of_calls(file: str, job: str, marks: BatchReasons) -> dict[str, str]:
    """Return the callers of a relative job by the user frame, its number or a variable's letter, that they name."""
    folder = f"{PurePath(file).parent}"
    return {
        number: marks[f"{folder} frame {job} {number}"]
        for number in marks.rests_behind(f"{folder} frame {job}")
    }


def _made_by_jobs(folder: str, marks: BatchReasons) -> list[tuple[str, str, str, bool]]:
    """Return job, UF or TL and number of each frame, and whether the job runs while the cell works."""
    working = {name for pair in marks.rests_behind(f"{folder} call") for name in pair.split(" ")}
    if marks.rests_behind(f"{folder} runs"):  # only the controller's table says which macro runs
        working.update(marks.rests_behind(f"{folder} macro"))
    made = (key.split(" ") for key in marks.rests_behind(f"{folder} makes"))
    return [(name, what, number, name in working) for name, what, number in made]
