"""Points of KUKA and Universal Robots programs that calls pass to routines."""

from pathlib import Path

import pytest

from cellcal.drivers.programs.barred import COMPUTED, OVERWRITTEN
from cellcal.drivers.universal_robots.program_files.script_positions import CONFLICTS
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_across_files import dat_file, frames_of_position, read_programs, src_file
from tests.programs.test_field_cases import move_program

POINT = "{X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0,S 2,T 2}"
DATA = '{TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE,POINT2[] " "}'
POINTS = (
    f"DECL E6POS XP1={POINT}",
    f"DECL FDAT FP1={DATA}",
    f"DECL E6POS XP2={POINT}",
    "DECL E6POS PT[1]",
    f"PT[1]={POINT}",
)
P1 = ("FDAT_ACT=FP1", "BAS(#PTP_PARAMS,100)", "PTP XP1")


def routine(name: str, parameters: str, *lines: str) -> str:
    return "\n".join((f"DEF {name} ({parameters})", "DECL E6POS P", *lines, "END", ""))


def frames_set(base: int) -> tuple[str, ...]:
    return (f"$BASE=BASE_DATA[{base}]", "$TOOL=TOOL_DATA[1]")


@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize(
    ("call", "body", "name", "expected"),
    [
        ("SUB(XP1)", ("P:IN", *frames_set(3), "LIN P"), "XP1", "taught with another tool or frame"),
        ("SUB(XP1)", ("P:IN", *frames_set(2), "LIN P"), "XP1", ("1", "2")),
        ("SUB(XP2)", ("P:IN", *frames_set(3), "LIN P"), "XP2", ("1", "3")),
        ("SUB(1, XP1)", ("N:IN, P:OUT", *frames_set(3), "LIN P"), "XP1", "taught with another"),
        ("SUB(XP1)", ("P:OUT", "P=$POS_ACT"), "XP1", OVERWRITTEN),
        ("SUB(XP1)", ("P:OUT", "P.X=P.X+7"), "XP1", OVERWRITTEN),
        ("SUB(XP1)", ("P:IN", "P.X=P.X+7"), "XP1", ("1", "2")),
        ("IF OK(XP1) THEN", ("P:IN", *frames_set(3), "LIN P"), "XP1", ("1", "2")),  # of another routine
        ("SUB(XP1.X)", ("R:OUT", "R=R+7"), "XP1", OVERWRITTEN),
        ("SUB(BASE_DATA[2])", ("F:OUT", "F.X=F.X+7"), "XP1", COMPUTED),
        ("SUB(PT[])", ("P[]:OUT", "P[1]=$POS_ACT"), "PT[1]", OVERWRITTEN),
        ("SUB(PT[])", ("P[]:OUT", *frames_set(3), "LIN P[1]"), "PT[1]", ("1", "3")),
        ("SUB(PT[N])", ("P:IN", *frames_set(3), "LIN P"), "PT[1]", ("1", "3")),
        ("SUB(BASE_DATA[3])", ("F:OUT", "F.X=F.X+7"), "XP1", ("1", "2")),
    ],
)
def test_what_a_routine_does_to_its_parameter_it_does_to_what_is_passed(
    tmp_path: Path, call: str, body: tuple[str, ...], name: str, expected: object, elsewhere: bool
) -> None:
    sub = routine("SUB", *body)
    end = ("ENDIF",) * call.startswith("IF")
    source = src_file("A", *P1, call, *end)
    files = {"a.dat": dat_file("A", *POINTS), "a.src": source if elsewhere else source + sub}
    found = frames_of_position(
        read_programs(tmp_path, {**files, "sub.src": sub} if elsewhere else files)["a.dat"], name
    )
    assert found == expected if isinstance(expected, tuple) else str(expected) in found


def test_a_point_is_passed_on_to_the_routine_of_another_file(tmp_path: Path) -> None:
    middle = routine("MID", "P:IN", "SUB(P)")
    files = {
        "a.dat": dat_file("A", *POINTS),
        "a.src": src_file("A", *P1, "MID(XP1)") + middle,
        "sub.src": routine("SUB", "P:IN", *frames_set(3), "LIN P"),
    }
    found = frames_of_position(read_programs(tmp_path, files)["a.dat"], "XP1")
    assert "taught with another tool or frame than sub.src" in found


TOLD = "before its program is called, or may"
COPYING = ("P:IN", "DECL E6POS H", "H=P", "LIN H")


@pytest.mark.parametrize(
    ("before", "main", "sub", "expected"),
    [
        ((), ("H=XP1", "SUB(H)"), ("P:IN", *frames_set(3), "LIN P"), "taught in another frame than sub.src"),
        ((), ("H=XP1", "K=H", "SUB(K)"), ("P:IN", *frames_set(3), *COPYING[1:]), "taught in another frame"),
        ((), ("H=XP1", "SUB(H)"), ("P:IN", *frames_set(2), "LIN P"), ("1", "2")),
        ((), ("H=XP1", "SUB(H)"), ("P:OUT", "P=$POS_ACT"), ("1", "2")),  # the copy, and not the point
        ((), ("H=PT[1]", "SUB(H)"), ("P:IN", *frames_set(3), "LIN P"), ("1", "2")),
        (frames_set(3), ("H=XP1", "SUB(H)"), ("P:IN", "LIN P"), TOLD),
        (frames_set(3), ("SUB(XP1)",), COPYING, TOLD),
        (("BAS(#INITMOV,0)",), ("SUB(XP1)",), COPYING, TOLD),
        (("BAS(#INITMOV,0)",), ("HA[1]=XP1", "SUB(HA[1])"), COPYING, TOLD),
        (("BAS(#INITMOV,0)",), ("SUB()",), ("", "LIN XP1"), TOLD),
        (("BAS(#INITMOV,0)",), ("SUB()",), ("", "H=XP1", "LIN H"), TOLD),
        (("BAS(#INITMOV,0)",), ("SUB()",), ("", "BAS(#INITMOV,0)", *frames_set(2), "LIN XP1"), ("1", "2")),
    ],
)
def test_a_copy_is_followed_into_the_routines_of_other_files(
    tmp_path: Path, before: tuple[str, ...], main: tuple[str, ...], sub: tuple[str, ...], expected: object
) -> None:
    points = (one.replace("DECL", "DECL GLOBAL") for one in POINTS)
    files = {
        "a.dat": dat_file("A", *points),
        "a.src": src_file("A", *before, *main),
        "sub.src": routine("SUB", *sub),
    }
    found = frames_of_position(read_programs(tmp_path, files)["a.dat"], "XP1")
    assert found == expected if isinstance(expected, tuple) else str(expected) in found


@pytest.mark.parametrize(
    ("main", "sub", "expected"),
    [
        (("XG=XP1",), (*frames_set(3), "LIN XG"), "taught in another frame than sub.src"),
        (("XG=XP1",), (*frames_set(2), "LIN XG"), ("1", "2")),
        (("XH=XP1", "XG=XH"), (*frames_set(3), "DECL E6POS H", "H=XG", "LIN H"), "taught in another frame"),
        (("XA[1]=XP1",), (*frames_set(3), "LIN XA[I]"), "taught in another frame than sub.src"),
        (("XG=XP1",), ("LIN XG",), TOLD),
    ],
)
def test_a_copy_that_all_files_see_is_followed_to_the_moves_of_others(
    tmp_path: Path, main: tuple[str, ...], sub: tuple[str, ...], expected: object
) -> None:
    files = {
        "a.dat": dat_file("A", *POINTS),
        "a.src": src_file("A", *frames_set(2), *main, "SUB()"),
        "sub.src": routine("SUB", "", *sub),
        "$config.dat": dat_file("$CONFIG", "E6POS XG", "E6POS XH", "E6POS XA[3]"),
    }
    found = frames_of_position(read_programs(tmp_path, files)["a.dat"], "XP1")
    assert found == expected if isinstance(expected, tuple) else str(expected) in found


@pytest.mark.parametrize(
    ("line", "name", "expected"),
    [
        ('RET=EKI_GetFrame("C","S/F",XP1)', "XP1", OVERWRITTEN),
        ('RET=EKI_GetReal("C","S/F",XP1.X)', "XP1", OVERWRITTEN),
        ('RET=EKI_GetReal("C","S/F",XP1.S)', "XP1", ("1", "2")),
        ('CREAD(H,ST,MODE,TIME,OFFS,"%r",XP1.Y)', "XP1", OVERWRITTEN),
        ('SREAD(S[],ST,OFFS,"%f",XP1.Z)', "XP1", OVERWRITTEN),
        ("CAST_FROM(BUF[],OFFS,XP1.X,XP1.Y)", "XP1", OVERWRITTEN),
        ('RET=EKI_GetFrame("C","S/F",BASE_DATA[2])', "XP1", COMPUTED),
        ('RET=EKI_SetFrame("C","S/F",XP1)', "XP1", ("1", "2")),
    ],
)
def test_a_function_of_the_language_gives_a_point_a_value(
    tmp_path: Path, line: str, name: str, expected: object
) -> None:
    files = {"a.dat": dat_file("A", *POINTS), "a.src": src_file("A", *P1, line)}
    found = frames_of_position(read_programs(tmp_path, files)["a.dat"], name)
    assert found == expected if isinstance(expected, tuple) else str(expected) in found


SCRIPT = """def go(n, q):
  {}
end
def over(q):
  go(1, q)
end
def prog():
  set_tcp(p[0,0,0,0,0,0])
  movej([0.3, -1.4, 1.9, -2.0, -1.57, 0.1], a=1.4, v=1.05)
  pick = p[-0.544299,-0.276221,0.194454,1.607636,2.295913,0.875803]
  movel(pick, a=1.2, v=0.25)
  {}
end
"""


@pytest.mark.parametrize(
    ("body", "call", "status"),
    [
        ("movel(pose_trans(p[0.1,0,0,0,0,0], q))", "go(1, pick)", "left"),
        ("movel(pose_trans(p[0.1,0,0,0,0,0], q))", "go(n=1, q=pick)", "left"),
        ("movel(pose_trans(p[0.1,0,0,0,0,0], q))", "over(pick)", "left"),
        ("t = pose_trans(plane, q)\n  movel(t)", "go(1, pick)", "left"),
        ("movel(pose_trans(p[0.1,0,0,0,0,0], q))", "go(pick, 1)", "changed"),
        ("t = q\n  movel(pose_trans(p[0.1,0,0,0,0,0], t))", "go(1, pick)", "left"),
        ("movel(q)", "t = pick\n  movel(pose_trans(p[0.1,0,0,0,0,0], t))", "left"),
        ("movel(q)", "global t = pick  # again\n  s = t\n  u = pose_trans(plane, s)\n  movel(u)", "left"),
        ("movel(q)", "t = pick\n  movel(t)", "changed"),
        ("movel(q)", "go(1, pick)", "changed"),
        ("movel(pose_trans(q, p[0,0,-0.1,0,0,0]))", "go(1, pick)", "changed"),  # a step from there
    ],
)
def test_a_place_that_a_function_brings_into_a_frame_is_in_two(
    tmp_path: Path, body: str, call: str, status: str
) -> None:
    text = SCRIPT.format(body, call)
    moved = move_program(tmp_path, "ur", "component_assignment.script", offset="10,-5,5,0,0,4", text=text)
    assert moved.report_point("pick")["status"] == status
    if status == "left":
        assert moved.code == ExitCode.REFUSED
        assert moved.report_point("pick")["reason"] == "the program goes to it in different frames"


NESTED = """def prog():
  def over(pose):
    local t = pose
    {over}
  end
  def set_target(q):
    global tgt = q
  end
  def go_to(pose):
    if (True):
      movel(pose)
    end
  end
  set_tcp(p[0,0,0,0,0,0])
  movej([0.3, -1.4, 1.9, -2.0, -1.57, 0.1], a=1.4, v=1.05)
  plane = p[0.1,0,0,0,0,0]
  pick = p[-0.544299,-0.276221,0.194454,1.607636,2.295913,0.875803]
  movel(pick, a=1.2, v=0.25)
  {main}
end
"""


@pytest.mark.parametrize(
    ("over", "main", "status"),
    [
        ("movel(t)", "places = [pick, pick]\n  movel(pose_trans(plane, places[0]))", "left"),
        (
            "movel(t)",
            "places = [pick, # first\n    pick]\n  t = places[1]\n  movel(pose_trans(plane, t))",
            "left",
        ),
        ("movel(pose_trans(plane, t))", "places = [pick]\n  over(places[0])", "left"),
        ("movel(t)", "places = [1, 1]\n  places[1] = pick\n  movel(pose_trans(plane, places[1]))", "left"),
        ("movel(t)", "places = [pick, pick]\n  movel(places[0])", "changed"),
        ("movel(t)", "set_target(pick)\n  movel(pose_trans(plane, tgt))", "left"),
        ("movel(pose_trans(plane, tgt))", "set_target(pick)\n  over(1)", "left"),
        ("movel(pose_trans(plane, t))", "over(pick)", "left"),
        ("movel(t)", "go_to(pick)\n  pose = get_pose()\n  movel(pose_trans(plane, pose))", "changed"),
        ("movel(t)", "over(pick)\n  t = get_pose()\n  movel(pose_trans(plane, t))", "changed"),
        ("t = get_pose()\n    movel(pose_trans(plane, t))", "t = pick\n  movel(t)", "changed"),
        (
            "movel(t)",
            "tgt = pick\n  movel(tgt)\n  tgt = get_pose()\n  movel(pose_trans(plane, tgt))",
            "changed",
        ),
        ("movel(t)", "t = pick\n  movel(t)\n  t = pose_trans(plane, t)\n  movel(t)", "left"),
        (
            "movel(t)",
            "while (True):\n    t = pick\n    movel(t)\n    t = get_pose()\n"
            "    movel(pose_trans(plane, t))\n  end",
            "changed",
        ),
        (
            "movel(t)",
            "while (True):\n    movel(pose_trans(plane, t))\n    t = get_pose()\n    t = pick\n  end",
            "left",
        ),
        (
            "movel(t)",
            "t = pick\n  if (True):\n    t = get_pose()\n  end\n  movel(pose_trans(plane, t))",
            "left",
        ),
        (
            "movel(t)",
            "if (True):\n    t = pick\n  else:\n    t = get_pose()\n  end\n  movel(pose_trans(plane, t))",
            "left",
        ),
        (
            "movel(pose_trans(plane, tgt))",
            "global tgt = pick\n  over(1)\n  global tgt = get_pose()\n  movel(tgt)",
            "left",
        ),
    ],
)
def test_copies_last_to_the_next_value_and_belong_to_their_function(
    tmp_path: Path, over: str, main: str, status: str
) -> None:
    text = NESTED.format(over=over, main=main)
    moved = move_program(tmp_path, "ur", "component_assignment.script", offset="10,-5,5,0,0,4", text=text)
    assert moved.report_point("pick")["status"] == status
    assert moved.report_point("pick")["reason"] == (CONFLICTS if status == "left" else "")


AXES = "{A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0}"
AXES_SET = """DEF a ()
E6AXIS AX
AX={}
PTP AX
{}
END
"""


@pytest.mark.parametrize(("joints", "status"), [("move", "left"), ("keep", "unchanged")])
@pytest.mark.parametrize("statement", ["AX=$AXIS_ACT", "AX.A1=20"])
def test_an_axis_point_that_gets_a_value_is_left_where_joints_move(
    tmp_path: Path, statement: str, joints: str, status: str
) -> None:
    text = AXES_SET.format(AXES, statement)
    moved = move_program(tmp_path, "kuka", "no_posture.src", offset="10,-5,5,0,0,4", text=text, joints=joints)
    assert moved.report_point("AX")["status"] == status
    assert moved.code == (ExitCode.REFUSED if status == "left" else ExitCode.PASS)
    assert not moved.list_findings()
