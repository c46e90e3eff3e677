"""KUKA files: what is read, what is left alone, what is refused; conventions on a real controller's data."""

from dataclasses import fields
from typing import cast

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.calibration.orientation import rotation_from
from cellcal.drivers.kuka.program_files.configuration import KukaConfigurations
from cellcal.drivers.kuka.program_files.programs import BRAND, writes_program
from cellcal.drivers.program_registry import read_program
from cellcal.drivers.programs.barred import COMPUTED
from cellcal.drivers.programs.brands import DeclaringProgram
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, UNREAD, UNTAUGHT, PositionChange
from tests.programs import generate_kuka
from tests.programs.fuzz import some_change

DAT = b"""&ACCESS RVP\r
DEFDAT  SCHWEISSEN PUBLIC\r
;DECL E6POS XP9={X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0}\r
DECL E6POS XP1={X 100.5,Y -20.25,Z 0.0,A 90.0,B 0.0,C 180.0,S 2,T 35,E1 0.0,E2 0.0}\r
DECL FDAT FP1={TOOL_NO 3,BASE_NO 4,IPO_FRAME #BASE,POINT2[] "}; BASE_NO 9"}\r
DECL E6AXIS XHOME={A1 0,A2 -90,A3 +90.0,A4 0,A5 45.5,A6 1.5E-1}\r
DECL POS xfree={E1 9,X 1}\r
ENDDAT\r
"""


def read_file(data: bytes, name: str = "a.dat"):
    return BRAND.read(name, data)


def src_text(*lines: str):
    return read_file("\r\n".join(["DEF test()", *lines, "END"]).encode("latin-1"), "a.src")


def shift_row(file, row: int, shift) -> str:
    moved = homogeneous_matrix(np.eye(3), np.array(shift)) @ file.positions.frame_tip[[row]]
    return file.with_changes(PositionChange(np.array([row]), frame_tip=moved)).to_bytes().decode("latin-1")


def test_a_data_list_says_points_with_tool_and_base():
    file = read_file(DAT.replace(b"DECL POS xfree={E1 9,X 1}\r\n", b""))
    positions = file.positions
    assert file.name == "SCHWEISSEN"
    assert positions.names == ("XP1", "XHOME")
    assert positions.kinds == (CARTESIAN, JOINTS)
    assert positions.lines.tolist() == [4, 6]
    assert positions.user_frames == ("4", None)
    assert positions.tools == ("3", None)
    assert positions.configurations == ("S 2,T 35", "")
    assert np.allclose(positions.frame_tip[0, :3, 3], (0.1005, -0.02025, 0))
    assert np.allclose(np.rad2deg(positions.joints[1]), (0, -90, 90, 0, 45.5, 0.15))
    assert [(remark.line, remark.code) for remark in file.remarks] == [(3, "comment")]


def test_a_shift_keeps_every_other_byte():
    file = read_file(DAT.replace(b"DECL POS xfree={E1 9,X 1}\r\n", b""))
    text = shift_row(file, 0, (0.001, 0, 0.0000004))
    assert text == DAT.decode("latin-1").replace("X 100.5,", "X 101.500,").replace(
        "DECL POS xfree={E1 9,X 1}\r\n", ""
    )


def test_a_zero_gets_the_decimals_that_a_shift_needs():
    file = read_file(b"DEFDAT A\nDECL E6POS XP1={X 0.0,Y 1,Z 12.1234567,A 0.0,B 0.0,C 0.0}\nENDDAT")
    assert "X 0.1234567,Y 1,Z" in shift_row(file, 0, (0.0001234567, 0, 0))


def test_an_exponent_never_costs_resolution():
    file = read_file(b"DEFDAT A\nDECL E6POS XP1={X 1E3,Y 1.5E-05,Z 0.0,A 0.0,B 0.0,C 0.0}\nENDDAT")
    moved = homogeneous_matrix(np.eye(3), np.array([0.2345678, 0.3, 0])) @ file.positions.frame_tip
    back = file.with_changes(PositionChange(np.array([0]), frame_tip=moved)).positions.frame_tip
    assert np.abs(back - moved).max() < 0.51e-6


@pytest.mark.parametrize(
    ("line", "column", "problem"),
    [
        ("DECL E6POS XP1={X 1.0,Y 2.0,Z 3.0,A 0,B 0,C 1E400}", 45, "no robot"),
        ("DECL E6AXIS XP1={X 1.0,Y 2.0,Z 3.0,A 0,B 0,C 0}", 17, "declared as E6AXIS"),
        ("DECL E6POS XP1={X 1.0,Y 2.0,Z 3.0,A 0,B 0,C 0} S 2", 48, "should end"),
        ("DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,IPO_FRAME #NEW}", 15, "not known"),
        ("DECL FDAT FP1={TOOL_NO 1,BASE_NO 1", 15, "not understood"),
        ("DECL FDAT FP1={TOOL_NO 1,BASE_NO " + "9" * 5000 + "}", 15, "no controller has"),
    ],
)
def test_what_is_not_understood_inside_a_position_is_refused_with_its_place(line, column, problem):
    with pytest.raises(ProgramFileError, match=problem) as caught:
        read_file(f"DEFDAT A\r\n{line}\r\nENDDAT\r\n".encode())
    assert (caught.value.line, caught.value.column) == (2, column)


@pytest.mark.parametrize("number", ["abc", "NaN", "1.#QNAN", "-1.#IND", "1.#INF00", "1.2.3", "2.0 Z", ""])
def test_a_point_with_a_number_that_is_none_leaves_the_others(number):
    whole = "{X 1.0,Y 2.0,Z 3.0,A 0,B 0,C 0}"
    line = f"DECL E6POS XP1={{X 1.0,Y {number},Z 3.0,A 0,B 0,C 0}},XP2={whole}"
    file = read_file(f"DEFDAT A\r\n{line}\r\nDECL POS XP3={whole}\r\nENDDAT\r\n".encode())
    assert file.positions.names == ("XP1", "XP2", "XP3")
    assert [row in file.positions.barred for row in range(3)] == [True, False, False]


@pytest.mark.parametrize(
    "struct",
    [
        "{X 1.2.3,Y 0,Z 3.0,A 0,B 0,C 0",
        "{X 1.0,Y 2.0,Z 3.0,A 0,B 0,C 0",
        "{X 1.0,X 2.0,Z 3.0,A 0,B 0,C 0}",
        "{X 1.0,Y 2.0,Z 3.0,A 0,B 0,C 0,Q 7}",
        "{X 1.0,,Y 2.0,Z 3.0,A 0,B 0,C 0}",
        "{X 1.0,Y 2.0,Z 3.0",
        "{",
    ],
)
def test_a_point_that_is_not_understood_leaves_the_others(struct):
    whole = "{X 1.0,Y 2.0,Z 3.0,A 0,B 0,C 0}"
    lines = f"DECL E6POS XP1={whole}\r\nDECL E6POS XP2={struct}\r\nDECL POS XP3={whole}"
    file = read_file(f"DEFDAT A\r\n{lines}\r\nENDDAT\r\n".encode())
    assert file.positions.names == ("XP1", "XP2", "XP3")
    assert [row in file.positions.barred for row in range(3)] == [False, True, False]


def test_an_external_tool_is_listed_but_not_shifted():
    file = read_file(DAT.replace(b"DECL POS xfree={E1 9,X 1}\r\n", b"").replace(b"#BASE", b"#TCP"))
    assert file.positions.kinds[0] == CARTESIAN
    assert 0 in file.positions.held_work
    assert "external tool" in file.positions.conditions[0].why
    assert any("external tool" in remark.text for remark in file.remarks)


def test_a_frame_is_a_point_only_where_it_has_a_tool():
    plain = "DEFDAT A\nDECL FRAME XF={X 1,Y 2,Z 3,A 0,B 0,C 0}\n"
    alone = read_file(f"{plain}ENDDAT".encode()).positions
    assert alone.kinds == (UNREAD,)
    assert "FRAME" in alone.barred[0]
    with_data = plain + "DECL FDAT FF={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}\n"
    assert read_file(f"{with_data}ENDDAT".encode()).positions.user_frames == ("2",)


@pytest.mark.parametrize(("base", "read_base"), [("4", "4"), ("5", None)])
def test_data_of_one_name_that_differ_tell_no_tool_and_no_base(base: str, read_base: str | None):
    text = "DEFDAT A\n"
    for number in ("4", base, "4"):
        text += "DECL E6POS XP1={X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T 2}\n"
        text += f"DECL FDAT FP1={{TOOL_NO 1,BASE_NO {number},IPO_FRAME #BASE}}\n"
    assert read_file(f"{text}ENDDAT".encode()).positions.user_frames == (read_base,) * 3


def test_tools_and_bases_of_the_cell_are_frames():
    file = read_file(
        b"DEFDAT $CONFIG PUBLIC\nDECL FRAME BASE_DATA[32]\nBASE_DATA[2]={X 1000.0,Y 0,Z 0,A 90.0,B 0,C 0}\n"
    )
    assert len(file.positions) == 0
    assert file.frames.base_frame["2"].position_m == (1.0, 0.0, 0.0)
    assert np.allclose(file.frames.base_frame["2"].rotation_matrix(), [[0, -1, 0], [1, 0, 0], [0, 0, 1]])


def test_a_declaration_without_value_is_untaught_unless_the_value_comes_later():
    file = read_file(b"DEFDAT A\nDECL E6POS XA\nDECL E6POS XB\nXB={X 1,Y 2,Z 3,A 0,B 0,C 0,S 2}\nENDDAT")
    assert file.positions.names == ("XA", "XB")
    assert file.positions.kinds == (UNTAUGHT, CARTESIAN)


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (("BAS(#BASE,1)",), ("BAS(#BASE,2)",), ""),
        (("$BASE=BASE_DATA[N]",), (), "while the program runs"),
        (("$BASE=BASE_DATA[1]", "OTHER()"), (), "calls"),
        (("OTHER()",), (), "calls"),
        (("$BASE=BASE_DATA[1]", "FOUND = OTHER (2)"), (), "calls"),
        (("$BASE=BASE_DATA[1]", "IF OTHER(2) > 1 THEN", "ENDIF"), (), "calls"),
        (("$BASE=BASE_DATA[1]", "LIN OTHER(2):SHIFT"), (), "calls"),
        (("$BASE=BASE_DATA[1]", "EXT OTHER(INT)"), (), ""),
        (("$BASE=BASE_DATA[2]", "OTHER()"), (), ""),
        (("$BASE=BASE_DATA[1]", "FAR()"), (), ""),
        ((), ("BAS(#BASE,1)",), "below it"),
        (("BAS(#BASE,1)", "BAS(#EX_BASE,2)"), (), "lets an external axis turn its base"),
        (("BAS (#INITMOV,0 )", "BAS(#BASE,1)"), (), ""),
        (("BAS(#BASE,1)", "BAS (#INITMOV,0 )"), (), "different places"),
        (("BAS(#BASE,1)", "FIFTH()"), (), "calls"),
        (("FIFTH()",), (), ""),
        (("GOTO L1", "BAS(#BASE,1)", "L1:"), (), "below it"),
        (("GOTO L1", "L1:", "BAS(#BASE,1)"), (), ""),
        (("BAS(#BASE,1)", "GOTO L1", "L1:"), (), ""),
        (("LOOP", "IF $IN[1] THEN", "EXIT", "ENDIF", "BAS(#BASE,1)", "ENDLOOP"), (), "below it"),
        (("LOOP", "BAS(#BASE,1)", "IF $IN[1] THEN", "EXIT", "ENDIF", "ENDLOOP"), (), ""),
        (("BASE_DATA[1]=FOUND", "BAS(#BASE,1)"), (), "while the program runs"),
        (("BASE_DATA[1].Z=BASE_DATA[1].Z+5", "BAS(#BASE,1)"), (), "while the program runs"),
        (("BASE_DATA[N]={X 1,Y 2,Z 3,A 0,B 0,C 0}", "BAS(#BASE,1)"), (), "while the program runs"),
        (("BASE_DATA[2]=FOUND", "TOOL_DATA[1]=FOUND", "BAS(#BASE,1)"), (), ""),
        (
            ("BASE_DATA[2]=FOUND", "TOOL_DATA[1]=FOUND", "BAS(#BASE,1)", "BAS(#TOOL,1)"),
            (),
            "while the program runs",
        ),
    ],
)
def test_a_point_whose_base_is_not_one_is_barred(before, after, words):
    point = "LIN {X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0,S 2,T 2}"
    routines = ("END", "DEF other ( )", "third (1)", "END", "DEF THIRD(N:IN)", "$BASE=BASE_DATA[2]", "END")
    routines += ("DEF fifth()", "BAS (#INITMOV,0 )")
    file = src_text(*before, point, *after, *routines)
    assert sorted(file.positions.barred) == ([0] if words else [])
    assert words in file.positions.barred.get(0, "")


def test_a_routine_does_not_call_itself_where_it_is_defined():
    point = "LIN {X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0,S 2,T 2}"
    for head in ("DEF TEST (N :IN)", "GLOBAL DEF TEST ( )", "GLOBAL DEFFCT INT TEST ( )"):
        file = read_file(
            "\n".join([head, "BAS(#BASE,1)", "BAS (#INITMOV,0)", "BAS(#TOOL,1)", "END"]).encode(), "a.src"
        )
        assert cast(DeclaringProgram, file).declarations.routines["TEST"].calls == frozenset()
    assert src_text("BAS (#INITMOV,0)", "BAS(#BASE,1)", point).positions.barred == {}


def test_a_point_with_a_base_of_its_own_move_is_barred():
    point = "SLIN {X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0,S 2,T 2} WITH $BASE=BASE_DATA[3]"
    assert sorted(src_text("$BASE=BASE_DATA[1]", point).positions.barred) == [0]


def test_points_inside_moves_have_the_frames_that_the_routine_sets_once():
    point = "LIN {X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0,S 2,T 2} C_DIS"
    file = src_text("BAS(#TOOL,3)", "$BASE=BASE_DATA[ 7 ]", point)
    assert file.positions.names == ("LIN@4",)
    assert (file.positions.tools, file.positions.user_frames) == (("3",), ("7",))
    assert src_text("BAS(#BASE,1)", point, "BAS(#BASE,2)", point).positions.user_frames == ("1", "2")
    assert src_text(point, "BAS(#BASE,1)").positions.user_frames == (None,)
    assert src_text("BAS(#BASE,1)", "BAS(#CP_PARAMS,1)", point).positions.user_frames == (None,)
    written = src_text("$BASE={X 1000.0,Y 0,Z 0,A 0,B 0,C 0}", point)
    (base,) = written.positions.user_frames
    assert written.frames.base_frame[base].position_m == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("LIN_REL {X 10.0}", "relative"),
        ("LIN XP1:{X 0,Y 0,Z 100,A 0,B 0,C 0}", "offset"),
        ("LIN {X 0,Y 0,Z 100,A 0,B 0,C 0} : SHIFT", "offset"),
        ("LIN {X XNOM,Y 0,Z 100,A 0,B 0,C 0}", "computed"),
        ("PTP XP1 C_PTP ; {X 1.0,Y 2.0}", "comment"),
        ("XP1.Z = XP1.Z+5", "computed"),
        ("BASE_DATA[3]=FOUND", "computed"),
        ("TS_BC6DCalc(VCD1, TSg_CD0)", "vision"),
        ("PTP NEXT(3)", "computed"),
        ("$BASE=BASE_DATA[2]:SHIFT", "computed"),
        ("PTP {A1 30.0}", "computed"),
        ("IMPORT E6POS Q IS /R1/A..XP1", "indirect"),
    ],
)
def test_what_also_moves_the_robot_is_remarked_and_left(line, code):
    file = src_text(line)
    assert code in [remark.code for remark in file.remarks if remark.line == 2]
    assert all(kind in (UNTAUGHT, UNREAD) for kind in file.positions.kinds)


def test_a_real_controllers_joints_and_pose_prove_a_b_c_and_the_signs_of_all_axes():
    """A state frame that a KUKA sent over RSI, as a public test client of that link keeps it; tool unturned.

    The arm's lengths are another model's and do not enter: KUKA's six-axis arms share axes and flange.
    """
    joints = np.deg2rad([74.8478, -128.7977, 75.8236, 102.2260, 0.0987, -56.5347])
    shown = rotation_from("kuka_abc", np.deg2rad([-126.9460, 24.9226, -28.2871]))
    mine = load_model("kuka_kr6_r900").base_flange(joints[None])[0, :3, :3]
    assert np.rad2deg(np.arccos((np.trace(shown.T @ mine) - 1) / 2)) < 2e-3


def test_another_order_of_the_angles_would_not_pass():
    joints = np.deg2rad([74.8478, -128.7977, 75.8236, 102.2260, 0.0987, -56.5347])
    wrong = rotation_from("kuka_abc", np.deg2rad([-28.2871, 24.9226, -126.9460]))
    mine = load_model("kuka_kr6_r900").base_flange(joints[None])[0, :3, :3]
    assert np.rad2deg(np.arccos((np.trace(wrong.T @ mine) - 1) / 2)) > 10


# Axes in degrees, S and T. KUKA's home is S 2, T 2 everywhere; the others follow from the bits' definition.
POSTURES = [
    ((0, -90, 90, 0, 0, 0), "S 2,T 2"),
    ((0, -90, 90, 0, 45, 0), "S 2,T 2"),
    ((-10, -90, 90, 0, 45, -5), "S 2,T 35"),
    ((10, -60, 70, 20, -30, -40), "S 6,T 50"),
    ((-10, -90, 90, -1, -45, 5), "S 6,T 27"),
    ((0, -45, -20, 0, 45, 0), "S 0,T 6"),
    ((0, -150, 20, 0, 45, 0), "S 3,T 2"),
]


@pytest.mark.parametrize(("degrees", "text"), POSTURES)
def test_flags_and_turns_of_known_postures(degrees, text):
    model, rule = load_model("kuka_kr6_r900"), KukaConfigurations()
    joints = np.deg2rad([degrees])
    assert rule.write_configurations(model, joints, [text]) == (text,)
    assert rule.matches_postures(model, joints, [text]).all()
    assert rule.write_configurations(model, joints, ["S 'B1010000',T 'H7F'"])[0].startswith("S 'B1010")
    assert rule.write_configurations(model, joints, [""]) == ("",)
    assert rule.matches_postures(model, joints, [""]).all()


def test_a_wrong_flag_or_turn_does_not_agree():
    model, rule = load_model("kuka_kr6_r900"), KukaConfigurations()
    joints = np.deg2rad([[10, -60, 70, 20, -30, -40]] * 3)
    assert rule.matches_postures(model, joints, ["S 4,T 50", "S 2,T 50", "S 6,T 51"]).tolist() == [False] * 3
    assert rule.matches_postures(model, joints, ["S 4", "S 6", "S 6,T 51"], turns=False).tolist() == [
        False,
        True,
        True,
    ]


def test_new_flags_are_written_in_place():
    file = read_file(DAT.replace(b"DECL POS xfree={E1 9,X 1}\r\n", b""))
    text = file.with_changes(PositionChange(np.array([0]), configurations=("S 6,T 50",))).to_bytes()
    assert text == file.to_bytes().replace(b"S 2,T 35", b"S 6,T 50")
    with pytest.raises(ProgramFileError, match="take the place"):
        file.with_changes(PositionChange(np.array([0]), configurations=("S 6",)))


def test_a_base_is_not_rewritten_at_a_point():
    file = read_file(DAT.replace(b"DECL POS xfree={E1 9,X 1}\r\n", b""))
    with pytest.raises(ProgramFileError, match="FDAT"):
        file.with_changes(PositionChange(np.array([0]), user_frames=("5",)))


def test_other_makers_dat_files_are_not_taken():
    assert not writes_program(b"time,value\n0,1\n")
    assert writes_program(DAT)
    assert writes_program(b"  global def foo()\n")


@pytest.mark.parametrize("seed", range(60))
def test_a_data_list_says_the_same_at_a_glance_as_read_whole(seed: int) -> None:
    data = generate_kuka.generate(seed)
    assert (
        BRAND.says("cell/A.dat", data) == cast(DeclaringProgram, BRAND.read("cell/A.dat", data)).declarations
    )
    assert BRAND.says("cell/A.src", data) is None


def test_motion_data_of_a_taught_move_is_no_use_of_a_position() -> None:
    text = "DEF A( )\r\nLDAT_ACT=LCPDAT1\r\nFDAT_ACT=FP1\r\nBAS(#CP_PARAMS,2)\r\n$BWDSTART=FALSE\r\nOTHER=XP9\r\nLIN XP1\r\nEND\r\n"
    declarations = cast(DeclaringProgram, BRAND.read("A.src", text.encode())).declarations
    assert set(declarations.uses) == {"XP9", "OTHER"}  # XP1 is moved to with its own frame data


@pytest.mark.parametrize("seed", range(40))
def test_a_point_as_the_controller_writes_it_is_read_and_changed_as_any_other(seed: int) -> None:
    rng = np.random.default_rng([seed, 5])
    text = "DEFDAT A\r\n"
    for number in range(12):
        frame_data = (
            f"{{TOOL_NO {rng.integers(3)},BASE_NO 1,IPO_FRAME #{rng.choice(['BASE', 'BASE', 'TCP'])}}}"
        )
        text += f"DECL E6POS XP{number}={generate_kuka.pose_as_printed(rng)}\r\n"
        text += f"DECL FDAT FP{number}={frame_data}\r\n" if rng.random() < 0.8 else ""
        text += f"DECL LDAT L{number}={{VEL 1,{rng.choice(['ACC', 'X', 'A1'])} 1}}\r\n"
    text += "ENDDAT\r\n"
    usual = read_file(text.encode())
    other = read_file(text.replace("DECL ", "DECL\t").encode())
    assert usual.remarks == other.remarks
    assert (usual.fixed, usual.taught, usual.keys, usual.declarations) == (
        other.fixed,
        other.taught,
        other.keys,
        other.declarations,
    )
    for name in (field.name for field in fields(usual.positions)):
        np.testing.assert_array_equal(getattr(usual.positions, name), getattr(other.positions, name))
    change = some_change(usual.positions, rng)
    if change is not None:
        new, old = (file.with_changes(change).to_bytes().decode() for file in (usual, other))
        assert new != text
        assert new == old.replace("DECL\t", "DECL ")


def test_a_zero_has_no_sign() -> None:
    text = "DEFDAT A\r\nDECL E6POS XP1={X 0.4,Y 1.0,Z 2.0,A 0.0,B 0.0,C 0.0,S 2,T 2}\r\nENDDAT\r\n"
    file = read_file(text.encode())
    assert shift_row(file, 0, (-0.0004001, 0, 0)) == text.replace("X 0.4,", "X 0.000,")


def test_a_taught_move_says_the_same_whole_as_line_by_line() -> None:
    fold = (
        ";FOLD LIN P1 Tool[1] Base[1];%{PE}%R 8.3.38\r\n$BWDSTART=FALSE\r\nLDAT_ACT=LCPDAT1\r\nFDAT_ACT=FP1\r\n"
        "BAS(#CP_PARAMS,0.2)\r\nLIN XP1 C_DIS\r\n;ENDFOLD\r\n"
    )
    for before, after in (
        ("", "LIN XP2\r\n"),
        ("BAS(#TOOL,1)\r\n", "LIN {X 1,Y 2,Z 3,A 0,B 0,C 0}\r\n"),
        ("IF $IN[1] THEN\r\n", "ENDIF\r\nLIN XP1\r\n"),
    ):
        text = f"DEF A( )\r\n{before}{fold}{after}END\r\n"
        whole = read_file(text.encode(), "a.src")
        alone = read_file(text.replace("BAS(#CP", "BAS (#CP").encode(), "a.src")
        assert whole.declarations == alone.declarations
        assert whole.remarks == alone.remarks
        assert whole.positions.barred == alone.positions.barred


def test_an_element_of_the_base_that_is_set_leaves_the_points_written_into_moves_below():
    point = "LIN {X 100,Y 30,Z 250,A 0,B 90,C 0}"
    file = src_text("$BASE = BASE_DATA[2]", "$TOOL = TOOL_DATA[2]", point, "$BASE.X = $BASE.X + 50", point)
    assert file.positions.barred == {1: COMPUTED}
    assert file.positions.user_frames[0] == "2"


@pytest.mark.parametrize(
    ("line", "count"),
    [
        ("LIN OFS:{X 100,Y 30,Z 250,A 0,B 90,C 0}", 1),
        ("LIN {X 100,Y 30,Z 250,A 0,B 90,C 0}:OFS", 1),
        ("LIN INV_POS({X 5,Y 0,Z 0,A 0,B 0,C 0}):{X 100,Y 30,Z 250,A 0,B 90,C 0}", 2),
        ("CIRC OFS:{X 1,Y 3,Z 2,A 0,B 90,C 0},{X 2,Y 4,Z 2,A 0,B 90,C 0}", 2),
    ],
)
def test_positions_written_into_a_computed_target_are_left(line, count):
    file = src_text("DECL FRAME OFS", line)
    assert file.positions.kinds == (UNREAD,) * count
    assert set(file.positions.barred) == set(range(count))


def test_a_base_that_is_coupled_to_an_external_axis_is_remarked():
    text = "DEF k()\n$TOOL=TOOL_DATA[1]\n$BASE=BASE_DATA[2]\n$ACT_EX_AX=2\nLIN {X 1,Y 20,Z 130,A 0,B 180,C 0}\nEND\n"
    (remark,) = [one for one in read_program("k.src", text.encode()).remarks if one.line == 4]
    assert "[[positioner]]" in remark.text
