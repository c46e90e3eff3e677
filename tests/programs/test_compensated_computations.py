"""Places that a program computes while it runs: a compensated program that goes there uncorrected is no PASS."""

import json
from pathlib import Path
from typing import Any

import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.drivers.universal_robots.program_files.urp_program import read_urp
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.programs.project import read_project
from cellcal.service.exit_codes import ExitCode
from tests.programs.external.test_clones_and_compensation import real_arm, write_parameters
from tests.programs.test_absent_places import SHIFTED, fanuc, yaskawa
from tests.programs.test_field_cases import CASES, move_program
from tests.programs.test_universal_robots_urp import _urp_bytes, _waypoint_xml

KUKA = (CASES / "kuka" / "lin_rel_rotated.src").read_text()
SCRIPT = """def calc():
  movej([0.3, -1.4, 1.9, -2.0, -1.57, 0.1])
  movel(p[-0.544299,-0.276221,0.194454,1.607636,2.295913,0.875803])
  {}
end
"""
ABB = """MODULE A
  CONST robtarget p1:=[[300,20,350],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PROC main()
    ConfL\\Off;
    MoveL p1, v100, z1, tool0;
    MoveL {}, v100, z1, tool0;
  ENDPROC
ENDMODULE
"""
NOT_CORRECTED = "not corrected for the arm"


def compensate(
    folder: Path, brand: str, name: str, text: str, *, beside: tuple[str, str] | None = None
) -> tuple[int, dict[str, Any]]:
    """Compensate one program, and one beside it, for an arm with errors of its lengths and zeros."""
    project, texts = folder / "project.toml", dict([(name, text), *([beside] if beside else [])])
    files = [folder / each for each in texts]
    for file in files:
        file.write_text(texts[file.name])
    stated = (CASES / brand / "project.toml").read_text()
    project.write_text(stated)
    cell = read_project(project)
    nominal = load_model(cell.nominal.name)
    write_parameters(folder / "robot.toml", nominal, real_arm(nominal, 3), cell.serial)
    project.write_text(stated.replace("[robot]\n", '[robot]\nparameters = "robot.toml"\n'))
    words = [
        "compensate", *files, "--project", project, "--out", folder / "out", "--json", folder / "report.json",
    ]  # fmt: skip
    code = run_command_line(["program", *map(str, words)])
    programs = json.loads((folder / "report.json").read_text())["programs"]
    (report,) = [one for one in programs if Path(one["source"]).name == name]
    return code, report


COMPUTED = [
    ("kuka", "A.src", KUKA.replace("LIN_REL {X 100}", "LIN calcpos()"), 8),
    ("abb", "A.mod", ABB.format("fCalc()"), 6),
    ("universal_robots", "A.script", SCRIPT.format("movel(socket_pose())"), 4),
    ("universal_robots", "A.script", SCRIPT.format("movel(p[x,-0.27,0.19,1.6,2.3,0.9])"), 4),
    (
        "fanuc",
        "A.LS",
        fanuc("L P[1] 100mm/sec FINE", "PR[9]=P[1]", "PR[9,3]=R[5]", "L PR[9] 100mm/sec FINE"),
        15,
    ),
    (
        "fanuc",
        "A.LS",
        fanuc("L P[1] 100mm/sec FINE", "PR[9]=LPOS", "PR[9,3]=120", "L PR[9] 100mm/sec FINE"),
        15,
    ),
    (
        "fanuc",
        "A.LS",
        fanuc("L P[1] 100mm/sec FINE", "PR[9]=P[1]", "PR[9,R[2]]=R[5]", "L PR[9] 100mm/sec FINE"),
        15,
    ),
    ("yaskawa", "A.JBI", yaskawa("GETS PX010 $PX001", "SETE P010 (3) D001", "MOVL P010 V=50.0"), 0),
]


@pytest.mark.parametrize(("brand", "name", "text", "line"), COMPUTED)
def test_a_computed_place_or_part_of_one_is_a_finding(tmp_path, brand, name, text, line) -> None:
    code, report = compensate(tmp_path, {"universal_robots": "ur"}.get(brand, brand), name, text)
    found = [one for one in report["findings"] if NOT_CORRECTED in one["text"]]
    assert len(found) == 1
    assert line in (0, found[0]["line"])
    assert code == ExitCode.REFUSED


@pytest.mark.parametrize(
    ("brand", "name", "text"),
    [
        ("kuka", "A.src", KUKA),  # a step goes on from the corrected place
        ("abb", "A.mod", ABB.format("Offs(p1,0,0,20)")),
        (
            "fanuc",
            "A.LS",
            fanuc("L P[1] 100mm/sec FINE", "PR[9]=LPOS", "PR[9,3]=PR[9,3]+20", "L PR[9] 100mm/sec FINE"),
        ),
        ("ur", "A.script", SCRIPT.format("movel(pose_trans(get_actual_tcp_pose(), p[0,0,-0.02,0,0,0]))")),
    ],
)
def test_a_step_from_a_corrected_place_is_no_finding(tmp_path, brand, name, text) -> None:
    _, report = compensate(tmp_path, brand, name, text)
    assert report["findings"] == []


KUKA_DATA = """DEFDAT A PUBLIC
DECL E6POS XP1={X -59.856,Y -325.164,Z 612.070,A 132.8375,B 43.2907,C -157.3346,S 2,T 34}
DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE}
DECL E6POS XQ1
ENDDAT
"""
KUKA_COPY = "DEF A()\nBAS(#TOOL,1)\nBAS(#BASE,1)\nXQ1 = XP1\nBAS(#TOOL,{})\nLIN XQ1\nLIN XP1\nEND\n"


@pytest.mark.parametrize(("tool", "findings"), [(1, 0), (2, 1)])
def test_a_copy_that_another_tool_goes_to_is_corrected_for_another_posture(tmp_path, tool, findings) -> None:
    program = KUKA_COPY.format(tool).replace("LIN XP1", "BAS(#TOOL,1)\nLIN XP1")
    code, report = compensate(tmp_path, "kuka", "A.dat", KUKA_DATA, beside=("A.src", program))
    assert report["counts"]["changed"] == 1
    assert [one["point"] for one in report["findings"]] == ["XP1"] * findings
    assert all(
        "A.src takes the numbers of XP1 with another tool" in one["text"] for one in report["findings"]
    )
    assert code == ExitCode.REFUSED  # XQ1 holds none


def test_an_element_that_is_set_after_the_position_was_read_does_not_move_with_the_work(tmp_path) -> None:
    text = yaskawa("GETS PX010 $PX001", "SETE P010 (3) D001", "MOVL P010 V=50.0")
    moved = move_program(tmp_path, "yaskawa", "one_point_refuses_all.JBI", offset=SHIFTED, text=text)
    (found,) = [one for one in moved.report["findings"] if one["point"] == "P010"]
    assert "sets a part of P010" in found["text"]
    assert moved.code == ExitCode.REFUSED


@pytest.mark.parametrize(
    ("node", "found"),
    [
        ("<Script type='File'><cachedContents>movel(target, a=1)</cachedContents></Script>", 1),
        ("<Script type='File'><cachedContents>movej(get_pick())</cachedContents></Script>", 1),
        ("<Script type='File'><cachedContents>servoj(q_now, t=0.008)</cachedContents></Script>", 1),
        (
            "<Script type='Line'><expression><ExpressionChar character='movel(pick)'/></expression></Script>",
            1,
        ),
        ("<Script type='File'><file resolves-to='file'>/programs/sub.script</file></Script>", 1),
        ("<Script type='File'><cachedContents>movel(Waypoint_1_p, a=1)</cachedContents></Script>", 0),
        ("<Script type='File'><cachedContents>set_digital_out(1, True)</cachedContents></Script>", 0),
        ("<Script type='File'><cachedContents>set_tcp(tool_2)</cachedContents></Script>", 1),
    ],
)
def test_a_script_of_a_polyscope_program_that_moves_is_a_shift(node: str, found: int) -> None:
    program = read_urp("a.urp", _urp_bytes(_waypoint_xml(), node))
    assert [one.what for one in program.positions.shifts] == ["a script or an expression"] * found
