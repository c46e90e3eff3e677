"""Programs of robots by reference: the catalogue, a model file, a description; and of which make they may be."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.urdf import bare_urdf
from cellcal.drivers.program_registry import brand_named
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.programs.cell_of_program import refuse_foreign
from cellcal.service.engineering.programs.project import ProjectError, read_project
from cellcal.service.engineering.programs.robot_makes import lacks_coupling, runs_programs_of

PROJECT = """format = 1
name = "c"
[robot]
serial = "1"
model = "{model}"
"""
LS = b"""/PROG  A
/MN
   1:J P[1] 20% FINE ;
/POS
P[1]{
   GP1:
    UF : 0, UT : 1,
    J1=    10.000 deg,    J2=    20.000 deg,    J3=   -30.000 deg,
    J4=     0.000 deg,    J5=   -60.000 deg,    J6=     0.000 deg
};
/END
"""

DESCRIPTIONS = Path(__file__).parents[2] / "data" / "descriptions"


def project(tmp_path: Path, model: str):
    path = tmp_path / "project.toml"
    path.write_text(PROJECT.format(model=model))
    return read_project(path)


@pytest.mark.parametrize(
    ("model", "brands"),
    [
        ("kuka_kr210_r2700_2", {"kuka"}),
        ("fanuc_crx10ia", {"fanuc"}),
        ("ur20", {"universal_robots"}),
        ("staubli_tx2_90l", set()),
        ("kawasaki_rs007n", set()),
    ],
)
def test_a_robot_of_the_catalogue_runs_programs_of_its_maker(model, brands):
    some = ("fanuc", "kuka", "abb", "yaskawa", "universal_robots")
    assert {brand for brand in some if runs_programs_of(load_model(model), brand)} == brands


def test_a_program_on_another_makers_robot_is_refused(tmp_path):
    program = brand_named("fanuc").read("A.LS", LS)
    with pytest.raises(ProgramFileError, match="a program of fanuc"):
        refuse_foreign(program, project(tmp_path, "staubli_tx2_90l"))
    refuse_foreign(program, project(tmp_path, "fanuc_crx10ia"))


def test_a_description_of_a_fanuc_is_not_taken_for_its_controllers_joints(tmp_path):
    """ROS counts joint 3 against the upper arm, the pendant against the horizon: 20 degrees apart in this program."""
    model = load_model("fanuc_m6ib")
    (tmp_path / "arm.urdf").write_text(bare_urdf(model, geometric_joints=True))
    own = project(tmp_path, "arm.urdf?tip=flange")
    assert lacks_coupling(own.nominal, "fanuc")
    assert not lacks_coupling(own.nominal, "kuka")
    with pytest.raises(ProgramFileError, match="does not couple J3 with J2") as refused:
        refuse_foreign(brand_named("fanuc").read("A.LS", LS), own)
    assert "interaction" in refused.value.remedy


@pytest.mark.parametrize(
    ("robot", "text", "says", "cure"),
    [
        ("scara.urdf?tip=flange", LS, "another number of joints", "[[track]]"),
        ("arm_on_track.urdf?base=world&tip=tool0", LS, "another number of joints", "[[track]]"),
    ],
)
def test_an_arm_of_another_kind_is_refused_for_what_it_is(tmp_path, robot, text, says, cure, capsys):
    """A SCARA or an arm on a track counts no joint against the horizon: that cure would bend its model."""
    (tmp_path / "A.LS").write_bytes(text)
    (tmp_path / "project.toml").write_text(PROJECT.format(model=f"{DESCRIPTIONS}/{robot}"))
    words = ["program", "inspect", "--project", str(tmp_path / "project.toml"), str(tmp_path / "A.LS")]
    assert run_command_line(words) == 10
    output = " ".join(capsys.readouterr().out.split())
    assert says in output
    assert cure in output
    assert "interaction" not in output


def test_a_program_of_joints_moves_with_an_arm_whose_postures_are_not_distinguished(tmp_path):
    """Its wrist does not meet in a point: poses are refused with the cure, and that cure works."""
    model, project_path = load_model("fanuc_crx10ia"), tmp_path / "project.toml"
    project_path.write_text(
        PROJECT.format(model="fanuc_crx10ia") + "[tools.1.entered]\nposition_mm = [0, 0, 100]\n"
    )
    (tmp_path / "A.LS").write_bytes(LS)
    words = ["program", "move", "--project", str(project_path), str(tmp_path / "A.LS")]
    assert run_command_line(
        [*words, "--offset", "10,20,30", "--joints", "move", "--out", str(tmp_path / "o")]
    ) in (0, 4)
    written = next((tmp_path / "o").glob("*.LS")).read_bytes()
    poses = [model.base_flange(joints_of(text))[0] for text in (LS, written)]
    assert np.allclose(poses[1][:3, 3] - poses[0][:3, 3], [0.01, 0.02, 0.03], atol=2e-5)
    assert np.allclose(poses[1][:3, :3], poses[0][:3, :3], atol=5e-5)


def joints_of(text: bytes):
    return np.radians([[float(value) for value in re.findall(rb"J\d=\s*(-?[\d.]+) deg", text)]])


def test_a_project_takes_a_description_beside_it(tmp_path, monkeypatch):
    model = load_model("kuka_kr10_r1100_2")
    (tmp_path / "arm.urdf").write_text(bare_urdf(model))
    monkeypatch.chdir("/")
    found = project(tmp_path, "arm.urdf?tip=flange,base=base").nominal
    joints = np.random.default_rng(1).uniform(-1, 1, (5, 6))
    assert np.allclose(found.base_flange(joints), model.base_flange(joints))


def test_a_project_says_what_is_wrong_with_its_robot(tmp_path):
    with pytest.raises(ProjectError, match="states no licence"):
        project(tmp_path, "jaka_a5")
    with pytest.raises(ProjectError, match=r"none\.urdf cannot be read"):
        project(tmp_path, "none.urdf?tip=a")


def test_points_beyond_a_sum_of_joints_are_named(tmp_path, capsys):
    """J2 and J3 are each inside their limits, and J2 + J3 is 40 degrees beyond what the arm allows."""
    far = LS.replace(b"20.000 deg,    J3=   -30.000", b"90.000 deg,    J3=   170.000")
    (tmp_path / "A.LS").write_bytes(far)
    path = tmp_path / "project.toml"
    path.write_text(
        PROJECT.format(model="fanuc_m20_25_18d") + "[tools.1.entered]\nposition_mm = [0, 0, 100]\n"
    )
    words = ["program", "inspect", "--project", str(path), str(tmp_path / "A.LS"), "--points", "--json"]
    assert run_command_line(words) == 4
    output = json.dumps(json.loads(capsys.readouterr().out))
    assert "J2+J3 beyond its limit" in output
