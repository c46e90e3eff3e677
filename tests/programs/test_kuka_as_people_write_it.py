"""KRL as the inline forms of present controllers and people write it: what moves, and what is named."""

import json
from pathlib import Path
from typing import Any

import pytest

from cellcal.drivers.kuka.program_files.lines import without_field_names
from cellcal.drivers.program_registry import read_program
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_field_cases import CASES

SHIFTED = "10,-5,3,0,0,0"
INI = """GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
INTERRUPT ON 3
BAS (#INITMOV,0 )
"""
FORM = """;FOLD LIN P{n} Vel=2 m/s CPDAT{n} Tool[2]:gripper Base[2] ;%{{PE}}
;FOLD Parameters ;%{{h}}
;Params IlfProvider=kukaroboter.basistech.inlineforms.movement.old; Kuka.PointName=P{n}
;ENDFOLD
$BWDSTART = FALSE
LDAT_ACT = LCPDAT{n}
FDAT_ACT = FP{n}
BAS(#CP_PARAMS, 2.0)
{between}
LIN XP{n}
;ENDFOLD
"""
POINT = """DECL E6POS XP{n}={{X {x},Y 30,Z 250,A 0,B 90,C 0,S 2,T 2}}
DECL FDAT FP{n}={{TOOL_NO 2,BASE_NO 2,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}}
"""


def move_module(
    folder: Path, body: str, points: int = 0, offset: str = SHIFTED
) -> tuple[int, dict[str, Any]]:
    """Move a module of a program and its data list; return the exit code and the report."""
    (folder / "work.src").write_text(f"DEF work( )\n{INI}{body}END\n")
    data = "".join(POINT.format(n=n, x=90 + 10 * n) for n in range(1, points + 1))
    (folder / "work.dat").write_text(f"DEFDAT WORK\n{data}ENDDAT\n")
    report = folder / "report.json"
    words = [folder / "work.src", folder / "work.dat", "--project", CASES / "kuka" / "project.toml"]
    code = run_command_line(
        ["program", "move", *map(str, words), "--offset", offset, "--out", str(folder / "out"),
         "--json", str(report)]
    )  # fmt: skip
    found = json.loads(report.read_text())
    points_by_name = {one["point"]: one for each in found["programs"] for one in each["points"]}
    return code, {
        "points": points_by_name,
        "findings": [(one["line"], one["point"]) for each in found["programs"] for one in each["findings"]],
    }


@pytest.mark.parametrize("between", ["SET_CD_PARAMS (0)", "ArcMainNG(#ArcOnBeforeMoveStd, WDAT1, WP1)"])
def test_calls_of_an_inline_form_leave_its_frame_data_in_force(tmp_path: Path, between: str) -> None:
    body = "".join(FORM.format(n=n, between=between) for n in (1, 2))
    code, found = move_module(tmp_path, body, points=2)
    assert code == ExitCode.PASS
    assert [one["status"] for one in found["points"].values()] == ["changed"] * 2


def test_a_call_of_a_persons_routine_leaves_them_open(tmp_path: Path) -> None:
    code, found = move_module(tmp_path, FORM.format(n=1, between="MY_PARAMS (0)"), points=1)
    assert code == ExitCode.REFUSED
    assert found["points"]["XP1"]["status"] == "left"


def test_components_behind_the_operator_are_no_places(tmp_path: Path) -> None:
    body = FORM.format(n=1, between="SET_CD_PARAMS (0)") + "LIN XP1:{X 0,Y 0,Z -40,A 0,B 0,C 0}\n"
    code, found = move_module(tmp_path, body, points=1)
    assert code == ExitCode.PASS
    assert not found["findings"]


def test_names_of_components_are_blank_and_their_values_stay() -> None:
    code = "XP1:{FRAME: X 5,Y dy,POINT2[] other,Z (a+b)},XP2"
    hidden = without_field_names(code)
    assert len(hidden) == len(code)
    assert hidden.split() == ["XP1:{", "5,", "dy,", "other,", "(a+b)},XP2"]
    assert without_field_names("CIRC XP1,XP2") == "CIRC XP1,XP2"


def test_bases_set_one_after_the_other_behind_the_ini_fold_are_distinguished() -> None:
    line = "LIN {{X {},Y 20,Z 130,A 0,B 180,C 0}}\n"
    body = f"{INI}BAS(#TOOL,1)\nBAS(#BASE,1)\n{line.format(10)}BAS(#BASE,2)\n{line.format(11)}"
    found = read_program("k.src", f"DEF k()\n{body}END\n".encode()).positions
    assert found.user_frames == ("1", "2")
    assert found.barred == {}


def test_a_reset_behind_a_base_leaves_what_follows_open() -> None:
    line = "LIN {X 10,Y 20,Z 130,A 0,B 180,C 0}\n"
    body = f"BAS(#TOOL,1)\nBAS(#BASE,1)\n{line}{INI}{line}"
    found = read_program("k.src", f"DEF k()\n{body}END\n".encode()).positions
    assert found.user_frames == ("1", None)
    assert sorted(found.barred) == [1]


def test_a_field_of_another_type_costs_its_own_point_alone(tmp_path: Path) -> None:
    """RoboDK writes external axes into an AXIS."""
    body = FORM.format(n=1, between="") + "PTP {AXIS: A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0,E1 100}\n"
    code, report = move_module(tmp_path, body, points=1)
    (by_axes,) = (point for name, point in report["points"].items() if name.startswith("PTP@"))
    assert code == ExitCode.REFUSED
    assert "not understood" in by_axes["reason"]
    assert report["points"]["XP1"]["status"] == "changed"
