"""What options and registers of FANUC motions do to positions: increments, led motions, shifts, other frames."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.drivers.fanuc.program_files.ls_registers import indirect_line, registers_used
from cellcal.drivers.fanuc.program_files.ls_statements import read_statements
from cellcal.drivers.fanuc.program_files.programs import BRAND
from cellcal.drivers.programs.cross_file_uses import BatchDeclarations
from cellcal.drivers.programs.shifts import ShiftAxes
from cellcal.service.engineering.programs.move import move_transfer
from cellcal.service.engineering.programs.project import read_project
from cellcal.service.engineering.programs.result import ProgramResult
from cellcal.service.exit_codes import ExitCode
from tests.programs.listings_to_move import PROJECT

RECORD = """P[{number}]{{
   GP1:
	UF : {frame}, UT : {tool},		CONFIG : 'N U T, 0, 0, 0',
	X =   100.000  mm,	Y =    {number}.000  mm,	Z =    20.000  mm,
	W =   180.000 deg,	P =      .000 deg,	R =      .000 deg{external}
}};
"""
JOINT = """P[{number}]{{
   GP1:
	UF : 1, UT : 1,
	J1=     0.000 deg,	J2=     0.000 deg,	J3=     0.000 deg,
	J4=     0.000 deg,	J5=   -30.000 deg,	J6=     0.000 deg
}};
"""


def listing_bytes(*lines: str, records: tuple[str, ...] | None = None, group: str = "1,*,*,*,*") -> bytes:
    """Return a listing with these statements and three positions."""
    body = "".join(f"{i:4d}:{line} ;\n" for i, line in enumerate(lines, 1))
    position_records = [position_record(number) for number in (1, 2, 3)] if records is None else records
    head = f"/PROG  A\n/ATTR\nDEFAULT_GROUP\t= {group};\n/MN\n"
    return f"{head}{body}/POS\n{''.join(position_records)}/END\n".encode("cp437")


def position_record(number: int, *, frame: str = "1", tool: str = "1", external: str = "") -> str:
    """Return a Cartesian position."""
    return RECORD.format(number=number, frame=frame, tool=tool, external=external)


def move_listing(data: bytes, tmp_path: Path, *, turn: bool = True, joints=None) -> ProgramResult:
    """Return a listing whose work moves, by a turn about z and a step."""
    file = tmp_path / "project.toml"
    file.write_text(PROJECT, encoding="utf-8")
    angle = np.radians(30.0) if turn else 0.0
    c, s = np.cos(angle), np.sin(angle)
    change = homogeneous_matrix(
        np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]), np.array([0.03, -0.02, 0.005])
    )
    return move_transfer(read_project(file), change, BRAND.configurations, joints=joints).transfer_programs(
        [BRAND.read("a.ls", data)]
    )[0]


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ("FINE INC", "increment"),
        ("CNT50 ACC80 INC", "increment"),
        ("FINE inc", "increment"),
        ("FINE COORD", "leads"),
        ("FINE COORD[LDR]", "leads"),
        ("FINE RTCP", "stands in the cell"),
        ("FINE VOFFSET,VR[1]", "camera"),
    ],
)
def test_what_is_no_place_is_left_and_named(options: str, word: str, tmp_path: Path) -> None:
    data = listing_bytes("L P[1] 100mm/sec FINE", f"L P[2] 100mm/sec {options}", "L P[3] 100mm/sec FINE")

    result = move_listing(data, tmp_path)

    assert result.status == ("changed", "left", "changed")
    assert word in result.reason[1]
    assert result.exit_code is ExitCode.REFUSED
    assert position_record(2) in result.after.to_bytes().decode()


@pytest.mark.parametrize(
    "lines",
    [
        ("PR[3]=VR[1].OFFSET", "L P[1] 100mm/sec FINE Offset,PR[3]"),
        ("PR[4]=VR[1].OFFSET", "PR[3]=PR[4]", "OFFSET CONDITION PR[3]", "L P[1] 100mm/sec FINE Offset"),
    ],
)
def test_a_shift_that_a_camera_measures_leaves_its_point(lines: tuple[str, ...], tmp_path: Path) -> None:
    result = move_listing(listing_bytes(*lines), tmp_path, turn=False)

    assert result.status == ("left", "changed", "changed")
    assert "camera" in result.reason[0]


def test_both_points_of_an_incremental_circle_are_left(tmp_path: Path) -> None:
    data = listing_bytes("L P[1] 100mm/sec FINE", "C P[2]    \n    :  P[3] 100mm/sec FINE INC")

    assert move_listing(data, tmp_path).status == ("changed", "left", "left")


@pytest.mark.parametrize(
    "line",
    ["L P[1:INC] 100mm/sec FINE", "//L P[1] 100mm/sec FINE INC", "L P[1] 100mm/sec FINE TB .1sec,CALL INC"],
)
def test_the_word_alone_makes_no_increment(line: str, tmp_path: Path) -> None:
    result = move_listing(listing_bytes(line, "L P[2] 100mm/sec FINE", "L P[3] 100mm/sec FINE"), tmp_path)

    assert result.status == ("changed",) * 3


def test_a_register_that_chooses_an_increment_leaves_every_position(tmp_path: Path) -> None:
    result = move_listing(listing_bytes("L P[1] 100mm/sec FINE", "L P[R[4]] 100mm/sec FINE INC"), tmp_path)

    assert result.status == ("left",) * 3


@pytest.mark.parametrize(
    ("lines", "turn", "found"),
    [
        (("L P[1] 100mm/sec FINE Offset,PR[3]",), True, {"P[1]"}),
        (("L P[1] 100mm/sec FINE Offset,PR[3]",), False, {"P[1]"}),  # nothing fills it: it may turn
        (("PR[3,3]=50", "L P[1] 100mm/sec FINE Offset,PR[3]"), False, set()),
        (("L P[1] 100mm/sec FINE Offset,PR[R[3]]",), False, {"P[1]"}),
        (("L P[1] 100mm/sec FINE Versatz,PR[3]",), True, {"P[1]"}),
        (("OFFSET CONDITION PR[3]", "L P[1] 100mm/sec FINE Offset"), True, {"P[1]"}),
        (("L P[1] 100mm/sec FINE Tool_Offset,PR[3]",), True, set()),
        (("L P[1] 100mm/sec FINE Skip,LBL[1],PR[3]=LPOS",), True, set()),
        (("PR[3]=P[1]", "PR[3,1]=PR[3,1]+50", "L PR[3] 100mm/sec FINE"), True, {"P[1]"}),
        (("PR[3]=P[1]", "PR[3,3]=PR[3,3]+50", "L PR[3] 100mm/sec FINE"), True, set()),  # it turns about z
        (("PR[3]=P[1]", "L PR[3] 100mm/sec FINE"), True, set()),
        (("PR[3]=P[1]", "PR[R[1],3]=50", "L PR[3] 100mm/sec FINE"), True, {"P[1]"}),
        (("PR[3]=P[1]", "PR[GP2:3,1]=50", "L PR[3] 100mm/sec FINE"), True, set()),
        (("PR[3]=P[1]", "L PR[3] 100mm/sec FINE Offset,PR[4]"), True, {"P[1]"}),
        (("L P[1] 100mm/sec FINE", "PR[3]=LPOS", "PR[3,3]=0", "L PR[3] 100mm/sec FINE"), True, {"P[1]"}),
        (("PR[3]=LPOS", "PR[3,3]=PR[3,3]+50", "L PR[3] 100mm/sec FINE"), True, {"PR[3]"}),
        (("PR[3]=LPOS", "L P[1] 100mm/sec FINE", "L PR[3] 100mm/sec FINE"), True, set()),
        (("L P[R[1]] 100mm/sec FINE Offset,PR[3]",), True, {"P[1]", "P[2]", "P[3]"}),
        (("Touch Offset PR[3]", "L P[1] 99mm/sec FINE", "Touch Offset End", "L P[2] 9mm/sec FINE"), True, {"P[1]"}),
        (("TOUCH OFFSET PR[3]", "L P[1] 99mm/sec FINE", "TOUCH OFFSET END", "L P[2] 9mm/sec FINE"), True, {"P[1]"}),
        (("L P[1] 99mm/sec FINE", "L P[9] 99mm/sec FINE"), False, {"P[9]"}),  # not under /POS
        (("L P[1] 99mm/sec FINE", "!L P[9] 99mm/sec FINE"), True, set()),
        (("MP OFFSET PR[3] RPM[1]", "L P[1] 99mm/sec FINE", "MP OFFSET END", "L P[2] 9mm/sec FINE"), True, {"P[1]"}),
    ],
)  # fmt: skip
def test_shifts_by_registers_are_findings_where_the_work_turns(
    lines: tuple[str, ...], turn: bool, found: set[str], tmp_path: Path
) -> None:
    result = move_listing(listing_bytes(*lines), tmp_path, turn=turn)

    assert {finding.point for finding in result.findings} == found
    assert not result.excluded_points
    assert result.exit_code is (ExitCode.REFUSED if found else ExitCode.PASS)
    for finding in result.findings:
        assert np.degrees(finding.angle_rad) == pytest.approx(30.0 if turn else 0.0)


def test_a_shift_that_the_program_states_costs_its_own_distance(tmp_path: Path) -> None:
    lines = ("PR[3]=PR[3]-PR[3]", "PR[3,1]=80", "L P[1] 100mm/sec FINE Offset,PR[3]")

    (finding,) = move_listing(listing_bytes(*lines), tmp_path).findings

    assert finding.distance_m == pytest.approx(0.08 * 2 * np.sin(np.radians(15.0)), abs=1e-6)
    along_the_axis = ("PR[3]=PR[3]-PR[3]", "PR[3,3]=80", "L P[1] 100mm/sec FINE Offset,PR[3]")
    assert not move_listing(listing_bytes(*along_the_axis), tmp_path).findings
    branched = ("IF R[1]=1,JMP LBL[1]", "PR[3]=PR[3]-PR[3]", "LBL[1]", "L P[1] 100mm/sec FINE Offset,PR[3]")
    assert move_listing(listing_bytes(*branched), tmp_path).findings
    called = (
        "PR[3]=PR[3]-PR[3]",
        "L P[2] 9mm/sec FINE TB .1sec,CALL X",
        "L P[1] 100mm/sec FINE Offset,PR[3]",
    )
    assert move_listing(listing_bytes(*called), tmp_path).findings


@pytest.mark.parametrize(
    "lines",
    [
        ("PR[3]=P[2]", "L P[1] 100mm/sec FINE Offset,PR[3]"),
        ("PR[3]=P[2]", "L PR[3] 100mm/sec FINE INC"),
        ("PR[3]=PR[4]+P[2]", "L PR[3] 100mm/sec FINE"),
        ("PR[3]=P[2]", "CALL GRIP"),
        ("PR[R[1]]=P[2]", "L P[1] 100mm/sec FINE Offset,PR[3]"),
        ("PR[3]=P[R[1]]", "L P[1] 100mm/sec FINE Offset,PR[3]"),
        ("PR[3]=P[2]", "TOOL_OFFSET CONDITION PR[3]", "L P[1] 100mm/sec FINE Tool_Offset"),
    ],
)
def test_a_position_that_is_only_computed_with_is_left(lines: tuple[str, ...], tmp_path: Path) -> None:
    result = move_listing(listing_bytes(*lines), tmp_path)

    assert result.status[1] == "left"
    assert "computes" in result.reason[1]


@pytest.mark.parametrize(
    ("lines", "left_points"),
    [
        (("UFRAME_NUM=2", "L P[1] 100mm/sec FINE"), {"P[1]": "user frame 2"}),
        (("UFRAME_NUM[GP1]=2", "L P[1] 100mm/sec FINE"), {"P[1]": "user frame 2"}),
        (("UFRAME_NUM[GP2]=2", "L P[1] 100mm/sec FINE"), {}),
        (("UTOOL_NUM=4", "L P[1] 100mm/sec FINE"), {"P[1]": "tool 4"}),
        (("UFRAME_NUM=1", "L P[1] 100mm/sec FINE", "UFRAME_NUM=2", "L P[3] 9mm/sec FINE"), {"P[3]": "user frame 2"}),
        (("UFRAME_NUM=2", "CALL FRAMES", "L P[1] 100mm/sec FINE"), {}),
        (("UFRAME_NUM=2", "UFRAME_NUM=R[1]", "L P[1] 100mm/sec FINE"), {}),
        (("IF R[1]=1,UFRAME_NUM=2", "L P[1] 100mm/sec FINE"), {}),
        (("UFRAME_NUM=2", "LBL[1]", "L P[1] 100mm/sec FINE"), {}),
    ],
)  # fmt: skip
def test_a_frame_or_tool_unlike_the_points_own_is_reported(
    lines: tuple[str, ...], left_points: dict[str, str], tmp_path: Path
) -> None:
    result = move_listing(listing_bytes(*lines), tmp_path)

    assert dict(result.excluded_points).keys() == left_points.keys()
    for point, words in left_points.items():
        assert words in dict(result.excluded_points)[point]
        assert "the controller stops there" in dict(result.excluded_points)[point]


def test_a_program_without_motion_group_1_is_reported(tmp_path: Path) -> None:
    result = move_listing(listing_bytes("L P[1] 100mm/sec FINE", group="*,1,*,*,*"), tmp_path)

    assert result.status == ("left",) * 3
    assert "motion group 1" in result.reason[0]


def test_a_group_that_a_position_was_not_taught_in_is_reported(tmp_path: Path) -> None:
    second = "   GP2:\n\tUF : 0, UT : 1,\t\n\tJ1=     0.000 deg\n};\n"
    records = (position_record(1).removesuffix("};\n") + second, position_record(2))

    result = move_listing(
        listing_bytes("L P[1] 100mm/sec FINE", records=records, group="1,1,*,*,*"), tmp_path
    )

    names = zip(
        result.before.positions.names, result.before.positions.groups.tolist(), result.status, strict=True
    )
    assert list(names) == [("P[1]", 1, "changed"), ("P[1]", 2, "left"), ("P[2]", 1, "left")]
    assert "motion group 2" in result.reason[2]


def test_points_beside_a_moving_axis_are_left_together(tmp_path: Path) -> None:
    rail = (
        position_record(1, external=",\n\tE1=     0.000  mm"),
        position_record(2, external=",\n\tE1=   800.000  mm"),
    )
    still = (
        position_record(1, external=",\n\tE1=     0.000  mm"),
        position_record(2, external=",\n\tE1=     0.000  mm"),
    )
    moves = ("L P[1] 100mm/sec FINE", "L P[2] 100mm/sec FINE")

    assert move_listing(listing_bytes(*moves, records=rail), tmp_path).status == ("left", "left")
    assert move_listing(listing_bytes(*moves, records=still), tmp_path).status == ("changed", "changed")


def test_a_positioner_in_another_group_refuses_no_program(tmp_path: Path) -> None:
    second = "   GP2:\n\tUF : 0, UT : 1,\t\n\tJ1=    {}.000 deg\n}};\n"
    records = tuple(position_record(n).removesuffix("};\n") + second.format(30 * (n - 1)) for n in (1, 2))

    result = move_listing(
        listing_bytes("L P[1] 100mm/sec FINE", records=records, group="1,1,*,*,*"), tmp_path
    )

    assert result.status == ("left",) * 4
    assert "external axes" in result.reason[0]


@pytest.mark.parametrize(
    ("joints", "status"), [("keep", "unchanged"), ("move", "changed"), (None, "changed")]
)
def test_the_option_for_joint_angles_goes_before_their_frame(joints, status: str, tmp_path: Path) -> None:
    records = (JOINT.format(number=1), position_record(2))
    data = listing_bytes("J P[1] 100% FINE", "L P[2] 100mm/sec FINE", records=records)

    result = move_listing(data, tmp_path, joints=joints)

    assert result.status == (status, "changed")
    assert (JOINT.format(number=1) in result.after.to_bytes().decode()) is (joints == "keep")


@pytest.mark.parametrize(
    ("line", "place"),
    [
        ("L PR[5] 100mm/sec FINE", True),
        ("L PR[5] 100mm/sec FINE INC", False),
        ("L PR[5] 100mm/sec FINE COORD", False),
        ("L PR[5] 100mm/sec FINE Offset", False),
        ("C PR[5]    \n    :  P[3] 100mm/sec FINE INC", False),
        ("L PR[5] 100mm/sec FINE VOFFSET,VR[2]", False),
    ],
)
def test_a_register_is_a_place_where_the_robot_goes_there_as_it_stands(line: str, place: bool) -> None:
    (use,) = registers_used(listing_bytes(line))

    assert use.goes_there is place


def test_a_register_that_is_chosen_and_computed_is_found() -> None:
    assert indirect_line(listing_bytes("L PR[R[1]] 100mm/sec FINE")) == 0
    assert indirect_line(listing_bytes("L PR[R[1]] 100mm/sec FINE INC")) == 5
    assert indirect_line(listing_bytes("PR[R[1],3]=20")) == 5


def test_a_shift_says_in_which_axes_it_is() -> None:
    shifts = BRAND.read("a.ls", listing_bytes("L P[1] 100mm/sec FINE Offset,PR[3]")).positions.shifts

    assert [(one.line, one.axes, one.rows) for one in shifts] == [(5, ShiftAxes.USER_FRAME, (0,))]


@pytest.mark.parametrize(
    ("lines", "other"),
    [
        (("PR[3,6]=5", "OFFSET CONDITION PR[3]", "L P[1] 100mm/sec FINE Offset"), ()),
        (("LBL[1]", "L P[1] 100mm/sec FINE Offset", "PR[3,6]=5", "OFFSET CONDITION PR[3]", "JMP LBL[1]"), ()),
        (("PR[3,3]=5", "CALL B", "L P[1] 100mm/sec FINE Offset,PR[3]"), ("PR[3,6]=10",)),
        (("OFFSET CONDITION PR[3]", "CALL B", "L P[1] 100mm/sec FINE Offset"), ("PR[3,4]=R[1]",)),
    ],
)
def test_a_register_that_turns_a_shift_is_a_finding_of_a_step_too(
    lines: tuple[str, ...], other: tuple[str, ...], tmp_path: Path
) -> None:
    data = listing_bytes("PR[3]=LPOS-LPOS", *lines)
    files = {"a.ls": data, "b.ls": listing_bytes(*other, records=()).replace(b"/PROG  A", b"/PROG  B")}
    across = BatchDeclarations({file: BRAND.read(file, each).declarations for file, each in files.items()})
    program = BRAND.read("a.ls", data).with_external_uses(across.uses_of_file("a.ls"))

    (shift,) = program.positions.shifts

    assert shift.quaternion is None


def test_a_step_from_here_on_a_led_motion_is_a_finding() -> None:
    data = listing_bytes("PR[1]=LPOS", "PR[1,1]=PR[1,1]+R[1]", "L PR[1] 100mm/sec FINE COORD", records=())
    (shift,) = BRAND.read("a.ls", data).positions.shifts
    assert (shift.point, shift.axes) == ("PR[1]", ShiftAxes.USER_FRAME)


@pytest.mark.parametrize(
    ("broken", "following"),
    [
        (b"--eg:THE PART IS NOT IN THE SPINDLE\n    :  CALL THE PEOPLE ;", b""),
        (b"!THE PART\r\n    :  L P[2] IS NOT\r\n    :  CLEAR ;", b""),
        (b"//C P[1]    \n    :  P[2] 600mm/sec FINE Offset,PR[1] ;", b""),
        (
            b"!A MOTION BELOW\n    :L P[1] 100mm/sec FINE Offset,PR[1] ;",
            b"L P[1] 100mm/sec FINE Offset,PR[1]",
        ),
    ],
)
def test_a_remark_that_the_controller_broke_is_no_statement(broken: bytes, following: bytes) -> None:
    data = listing_bytes("REMARK", "L P[3] 100mm/sec FINE").replace(b"REMARK ;", broken)
    lines = data[: data.index(b"L P[3]")].count(b"\n") + 1

    statements = list(read_statements(data))

    assert [each.text for each in statements] == [
        *([following] if following else []),
        b"L P[3] 100mm/sec FINE",
    ]
    assert statements[-1].line == lines
