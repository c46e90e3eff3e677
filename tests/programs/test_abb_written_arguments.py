"""RAPID targets and work objects that a call gives a value, or that only one module sees."""

from pathlib import Path

import pytest

from cellcal.drivers.abb.program_files.programs import AbbFile
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_abb_passed_targets import BOTH, IN, MODULE, REST, move

WRITES = "  PROC Find(INOUT {} x)\n    {}\n  ENDPROC"
OVERWRITTEN = "the program gives it another value while it runs"
PART = "the program sets a component of it while it runs"


@pytest.mark.parametrize(
    ("statement", "reason"),
    [
        ("ok:=StrToVal(line,p10);", OVERWRITTEN),
        ("IF StrToVal(line,p10.trans.x) Stop;", PART),
        ("UnpackRawBytes raw,1,p10.trans.z\\Float4;", PART),
        ("GetDataVal stName,p10;", OVERWRITTEN),
        ('SetDataVal "p10",pCamera;', OVERWRITTEN),
        ("Add p10.trans.x,20;", PART),
        ('TPReadNum p10.trans.z,"height";', PART),
    ],
)
def test_an_instruction_gives_a_target_a_value(tmp_path: Path, statement: str, reason: str) -> None:
    moved = move(tmp_path, BOTH + statement)
    assert moved["code"] == ExitCode.REFUSED
    assert moved["points"]["p10"]["reason"] == reason
    assert moved["points"]["p20"]["status"] == "changed"


@pytest.mark.parametrize(
    "statement",
    [
        "ok:=StrToVal(line,nHeight);",
        '! StrToVal(line,p10);\nTPWrite "Add p10.trans.x";',
        "Add p10.extax.eax_a,1;",
    ],
)
def test_what_gives_no_target_a_place_leaves_none(tmp_path: Path, statement: str) -> None:
    assert move(tmp_path, BOTH + statement)["code"] == ExitCode.PASS


@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize(
    ("call", "kind", "body", "left"),
    [
        ("Find p10;", "robtarget", "x:=CRobT();", ["p10"]),
        ("Find p10.trans.x;", "num", "x:=x+7;", ["p10"]),
        ("Find p10.trans;", "pos", "x.x:=x.x+7;", ["p10"]),
        ("Find p10.trans;", "pos", 'TPWrite "x:=";', []),
        ("Find wobj1;", "wobjdata", "x:=wobj2;", ["p10", "p20"]),
        ("Find wobj1.oframe.trans.x;", "num", "ok:=StrToVal(line,x);", ["p10", "p20"]),
        ("Find wobj2;", "wobjdata", "x.uframe.trans.x:=0;", []),
    ],
)
def test_a_routine_gives_its_caller_a_value(
    tmp_path: Path, call: str, kind: str, body: str, left: list[str], elsewhere: bool
) -> None:
    routine = WRITES.format(kind, body)
    moved = move(tmp_path, BOTH + call, "" if elsewhere else routine, other_file=routine if elsewhere else "")
    assert [name for name in ("p10", "p20") if moved["points"][name]["status"] == "left"] == left
    if left:
        assert moved["code"] == ExitCode.REFUSED


@pytest.mark.parametrize(
    ("statement", "reason"),
    [("p10:=fCamera();", OVERWRITTEN), ("p10.trans.z:=100;", PART), ("ok:=StrToVal(line,p10);", OVERWRITTEN)],
)
def test_a_value_that_another_module_gives_counts(tmp_path: Path, statement: str, reason: str) -> None:
    moved = move(tmp_path, BOTH, other_file=f"  PROC Look()\n    {statement}\n  ENDPROC")
    assert moved["code"] == ExitCode.REFUSED
    assert moved["points"]["p10"]["reason"] == reason


@pytest.mark.parametrize(("there", "status"), [("wobj2", "left"), ("wobj1", "changed")])
@pytest.mark.parametrize(
    ("body", "more"),
    [
        (f"VAR robtarget pOwn:=[[320,0,300],{REST};\n{IN.format('pOwn', 'wobj1')}\nPick pOwn;", ""),
        (IN.format("pOwn", "wobj1") + "\nPick pOwn;", f"  LOCAL CONST robtarget pOwn:=[[320,0,300],{REST};"),
    ],
)
def test_a_target_of_its_own_is_passed_to_another_module(
    tmp_path: Path, body: str, more: str, there: str, status: str
) -> None:
    other_file = f"  PROC Pick(robtarget p)\n    {IN.format('p', there)}\n  ENDPROC"
    moved = move(tmp_path, BOTH + body, more, other_file=other_file)
    assert moved["points"]["pOwn"]["status"] == status
    assert moved["code"] == (ExitCode.REFUSED if status == "left" else ExitCode.PASS)
    assert not moved["findings"]


def test_a_target_is_passed_on_over_three_routines(tmp_path: Path) -> None:
    other_file = f"  PROC Pick(robtarget p,PERS wobjdata w)\n    {IN.format('p', 'w')}\n  ENDPROC"
    chain = (
        "  PROC Go(robtarget q,PERS wobjdata v)\n    Then q,v;\n  ENDPROC\n"
        "  PROC Then(robtarget q,PERS wobjdata v)\n    Pick q,v;\n  ENDPROC"
    )
    moved = move(tmp_path, BOTH + "Go p10,wobj2;\nGo p20,wobj1;", chain, other_file=other_file)
    assert [moved["points"][name]["status"] for name in ("p10", "p20")] == ["left", "changed"]


@pytest.mark.parametrize("statement", [IN.format("p10", "wobj1"), "Pick p10;"])
def test_a_work_object_that_only_the_other_module_sees_is_not_taken_for_the_own(
    tmp_path: Path, statement: str
) -> None:
    frame = '[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]]'
    other_file = f"  LOCAL PERS wobjdata wobj1:={frame};\n"
    other_file += f"  PROC Pick(robtarget p)\n    {IN.format('p', 'wobj1')}\n  ENDPROC\n"
    other_file += f"  PROC Other()\n    {IN.format('p10', 'wobj1')}\n  ENDPROC" if "Move" in statement else ""
    moved = move(
        tmp_path, IN.format("p20", "wobj1") + "\nPick p10;" * ("Pick" in statement), other_file=other_file
    )
    assert moved["points"]["p10"]["status"] == "left"
    assert "only that module sees" in moved["points"]["p10"]["reason"]


WBOX = 'PERS wobjdata wBox:=[FALSE,TRUE,"",[[{},0,300],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];'
TLOC = "LOCAL PERS tooldata tLoc:=[TRUE,[[0,0,{}],[1,0,0,0]],[1,[0,0,10],[1,0,0,0],0,0,0]];"
IN_PROJECT = "[frames.wBox]\nposition_mm = [{}, 0, 300]\n"


@pytest.mark.parametrize(
    "statement",
    [
        "MoveL p10,v100,fine,tLoc\\WObj:=wBox;",
        "Pick p10;",
        "StudL p10,v100,tLoc\\WObj:=wBox;",
        "Give p10,wBox;",
    ],
)
@pytest.mark.parametrize(
    ("here", "project", "status"),
    [
        ("", "", "changed"),
        ("", IN_PROJECT.format(1200), "changed"),
        ("", IN_PROJECT.format(1100), "left"),
        (WBOX.format(1200), "", "changed"),
        (WBOX.format(1100), "", "left"),
        ("LOCAL " + WBOX.format(1100), "", "left"),
        (WBOX.format("GetX()"), "", "left"),
        (TLOC.format(200), "", "changed"),
        (TLOC.format(210), "", "left"),
    ],
)
def test_a_work_object_of_the_moving_module_is_the_one_that_it_declares(
    tmp_path: Path, statement: str, here: str, project: str, status: str
) -> None:
    move_there = "MoveL p,v100,fine,tLoc\\WObj:=wBox;"
    other_file = f"  LOCAL {WBOX.format(1200)}\n  {TLOC.format(200)}\n"
    other_file += (
        f"  PROC Run()\n    {statement}\n  ENDPROC\n  PROC Pick(robtarget p)\n    {move_there}\n  ENDPROC"
    )
    call = "Pick p10;" if statement.startswith("Pick") else ""
    give = "  PROC Give(robtarget p,PERS wobjdata w)\n    MoveL p,v100,fine,tool1\\WObj:=w;\n  ENDPROC"
    moved = move(
        tmp_path,
        IN.format("p20", "wobj1") + call,
        f"{give}\n  {here}",
        other_file=other_file,
        project=project,
    )
    if statement.startswith("Give") and "tLoc" in here:
        status = "changed"  # it goes there with tool1
    assert moved["points"]["p10"]["status"] == status, moved["points"]["p10"]


@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize(
    "statement", ["StudL p10,v100,gun1,tool1\\WObj:={};", "j1:=CalcJointT(p10,tool1\\WObj:={});"]
)
@pytest.mark.parametrize(("frame", "status"), [("wobj2", "left"), ("wobj1", "changed")])
def test_an_instruction_that_is_not_known_names_its_work_object(
    tmp_path: Path, statement: str, elsewhere: bool, frame: str, status: str
) -> None:
    text = statement.format(frame)
    other_file = f"  PROC Run()\n    {text}\n  ENDPROC" if elsewhere else ""
    moved = move(tmp_path, BOTH + text * (not elsewhere), other_file=other_file)
    assert moved["points"]["p10"]["status"] == status


GUN = "PERS tooldata tGun:=[TRUE,[[0,0,300],[1,0,0,0]],[1,[0,0,10],[1,0,0,0],0,0,0]];"


@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize(
    ("call", "declared", "status"),
    [
        ("Grip p10,50\\WObj:=wobj1;", "", "changed"),
        ("Grip p10,nHigh\\WObj:=wobj1;", "PERS num nHigh:=50;", "changed"),
        ("PlaceIt p10\\WObj:=wobj1,tool1;", "", "changed"),
        ("PlaceIt p20,p10\\WObj:=wobj1;", "", "changed"),
        ("Grip p10,50\\WObj:=wobj2;", "", "left"),
        ("PlaceIt p10\\WObj:=wobj2,tool1;", "", "left"),
        ("StudL p10,v100,tGun\\WObj:=wobj1;", GUN, "left"),
        ("StudL p10,v100,tGun\\WObj:=wobj2;", "", "left"),
    ],
)
def test_only_a_tool_before_the_work_object_of_a_call_is_one(
    tmp_path: Path, call: str, declared: str, status: str, elsewhere: bool
) -> None:
    run = f"  PROC Run()\n    {call}\n  ENDPROC"
    moved = move(tmp_path, BOTH + call * (not elsewhere), other_file=declared + "\n" + run * elsewhere)
    assert moved["points"]["p10"]["status"] == status, moved["points"]["p10"]


@pytest.mark.parametrize("local", ["", "LOCAL "])
@pytest.mark.parametrize(
    ("parameters", "call", "status"),
    [
        ("PERS tooldata t", "StudL pOwn,v100,t\\WObj:=wobj1;", "left"),
        ("num h", "Grip pOwn,h\\WObj:=wobj1;", "changed"),
        ("PERS wobjdata w", "Grip pOwn,50\\WObj:=w;", "left"),
        ("", "StudL pOwn,v100,tGun\\WObj:=wobj1;", "left"),
        ("", "StudL pOwn,v100,nGun\\WObj:=wobj1;", "changed"),
    ],
)
def test_a_call_in_a_routine_may_name_its_parameters(
    tmp_path: Path, parameters: str, call: str, status: str, local: str
) -> None:
    own = f"  {local}CONST robtarget pOwn:=[[320,0,300],{REST};\n"
    own += f"  PROC Run({parameters})\n    {call}\n  ENDPROC"
    moved = move(tmp_path, BOTH + IN.format("pOwn", "wobj1"), own, other_file=GUN)
    assert moved["points"]["pOwn"]["status"] == status, moved["points"]["pOwn"]


def test_a_target_that_is_copied_into_a_record_counts_where_that_is_moved_to(tmp_path: Path) -> None:
    moved = move(tmp_path, BOTH + "r1.pos:=p10;\n" + IN.format("r1.pos", "wobj2"))
    assert moved["points"]["p10"]["status"] == "left"
    assert moved["points"]["p20"]["status"] == "changed"


JOINTS = "[[0,20,10,0,40,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
JOINT_MOVE = f"{BOTH}MoveAbsJ j1,v100,fine,tool1;\n"
DECLARED = f"  VAR jointtarget j1:={JOINTS};"


@pytest.mark.parametrize(
    "statement", ["j1:=fHome();", "j1.robax.rax_1:=20;", "ok:=StrToVal(line,j1);", "Add j1.robax.rax_1,5;"]
)
@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_joint_target_that_gets_a_value_is_left_where_joints_move(
    tmp_path: Path, statement: str, elsewhere: bool
) -> None:
    other_file = f"  PROC Run()\n    {statement}\n  ENDPROC" if elsewhere else ""
    body = JOINT_MOVE + statement * (not elsewhere)
    moved = move(tmp_path, body, DECLARED, other_file=other_file, options=("--joints", "move"))
    assert moved["points"]["j1"]["status"] == "left"
    assert moved["points"]["j1"]["reason"] in (OVERWRITTEN, PART)


def test_it_stays_as_any_other_where_joints_are_kept(tmp_path: Path) -> None:
    moved = move(tmp_path, JOINT_MOVE + "j1:=fHome();", DECLARED, options=("--joints", "keep"))
    assert moved["points"]["j1"]["status"] == "unchanged"
    assert moved["code"] == ExitCode.PASS


@pytest.mark.parametrize(
    ("statement", "tool"),
    [
        ("MoveAbsJ j1,v100,fine,tool1;", "tool1"),
        ("MoveAbsJ j1,v100,fine,tool1;\nMoveAbsJ j1,v100,fine,tool0;", None),
        ("MoveAbsJ j1,v100,fine,tool1;\ntool1.tframe.trans.z:=70;", None),
    ],
)
def test_a_joint_target_has_the_tool_of_its_moves(statement: str, tool: str | None) -> None:
    text = MODULE.format(statement, DECLARED)
    positions = AbbFile.from_bytes("M1.mod", text.encode("ascii")).positions
    assert positions.tools[positions.names.index("j1")] == tool
