"""RAPID places whose numbers stand elsewhere: in constants, in what a parameter or an array's element is given."""

import pytest

from cellcal.drivers.programs.positions import CARTESIAN, UNREAD
from tests.programs.test_abb_as_people_write_it import E, declaration_lines, read_module

PARTS = ("CONST pos t0:=[50,30,150];", "CONST orient o0:=[0,0,1,0];", "CONST num zTop:=150;")
CONF = f"[0,0,0,0],{E}"


def move(name: str) -> str:
    return f"MoveL {name},v100,fine,tGrip\\WObj:=wTable;"


@pytest.mark.parametrize(
    "value",
    [
        f"[t0,o0,{CONF}]",
        f"[t0,[0,0,1,0],{CONF}]",
        f"[[50,30,zTop],[0,0,1,0],{CONF}]",
        "[t0,o0,cNormal,eNone]",
    ],
)
@pytest.mark.parametrize("kind", ["CONST", "PERS", "VAR"])
def test_a_target_of_constants_is_left_and_named(kind: str, value: str) -> None:
    file = read_module(*PARTS, f"{kind} robtarget p1:={value};", "PROC main()", move("p1"), "ENDPROC")
    assert file.positions.names == ("p1",)
    assert file.positions.kinds == (UNREAD,)
    assert "computed in part" in file.positions.barred[0]


def test_an_element_of_constants_is_left_and_the_next_one_is_read() -> None:
    array = f"CONST robtarget pAll{{2}}:=[[t0,o0,{CONF}],[[1,2,3],[1,0,0,0],{CONF}]];"
    file = read_module(*PARTS, array, "PROC main()", move("pAll{n}"), "ENDPROC")
    assert dict(zip(file.positions.names, file.positions.kinds, strict=True)) == {
        "pAll{1}": UNREAD,
        "pAll{2}": CARTESIAN,
    }
    assert sorted(file.positions.barred) == [0]


@pytest.mark.parametrize(
    ("value", "is_finding"),
    [
        (f"[t0,o0,{CONF}]", True),
        ("[t0,{}.rot,{}.robconf,{}.extax]", True),
        ("fPlace(3)", True),
        ("p2", False),
        ("Offs({},0,0,0)", False),
        ("CRobT(\\Tool:=tGrip\\WObj:=wTable)", False),
    ],
)
@pytest.mark.parametrize("name", ["p", "pAll{1}"])
def test_a_value_that_a_parameter_or_an_element_gets_is_a_finding(
    name: str, value: str, is_finding: bool
) -> None:
    body = (f"{name}:={value.replace('{}', name)};", move(name))
    file = read_module(
        *PARTS, *declaration_lines("p1", "p2"), "VAR robtarget pAll{2};",
        "PROC main()", "pick p1;", move("p1"), move("p2"), "ENDPROC", "PROC pick(robtarget p)", *body, "ENDPROC",
    )  # fmt: skip
    sets = [one for one in file.positions.shifts if one.sets]
    assert [(one.point, one.rows, one.user_frame) for one in sets] == [(name, (), "wTable")] * is_finding


def test_values_that_no_move_goes_to_are_no_findings() -> None:
    file = read_module(
        "VAR robtarget pAll{2};", "PROC main(num n,robtarget p)", "n:=n+1;", "pAll{1}:=fPlace(3);", "p:=fPlace(3);", "ENDPROC"
    )  # fmt: skip
    assert file.positions.shifts == ()


def test_joints_of_a_target_follow_it() -> None:
    body = ("jAll{1}:=CalcJointT(p1,tGrip\\WObj:=wTable);", "MoveAbsJ jAll{1},v100,fine,tGrip;", move("p1"))
    file = read_module(*declaration_lines("p1"), "VAR jointtarget jAll{2};", "PROC main()", *body, "ENDPROC")
    assert file.positions.shifts == ()
