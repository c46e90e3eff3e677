"""Reports of FANUC controllers: read in any usual form, refused where something is missing or no number."""

import pytest

from cellcal.calibration.errors import CellError
from cellcal.drivers.fanuc.controller_files.alarm_report import read_alarm_report
from cellcal.drivers.fanuc.controller_files.axis_report import read_axis_report
from cellcal.drivers.fanuc.controller_files.controller_address import parse_address
from cellcal.drivers.fanuc.controller_files.position_report import read_position_report
from cellcal.drivers.fanuc.controller_files.report_text import decode_report, parse_date, read_heading
from cellcal.drivers.fanuc.controller_files.version_report import read_version_report
from cellcal.drivers.programs.errors import ProgramFileError

TABLE = (
    "AXIS PULSE STATUS:\n      Position    Machine     Motion    \n        Error        Pulse      Command \n"
)


def axis_bytes(*rows: str) -> bytes:
    return (
        "F Number: F1\nDATE:     27-AUG-26 13:14 \n\n" + TABLE + "\n".join(rows) + "\n\nAXIS MONITOR:\n"
    ).encode()


def test_pulses_of_one_group() -> None:
    report = read_axis_report(
        axis_bytes(" J1 :         0     6703385           0", " J2 :        -3    -4926001           0")
    )
    assert report.pulses == ((6703385, -4926001),)
    assert (report.heading.f_number, str(report.heading.written)) == ("F1", "2026-08-27 13:14:00")
    assert report.split_by_groups((2,)) == ((6703385, -4926001),)
    assert report.split_by_groups((3,)) == ()


@pytest.mark.parametrize(
    "rows",
    [
        (" J1 : 0 11 0", " J2 : 0 12 0", " J3 : 0 21 0"),  # on with the next number
        (" J1 : 0 11 0", " J2 : 0 12 0", "Group #:  2", " J1 : 0 21 0"),
        ("GROUP: 1", "J1: 0 11 0", "J2: 0 12 0", "", "GROUP: 2", "J1: 0 21 0"),
        (" j1 : 0 +11 0", " j2 : 0 12", " j1 : 0 21 0"),  # numbered anew, without a heading
    ],
)
def test_pulses_of_two_groups(rows: tuple[str, ...]) -> None:
    assert read_axis_report(axis_bytes(*rows)).split_by_groups((2, 1)) == ((11, 12), (21,))


def test_a_count_that_is_not_shown_is_none() -> None:
    assert read_axis_report(axis_bytes(" J1 : 0 ******** 0", " J2 : 0 5 0")).pulses == ((None, 5),)


@pytest.mark.parametrize(
    "rows",
    [
        (),
        (" J1 : 0 67x3 0",),
        (" J1 : 0 4294967296 0",),
        (" J1 : 0 1 0", " J3 : 0 1 0"),
        (" J1 : 0",),
        (" J1 : 0 nan 0",),
    ],
)
def test_a_table_of_pulses_that_is_not_whole_is_refused(rows: tuple[str, ...]) -> None:
    with pytest.raises(ProgramFileError):
        read_axis_report(axis_bytes(*rows))


@pytest.mark.parametrize("rest", [" J1 : 0 11 0\n J2 : 0 1234", " J1 : 0 11 0\n J2 : 0 1234567 0"])
def test_a_table_of_pulses_whose_last_line_has_no_end_is_refused(rest: str) -> None:
    assert read_axis_report((TABLE + rest + "\n").encode()).pulses[0][0] == 11
    with pytest.raises(ProgramFileError, match="ends within the table"):
        read_axis_report((TABLE + rest).encode())


CURPOS = """CURRENT ROBOT POSITION::
Group #:  1

CURRENT JOINT POSITION:
Joint   1:    -35.00
Joint   2:       .25

Frame #:   3  Tool #:   1
CURRENT USER FRAME POSITION:
X:    466.50

Group #:  2

CURRENT JOINT POSITION:
Joint   1: *********
"""


def test_shown_joints_of_each_group() -> None:
    report = read_position_report(CURPOS.encode())
    first, second = report.groups
    assert (first.joints_deg, first.frame, first.tool) == ((-35.0, 0.25), 3, 1)
    assert (second.group, second.joints_deg) == (2, (None,))
    upper = read_position_report(CURPOS.upper().replace("\n", "\r\n").encode())
    assert upper.groups == report.groups


@pytest.mark.parametrize(
    ("old", "new"),
    [(".25", "1e9"), (".25", "nan"), (".25", "--"), ("Joint   2", "Joint   3"), ("Joint   2", "Joint   1")],
)
def test_joints_that_are_no_numbers_or_missing_are_refused(old: str, new: str) -> None:
    with pytest.raises(ProgramFileError):
        read_position_report(CURPOS.replace(old, new, 1).encode())


def test_extended_axes_follow_the_joints_of_the_arm() -> None:
    shown = CURPOS.replace("Joint   2:       .25\n", "Joint   2:       .25\nEXTAXS: 1:  -1444.07\n", 1)
    after_pose = shown.replace("X:    466.50\n", "X:    466.50\nEXTAXS: 1:  -1444.07\n", 1)
    for text in (shown, after_pose):
        assert read_position_report(text.encode()).groups[0].joints_deg == (-35.0, 0.25, -1444.07)
    with pytest.raises(ProgramFileError):
        read_position_report(shown.replace("-1444.07", "nan").encode())


def test_active_alarms() -> None:
    head = "ERRACT.LS      Robot Name R 01 27-AUG-26 13:14:06  \n\n"
    line = '4428" 27-AUG-26 12:02:10 " SRVO-062 BZAL alarm (Group:1 Axis:3)   " " SERVO   00110110" \n'
    report = read_alarm_report(
        (head + line + line.replace("SRVO-062 BZAL alarm (Group:1 Axis:3)", "R E S E T")).encode()
    )
    first, second = report.alarms
    assert (first.code, first.text, first.group, first.axis) == (
        "SRVO-062",
        "BZAL alarm (Group:1 Axis:3)",
        1,
        3,
    )
    assert (second.code, second.text) == ("", "R E S E T")
    assert (report.robot_name, str(report.written)) == ("R 01", "2026-08-27 13:14:06")
    assert read_alarm_report(head.encode()).alarms == ()
    short = read_alarm_report((head + line.replace("(Group:1 Axis:3)", "(G:2 A:6)")).encode())
    assert (short.alarms[0].group, short.alarms[0].axis) == (2, 6)


def test_an_alarm_that_is_not_understood_does_not_pass_for_none() -> None:
    with pytest.raises(ProgramFileError, match="no alarm"):
        read_alarm_report(b'ERRACT.LS\n\n4428" 27-AUG-26 12:02')
    with pytest.raises(ProgramFileError, match="empty"):
        read_alarm_report(b" \r\n")


@pytest.mark.parametrize("missing", range(1, 100, 9))
def test_a_list_of_alarms_that_was_cut_off_does_not_pass_for_none(missing: int) -> None:
    head = "ERRACT.LS      Robot Name R 01 27-AUG-26 13:14:06  \n\n"
    line = '4428" 27-AUG-26 12:02:10 " SRVO-062 BZAL alarm (Group:1 Axis:3)   " " SERVO   00110110" \n'
    with pytest.raises(ProgramFileError):
        read_alarm_report((head + line)[: -missing - 1].rstrip("\n").encode())


def test_whose_controller_it_is() -> None:
    text = (
        "F Number: F1\nVERSION : HandlingTool\n$VERSION: V8.30273     5/6/2020\n\nVERSION INFORMATION::\n"
        "Robot No.           : F2\nLR Mate 200iD         V8.30P/33 \nSoftware Edition No.: V8.30P/33 \n"
        "CONFIG::\nFEATURE:              ORD NO:\nHMI Device (SNPX)     R553\nMOTOR::\n"
    )
    report = read_version_report(text.encode())
    assert (report.serial, report.robots, report.software) == ("F2", ("LR Mate 200iD",), "V8.30P/33")
    assert report.options == ("R553",)
    assert read_version_report(b"something else").serial == ""


def test_dates_and_addresses() -> None:
    assert str(parse_date("DATE: 1-jan-2024 7:05")) == "2024-01-01 07:05:00"
    assert str(parse_date("01-JAN-90 00:00")) == "1990-01-01 00:00:00"  # of a clock without its battery
    assert parse_date("31-FEB-26 13:14") is None
    assert parse_date("27-ABC-26 13:14") is None
    assert str(parse_address("robot1")) == "robot1"
    assert str(parse_address("ftp://10.0.0.9:2121/")) == "10.0.0.9:2121"
    assert str(parse_address("[fe80::1]:21")) == "[fe80::1]"
    assert str(parse_address("fe80::1")) == "[fe80::1]"
    assert str(parse_address("fanuc://10.0.0.9")) == "10.0.0.9"
    wrong = (
        "",
        "a b",
        "host:0",
        "host:70000",
        "user@host",
        "../x",
        "host:21:22",
        "10.0.0.300",
        "10.0.0",
        "[::g]",
    )
    for text in wrong:
        with pytest.raises(CellError):
            parse_address(text)


def test_a_robot_is_named_by_the_options_where_the_line_names_another_group() -> None:
    text = "\n".join(
        [
            *(
                "F Number: F1",
                "VERSION INFORMATION::",
                "SOFTWARE:              ID:",
                "HandlingTool   7DC3/39",
            ),
            *("Independent Axes      V8.20P/A2 ", "Servo Code          : V06.04", "CONFIG::"),
            *(
                "FEATURE:              ORD NO:",
                "R-2000iB/210F         H601",
                "FTP Interface         J716",
                "",
            ),
        ]
    )
    report = read_version_report(text.encode())
    assert (report.robots, report.options) == (("R-2000iB/210F",), ("H601", "J716"))
    named = text.replace("Independent Axes", "M-900iB/700-IF  ").replace("R-2000iB/210F", "M-900iB/700  ")
    assert read_version_report(named.encode()).robots == ("M-900iB/700-IF",)


def test_a_heading_is_found_behind_the_page_of_a_web_server() -> None:
    page = ["<html>", *["<!-- script -->"] * 60, "Robot No: E1<br>", "Date:  20/02/11", "<PRE>"]
    report = [
        "F Number: E1",
        "VERSION : ArcTool",
        "$VERSION: V7.7027  10/06/2010",
        "DATE:     11-FEB-20 15:40 ",
    ]
    heading = read_heading(decode_report("curpos.dg", "\n".join([*page, *report]).encode()))
    assert (heading.f_number, heading.software) == ("E1", "V7.7027")
    assert heading.written is not None
    assert heading.written.year == 2020
