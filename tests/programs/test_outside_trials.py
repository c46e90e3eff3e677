"""Programs as people outside write them: small letters, sums in numbers, pallets, postures that stay."""

import re
from pathlib import Path

import pytest

from cellcal.service.exit_codes import ExitCode
from tests.programs.test_field_cases import CASES, TURNED, move_program

SHIFTED = "30,-20,5,0,0,0"


def _listing_with(statements: list[str]) -> str:
    """Return the listing of the increment with other statements."""
    text = (CASES / "fanuc" / "inc_lift.LS").read_text()
    lines = "\n".join(f"{number:4d}:{each} ;" for number, each in enumerate(statements, 1))
    return re.sub(r"/MN\n.*?/POS", lambda _: f"/MN\n{lines}\n/POS", text, flags=re.DOTALL)


@pytest.mark.parametrize(
    "motions",
    [
        ["l p[1] 100mm/sec fine", "l p[2] 100mm/sec fine inc"],
        ["L P[1] 100mm/sec FINE", "  l P[2] 100mm/sec FINE Inc"],
        ["L P[1] 100mm/sec FINE", "L p[2] 100mm/sec FINE INC"],
    ],
)
def test_an_increment_in_small_letters_is_left(tmp_path: Path, motions: list[str]) -> None:
    text = _listing_with(["  UFRAME_NUM=2", "  UTOOL_NUM=1", *motions])
    moved = move_program(tmp_path, "fanuc", "inc_lift.LS", offset=SHIFTED, text=text)
    assert moved.code == ExitCode.REFUSED
    assert moved.report_point("P[1]")["status"] == "changed"
    assert moved.report_point("P[2]")["status"] == "left"
    assert "increment" in moved.report_point("P[2]")["reason"]


def test_an_offset_in_small_letters_is_a_finding(tmp_path: Path) -> None:
    motions = ["l p[1] 100mm/sec fine offset,pr[3]", "l p[2] 9mm/sec fine skip,lbl[1],pr[9]=lpos"]
    text = _listing_with(["  uframe_num=2", "  utool_num=1", *motions])
    moved = move_program(tmp_path, "fanuc", "inc_lift.LS", offset="3,-2,5,0,0,3", text=text)
    assert moved.code == ExitCode.REFUSED
    assert [point for _, point, _ in moved.list_findings()] == ["P[1]"]


@pytest.mark.parametrize(
    ("statement", "reason"),
    [("  uframe[2]=pr[5]", "sets its frame"), ("  uframe_num=1", "the controller stops")],
)
def test_a_frame_chosen_in_small_letters_counts(tmp_path: Path, statement: str, reason: str) -> None:
    text = _listing_with([statement, "L P[1] 100mm/sec FINE", "L P[2] 100mm/sec FINE"])
    moved = move_program(tmp_path, "fanuc", "inc_lift.LS", offset=SHIFTED, text=text)
    assert moved.code == ExitCode.REFUSED
    assert reason in moved.report_point("P[1]")["reason"]


@pytest.mark.parametrize("offset", [TURNED, SHIFTED])
def test_a_pallet_is_named_because_its_places_stay(tmp_path: Path, offset: str) -> None:
    motions = [
        "  PALLETIZING-B_1",
        "L PAL_1[A_1] 9mm/sec FINE",
        "L PAL_1[BTM] 9mm/sec FINE",
        "  PALLETIZING-END_1",
    ]
    text = _listing_with(
        ["  UFRAME_NUM=2", "  UTOOL_NUM=1", *motions, "L P[1] 9mm/sec FINE", "L P[2] 9mm/sec FINE"]
    )
    moved = move_program(tmp_path, "fanuc", "inc_lift.LS", offset=offset, text=text)
    assert moved.code == ExitCode.REFUSED
    assert [point for _, point, _ in moved.list_findings()] == ["PAL_1[A_1]", "PAL_1[BTM]"]


SCRIPT = """def work():
  set_tcp(p[0,0,0,0,0,0])
  movej([0.3, -1.4, 1.9, -2.0, -1.57, 0.1], a=1.4, v=1.05)
  {}
  movel(p[-0.544299,-0.276221,0.194454,1.607636,2.295913,0.875803], a=1.2, v=0.25)
end
"""
REST = "-0.276221,0.194454,1.607636,2.295913,0.875803"


@pytest.mark.parametrize("offset", [TURNED, SHIFTED])
@pytest.mark.parametrize("first", ["-0.544299+0.05", "-0.544299 - 1e-2", "-544.299/1000"])
@pytest.mark.parametrize("statement", ["movel(p[{},{}])", "pick = p[{},{}]\n  movel(pick)"])
def test_a_sum_in_one_pose_is_named_and_the_others_move(
    tmp_path: Path, offset: str, first: str, statement: str
) -> None:
    text = SCRIPT.format(statement.format(first, REST))
    moved = move_program(tmp_path, "ur", "component_assignment.script", offset=offset, text=text)
    assert moved.code == ExitCode.REFUSED
    assert moved.report["points"][-1]["status"] == "changed"
    assert len(moved.list_findings()) == 1


def test_numbers_with_an_exponent_are_no_sum(tmp_path: Path) -> None:
    text = SCRIPT.format(f"movel(p[-5.44299e-1,{REST}])")
    moved = move_program(tmp_path, "ur", "component_assignment.script", offset=TURNED, text=text)
    assert moved.code == ExitCode.PASS


def test_a_joint_point_that_is_left_tells_the_posture_of_the_next(tmp_path: Path) -> None:
    text = SCRIPT.format("textmsg(1)")
    moved = move_program(tmp_path, "ur", "component_assignment.script", offset=TURNED, text=text, joints="")
    assert moved.code == ExitCode.REFUSED
    assert [one["status"] for one in moved.report["points"]] == ["left", "changed"]
    assert "joint angles" in moved.report["points"][0]["reason"]


def test_a_shift_in_an_unknown_frame_is_stated_as_a_bound(tmp_path: Path) -> None:
    text = (CASES / "abb" / "pdisp_rotated.mod").read_text()
    lines = ["p2:=p1;", "p2.trans.z:=p2.trans.z+40;", "MoveL p2, v100, z1, tool0;"]
    text = text.replace("PDispSet [[100,0,0],[1,0,0,0]];", "\n".join(lines)).replace("PDispOff;", "")
    text = text.replace("PROC main", "VAR robtarget p2;\n  PROC main")
    moved = move_program(tmp_path, "abb", "pdisp_rotated.mod", offset=TURNED, text=text)
    assert moved.code == ExitCode.REFUSED
    assert "misses by up to 20.71 mm" in moved.report["findings"][0]["text"]


KRL = """DEF work()
BAS(#INITMOV,0)
PTP {A1 0, A2 -90, A3 90, A4 0, A5 10, A6 0}
FDAT_ACT=FP1
BAS(#PTP_PARAMS,100)
PTP XP1
{rest}END
"""


@pytest.mark.parametrize(("joints", "status"), [("keep", "unchanged"), ("move", "left")])
def test_joints_are_kept_although_a_point_sets_the_tool_below(
    tmp_path: Path, joints: str, status: str
) -> None:
    text = KRL.replace("{rest}", "")
    moved = move_program(tmp_path, "kuka", "lin_rel_rotated.src", offset=TURNED, text=text, joints=joints)
    assert moved.report_point("PTP@3")["status"] == status


def test_an_increment_in_joints_is_left_although_joints_are_kept(tmp_path: Path) -> None:
    text = KRL.replace("{rest}", "PTP_REL {A1 10}\n")
    moved = move_program(tmp_path, "kuka", "lin_rel_rotated.src", offset=TURNED, text=text)
    assert moved.code == ExitCode.REFUSED
    assert moved.report_point("PTP_REL@7")["status"] == "left"


@pytest.mark.parametrize("x", ["100+10", "100 -10", "2*55.0", "1E2+XVAL", "110/(1)"])
def test_a_sum_in_one_krl_position_does_not_refuse_the_program(tmp_path: Path, x: str) -> None:
    text = (CASES / "kuka" / "lin_rel_rotated.src").read_text().replace("LIN_REL {X 100}", "LIN {X PLACE}")
    text = text.replace("PLACE", f"{x},Y 30,Z 250,A 0,B 90,C 0")
    moved = move_program(tmp_path, "kuka", "lin_rel_rotated.src", offset=SHIFTED, text=text)
    assert moved.code == ExitCode.REFUSED
    assert moved.report_point("LIN@7")["status"] == "changed"
    assert moved.report_point("LIN@8")["status"] == "left"


TARGET = "[[{},20,350],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
RAPID = """MODULE AR
  VAR robtarget pA{{5}};
  PROC main()
    pA{{1}}:={};
    pA{{2}}:={};
    {}
    MoveL pA{{1}}, v100, z1, tool0;
    MoveL pA{{2}}, v100, z1, tool0;
  ENDPROC
ENDMODULE
"""


@pytest.mark.parametrize(
    ("statement", "statuses", "code"),
    [
        ("", ["changed", "changed"], ExitCode.PASS),
        ("pA{2}:=CRobT();", ["changed", "left"], ExitCode.REFUSED),
        ("pA{2}.trans.x:=pA{2}.trans.x+40;", ["changed", "changed"], ExitCode.REFUSED),
    ],
)
def test_values_given_to_an_empty_array_are_its_targets(
    tmp_path: Path, statement: str, statuses: list[str], code: ExitCode
) -> None:
    text = RAPID.format(TARGET.format(300), TARGET.format(310), statement)
    moved = move_program(tmp_path, "abb", "wobj0_case.mod", offset=TURNED, text=text)
    assert moved.code == code
    assert [one["status"] for one in moved.report["points"]] == statuses
