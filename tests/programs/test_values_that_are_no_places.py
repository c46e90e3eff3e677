"""Values of programs that look like places and are none: gains, bits, buffers, and points that axes carry."""

import json
from pathlib import Path

import pytest

from cellcal.service.exit_codes import ExitCode
from tests.programs.test_field_cases import run_command_line

UR, ABB = ("universal_robots", "ur5e", "p.script"), ("abb", "abb_irb120", "M.mod")
TARGET = "p[0.4, -0.3, 0.3, 0, 3.1416, 0]"
START = "  set_tcp(p[0, 0, 0.1, 0, 0, 0])\n  movej([0.1, -1.5, 1.6, -1.6, -1.57, 0.2])\n"


def move_text(folder: Path, text: str, arm: tuple[str, str, str]):
    project = folder / "project.toml"
    project.write_text(
        f'format = 1\nname = "cell"\n[robot]\nserial = "A1"\nmodel = "{arm[1]}"\nsmallest_sigma = 0.0001\n'
    )
    (folder / arm[2]).write_text(text)
    report = folder / "report.json"
    words = ["move", folder / arm[2], "--project", project, "--offset", "10,0,0,0,0,20", "--joints", "keep"]
    code = run_command_line(
        ["program", *map(str, words), "--out", str(folder / "out"), "--json", str(report)]
    )
    return code, json.loads(report.read_text())


@pytest.mark.parametrize(
    ("lines", "findings"),
    [
        ("  bits = [False, False]\n  bits[1] = True\n", 0),
        ("  buffer = [1086, 0, 0, 0]\n  buffer[0] = registers(1)\n", 0),
        ("  stw = integer_to_binary_list(4)\n  stw[2] = other\n", 0),
        ('  names = list()\n  names[0] = "a"\n', 0),
        ("  place = get_forward_kin()\n  place[0] = other\n  movel(place)\n", 1),
        ("  place = get_actual_tcp_pose()\n  place[0] = place[0] + 0.05\n  movel(place)\n", 1),
    ],
)
def test_elements_of_what_is_no_place_are_no_shifts(lines, findings, tmp_path):
    _, report = move_text(tmp_path, f"def prog():\n{START}  movel({TARGET})\n{lines}end\n", UR)
    (program,) = report["programs"]
    assert len([one for one in program["findings"] if "[" in one["what"]]) == findings


def test_gains_do_not_refuse_a_script(tmp_path):
    lines = "  gains = [1000, 1000, 500, 100, 100, 100]\n  k = [2*gains[0], gains[1]]\n  control(gains)\n"
    text = f"def control(g):\n  sync()\nend\ndef prog():\n{START}  movel({TARGET})\n{lines}end\n"
    code, report = move_text(tmp_path, text, UR)
    assert code == ExitCode.PASS
    assert report["counts"]["changed"] == 1


def test_a_point_far_out_on_a_track_is_left_and_refuses_no_module(tmp_path):
    far = "[[9000,0,700],[0,0,1,0],[0,0,0,0],[8600,9E9,9E9,9E9,9E9,9E9]]"
    text = f"MODULE M\nPROC main()\nMoveL {far},v100,fine,tool0\\WObj:=wobj0;\nENDPROC\nENDMODULE\n"
    code, report = move_text(tmp_path, text, ABB)
    assert code == ExitCode.REFUSED
    (point,) = report["programs"][0]["points"]
    assert "external axes" in point["reason"]
