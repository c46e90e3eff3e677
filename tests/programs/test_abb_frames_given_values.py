"""Whatever gives a RAPID tool, work object or target a value leaves the points: only what is known to read is allowed."""

from pathlib import Path

import pytest

from tests.programs import test_abb_frames_in_numbers as rapid
from tests.programs.test_across_files import TARGET, WORK_OBJECT, rapid_module, read_programs

WORK = WORK_OBJECT.format("FALSE")
POINT = f"CONST robtarget p1:={TARGET};"
MOVE = "MoveL p1,v100,z10,tool0\\WObj:=w1;"


@pytest.mark.parametrize(
    ("line", "left"),
    [
        ("w1.robhold:=TRUE;", True),
        ("w1.ufprog:=FALSE;", True),
        ('w1.ufmec:="STN1";', True),
        ("Incr w1.uframe.trans.x;", True),
        ("GetSysData w1;", True),
        ("ReadVarArr x,w1;", True),
        ('CamGetParameter c,"x"\\NumVar:=w1.oframe.trans.x;', True),
        ("SetDataVal name,w2;", True),
        ("SetDataVal name,5;", False),
        ("SetDataVal name,count;", False),
        ("SetDataVal name,p9;", True),
        ('SetAllDataVal "wobjdata",w2;', True),
        ('SetAllDataVal "robtarget",p9;', True),
        ('SetAllDataVal "num",0;', False),
        ("b:=Find(w1);", True),
        ("b:=Find(1,p1);", True),
        ("b:=Find(Reach(tool0\\WObj:=w1),w1);", True),
        ("b:=known(w1);", False),
        ("a:=Offs(p1,0,0,5);", False),
        ("WriteAnyBin dev,p1;", False),
        ("SetSysData w1;", False),
    ],
)
@pytest.mark.parametrize("elsewhere", [False, True])
def test_what_may_give_a_value_leaves_the_point(
    tmp_path: Path, line: str, left: bool, elsewhere: bool
) -> None:
    routine = (
        f"VAR num count;\nPROC n1()\n{line}\nENDPROC\nFUNC bool known(wobjdata w)\nRETURN TRUE;\nENDFUNC"
    )
    own = f"PROC r()\n{MOVE}\nENDPROC"
    lines = [WORK, POINT, own] if elsewhere else [WORK, POINT, own, routine]
    files = {"m.mod": rapid_module("m", *lines)}
    if elsewhere:
        files["n.mod"] = rapid_module("n", routine)
    positions = read_programs(tmp_path, files)["m.mod"].positions
    row = positions.names.index("p1")
    assert (row in positions.barred) is left
    assert positions.user_frames[row] == "w1"


@pytest.mark.parametrize(
    "line",
    [
        "Frame1.robhold:=TRUE;",
        "Frame1.ufprog:=FALSE;",
        "ReadVarArr x,Frame1;",
        "b:=Find(Frame1);",
        "GetSysData rdkTool;",
    ],
)
def test_another_module_may_give_what_stands_in_numbers_a_value(tmp_path: Path, line: str) -> None:
    own = rapid.module_of(*rapid.BEGIN, rapid.MOVE, kind="PERS")
    own = own.replace("LOCAL PERS tooldata", "PERS tooldata")
    files = {"m.mod": own, "n.mod": rapid_module("n", f"PROC n1()\n{line}\nENDPROC")}
    assert read_programs(tmp_path, files)["m.mod"].positions.barred


@pytest.mark.parametrize("line", ["a{vs()}:=3;", "a{1,1+vs()}.x:=3;"])
def test_a_function_in_an_index_may_set_another_frame(line: str) -> None:
    function = f"FUNC num vs()\n{rapid.SET_2}\nRETURN 1;\nENDFUNC"
    assert rapid.places(rapid.read(*rapid.BEGIN, line, rapid.MOVE, routines=function)) == [None]


@pytest.mark.parametrize("open_sign", ["a{", "a{b:="])
def test_indices_that_do_not_end_are_read_in_one_pass(open_sign: str) -> None:
    lines = [*rapid.BEGIN, open_sign * 40_000]
    assert rapid.read(*lines).positions.names == ()  # the square of the length would take minutes
