"""Backups of controllers with several tasks: where two of them move, they may move two robots."""

import json
from pathlib import Path

import pytest

from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_abb_passed_targets import PROJECT, REST

MOVING = """MODULE {name}
  PERS tooldata tool1:=[TRUE,[[0,0,200],[1,0,0,0]],[1,[0,0,10],[1,0,0,0],0,0,0]];
  CONST robtarget {name}p:=[[1500,80,600],{rest};
  PROC {name}Main()
    MoveL {name}p,v100,fine,tool1;
  ENDPROC
ENDMODULE
"""
STILL = "MODULE Comm\n  PERS num nState:=1;\nENDMODULE\n"


def move_backup(tmp_path: Path, files: dict[str, str]) -> tuple[int, list[str]]:
    for name, text in files.items():
        place = tmp_path / "backup" / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text, encoding="ascii")
    (tmp_path / "project.toml").write_text(PROJECT, encoding="utf-8")
    words = ["program", "move", tmp_path / "backup", "--project", tmp_path / "project.toml"]
    words += ["--offset=0,0,0,0,0,5", "--out", tmp_path / "out", "--json", tmp_path / "r.json"]
    code = run_command_line([str(word) for word in words])
    programs = json.loads((tmp_path / "r.json").read_text())["programs"]
    return code, [point["reason"] for program in programs for point in program["points"]]


@pytest.mark.parametrize(
    ("first", "second"),
    [("RAPID/TASK1/PROGMOD", "RAPID/TASK2/PROGMOD"), ("T_ROB1", "T_ROB2"), ("T_ROB_L/a", "T_ROB_R/a")],
)
def test_two_tasks_that_move_may_be_two_robots(tmp_path: Path, first: str, second: str) -> None:
    files = {
        f"{first}/A.mod": MOVING.format(name="A", rest=REST.replace("-1", "0")),
        f"{second}/B.mod": MOVING.format(name="B", rest=REST.replace("-1", "0")),
    }
    code, reasons = move_backup(tmp_path, files)
    assert code == ExitCode.REFUSED
    assert len(reasons) == 2
    assert all("moves, too, and may be another robot" in reason for reason in reasons)


def test_a_task_that_does_not_move_is_no_robot(tmp_path: Path) -> None:
    files = {
        "RAPID/TASK1/A.mod": MOVING.format(name="A", rest=REST.replace("-1", "0")),
        "RAPID/TASK1/B.mod": MOVING.format(name="B", rest=REST.replace("-1", "0")),
        "RAPID/TASK2/Comm.mod": STILL,
    }
    code, reasons = move_backup(tmp_path, files)
    assert not any("robot" in reason for reason in reasons)
    assert code == ExitCode.PASS, reasons


COMPUTING = f"""MODULE Comm
  PERS robtarget pNow:=[[300,0,300],{REST};
  PERS jointtarget jNow:=[[0,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PROC commMain()
    pNow:=CRobT(\\TaskName:="T_ROB1"\\Tool:=tool0\\WObj:=wobj0);
    jNow:=CalcJointT(pNow,tool0);
    {{}}
  ENDPROC
ENDMODULE
"""


@pytest.mark.parametrize(("statement", "moves"), [("", False), ("MoveAbsJ jNow,v100,fine,tool0;", True)])
def test_a_task_that_only_computes_places_is_no_robot(tmp_path: Path, statement: str, moves: bool) -> None:
    files = {
        "RAPID/TASK1/A.mod": MOVING.format(name="A", rest=REST.replace("-1", "0")),
        "RAPID/TASK2/Comm.mod": COMPUTING.format(statement),
    }
    _, reasons = move_backup(tmp_path, files)
    assert any("moves, too, and may be another robot" in reason for reason in reasons) == moves, reasons
