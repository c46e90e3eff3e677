"""AXIS.DG: the present pulse count of each motor, in the column Machine Pulse.

::

    AXIS PULSE STATUS:
          Position    Machine     Motion
            Error        Pulse      Command
     J1 :         0     6703385           0

Axes of further motion groups follow: numbered anew below a heading of their group, or on with J7, J8.
"""

import re
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.controller_files.report_text import (
    ReportHeading,
    damaged_report_error,
    decode_report,
    read_heading,
)

_PULSES = re.compile(r"\s*AXIS\s+PULSE\s+STATUS", re.IGNORECASE)
_SECTION = re.compile(r"\s*AXIS\s+[A-Z0-9 ]+:?\s*\Z", re.IGNORECASE)
_GROUP = re.compile(r"\s*G(?:ROU)?P\s*(?:#|NO\.?)?\s*:?\s*#?\s*(\d+)", re.IGNORECASE)
_NUMBER = r"([+-]?\d{1,10}|\*+|-{2,})"
_ROW = re.compile(
    rf"\s*(?:G\d+)?\s*(?:J|A|AXIS)\s*(\d+)\s*:\s*{_NUMBER}\s+{_NUMBER}(?:\s+{_NUMBER})?\s*\Z", re.IGNORECASE
)
_LOOKS_LIKE_ROW = re.compile(r"\s*(?:J|A|AXIS)\s*\d+\s*:", re.IGNORECASE)
_READY = re.compile(r"\s*J\s*(\d+)\s*:.*\b(ON|OFF)\s*\Z", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class AxisReport:
    """Pulse counts by motion group; None where the controller shows no number."""

    heading: ReportHeading
    pulses: tuple[tuple[int | None, ...], ...]  # one row for each group, in their order
    servo_ready: bool | None  # None: it does not say

    def split_by_groups(self, axes: tuple[int, ...]) -> tuple[tuple[int | None, ...], ...]:
        """Return the pulses of each group, where groups have that many axes; empty where they do not fit.

        Axes that no variable tells of may follow those of a group; where the groups are in one row, none may.
        """
        if len(self.pulses) == len(axes):
            pairs = list(zip(self.pulses, axes, strict=True))
            fits = all(len(row) >= count for row, count in pairs)
            return tuple(row[:count] for row, count in pairs) if fits else ()
        together = [pulse for row in self.pulses for pulse in row]
        if len(self.pulses) != 1 or len(together) != sum(axes):
            return ()
        found, at = [], 0
        for count in axes:
            found.append(tuple(together[at : at + count]))
            at += count
        return tuple(found)


def read_axis_report(data: bytes, file: str = "axis.dg") -> AxisReport:
    """Read the pulse counts.

    Raises
    ------
    ProgramFileError
        There are none, or the table is not whole.
    """
    lines = decode_report(file, data)
    rows: list[dict[int, int | None]] = []
    inside = False
    for number, line in enumerate(lines, 1):
        if _PULSES.match(line):
            inside = True
        elif _SECTION.match(line):
            inside = False
        elif inside:
            _take_line(rows, line, file, number)
    if not rows:
        raise damaged_report_error(file, "it holds no table of pulses (AXIS PULSE STATUS).")
    if inside and lines[-1]:  # a line of the table without an end: digits may be missing
        raise damaged_report_error(file, "it ends within the table of pulses.", len(lines))
    pulses = tuple(_whole_row(row, file) for row in rows if row)
    return AxisReport(read_heading(lines), pulses, _read_servo(lines))


def _take_line(rows: list[dict[int, int | None]], line: str, file: str, number: int) -> None:
    group, row = _GROUP.match(line), _ROW.match(line)
    if row is not None:
        axis, pulse = int(row[1]), _parse_pulse(row[3], file, number)
        if not rows or axis in rows[-1]:
            rows.append({})
        rows[-1][axis] = pulse
    elif group is not None and rows and rows[-1]:
        rows.append({})
    elif _LOOKS_LIKE_ROW.match(line):
        raise damaged_report_error(
            file,
            make_message("this line of pulses is not understood: {text!r}.", text=line.strip()[:60]),
            number,
        )


def _parse_pulse(text: str, file: str, number: int) -> int | None:
    if text.startswith(("*", "--")):
        return None
    if not -(2**31) <= int(text) < 2**31:
        raise damaged_report_error(file, make_message("{text} is no count of 32 bits.", text=text), number)
    return int(text)


def _whole_row(row: dict[int, int | None], file: str) -> tuple[int | None, ...]:
    first = min(row)
    if sorted(row) != list(range(first, first + len(row))):
        axes = ", ".join(f"J{axis}" for axis in sorted(row))
        raise damaged_report_error(
            file, make_message("pulses are there of {axes} only; an axis between is missing.", axes=axes)
        )
    return tuple(row[axis] for axis in sorted(row))


def _read_servo(lines: list[str]) -> bool | None:
    words = [found[2].upper() for line in lines if (found := _READY.match(line))]
    return None if not words else "ON" in words
