"""ERRACT.LS: the alarms that are active.

::

    ERRACT.LS      Robot Name R01 27-AUG-26 13:14:06

    4428" 27-AUG-26 12:02:10 " SRVO-062 BZAL alarm (Group:1 Axis:3)   " " SERVO   00110110"
"""

import re
from dataclasses import dataclass
from datetime import datetime

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.controller_files.report_text import (
    damaged_report_error,
    decode_report,
    parse_date,
)

_LINE = re.compile(r'\s*(\d+)\s*"([^"]*)"\s*([^"]*?)\s*"(.*)\Z')
_CODE = re.compile(r"([A-Z]{2,5}\d?)-\s?(\d{3})\b[ \t]*(.*)\Z")
_ANY_CODE = re.compile(r"\b[A-Z]{4}-\d{3}\b")
_AXIS = re.compile(
    r"\b(?:G|GR[A-Z]*)\s*:\s*(\d+)(?:[\s,]*(?:A|AX[A-Z]*|AS[A-Z]*|AC[A-Z]*|EJ[A-Z]*)\s*:\s*(\d+))?",
    re.IGNORECASE,
)  # group alone, or group and axis, also in other languages
_NAME = re.compile(r"ROBOT\s+NAME\s+(.*?)\s+\d{1,2}-[A-Z]{3}-\d{2}", re.IGNORECASE)
_HEADING_LINES = 3


@dataclass(frozen=True, slots=True)
class ControllerAlarm:
    """One active alarm; ``axis`` counts from 1. Group and axis are None where the alarm names none."""

    number: int
    raised: str
    code: str  # "SRVO-062"; "" where the line holds text only
    text: str
    group: int | None = None
    axis: int | None = None


@dataclass(frozen=True, slots=True)
class AlarmReport:
    """Every active alarm, as the file lists them."""

    robot_name: str
    written: datetime | None
    alarms: tuple[ControllerAlarm, ...]


def read_alarm_report(data: bytes, file: str = "erract.ls") -> AlarmReport:
    """Read the active alarms.

    Raises
    ------
    ProgramFileError
        A line is no alarm, or the last one has no end: an alarm that is not understood, or is missing, must not
        pass for none.
    """
    lines = decode_report(file, data)
    alarms = []
    for number, line in enumerate(lines, 1):
        if '"' not in line and _ANY_CODE.search(line) is None:
            continue  # blank, or a heading
        alarms.append(_parse_line(line, file, number))
    if lines[-1]:
        raise damaged_report_error(file, "it ends within a line: alarms may be missing.", len(lines))
    head = " ".join(lines[:_HEADING_LINES])
    name = _NAME.search(head)
    return AlarmReport(name[1] if name else "", parse_date(lines[0]), tuple(alarms))


def _parse_line(line: str, file: str, number: int) -> ControllerAlarm:
    found = _LINE.match(line)
    if found is None:
        raise damaged_report_error(
            file, make_message("this line is no alarm: {text!r}.", text=line.strip()[:60]), number
        )
    code, axis = _CODE.match(found[3]), _AXIS.search(found[3])
    return ControllerAlarm(
        number=int(found[1]),
        raised=found[2].strip(),
        code="" if code is None else f"{code[1]}-{code[2]}",
        text=(found[3] if code is None else code[3]).strip(),
        group=int(axis[1]) if axis else None,
        axis=int(axis[2]) if axis and axis[2] else None,
    )
