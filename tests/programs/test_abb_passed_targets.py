"""RAPID targets that a program passes to routines, of its own module and of others, and options of instructions."""

import json
from pathlib import Path

import pytest

from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode

PROJECT = (
    'format = 1\nname = "a"\n[robot]\nserial = "A1"\nmodel = "abb_irb6700_200_260"\nsmallest_sigma = 0.001\n'
)
REST = "[0,0,1,0],[0,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
MODULE = f"""MODULE M1
  PERS tooldata tool1:=[TRUE,[[0,0,200],[1,0,0,0]],[1,[0,0,10],[1,0,0,0],0,0,0]];
  PERS wobjdata wobj1:=[FALSE,TRUE,"",[[1200,0,300],[0.984807753,0,0,0.173648178]],[[0,0,0],[1,0,0,0]]];
  PERS wobjdata wobj2:=[FALSE,TRUE,"",[[1190,20,310],[0.984807753,0,0,0.173648178]],[[0,0,0],[1,0,0,0]]];
  PERS robtarget p10:=[[300,0,300],{REST};
  PERS robtarget p20:=[[350,80,250],{REST};
  PERS pose peX:=[[0,0,0],[1,0,0,0]];
  PROC main()
{{}}
  ENDPROC
{{}}
ENDMODULE
"""
ALONG, ABOUT_Z = "10,20,0,0,0,0", "0,0,0,0,0,5"
IN = "MoveL {},v100,fine,tool1\\WObj:={};"
BOTH = f"{IN.format('p10', 'wobj1')}\n{IN.format('p20', 'wobj1')}\n"


def pick(body: str, parameters: str = "robtarget p") -> str:
    return f"  PROC Pick({parameters})\n    {body}\n  ENDPROC"


def move(
    tmp_path: Path,
    body: str,
    more: str = "",
    *,
    other_file: str = "",
    offset: str = ABOUT_Z,
    options: tuple[str, ...] = (),
    project: str = "",
) -> dict:
    source = tmp_path / "src"
    source.mkdir()
    (source / "M1.mod").write_text(MODULE.format(body, more), encoding="ascii")
    if other_file:
        (source / "R.mod").write_text(f"MODULE R\n{other_file}\nENDMODULE\n", encoding="ascii")
    (tmp_path / "project.toml").write_text(PROJECT + project, encoding="utf-8")
    words = [
        "program",
        "move",
        str(source),
        "--project",
        str(tmp_path / "project.toml"),
        f"--offset={offset}",
        *options,
    ]
    code = run_command_line([*words, "--out", str(tmp_path / "out"), "--json", str(tmp_path / "r.json")])
    programs = json.loads((tmp_path / "r.json").read_text())["programs"]
    points = {one["point"]: one for program in programs for one in program["points"]}
    return {
        "code": code,
        "points": points,
        "findings": [one for each in programs for one in each["findings"]],
    }


@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize(
    ("call", "parameters", "move_there", "status"),
    [
        ("Pick p10;", "robtarget p", IN.format("p", "wobj2"), "left"),
        ("Pick p10;", "robtarget p", IN.format("p", "wobj1"), "changed"),
        ("Pick\\q:=p10,p20;", "\\robtarget q,robtarget p", IN.format("q", "wobj2"), "left"),
        ("Pick\\q:=p10,p20;", "\\robtarget q,robtarget p", IN.format("q", "wobj1"), "changed"),
        ("Pick p10,wobj2;", "robtarget p,PERS wobjdata w", IN.format("p", "w"), "left"),
        ("Pick p10,wobj1;", "robtarget p,PERS wobjdata w", IN.format("p", "w"), "changed"),
        ('%"Pick"% p10;', "robtarget p", IN.format("p", "wobj2"), "left"),
        ('% "r:PICK" % p10;', "robtarget p", IN.format("p", "wobj1"), "changed"),
        ('%"Pi"+"ck"% p10;', "robtarget p", IN.format("p", "wobj1"), "left"),  # which, it does not say
        ("%stName% p10;", "robtarget p", IN.format("p", "wobj1"), "left"),
        ('%"MoveL"% p10,v100,fine,tool1;', "robtarget p", IN.format("p", "wobj1"), "left"),
        ("Pick p20\\w:=wobj2,p10;", "robtarget o\\PERS wobjdata w,robtarget p", IN.format("p", "w"), "left"),
    ],
)
def test_moves_to_a_parameter_go_to_what_is_passed(
    tmp_path: Path, call: str, parameters: str, move_there: str, status: str, elsewhere: bool
) -> None:
    routine = pick(move_there, parameters)
    moved = move(tmp_path, BOTH + call, "" if elsewhere else routine, other_file=routine if elsewhere else "")
    assert moved["points"]["p10"]["status"] == status, moved["points"]["p10"]
    assert moved["code"] == (ExitCode.REFUSED if status == "left" else ExitCode.PASS)


@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize(
    ("call", "parameters", "body", "status"),
    [
        ("Pick p10;", "robtarget p", IN.format("q", "wobj2"), "left"),
        ("Pick p10;", "robtarget p", IN.format("q", "wobj1"), "changed"),
        ("Pick p10;", "robtarget p", "q2:=q;\n" + IN.format("q2", "wobj1"), "changed"),
        ("Pick p10;", "robtarget p", f"{IN.format('p', 'wobj1')}\n{IN.format('q', 'wobj2')}", "left"),
        ("Go p10;", "robtarget p", IN.format("q", "wobj2"), "left"),
        ("Go p10;", "robtarget p", IN.format("q", "wobj1"), "changed"),
    ],
)
def test_moves_to_a_copy_of_a_parameter_count_for_what_is_passed(
    tmp_path: Path, call: str, parameters: str, body: str, status: str, elsewhere: bool
) -> None:
    routine = pick(f"VAR robtarget q;\nVAR robtarget q2;\nq:=p;\n{body}", parameters)
    go = "  PROC Go(robtarget g)\n    Pick g;\n  ENDPROC\n"
    moved = move(
        tmp_path, BOTH + call, go + routine * (not elsewhere), other_file=routine if elsewhere else ""
    )
    assert moved["points"]["p10"]["status"] == status, moved["points"]["p10"]


@pytest.mark.parametrize(
    ("call", "body", "status"),
    [
        ("Pick p10,wobj2;", IN.format("q", "w"), "left"),
        ("Pick p10,wobj1;", IN.format("q", "w"), "changed"),
        ("Pick p10,wobjs{n};", IN.format("q", "w"), "left"),
        ("Pick p10,wobj1;", "q2:=q;\n" + IN.format("q2", "wobj2"), "left"),
    ],
)
def test_a_copy_of_a_parameter_is_moved_to_in_the_work_object_that_is_passed(
    tmp_path: Path, call: str, body: str, status: str
) -> None:
    text = f"VAR robtarget q;\nVAR robtarget q2;\nq:=p;\n{body}"
    moved = move(tmp_path, BOTH + call, other_file=pick(text, "robtarget p,PERS wobjdata w"))
    assert moved["points"]["p10"]["status"] == status, moved["points"]["p10"]


def test_a_target_that_only_a_routine_moves_to_is_moved(tmp_path: Path) -> None:
    chain = "  PROC Go(robtarget q)\n    Pick q;\n  ENDPROC\n" + pick(IN.format("p", "wobj1"))
    assert move(tmp_path, "Go p10;\nPick p20;", chain)["code"] == ExitCode.PASS


@pytest.mark.parametrize(("offset", "counts"), [(ALONG, False), (ABOUT_Z, True)])
@pytest.mark.parametrize(
    ("call", "move_there"),
    [
        ("Pick p10;", IN.format("Offs(p,50,0,0)", "wobj1")),
        ("Pick Offs(p10,50,0,0);", IN.format("p", "wobj1")),
        ("Pick p10;", "p.trans.x:=p.trans.x+50;\n" + IN.format("p", "wobj1")),
    ],
)
def test_a_shift_of_a_parameter_is_one_of_what_is_passed(
    tmp_path: Path, call: str, move_there: str, offset: str, counts: bool
) -> None:
    moved = move(tmp_path, BOTH + call, pick(move_there), offset=offset)
    assert [one["point"] for one in moved["findings"]] == ["p10"] * counts
    assert moved["code"] == (ExitCode.REFUSED if counts else ExitCode.PASS)


@pytest.mark.parametrize(("mode", "status"), [("", "changed"), ("INOUT ", "left")])
def test_a_value_that_a_routine_gives_counts_where_it_comes_back(
    tmp_path: Path, mode: str, status: str
) -> None:
    routine = pick("p:=CRobT(\\Tool:=tool1\\WObj:=wobj1);\n" + IN.format("p", "wobj1"), mode + "robtarget p")
    moved = move(tmp_path, BOTH + "Pick p10;", routine)
    assert moved["points"]["p10"]["status"] == status


@pytest.mark.parametrize(
    "instruction",
    [
        "Search_1D peX,p10,p20,v200,tool1\\WObj:=wobj1;",
        "Search_1D\\NotOff,peX,p10,p20,v200,tool1\\WObj:=wobj1\\PrePDisp:=peX;",
        "Search_Part bFound,p10,p20,v200,tool1\\WObj:=wobj1;",
        "ArcMoveC p10,p20,v100,fine,tool1\\WObj:=wobj1;",
        "ContactL\\DesiredTorque:=0.5,p10,v100\\Zone:=z10,tool1\\WObj:=wobj1;\nFCPressL p20,v100,50,z10,tool1\\WObj:=wobj1;",
    ],
)
def test_searches_with_the_torch_and_moves_of_options_name_their_tool(
    tmp_path: Path, instruction: str
) -> None:
    assert move(tmp_path, instruction)["code"] == ExitCode.PASS


def test_an_option_is_no_assignment(tmp_path: Path) -> None:
    moved = move(tmp_path, f"{IN.format('p10', 'wobj1')}\nUnknown\\Way:=p20,p10;")
    assert "copies" not in moved["points"]["p20"]["reason"]


DISPLACED = IN.format("p30", "wobj1") + "\nPDispOff;"


@pytest.mark.parametrize("offset", [ALONG, ABOUT_Z])
@pytest.mark.parametrize(
    ("before", "counts"),
    [
        ("PDispOn\\Rot\\ExeP:=p20,p10,tool1\\WObj:=wobj1;", False),
        ("PDispOn\\ExeP:=p20,p10,tool1\\WObj:=wobj1;", False),
        ("PDispOn p10,tool1\\WObj:=wobj1;", False),
        (
            "SearchL\\Stop,di1,pFound,p20,v100,tool1\\WObj:=wobj1;\nPDispOn\\ExeP:=pFound,p10,tool1\\WObj:=wobj1;",
            False,
        ),
        ("GoHome;\nPDispOn p10,tool1\\WObj:=wobj1;", True),
        ("IF di1=1 THEN\nGoHome;\nENDIF\nPDispOn p10,tool1\\WObj:=wobj1;", True),
        ("p20:=CRobT();\nPDispOn\\ExeP:=p20,p10,tool1\\WObj:=wobj1;", True),
        ("PDispOn\\ExeP:=p20,p10,tool1\\WObj:=wobj2;", True),
        ("PDispOn\\ExeP:=p40,p10,tool1\\WObj:=wobj1;", True),
    ],
)
def test_a_displacement_between_places_that_go_along_goes_along(
    tmp_path: Path, before: str, counts: bool, offset: str
) -> None:
    more = f"  PERS robtarget p30:=[[340,60,300],{REST};\n  PERS robtarget p40:=[[340,60,290],{REST};\n"
    more += f"  PERS robtarget pFound:=[[340,60,290],{REST};"
    moved = move(tmp_path, BOTH + before + "\n" + DISPLACED, more, offset=offset)
    assert {one["point"] for one in moved["findings"]} >= ({"p30"} if counts else set())
    assert bool(moved["findings"]) == counts


@pytest.mark.parametrize("frame", ["wobj1", "wobj2"])
@pytest.mark.parametrize(
    ("main", "declared", "other_file"),
    [
        ("H{1}:=p10;\nPick H{1};", "VAR robtarget H{2};", pick("MoveL p,v100,fine,tool1\\WObj:=@;")),
        (
            "H:=[p10,p20];\nPick H;",
            "VAR robtarget H{2};",
            pick("MoveL p{1},v100,fine,tool1\\WObj:=@;", "robtarget p{*}"),
        ),
        (
            "gH:=p10;\nGo;",
            "",
            "PERS robtarget gH:=[[300,0,300],"
            + REST
            + ";\nPROC Go()\nMoveL gH,v100,fine,tool1\\WObj:=@;\nENDPROC",
        ),
        ("Pick fUp(p10);", "", pick("MoveL p,v100,fine,tool1\\WObj:=@;")),
    ],
)
def test_a_copy_is_followed_to_the_moves_of_other_modules(
    tmp_path: Path, main: str, declared: str, other_file: str, frame: str
) -> None:
    more = "  FUNC robtarget fUp(robtarget p)\n    RETURN p;\n  ENDFUNC\n"
    moved = move(
        tmp_path, f"{declared}\n{BOTH}{main}", more, other_file=other_file.replace("@", frame), offset=ALONG
    )
    status = "left" if frame == "wobj2" else "changed"
    assert moved["points"]["p10"]["status"] == status, moved["points"]["p10"]


@pytest.mark.parametrize(("frame", "status"), [("wobj1", "changed"), ("wobj2", "left")])
@pytest.mark.parametrize(
    ("declared", "value", "goal"),
    [
        ("VAR robtarget H{2};", "H:=[p20,p10];", "H{2}"),
        ("VAR st r1;", "r1:=[p10,1];", "r1.p"),
    ],
)
def test_targets_in_a_list_or_a_record_are_copies(
    tmp_path: Path, declared: str, value: str, goal: str, frame: str, status: str
) -> None:
    record = "  RECORD st\n    robtarget p;\n    num n;\n  ENDRECORD\n"
    moved = move(tmp_path, f"{declared}\n{BOTH}{value}\n{IN.format(goal, frame)}", record, offset=ALONG)
    assert moved["points"]["p10"]["status"] == status


@pytest.mark.parametrize("is_in_other_file", [False, True], ids=["own routine", "another module's"])
@pytest.mark.parametrize("frame", ["wobj1", "wobj2"])
@pytest.mark.parametrize("value", ["r1:=[p10,1];", "r1.p:=p10;"])
@pytest.mark.parametrize(
    "passed", [("Pick r1;", "st p", "p.p"), ("Pick r1.p;", "robtarget p", "p")], ids=["record", "component"]
)
def test_a_copy_in_a_record_is_followed_into_routines(
    tmp_path: Path, passed: tuple[str, str, str], value: str, frame: str, is_in_other_file: bool
) -> None:
    call, parameter, goal = passed
    record = "  RECORD st\n    robtarget p;\n    num n;\n  ENDRECORD\n"
    routine = pick(IN.format(goal, frame), parameter)
    more, other_file = (record, routine) if is_in_other_file else (record + routine, "")
    moved = move(tmp_path, f"VAR st r1;\n{BOTH}{value}\n{call}", more, other_file=other_file, offset=ALONG)
    status = "left" if frame == "wobj2" else "changed"
    assert moved["points"]["p10"]["status"] == status, moved["points"]["p10"]
