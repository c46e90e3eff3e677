"""A tool whose pose a script writes: its measured tip counts, several are refused, and none is said."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.geometry import exp_twist, homogeneous_matrix, inverse_transform
from cellcal.drivers.universal_robots.program_files.script_program import read_script
from cellcal.service.engineering.programs.move import move_transfer
from cellcal.service.engineering.programs.project import read_project
from cellcal.service.engineering.programs.result import ProgramResult

SCRIPT = """def prog():
  {setting}
  movej([0.1,-1.2,1.4,-1.7,-1.5,0.2], a=1.4, v=1.05)
  movel(p[0.4,-0.5,0.5,2.2,2.2,0.1], a=1.2, v=0.25)
end
"""
LITERAL = "set_tcp(p[0, 0, 0.15, 0, 0, 0])"
VARIABLE = "grip = p[0, 0, 0.15, 0, 0, 0]\n  set_tcp(grip)"
TOOL = "[tools.{}.entered]\nposition_mm = [0, 0, {}]\n[tools.{}.real]\nposition_mm = [{}, -0.5, 150.4]\n"
TURN = exp_twist(np.array([0.05, -0.02, 0.01, 0.0, 0.0, 0.6]))


def moved(folder: Path, setting: str, *tools: tuple[str, float, float]) -> ProgramResult:
    """Return a script moved in a project with tools: name, entered length [mm], real x [mm]."""
    file = folder / "project.toml"
    texts = [TOOL.format(name, entered, name, real_x) for name, entered, real_x in tools]
    head = 'format = 1\n[robot]\nserial = "S"\nmodel = "ur10e"\n'
    file.write_text(head + "".join(texts), encoding="utf-8")
    program = read_script("a.script", SCRIPT.format(setting=setting).encode())
    return move_transfer(read_project(file), TURN, None, joints="keep").transfer_programs([program])[0]


@pytest.mark.parametrize("setting", [LITERAL, VARIABLE])
def test_the_measured_tip_of_a_written_tool_keeps_its_place_at_the_work(tmp_path: Path, setting: str) -> None:
    result = moved(tmp_path, setting, ("gripper", 150.0, 0.8), ("camera", 90.0, 3.0))

    entered_real = homogeneous_matrix(np.eye(3), np.array([0.0008, -0.0005, 0.0004]))
    before, after = (p.positions.frame_tip[1] @ entered_real for p in (result.before, result.after))
    assert result.status[1] == "changed"
    assert np.abs(TURN @ before - after).max() < 1e-8
    assert np.abs(inverse_transform(result.before.positions.frame_tip[1]) @ before - np.eye(4)).max() > 5e-4
    assert not any("measured" in warning for warning in result.warnings)


def test_two_measured_tools_at_one_written_pose_leave_the_points(tmp_path: Path) -> None:
    result = moved(tmp_path, LITERAL, ("left", 150.0, 0.8), ("right", 150.0, 3.0))

    assert result.status[1] == "left"
    assert "left, right of project.toml" in result.reason[1]


def test_two_tools_that_are_alike_throughout_are_one(tmp_path: Path) -> None:
    result = moved(tmp_path, LITERAL, ("left", 150.0, 0.8), ("right", 150.0, 0.8))

    assert result.status[1] == "changed", result.reason


def test_a_written_tool_that_the_project_does_not_have_is_said(tmp_path: Path) -> None:
    result = moved(tmp_path, LITERAL, ("gripper", 150.1, 0.8))

    assert result.status[1] == "changed"
    assert any("no measured tip counts there" in warning for warning in result.warnings)
