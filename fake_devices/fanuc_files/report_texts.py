"""The .DG and .LS files of the fake controller: AXIS, CURPOS, VERSION, ERRACT and the programs."""

import math
from collections.abc import Sequence

from cellcal.fake_devices.fanuc_files.cabinet import FanucCabinet

_MONTHS = ("JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC")


def axis_text(cabinet: FanucCabinet) -> str:
    """Return AXIS.DG."""
    lines = _heading_lines(cabinet)
    for pulses in ([*cabinet.pulses(), *cabinet.rail_pulses()], cabinet.positioner_pulses()):
        lines += _axis_tables(pulses, ready="ON " if cabinet.servo_on else "OFF") if pulses else []
    return "\n".join([*lines, ""])


def _axis_tables(pulses: Sequence[int], *, ready: str) -> list[str]:
    """Return every table of one motion group; its axes are numbered from 1."""
    names = [f"J{axis}" for axis in range(1, len(pulses) + 1)]
    lines = ["AXIS STATUS1:", "      Flag Bits 1/2          History    "]
    for name in names:
        lines += [f" {name}: 0100000000001000 (0100000000001110)", "     0000001000010000 (0100001000010000)"]
    lines += ["", "AXIS STATUS2:", "      Alarm Status     History          "]
    lines += [f" {name} : 000000000000 ( 000000100000 )" for name in names]
    lines += [
        "",
        "AXIS PULSE STATUS:",
        "      Position    Machine     Motion    ",
        "        Error        Pulse      Command ",
    ]
    lines += [
        f" {name} :         0 {pulse:>11}           0" for name, pulse in zip(names, pulses, strict=True)
    ]
    lines += [
        "",
        "AXIS MONITOR:",
        "     Torque Monitor                     ",
        "           Ave. / Max.    Inpos OT VRDY ",
    ]
    lines += [f" {name} :      0.000/     0.000  1   0  {ready}" for name in names]
    lines += [
        "",
        "AXIS TRACKING:",
        "       Flag Bits 1      Flag Bits 2     ",
        " P1 : 0000000000000000 0000000000000000 ",
    ]
    return lines


def curpos_text(cabinet: FanucCabinet) -> str:
    """Return CURPOS.DG: angles cut off at a hundredth, stars while the position is not known."""
    lines = [
        *_heading_lines(cabinet),
        "CURRENT ROBOT POSITION::",
        "Group #:  1",
        " ",
        "CURRENT JOINT POSITION:",
    ]
    for axis, angle in enumerate(cabinet.shown_deg(), 1):
        lines += [f"Joint   {axis}: {_cut_angle(angle) if cabinet.knows_position else '*********'}"]
    if cabinet.rail_count_at_zero is not None:
        lines += [f"EXTAXS: 1: {cabinet.rail_mm:>9.2f}"]
    lines += ["", "", "Frame #:   3  Tool #:   1", "CURRENT USER FRAME POSITION:", "CFG: F U T, 0, 0, 0"]
    lines += [
        "X:    466.50",
        "Y:   -789.17",
        "Z:   -902.43",
        "W:       .32",
        "P:     -1.30",
        "R:     90.18",
        "",
    ]
    if cabinet.positioner_counts is not None:
        lines += [
            "CURRENT ROBOT POSITION::",
            "Group #:  2",
            " ",
            "CURRENT JOINT POSITION:",
            f"Joint   1: {_cut_angle(cabinet.positioner_at)}",
            "",
        ]
    return "\n".join([*lines, ""])


def version_text(cabinet: FanucCabinet) -> str:
    """Return VERSION.DG."""
    fields = [
        *("VERSION INFORMATION::", "SOFTWARE:              ID:", "HandlingTool          7DF5/83"),
        f"Robot No.           : {cabinet.f_number}",
        "Manufacturing ID    : ",
        f"{cabinet.robot}, HandlingTool    ",
        f"{cabinet.robot:<21} {cabinet.software} ",
        "Servo Code          : V15.02    ",
        f"Software Edition No.: {cabinet.software} ",
        *("", "CONFIG::", "FEATURE:              ORD NO:", "HandlingTool          H552"),
        *("FTP Interface         J716", "HMI Device (SNPX)     R553", "", "MOTOR::"),
        "     1   1     aiSR30/3000 80A H1 DSP1-S1",
    ]
    return "\n".join([*_heading_lines(cabinet), *fields, ""])


def erract_text(cabinet: FanucCabinet) -> str:
    """Return ERRACT.LS."""
    stamp = f"{_date_text(cabinet)}:{cabinet.now:%S}"
    lines = [f"ERRACT.LS      Robot Name {cabinet.robot_name} {stamp}  ", ""]
    for number, (code, text) in enumerate(cabinet.alarms, 4428):
        words = f"{code} {text}"
        lines += [f'{number}" {stamp} " {words:<45} " " SERVO                         00110110" ']
    return "\n".join([*lines, ""])


def dcs_text(cabinet: FanucCabinet) -> str:
    """Return DCSVRFY.DG: of its settings one, and the signature numbers at its end."""
    number = cabinet.safety_signature
    lines = [
        *_heading_lines(cabinet),
        "DCS Version: V4.2.14",
        "",
        "--- User frame -------------------------",
        "Group: 1",
        "--- Signature number (Dec) -------------",
        "                Current        Latch",
        f"1 Total:       {number + 7:>11} {number + 7:>12}",
        "  Time:27-JUL-21 19:49  15-JUL-21 21:30 ",
        "2 Base:        -1149932377  -1149932377",
        "   Mastering:   -983540984",
        f"3 Pos./Speed:  {number:>11} {number:>12}",
        "  Time:12-JUL-21 01:09  15-JUL-21 21:30 ",
        "",
    ]
    return "\n".join(lines)


def program_text(cabinet: FanucCabinet, name: str) -> str:
    """Return a program as a listing."""
    lines = [
        *(f"/PROG  {name}", "/ATTR", "OWNER\t\t= MNEDITOR;", f'COMMENT\t\t= "{name}";', "PROG_SIZE\t= 412;"),
        f"MODIFIED\t= DATE {cabinet.now:%y-%m-%d}  TIME {cabinet.now:%H:%M:%S};",
        *("DEFAULT_GROUP\t= 1,*,*,*,*;", "/MN", f"   1:  {cabinet.programs[name]} ;", "/POS", "/END"),
    ]
    return "\n".join([*lines, ""])


def _heading_lines(cabinet: FanucCabinet) -> list[str]:
    return [
        f"F Number: {cabinet.f_number}",
        "VERSION : HandlingTool         ",
        "$VERSION: V9.40526     12/12/2025",
        f"DATE:     {_date_text(cabinet)} ",
        "",
    ]


def _date_text(cabinet: FanucCabinet) -> str:
    now = cabinet.now
    return f"{now.day:02d}-{_MONTHS[now.month - 1]}-{now:%y %H:%M}"


def _cut_angle(angle: float) -> str:
    cut = math.trunc(round(angle * 100, 6)) / 100
    text = f"{cut:.2f}"
    return f"{text.replace('0.', '.', 1) if 0 < abs(cut) < 1 else text:>9}"
