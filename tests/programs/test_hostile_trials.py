"""Programs that hostile trials were made of: selections by system variables, searches, angles of circles, marks."""

import math
from pathlib import Path

import pytest

from cellcal.drivers.program_registry import read_program
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_absent_places import STAYS, rapid, yaskawa
from tests.programs.test_field_cases import CASES, TURNED, move_program

SHIFTED = "30,-20,5,0,0,0"
LISTING = (CASES / "fanuc" / "offset_pr.LS").read_text().replace(" Offset,PR[3]", "")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("UFRAME_NUM=1", "$MNUFRAMENUM[1]=2", "with user frame 2"),
        ("UTOOL_NUM=1", "$MNUTOOLNUM[1]=2", "with tool 2"),
        ("UTOOL_NUM=1", "$MNUTOOLNUM[1]=R[5]", ""),
        ("UFRAME_NUM=1", "$MNUFRAMENUM[2]=2", ""),
    ],
)
def test_a_frame_chosen_by_its_system_variable_counts(tmp_path: Path, old: str, new: str, words: str) -> None:
    moved = move_program(tmp_path, "fanuc", "offset_pr.LS", offset=SHIFTED, text=LISTING.replace(old, new))
    assert moved.code == (ExitCode.REFUSED if words else ExitCode.PASS)
    assert words in (moved.report_point("P[1]").get("reason") or "")


def test_a_frame_chosen_so_leaves_a_position_that_names_none(tmp_path: Path) -> None:
    text = LISTING.replace("UTOOL_NUM=1 ;", "UTOOL_NUM=1 ;\n   3:  $MNUFRAMENUM[1]=2 ;").replace(
        "UF : 1", "UF : F"
    )
    moved = move_program(tmp_path, "fanuc", "offset_pr.LS", offset=SHIFTED, text=text)
    assert moved.code == ExitCode.REFUSED
    assert "set while the program runs" in moved.report_point("P[1]")["reason"]


@pytest.mark.parametrize(
    "search",
    [
        "SearchL di1, pOwn, p10, v100, tool0\\WObj:=wobj0;",
        "SearchL \\Stop, di1\\Flanks, pOwn, p10, v100, tool0\\WObj:=wobj0;",
        "SearchL\\PStop, di1, pOwn, p10, v100\\V:=50, tool0\\WObj:=wobj0;",
        "SearchC \\Sup, di1, pOwn, p10, p10, v100, tool0\\WObj:=wobj0;",
    ],
)
def test_signal_speed_and_tool_of_a_search_are_no_places(tmp_path: Path, search: str) -> None:
    moved = move_program(tmp_path, "abb", "pdisp_rotated.mod", offset=SHIFTED, text=rapid(search))
    assert moved.report["findings"] == []
    assert moved.report_point("p10")["status"] == "changed"
    assert moved.report_point("pOwn")["reason"] == "it gets its coordinates while the program runs"


def test_a_search_to_a_place_that_no_file_holds_is_a_finding(tmp_path: Path) -> None:
    search = "SearchL \\Stop, di1, pOwn, pOther, v100, tool0\\WObj:=wobj0;"
    moved = move_program(tmp_path, "abb", "pdisp_rotated.mod", offset=SHIFTED, text=rapid(search))
    (found,) = moved.report["findings"]
    assert found["text"].startswith(STAYS.format("pOther"))


@pytest.mark.parametrize("angle", ["CA 180", "CA=270.0", "ca -90", "CA 360 C_DIS"])
def test_the_angle_of_a_circle_is_no_place(tmp_path: Path, angle: str) -> None:
    text = (CASES / "kuka" / "lin_rel_rotated.src").read_text()
    points = "{X 110,Y 30,Z 250,A 0,B 90,C 0},{X 120,Y 40,Z 250,A 0,B 90,C 0}"
    text = text.replace("LIN_REL {X 100}", f"CIRC {points},{angle}")
    moved = move_program(tmp_path, "kuka", "lin_rel_rotated.src", offset=SHIFTED, text=text)
    assert moved.report["findings"] == []


@pytest.mark.parametrize("offset", [SHIFTED, TURNED])
def test_a_variable_that_a_number_chooses_is_a_place_of_the_controller(tmp_path: Path, offset: str) -> None:
    text = yaskawa("MOVL P[I000] V=50.0")
    moved = move_program(tmp_path, "yaskawa", "one_point_refuses_all.JBI", offset=offset, text=text)
    found = [one["text"] for one in moved.report["findings"]]
    assert any(text.startswith(STAYS.format("P[I000]")) for text in found)
    assert moved.code == ExitCode.REFUSED


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("A.LS", b"\xef\xbb\xbf" + LISTING.encode(), "byte order mark"),
        ("A.JBI", b"\xef\xbb\xbf" + yaskawa().encode(), "byte order mark"),
        ("A.mod", rapid().encode("utf-16"), "UTF-16"),
        ("A.LS", LISTING.encode("utf-16"), "UTF-16"),
        ("A.LS", b"\xef\xbb\xbfhello", "not a robot program"),
    ],
)
def test_what_an_editor_did_to_a_program_is_said(name: str, data: bytes, words: str) -> None:
    with pytest.raises(ProgramFileError) as refused:
        read_program(name, data)
    assert words in refused.value.message


@pytest.mark.parametrize(("elbow", "code"), [("1.2", ExitCode.PASS), ("0.2", ExitCode.REFUSED)])
def test_a_joint_point_is_left_where_only_another_posture_reaches_it(
    tmp_path: Path, elbow: str, code: ExitCode
) -> None:
    text = f"def a():\n  set_tcp(p[0,0,0.1,0,0,0])\n  movej([0.1,-1.0,{elbow},0.1,0.2,0.3])\nend\n"
    file = "component_assignment.script"
    moved = move_program(tmp_path, "ur", file, offset=TURNED, text=text, joints="move")
    assert moved.code == code
    is_left = "change its posture" in (moved.report["points"][0].get("reason") or "")
    assert is_left is (code == ExitCode.REFUSED)


@pytest.mark.parametrize("turn", [90, 170, -170])
def test_a_turn_of_the_work_about_the_first_axis_turns_that_axis_alone(tmp_path: Path, turn: int) -> None:
    text = "def a():\n  set_tcp(p[0,0,0.1,0,0,0])\n  movej([0.1,-1.0,0.2,0.1,0.2,0.3])\nend\n"
    file = "component_assignment.script"
    moved = move_program(tmp_path, "ur", file, offset=f"0,0,0,0,0,{turn}", text=text, joints="move")
    assert moved.code == ExitCode.PASS
    (line,) = [each for each in moved.lines if "movej" in each]
    joints = [float(each) for each in line[line.index("[") + 1 : line.index("]")].split(",")]
    assert joints == pytest.approx([0.1 + math.radians(turn), -1.0, 0.2, 0.1, 0.2, 0.3], abs=1e-6)


def test_a_tool_for_each_group_leaves_the_points_and_reads_the_job(tmp_path: Path) -> None:
    text = (CASES / "yaskawa" / "one_point_refuses_all.JBI").read_text().replace("///TOOL 0", "///TOOL 0,1")
    moved = move_program(tmp_path, "yaskawa", "one_point_refuses_all.JBI", offset=SHIFTED, text=text)
    assert moved.code == ExitCode.REFUSED
    assert "no tool 0,1" in moved.report_point("P00001")["reason"]


@pytest.mark.parametrize(
    ("value", "code"), [("120", ExitCode.REFUSED), ("PR[9,3]+120", ExitCode.PASS), ("R[1]", ExitCode.REFUSED)]
)
def test_a_height_set_where_the_robot_stands_stays_in_a_shift(
    tmp_path: Path, value: str, code: ExitCode
) -> None:
    text = LISTING.replace(
        "UTOOL_NUM=1 ;",
        f"UTOOL_NUM=1 ;\n  :  PR[9]=LPOS ;\n  :  PR[9,3]={value} ;\n  :L PR[9] 9mm/sec FINE ;",
    )
    moved = move_program(tmp_path, "fanuc", "offset_pr.LS", offset="0,0,50,0,0,0", text=text)
    assert moved.code == code
    assert [each["what"] for each in moved.report["findings"]] == ["PR[9,3]"] * (code == ExitCode.REFUSED)
