"""Project files: what they hold, and that nothing in them is taken for something else."""

from pathlib import Path

import numpy as np
import pytest

from calibration.orientation import rotation_from
from service.programs.project import read_project
from service.programs.project_poses import ProjectError

PLAIN = """\
format = 1
name = "cell"
programs = ["*.ls"]
[robot]
serial = "E-1"
model = "fanuc_m6ib"
lower_deg = [-100, -80, -90, -180, -120, -300]
[tools.1.entered]
position_mm = [1, 2, 150]
fanuc_wpr_deg = [10, 20, 30]
[frames.2]
position_mm = [900, -200, 350]
[unsaid]
tool = "1"
"""


def _written(folder: Path, text: str) -> Path:
    path = folder / "project.toml"
    path.write_text(text)
    return path


def test_a_project_is_read_in_si(tmp_path: Path) -> None:
    (tmp_path / "B.ls").touch()
    (tmp_path / "A.ls").touch()

    project = read_project(_written(tmp_path, PLAIN))

    tool = project.tools["1"]
    assert tool.entered[:3, 3].tolist() == [0.001, 0.002, 0.15]
    assert np.allclose(tool.entered[:3, :3], rotation_from("fanuc_wpr", np.deg2rad([10, 20, 30])))
    assert tool.real is tool.entered
    assert project.frames["2"][:3, 3].tolist() == [0.9, -0.2, 0.35]
    assert np.degrees(project.controller.lower_rad[0]) == pytest.approx(-100)
    assert project.identified is None
    assert [path.name for path in project.program_files()] == ["A.ls", "B.ls"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("format = 1", "format = 2", "format 1"),
        ('serial = "E-1"', "", "serial and model"),
        ('"fanuc_m6ib"', '"fanuc_9"', "no model is called"),
        ("lower_deg", "lowest_deg", "unknown lowest_deg"),
        ("[-100, -80,", "[-80,", "6 finite numbers"),
        ("[1, 2, 150]", "[1, 2, nan]", "3 finite numbers"),
        ("fanuc_wpr_deg = [10, 20, 30]", "abb_quaternion = [1, 1, 0, 0]", "abb_quaternion"),
        ("[10, 20, 30]", "[10, 20, 30]\nkuka_abc_deg = [1, 2, 3]", "one orientation"),
        ("position_mm = [900, -200, 350]", "", "position_mm is missing"),
        ('["*.ls"]', '["/etc/*.ls"]', "relative"),
        ("[unsaid]", '[fixture]\nalignment = "no.json"\n[unsaid]', "cannot be read"),
        ('model = "fanuc_m6ib"', 'model = "fanuc_m6ib"\nparameters = "no.toml"', "cannot be read"),
        ("[frames.2]", "[frames.2", "cannot be read as a project"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in PLAIN

    with pytest.raises(ProjectError, match=words):
        read_project(_written(tmp_path, PLAIN.replace(old, new)))


@pytest.mark.parametrize("cell", ["cell_1", "cell_7"])
def test_the_examples_want_only_the_files_they_name(cell: str) -> None:
    path = Path(__file__).parents[3] / "deploy" / "example_projects" / cell / "project.toml"

    with pytest.raises(ProjectError, match=r"E-987\d\d.toml cannot be read"):
        read_project(path)
