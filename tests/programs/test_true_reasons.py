"""Why a RAPID or KRL point is left is true: it says what the program does with it, and nothing that it does not."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.geometry import exp_twist
from cellcal.drivers.program_registry import brand_named, read_program
from cellcal.service.engineering.programs.move import move_transfer
from cellcal.service.engineering.programs.project import read_project
from cellcal.service.engineering.programs.result import ProgramResult

HEAD = (
    "MODULE m\n"
    "  PERS tooldata tGrip:=[TRUE,[[0,0,50],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
    "  CONST robtarget q1:={};\n  CONST robtarget q2:={};\n"
).format(*[f"[[3{k}0,50,130],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]" for k in (2, 3)])
VALUE = "[[335,50,130],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
MOVE = "MoveL {},v100,fine,tGrip;\n"
TURN = exp_twist(np.array([0.01, 0.0, 0.0, 0.0, 0.0, np.deg2rad(5.0)]))


def moved(tmp_path: Path, name: str, text: str, model: str = "abb_irb120") -> ProgramResult:
    file = tmp_path / "project.toml"
    file.write_text(
        f'format = 1\nname = "cell"\n[robot]\nserial = "A1"\nmodel = "{model}"\nsmallest_sigma = 0.001\n',
        encoding="utf-8",
    )
    cell = read_project(file)
    program = read_program(name, text.encode())
    return move_transfer(cell, TURN, brand_named(program.brand).configurations).transfer_programs([program])[
        0
    ]


def rapid(tmp_path: Path, declared: str, body: str) -> ProgramResult:
    text = f"{HEAD}{declared}\n  PROC main()\n{body}  ENDPROC\nENDMODULE\n"
    return moved(tmp_path, "m.mod", text)


def reasons(result: ProgramResult) -> dict[str, str]:
    names = result.before.positions.names
    return {names[row]: str(why) for row, why in enumerate(result.reason) if why}


def remarks(result: ProgramResult) -> str:
    return " ".join(result.warnings)


def test_a_value_that_is_assigned_to_a_declared_target_moves_with_it(tmp_path: Path) -> None:
    result = rapid(tmp_path, f"  VAR robtarget p1:={VALUE};", f"p1 := {VALUE};\n" + MOVE.format("p1"))
    assert reasons(result).keys() <= {"q1", "q2"}  # no move goes to these
    assert "not read" not in remarks(result)


def test_one_that_gets_its_value_later_is_not_called_untaught(tmp_path: Path) -> None:
    for value in (VALUE, "q1", "CRobT()"):
        found_reasons = reasons(
            rapid(tmp_path, "  VAR robtarget p1;", f"p1 := {value};\n" + MOVE.format("p1"))
        )
        assert found_reasons["p1"] == "it gets its coordinates while the program runs"
    untouched = reasons(rapid(tmp_path, "  VAR robtarget p1;", MOVE.format("p1")))
    assert untouched["p1"] == "it has no coordinates"


def test_one_of_a_name_that_is_declared_elsewhere_says_so(tmp_path: Path) -> None:
    found_reasons = reasons(rapid(tmp_path, "", f"p1 := {VALUE};\n" + MOVE.format("p1")))
    (why,) = [why for name, why in found_reasons.items() if name.startswith("p1")]
    assert "a name that this file does not declare" in why


def test_a_copy_is_not_said_to_be_unread(tmp_path: Path) -> None:
    result = rapid(tmp_path, f"  VAR robtarget p1:={VALUE};", "p1 := q1;\n" + MOVE.format("p1"))
    assert "p1 is set to another target while the program runs." in remarks(result)
    assert "that value is not read" not in remarks(result)


def test_a_target_that_a_displacement_is_taken_from_says_so(tmp_path: Path) -> None:
    body = "PDispOn q2,tGrip;\n" + MOVE.format("q1") + "PDispOff;\n"
    assert "a displacement is taken from it (PDispOn)" in reasons(rapid(tmp_path, "", body))["q2"]
    both = body + MOVE.format("q2")
    assert "q2" not in reasons(rapid(tmp_path, "", both))


@pytest.mark.parametrize("part", ["r.trans := [1,2,3];", "r.trans.x := 300;", "r.rot := [1,0,0,0];"])
def test_a_component_that_is_set_is_no_shift(tmp_path: Path, part: str) -> None:
    for declared in ("", "  VAR robtarget r;", f"  VAR robtarget r:={VALUE};"):
        result = rapid(tmp_path, declared, part + "\n" + MOVE.format("r"))
        texts = [finding.text for finding in result.findings if "r." in finding.text]
        assert not [text for text in texts if "shifts" in text], declared
        assert texts or "r" in reasons(result), declared
        assert all("sets a part of r" in text for text in texts)


def test_a_component_that_is_added_to_is_a_shift(tmp_path: Path) -> None:
    result = rapid(
        tmp_path, f"  VAR robtarget r:={VALUE};", "r.trans.x := r.trans.x + 20;\n" + MOVE.format("r")
    )
    assert any("shifts r" in finding.text for finding in result.findings)


def test_a_frame_that_the_program_moves_to_is_said_to_be_set(tmp_path: Path) -> None:
    text = "DEF k()\nDECL FRAME P1\nP1={X 400,Y 20,Z 330,A 0,B 90,C 0}\nLIN P1\nEND\n"
    found_reasons = reasons(moved(tmp_path, "k.src", text, "kuka_kr6_r900"))
    assert found_reasons == {
        "P1": "it is a FRAME without status and turn that the program sets while it runs"
    }
