"""RAPID work objects and tools that are passed to a routine which is in no given file, and may set them."""

from pathlib import Path

import pytest

from tests.programs.test_across_files import TARGET, WORK_OBJECT, rapid_module, read_programs

WORK = WORK_OBJECT.format("FALSE")
TOOL = "PERS tooldata t1:=[TRUE,[[0,0,60],[1,0,0,0]],[1,[0,0,50],[1,0,0,0],0,0,0]];"
POINT = f"CONST robtarget p1:={TARGET};\nVAR robtarget p2;\nVAR robtarget p3;"
MAIN = "PROC main()\n{}\nMoveL p1,v100,z10,t1\\WObj:=w1;\nENDPROC"


def is_left(folder: Path, statement: str, *own: str, **others: str) -> bool:
    """Return whether the target of a move behind a statement is left."""
    files = {f"{name}.mod": rapid_module(name, text) for name, text in others.items()}
    files["m.mod"] = rapid_module("m", WORK, TOOL, POINT, MAIN.format(statement), *own)
    return 0 in read_programs(folder, files)["m.mod"].positions.barred


@pytest.mark.parametrize(
    ("statement", "left"),
    [
        ("Survey w1;", True),
        ("survey W1;", True),
        ("Survey 1,w1;", True),
        ('Survey "a",w1;', True),
        ("Survey -1,w1;", True),
        ("Survey [1,2],w1;", True),
        ("Survey\\Frame:=w1;", True),
        ("Survey w1.oframe;", True),
        ("Survey w1.uframe.trans.x;", True),
        ("IF di1=1 THEN Survey w1; ENDIF", True),
        ("IF di1=1 Survey w1;", True),
        ("IF bOk Survey w1;", True),
        ("IF a>-1 AND bOk Survey\\Frame:=w1;", True),
        ('IF w1.robhold AND bOk TPWrite "";', False),
        ("ok:=Survey(w1);", True),
        ("IF Survey(1,w1) Stop;", True),
        ("WHILE NOT Survey(w1) DO ENDWHILE", True),
        ("%stName% w1;", True),
        ("Survey t1;", True),
        ("Survey t1.tframe;", True),
        ("Survey\\WObj:=w1;", True),
        ("GetSysData t1;", True),
        ("Survey t1.tload;", False),
        ("Survey p2;", False),
        ("Survey w2;", False),
        ("Survey NumToStr(w1.uframe.trans.x,1);", False),
        ("! Survey w1;", False),
        ('TPWrite "Survey w1;";', False),
        ("TPWrite ValToStr(w1);", False),
        ("p2:=CRobT(\\Tool:=t1\\WObj:=w1);", False),
        ("p2:=CalcRobT(j1,t1\\WObj:=w1);", False),
        ("ps:=PoseInv(w1.uframe);", False),
        ("SetSysData w1;", False),
        ("WaitWObj w1;", False),
        ("GripLoad t1.tload;", False),
        ("GlueL p1,v100,z10,t1\\WObj:=w1;", False),
        ("MoveJ p1,v100,z10,t1\\WObj:=w1;", False),
    ],
)
def test_what_a_routine_gets_that_was_not_given(tmp_path: Path, statement: str, left: bool) -> None:
    assert is_left(tmp_path, statement) is left


READS = "PROC Survey(PERS wobjdata w)\nTPWrite ValToStr(w);\nENDPROC"
ASKS = "FUNC bool Asks(PERS wobjdata w)\n{}\nRETURN TRUE;\nENDFUNC"
ON = "PROC Survey(PERS wobjdata w)\nFurther w;\nENDPROC"


@pytest.mark.parametrize(
    ("statement", "routine", "left"),
    [
        ("Survey w1;", READS, False),
        ("Survey w1;", ON, True),
        ("Survey w1;", ON.replace("PERS ", ""), False),
        ("Survey w1;", f"{ON}\nPROC Further(PERS wobjdata w)\nENDPROC", False),
        ("ok:=Asks(w1);", ASKS.format(""), False),
        ("ok:=Asks(w1);", ASKS.format("w.uframe.trans.x:=5;"), True),
        ("IF Asks(w1) Stop;", ASKS.format("Further w;"), True),
    ],
)
def test_routines_that_were_given_are_looked_at(
    tmp_path: Path, statement: str, routine: str, left: bool
) -> None:
    assert is_left(tmp_path / "own", statement, routine) is left
    assert is_left(tmp_path / "other", statement, n=routine) is left


def test_a_call_of_another_module_counts(tmp_path: Path) -> None:
    assert is_left(tmp_path, "", n="PROC q()\nSurvey w1;\nENDPROC")


def test_a_work_object_that_is_set_to_numbers_before(tmp_path: Path) -> None:
    assert is_left(tmp_path, "w1.uframe:=[[1,2,3],[1,0,0,0]];\nSurvey w1;")
    assert is_left(tmp_path, "w1.uframe:=[[1,2,3],[1,0,0,0]];", n="PROC q()\nSurvey w1;\nENDPROC")
