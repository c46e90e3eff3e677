"""RAPID data that are set by name, hidden by others of their name, passed with a parameter's name, or copied elsewhere."""

from pathlib import Path

import pytest

from tests.programs.test_across_files import TARGET, WORK_OBJECT, rapid_module, read_programs

WORK = WORK_OBJECT.format("FALSE")
OTHER = WORK_OBJECT.replace("w1", "w2").format("FALSE")
MAIN = "PROC main()\nMoveL {},v100,z10,tool0\\WObj:={};\n{}\nENDPROC"
GO = "PROC go(robtarget p)\nMoveL p,v100,z10,tool0\\WObj:=w2;\nENDPROC"
SHARED = f"CONST robtarget p1:={TARGET};"


def is_left(folder: Path, *own: str, **others: str) -> bool:
    """Return whether the first target of a module is left."""
    modules = {f"{name}.mod": rapid_module(name, text) for name, text in others.items()}
    files = {
        "cell.mod": rapid_module("cell", WORK, OTHER),
        "m.mod": rapid_module("m", SHARED, *own),
        **modules,
    }
    return 0 in read_programs(folder, files)["m.mod"].positions.barred


@pytest.mark.parametrize(
    ("call", "left"),
    [
        ("go p:=p1;", True),
        ("go p := p1;", True),
        ("MoveL ToPoint:=p1,Speed:=v100,Zone:=z10,Tool:=tool0\\WObj:=w2;", True),
        ("MoveL ToPoint:=p1,Speed:=v100,Zone:=z10,Tool:=tool0\\WObj:=w1;", False),
        ("wait t:=p1;", False),
    ],
)
def test_arguments_with_the_name_of_their_parameter(tmp_path: Path, call: str, left: bool) -> None:
    routines = f"{GO}\nPROC wait(robtarget t)\nENDPROC"
    assert is_left(tmp_path / "own", MAIN.format("p1", "w1", call), routines) is left
    assert is_left(tmp_path / "other", MAIN.format("p1", "w1", call), n=routines) is left


@pytest.mark.parametrize("part", ["robhold:=TRUE", "ufprog:=FALSE", 'ufmec:="STN_1"', "uframe.trans.x:=1"])
def test_every_component_of_a_work_object_that_another_module_sets(tmp_path: Path, part: str) -> None:
    assert is_left(tmp_path, MAIN.format("p1", "w1", ""), n=f"PROC q()\nw1.{part};\nENDPROC")


@pytest.mark.parametrize(
    ("line", "left"),
    [
        ('SetDataVal "w"+NumToStr(1,0),wNew;', True),
        ("SetDataVal stName\\Block:=bk,wNew;", True),
        ("SetDataVal stName,unknown;", True),
        ('SetAllDataVal "wobjdata",wNew;', True),
        ("SetAllDataVal stType,wNew;", True),
        ('SetAllDataVal "num",nNew;', False),
        ("SetDataVal stName\\Block:=bk,nNew;", False),
        ("SetDataVal stName,TRUE;", False),
        ('TPWrite "SetDataVal";', False),
        ("! SetDataVal stName,wNew;", False),
    ],
)
def test_data_that_are_set_by_a_computed_name(tmp_path: Path, line: str, left: bool) -> None:
    other = f"VAR num nNew;\nPERS wobjdata wNew;\nPROC q()\n{line}\nENDPROC"
    assert is_left(tmp_path, MAIN.format("p1", "w1", ""), n=other) is left


@pytest.mark.parametrize("line", ["CONST robtarget p9:=p1;", "VAR robtarget p9;"])
@pytest.mark.parametrize(("frame", "left"), [("w2", True), ("w1", False)])
def test_a_copy_that_another_module_moves_to(tmp_path: Path, line: str, frame: str, left: bool) -> None:
    copy = "" if ":=" in line else "p9:=p1;\n"
    other = f"{line}\nPROC q()\n{copy}MoveL p9,v100,z10,tool0\\WObj:={frame};\nENDPROC"
    assert is_left(tmp_path, MAIN.format("p1", "w1", ""), n=other) is left


HIDING = WORK.replace("[0,0,0],[1", "[9,9,9],[1", 1)


def test_a_work_object_of_one_module_that_hides_that_of_another(tmp_path: Path) -> None:
    own, other = MAIN.format("p1", "w1", ""), "PROC q()\nMoveL p1,v100,z10,tool0\\WObj:=w1;\nENDPROC"
    assert is_left(tmp_path / "both", f"LOCAL {HIDING}", own, n=other)
    assert not is_left(tmp_path / "alone", f"LOCAL {HIDING}", own)


def test_a_work_object_of_a_routine_that_hides_that_of_all(tmp_path: Path) -> None:
    move = "MoveL p1,v100,z10,tool0\\WObj:=w1;"
    hiding = f"PROC q()\n{HIDING.replace('PERS', 'VAR')}\n{move}\nENDPROC"
    assert is_left(tmp_path, MAIN.format("p1", "w1", ""), hiding)


FUNCTION = "FUNC robtarget f(robtarget p)\nRETURN {};\nENDFUNC"


@pytest.mark.parametrize(
    ("target", "returned", "frame", "left"),
    [
        ("f(p1)", "p", "w2", True),
        ("f(p1)", "p", "w1", False),
        ("f(p2)", "p1", "w2", True),
        ("f(p2)", "p1", "w1", False),
        ("unknown(1,p1)", "p", "w2", True),
        ("(p1)", "p", "w2", True),
        ("(p1)", "p", "w1", False),
        ("f(p2)", "p", "w2", False),
    ],
)
def test_targets_that_functions_make_of_others(
    tmp_path: Path, target: str, returned: str, frame: str, left: bool
) -> None:
    more = f"CONST robtarget p2:={TARGET};"
    move = f"MoveL {target},v100,z10,tool0\\WObj:={frame};"
    assert is_left(tmp_path, more, MAIN.format("p1", "w1", move), FUNCTION.format(returned)) is left


GLOBAL = "{}FUNC robtarget f()\nRETURN {};\nENDFUNC"


@pytest.mark.parametrize("hidden", ["", "LOCAL "])
@pytest.mark.parametrize(
    ("returned", "frame", "left"), [("p1", "w2", True), ("p1", "w1", False), ("p2", "w2", False)]
)
@pytest.mark.parametrize(
    "move", ["MoveL f(),v100,z10,tool0\\WObj:={};", "p9:=f();\nMoveL p9,v100,z10,tool0\\WObj:={};"]
)
def test_a_target_that_a_function_of_another_module_returns(
    tmp_path: Path, move: str, returned: str, frame: str, left: bool, hidden: str
) -> None:
    function = GLOBAL.format(hidden, returned)
    more = f"VAR robtarget p9;\nCONST robtarget p2:={TARGET};"
    main = MAIN.format("p1", "w1", move.format(frame))
    assert is_left(tmp_path / "other", more, main, n=function) is (left and not hidden)
    assert is_left(tmp_path / "own", more, main, function) is left


def test_a_function_that_is_not_given_names_no_absent_place(tmp_path: Path) -> None:
    main = MAIN.format("p1", "w1", "MoveL f(),v100,z10,tool0\\WObj:=w2;")
    files = {"cell.mod": rapid_module("cell", WORK, OTHER), "m.mod": rapid_module("m", SHARED, main)}
    found = read_programs(tmp_path, files)["m.mod"].positions
    assert not [shift for shift in found.shifts if "result" in shift.what]
