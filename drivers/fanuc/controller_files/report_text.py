"""Text of a controller's reports (.DG, .LS of alarms): lines, and the heading that each report begins with.

::

    F Number: F333333
    VERSION : HandlingTool
    $VERSION: V9.40107     3/3/2024
    DATE:     27-AUG-26 13:14
"""

import re
from dataclasses import dataclass
from datetime import datetime

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError

ENCODING = "cp437"  # one byte is one character, whatever the byte
MAX_LINE = 4096
_MONTHS = ("JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC")
_DATE = re.compile(r"(\d{1,2})-([A-Z]{3})-(\d{2}|\d{4})\s+(\d{1,2}):(\d{2})(?::(\d{2}))?", re.IGNORECASE)
_HEADING = re.compile(r"\s*(F NUMBER|\$VERSION|VERSION|DATE)\s*:\s*(.*?)\s*\Z", re.IGNORECASE)
_F_NUMBER = re.compile(r"\s*F NUMBER\s*:", re.IGNORECASE)
_TAGS = re.compile(r"</?[A-Za-z][^<>]*>")  # what the controller's web server wraps around
_HEADING_LINES = 20
_FIRST_YEAR = 80


@dataclass(frozen=True, slots=True)
class ReportHeading:
    """Whose report it is and when it was written, as far as the file says."""

    f_number: str = ""
    application: str = ""
    software: str = ""
    written: datetime | None = None  # by the controller's clock, without a zone


def decode_report(file: str, data: bytes) -> list[str]:
    """Return the lines of a report.

    Raises
    ------
    ProgramFileError
        It is empty or no text.
    """
    text = data.decode(ENCODING).replace("\r\n", "\n").replace("\r", "\n").replace("\x1a", "")
    control_character = re.search(r"[\x00-\x08\x0e-\x1f]", text)
    if control_character is not None or not text.strip():
        cause = (
            "it is empty."
            if control_character is None
            else make_message("byte {ord:#04x} is no text.", ord=ord(control_character[0]))
        )
        raise damaged_report_error(file, cause)
    return [_TAGS.sub("", line[:MAX_LINE]).rstrip() for line in text.split("\n")]


def damaged_report_error(file: str, cause: str, line: int = 0) -> ProgramFileError:
    """Return the refusal of a report that is not as a controller writes it."""
    remedy = "Read the file from the controller again, in binary mode, whole."
    return ProgramFileError(file, cause, line=line, remedy=remedy)


def read_heading(lines: list[str]) -> ReportHeading:
    """Read the heading; what is not there stays empty. A page of the controller's web server may stand before it."""
    found: dict[str, str] = {}
    start = next((at for at, line in enumerate(lines) if _F_NUMBER.match(line)), 0)
    for line in lines[start : start + _HEADING_LINES]:
        match = _HEADING.match(line)
        if match is not None:
            found.setdefault(match[1].upper(), match[2])
    date = parse_date(found.get("DATE", ""))
    return ReportHeading(
        found.get("F NUMBER", ""), found.get("VERSION", ""), found.get("$VERSION", "").split("  ")[0], date
    )


def parse_date(text: str) -> datetime | None:
    """Read 27-AUG-26 13:14, with or without seconds; None where there is no such date."""
    found = _DATE.search(text)
    if found is None or found[2].upper() not in _MONTHS:
        return None
    year = int(found[3])
    if len(found[3]) == 2:  # clocks begin in 1980, and go back to then or to 1990 without their battery
        year += 1900 if year >= _FIRST_YEAR else 2000
    month = _MONTHS.index(found[2].upper()) + 1
    try:
        return datetime(  # noqa: DTZ001  the controller's clock has no zone
            year, month, int(found[1]), int(found[4]), int(found[5]), int(found[6] or 0)
        )
    except ValueError:
        return None
