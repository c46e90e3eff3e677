"""RAPID data of one name in two tasks of a controller: they share what is PERS, whichever of them was loaded."""

from pathlib import Path

import pytest

from tests.programs.test_across_files import TARGET, WORK_OBJECT, rapid_module, read_programs

WORK = WORK_OBJECT.format("FALSE")
UNLIKE = WORK.replace("[0,0,0],[1", "[9,9,9],[1", 1)
MOVE = "PROC main()\nMoveL p1,v100,z10,tool0\\WObj:=w1;\nENDPROC"
POINT = f"PERS robtarget p1:={TARGET};"
STILL = "PROC main()\nWaitTime 1;\nENDPROC"


def is_left(folder: Path, first: str, other: str, places: tuple[str, str] = ("T_ROB1", "T_BCK")) -> bool:
    """Return whether the target of the task that moves is left beside a task that does not."""
    name = f"{places[0]}/m.mod"
    files = {name: rapid_module("m", first, MOVE), f"{places[1]}/b.mod": rapid_module("b", other, STILL)}
    return 0 in read_programs(folder, files)[name].positions.barred


TASKS = [("T_ROB1", "T_BCK"), ("RAPID/TASK1/PROGMOD", "RAPID/TASK2/SYSMOD"), ("T_ROB1/a", "T_ROB2")]
CONST = POINT.replace("PERS", "CONST")


@pytest.mark.parametrize("places", TASKS)
@pytest.mark.parametrize(
    ("declared", "left"),
    [
        (UNLIKE, True),
        (WORK, False),
        (WORK.replace("[0,0,0]", "[0.0, +0,0 ]").replace("PERS", "pers "), False),
        (f"TASK {UNLIKE}", False),
        (f"LOCAL {UNLIKE}", False),
        (f"! {UNLIKE}", False),
        (UNLIKE.replace("PERS", "CONST"), False),
        ("PERS wobjdata w1;", False),
        ("PROC go(PERS wobjdata w1)\nENDPROC", False),
    ],
)
def test_a_work_object_that_two_tasks_declare(
    tmp_path: Path, declared: str, left: bool, places: tuple[str, str]
) -> None:
    assert is_left(tmp_path, f"{WORK}\n{CONST}", declared, places) is left


def test_a_work_object_that_the_task_of_the_moves_hides(tmp_path: Path) -> None:
    assert not is_left(tmp_path, f"LOCAL {WORK}\n{CONST}", UNLIKE)


@pytest.mark.parametrize(
    ("declared", "other", "left"),
    [
        (POINT, POINT, True),
        (POINT, POINT.replace("[[1,", "[[2,"), True),
        (POINT, "PERS robtarget p1;", True),
        (POINT, CONST, False),
        (POINT, f"TASK {POINT}", False),
        (f"LOCAL {POINT}", POINT, False),
        (CONST, POINT, False),
    ],
)
def test_a_target_that_two_tasks_share(tmp_path: Path, declared: str, other: str, left: bool) -> None:
    assert is_left(tmp_path, f"{WORK}\n{declared}", other) is left


@pytest.mark.parametrize("places", [("a/T_ROB1", "b/T_ROB1"), ("a/TASK1", "b/TASK2"), ("T_ROB1", "T_ROB1/x")])
def test_other_controllers_and_the_same_task_share_nothing(tmp_path: Path, places: tuple[str, str]) -> None:
    assert not is_left(tmp_path, f"{WORK}\n{POINT}", "PERS wobjdata w2;", places)
    if places[0] != "T_ROB1":
        assert not is_left(tmp_path, f"{WORK}\n{POINT}", f"{UNLIKE}\n{POINT}", places)
