"""RAPID modules: what is read out of them, what is left alone, what is refused; confdata of postures."""

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import homogeneous_matrix, quaternion_from_rotation
from cellcal.drivers.abb.program_files import programs as abb_programs
from cellcal.drivers.abb.program_files.configuration import AbbConfigurations
from cellcal.drivers.abb.program_files.programs import BRAND, writes_program
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, NO_NUMBER, UNREAD, UNTAUGHT, PositionChange

E = "[9E9,9E+09,9E+9,9E9,9E9,9E9]"


def read_module(*lines: str):
    return BRAND.read("a.mod", "\r\n".join(["MODULE Teil", *lines, "ENDMODULE"]).encode("latin-1"))


def target_line(
    name: str, place: str = "100.5,0,-20", turn: str = "0,0.70711,0,0.70711", flags: str = "0,-1,0,1"
) -> str:
    return f"CONST robtarget {name}:=[[{place}],[{turn}],[{flags}],{E}];"


def move_row(file, row: int, shift) -> str:
    moved = homogeneous_matrix(np.eye(3), np.array(shift)) @ file.positions.frame_tip[[row]]
    return file.with_changes(PositionChange(np.array([row]), frame_tip=moved)).to_bytes().decode("latin-1")


def test_targets_have_the_frames_of_the_moves_that_use_them():
    file = read_module(
        target_line("p1"),
        target_line("p2"),
        target_line("p3"),
        f"CONST jointtarget jp:=[[0,10,-20,0,9E9,5.5],{E}];",
        "PROC main()",
        "MoveL P1,v100,fine,tGrip\\WObj:=wTable;",
        "MoveJ p2,v100,fine,tGrip;",
        "MoveL p2,v100,fine,tGrip\\WObj:=WTABLE;",
        "MoveL Offs(p3,0,0,10),v100,fine,TGRIP\\WObj:=wTable;",
        "ENDPROC",
    )
    positions = file.positions
    assert (file.name, positions.names) == ("Teil", ("p1", "p2", "p3", "jp"))
    assert positions.kinds == (CARTESIAN, CARTESIAN, CARTESIAN, JOINTS)
    assert positions.user_frames == ("wTable", None, "wTable", None)
    assert positions.tools == ("tGrip", "tGrip", "tGrip", None)
    assert positions.configurations == ("[0,-1,0,1]",) * 3 + ("",)
    assert np.allclose(positions.frame_tip[0, :3, 3], (0.1005, 0, -0.02))
    assert np.allclose(np.rad2deg(positions.joints[3]), (0, 10, -20, 0, np.nan, 5.5), equal_nan=True)
    assert np.isnan(positions.external).all()
    assert [remark.code for remark in file.remarks] == ["indirect", "offset"]


def test_a_shift_keeps_every_other_byte_and_a_zero_gets_its_decimals():
    file = read_module(target_line("p1"))
    text = move_row(file, 0, (0.001, 0.00025, 0))
    assert text == file.to_bytes().decode().replace("100.5,0,-20", "101.500,0.250,-20")


def test_a_quaternion_keeps_its_sign():
    file = read_module(target_line("p1", turn="-0.5,0.5,-0.5,0.5"))
    turned = file.positions.frame_tip @ homogeneous_matrix(_turn_about_z(0.01), np.zeros(3))
    text = file.with_changes(PositionChange(np.array([0]), frame_tip=turned))
    assert text.to_bytes().decode().split("[")[3].startswith("-0.502494,0.497494")
    difference = text.positions.frame_tip[0, :3, :3].T @ turned[0, :3, :3]
    assert np.linalg.norm(quaternion_from_rotation(difference)[1:]) < 1e-6


def _turn_about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def test_a_file_that_ends_behind_a_bracket_is_read_to_its_end():
    data = (
        b"MODULE Teil\r\nCONST robtarget p1:="
        + target_line("p1").partition(":=")[2].encode()
        + b"\r\nMoveL p1, ["
    )
    with pytest.raises(ProgramFileError):
        BRAND.read("a.mod", data)


def test_arrays_inline_targets_and_two_in_one_circle_are_named():
    one = f"[[1,2,3],[1,0,0,0],[0,0,0,0],{E}]"
    file = read_module(
        f"CONST robtarget pts{{2,2}}:=[[{one},{one}],[{one},! so\n {one}]];",
        f"MoveC {one},{one},v1,z1,tool0;",
        f"MoveAbsJ [[1,2,3,4,5,6],{E}],v1,z1,tool0;",
    )
    inline = ("MoveC@4", "MoveC@4.2", "MoveAbsJ@5")
    assert file.positions.names == ("pts{1,1}", "pts{1,2}", "pts{2,1}", "pts{2,2}", *inline)
    assert file.positions.user_frames[4:] == ("wobj0", "wobj0", None)


def test_a_routines_own_target_hides_the_modules():
    file = read_module(
        target_line("p1"),
        "PROC a()",
        target_line("p1"),
        "MoveL p1,v1,z1,tOwn\\WObj:=wOwn;",
        "ENDPROC",
        "PROC b()",
        "MoveL p1,v1,z1,tAll\\WObj:=wAll;",
        "ENDPROC",
    )
    assert file.positions.names == ("p1", "p1@4")
    assert file.positions.user_frames == ("wAll", "wOwn")


@pytest.mark.parametrize(
    ("line", "column", "problem"),
    [
        (target_line("p", place="1,2.3.4,3").replace("]];", "];"), 24, "a number"),
        (target_line("p", place="1,2").replace("]]", "]\n]"), 25, "here should be ','"),
        (target_line("p", turn="0.8,0.8,0,0"), 36, "quaternion has the length 1.1314"),
        (target_line("p", place="1,2,1E400"), 26, "no robot"),
        (f"CONST robtarget p{{{'9' * 5000}}}:=[[1,2,3]];", 19, "more elements"),
        ("MoveL [[1,2,x3],[1,0,0]],v1,z1,tool0", 6, "does not end"),
    ],
)
def test_what_is_not_understood_inside_a_position_is_refused_with_its_place(line, column, problem):
    with pytest.raises(ProgramFileError, match=problem) as caught:
        read_module(line)
    assert (caught.value.line, caught.value.column) == (2, column)


@pytest.mark.parametrize(
    "place", ["1,2", "1,2,3,4", "1,2.3.4,3", "1 2,3", "nan,2,3", ",2,3", "1.#QNAN,2,3", "3x0,2,3"]
)
def test_a_target_with_a_number_that_is_none_leaves_the_others(place):
    broken = target_line("p", place=place)
    inline = "MoveL " + broken.partition(":=")[2].rstrip(";") + ",v1,z1,tool0;"
    file = read_module(broken, target_line("q"), inline, "MoveL q,v1,z1,tool0;")
    assert file.positions.names == ("p", "q", "MoveL@4")
    assert {row for row, why in file.positions.barred.items() if why == NO_NUMBER} == {0, 2}


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("MoveL *,v1,z1,tool0;", "computed"),
        ("MoveL RelTool(p1,0,0,5),v1,z1,tool0;", "offset"),
        ("MoveL fNext(3),v1,z1,tool0;", "computed"),
        ("PDispOn p1,tool0;", "offset"),
        ("p1.trans.x:=5;", "computed"),
        ("p1:=CRobT();", "computed"),
        ("VAR robtarget many{20};", "computed"),
        ("! [[1,2,3],[1,0,0,0]]", "comment"),
        (target_line("q", place="1,dist,3"), "computed"),
    ],
)
def test_what_also_moves_the_robot_is_remarked_and_left(line, code):
    file = read_module(target_line("p1"), line)
    assert code in [remark.code for remark in file.remarks if remark.line == 3]
    assert {
        name for name, kind in zip(file.positions.names, file.positions.kinds, strict=True) if kind != UNREAD
    } == {"p1"}


def test_a_target_used_in_several_frames_is_barred_and_takes_none_that_a_project_assumes():
    file = read_module(
        target_line("p1"), target_line("p2"), target_line("p3"), target_line("p4"),
        "PROC main()",
        "MoveL p1,v100,fine,tGrip\\WObj:=wA;", "MoveL p1,v100,fine,tGrip\\WObj:=wB;",
        "MoveL p2,v100,fine,tGrip\\WObj:=wAll{i};",
        "MoveL p3,v100,fine,tGrips{i}\\WObj:=wA;",
        "ENDPROC",
    )  # fmt: skip
    assert sorted(file.positions.barred) == [0, 1, 2]
    assert "different" in file.positions.barred[0]
    assert "computed" in file.positions.barred[1]


@pytest.mark.parametrize(
    "line",
    [
        f"PERS pickpoint g:=[[[100.5,0,-20],[0,0.70711,0,0.70711],[0,-1,0,1],{E}],25];",
        f"PERS pickpoint g{{2}}:=[[[[1,0,-2],[1,0,0,0],[0,0,0,0],{E}],25],[[[1,0,-2],[1,0,0,0],[0,0,0,0],{E}],2]];",
        f"g:=[[[100.5,0,-20],[0,0.70711,0,0.70711],[0,-1,0,1],{E}],25];",
        f"rPick [[100.5,0,-20],[0,0.70711,0,0.70711],[0,-1,0,1],{E}],25;",
        f"CONST pickaxes g:=[[[0,0,0,0,30,0],{E}],25];",
        "CONST pose shift:=[[1,0,-2],[1,0,0,0]];",
    ],
)
def test_a_position_inside_other_data_is_remarked_and_left(line):
    file = read_module("PROC main()", "MoveL p,v100,fine,tGrip;", line, "ENDPROC")
    assert set(file.positions.kinds) <= {UNREAD}
    assert len(file.positions) == line.count("9E+09")
    assert all("not read" in why for why in file.positions.barred.values())
    assert [(remark.line, remark.code) for remark in file.remarks] == [(4, "computed")]


@pytest.mark.parametrize(
    ("line", "count"),
    [
        ("rPick [p9.trans,[0,0,1,0],p9.robconf,p9.extax];", 1),
        (f"rPick [[100.5,0,-20],p9.rot,[0,-1,0,1],{E}];", 1),
        ("rPick [p9.trans,p9.rot,p9.robconf,p9.extax];", 0),
        (f"rPick [p9.trans,p9.rot,[0,-1,0,1],{E}];", 0),
    ],
)
def test_a_place_or_an_orientation_written_into_a_call_is_left(line: str, count: int) -> None:
    file = read_module("PROC main()", "MoveL p,v100,fine,tGrip;", line, "ENDPROC")
    assert file.positions.kinds == (UNREAD,) * count


def test_numbers_in_lists_are_no_position():
    assert not read_module(
        "CONST num a{2,2}:=[[1,2],[3,4]];", "VAR speeddata v:=[100,500,5000,1000];"
    ).remarks


def test_frames_of_fixed_work_objects_and_tools_on_the_robot():
    file = read_module(
        'PERS wobjdata w:=[FALSE,TRUE,"",[[1000,0,0],[0,0,0,1]],[[100,0,0],[1,0,0,0]]];',
        'PERS wobjdata wTurn:=[FALSE,FALSE,"STN1",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];',
        "PERS tooldata t:=[TRUE,[[0,0,180],[1,0,0,0]],[5,[0,0,50],[1,0,0,0],0,0,0]];",
    )
    assert sorted(file.frames.base_frame) == ["w", "wobj0"]
    assert np.allclose(file.frames.base_frame["w"].position_m, (0.9, 0, 0))
    assert file.frames.flange_tip["t"].position_m == (0, 0, 0.18)


def test_a_target_on_a_conveyor_is_barred():
    frame = "[[0,0,0],[1,0,0,0]]"
    file = read_module(
        f'PERS wobjdata wCnv:=[FALSE,FALSE,"CNV1",{frame},{frame}];', target_line("p1"), target_line("p2"),
        "PROC main()", "MoveL p1,v100,fine,tGrip\\WObj:=wcnv;", "MoveL p2,v100,fine,tGrip;", "ENDPROC",
    )  # fmt: skip
    assert list(file.positions.conditions) == [0]
    assert "mechanical unit" in file.positions.conditions[0].why


def test_a_held_work_object_is_listed_but_not_shifted():
    file = read_module(
        'PERS wobjdata wHeld:=[TRUE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];',
        target_line("p1"),
        "MoveL p1,v1,z1,tool0\\WObj:=wHeld;",
    )
    assert file.positions.kinds == (UNTAUGHT,)
    with pytest.raises(ProgramFileError, match="held work object"):
        file.with_changes(PositionChange(np.array([0]), frame_tip=np.eye(4)[None]))


# Axes in degrees and confdata: quadrants and the eight postures of the RAPID manual's table.
POSTURES = [
    ((0, 0, 0, 0, 30, 0), "[0,0,0,0]"),
    ((10, 0, 0, 100, -30, -100), "[0,1,-2,1]"),
    ((-10, 0, 0, -100, 30, 370), "[-1,-2,4,0]"),
    ((10, 30, -95, 10, 30, -95), "[0,0,-2,2]"),
    ((10, -100, 20, 10, -30, -5), "[0,0,-1,5]"),
]


@pytest.mark.parametrize(("degrees", "text"), POSTURES)
def test_confdata_of_known_postures(degrees, text):
    model, rule = load_model("abb_irb120"), AbbConfigurations()
    joints = np.deg2rad([degrees])
    assert rule.write_configurations(model, joints, [text]) == (text,)
    assert rule.matches_postures(model, joints, [text]).all()
    assert rule.matches_postures(model, joints, [""]).all()


def test_wrong_confdata_does_not_agree():
    model, rule = load_model("abb_irb120"), AbbConfigurations()
    joints = np.deg2rad([[10, 0, 0, 100, -30, -100]] * 3)
    texts = ["[0,1,-2,0]", "[0,1,2,1]", "[1,1,-2,1]"]
    assert not rule.matches_postures(model, joints, texts).any()
    assert rule.matches_postures(model, joints, texts, turns=False).tolist() == [False, True, False]


def test_new_confdata_is_written_in_place():
    file = read_module(target_line("p1"))
    text = file.with_changes(PositionChange(np.array([0]), configurations=("[1,0,-1,0]",))).to_bytes()
    assert text == file.to_bytes().replace(b"[0,-1,0,1]", b"[1,0,-1,0]")


def test_other_makers_mod_files_are_not_taken():
    assert not writes_program(b"M.K.\0\0")
    assert writes_program(b"%%%\n  VERSION:1\n%%%\nMODULE a\n")


# A public RAPID program of an IRB 120 that turns the layers of a cube (MainModule, procedures D and D2, tool0): after
# MoveAbsJ to the joints it goes to a target that was taught in this very posture.
TAUGHT_TOGETHER = [
    ("[-2.25121,2.78876,13.3434,0.317686,76.8499,135.2142]",
     "[[318.72,-12.14,471.11],[0.0128513,-0.931854,-0.361886,0.022812],[-1,0,1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]]"),
    ("[-2.25139,2.78889,13.3435,0.317466,76.8479,223.215]",
     "[[318.72,-12.13,471.11],[0.00658412,0.921755,-0.386889,-0.0253209],[-1,0,2,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]]"),
]  # fmt: skip


@pytest.mark.parametrize(("joints", "robtarget"), TAUGHT_TOGETHER)
def test_joints_and_target_of_one_posture_on_a_real_controller(joints: str, robtarget: str):
    none = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
    text = (
        "MODULE MainModule\n"
        f"    CONST jointtarget jpos11:=[{joints},{none}];\n    CONST robtarget p12:={robtarget};\n"
        "    PROC D()\n        MoveAbsJ jpos11\\NoEOffs, v1000, fine, tool0;\n"
        "        MoveL p12, v1000, fine, tool0;\n    ENDPROC\nENDMODULE\n"
    )
    positions = BRAND.read("cube.mod", text.encode()).positions
    assert positions.kinds == (JOINTS, CARTESIAN)
    model = load_model("abb_irb120")
    flange = model.base_flange(positions.joints[:1, :6])[0]
    declared_pose = positions.frame_tip[1]
    assert np.linalg.norm(flange[:3, 3] - declared_pose[:3, 3]) < 2e-5
    turned = flange[:3, :3].T @ declared_pose[:3, :3]
    assert np.degrees(np.arccos((np.trace(turned) - 1.0) / 2.0)) < 0.01
    assert (
        AbbConfigurations()
        .matches_postures(model, positions.joints[:1, :6], positions.configurations[1:])
        .all()
    )


def test_a_file_of_another_language_with_the_suffix_is_no_module() -> None:
    wanted = abb_programs.BRAND.writes_program
    assert wanted is not None
    assert wanted(b"MODULE MainModule(SYSMODULE)\r\n")
    assert wanted(b"%%%\n  VERSION:1\n%%%\nMODULE m ! mine\n")
    assert not wanted(b"module github.com/one/two\n\ngo 1.13\n")
    assert not wanted(b"module example.com\n")
