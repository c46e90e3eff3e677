"""Files of tools and frames that are cloned beside the programs that use them."""

import json
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Pose
from cellcal.calibration.points.alignment import Alignment, alignment_text
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.programs.external.test_clones_and_compensation import POINTS, write_parameters

ARM = "abb_irb120"
OBJECT = '[FALSE,TRUE,"",[[{x},30,20],[1,0,0,0]],[[0,0,0],[1,0,0,0]]]'
USING = """MODULE A
  CONST robtarget p1:=[[301,21,350],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PROC main()
    MoveL p1,v100,fine,tool0\\WObj:=wT;
  ENDPROC
ENDMODULE
"""
DATA = "MODULE D(SYSMODULE)\n  PERS wobjdata wT:={};\nENDMODULE\n"


def write_cell(folder: Path, serial: str, fixture_x: float, frame_x: float, master: str = "") -> Path:
    folder.mkdir()
    nominal = load_model(ARM)
    write_parameters(folder / "robot.toml", nominal, nominal, serial)
    alignment = Alignment(
        fixture="door",
        robot_serial=serial,
        model=ARM,
        points_in_fixture_m=tuple(map(tuple, POINTS.tolist())),
        base_fixture=Pose((fixture_x, 0.0, 0.1)),
        covariance=tuple(map(tuple, (np.eye(6) * 1e-12).tolist())),
    )
    (folder / "door.json").write_text(alignment_text([alignment]), encoding="utf-8")
    text = f'format = 1\nname = "{serial}"\n{master}[robot]\nserial = "{serial}"\nmodel = "{ARM}"\n'
    text += 'parameters = "robot.toml"\nsmallest_sigma = 0.0001\n'
    text += f'[frames.wT]\nposition_mm = [{frame_x}, 30, 20]\n[fixture]\nalignment = "door.json"\n'
    (folder / "project.toml").write_text(text, encoding="utf-8")
    return folder / "project.toml"


@pytest.mark.parametrize(("frame_x", "told"), [(45, True), (40, False)])
def test_a_frame_that_is_cloned_as_the_master_has_it_is_reported(
    tmp_path: Path, frame_x: int, told: bool
) -> None:
    master = write_cell(tmp_path / "a", "M1", 0.3, 40)
    clone = write_cell(tmp_path / "b", "C1", 0.305, frame_x, '[master]\nproject = "../a/project.toml"\n')
    (tmp_path / "a" / "A.mod").write_text(USING, encoding="ascii")
    (tmp_path / "a" / "D.sys").write_text(DATA.format(OBJECT.format(x=40)), encoding="ascii")
    words = ["program", "clone", master, clone, tmp_path / "a" / "A.mod", tmp_path / "a" / "D.sys"]
    words += ["--out", tmp_path / "out", "--json", tmp_path / "r.json"]
    assert run_command_line([str(word) for word in words]) == ExitCode.PASS
    programs = json.loads((tmp_path / "r.json").read_text())["programs"]
    warnings = [warning for one in programs for warning in one["warnings"]]
    assert any("user frame wT as the master has it" in warning for warning in warnings) == told
    ((point,),) = ([one["status"] for one in program["points"]] for program in programs if program["points"])
    assert point == ("unchanged" if told else "changed")  # the clone's frame has moved with its fixture
