"""Project files: what they hold, and that nothing in them is taken for something else."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.calibration.orientation import CONVENTIONS, rotation_from
from cellcal.drivers.program_registry import brand_named
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.service.engineering.programs.cell_of_program import refuse_foreign
from cellcal.service.engineering.programs.move import redefined_frame
from cellcal.service.engineering.programs.project import read_project
from cellcal.service.engineering.programs.project_poses import (
    CONVENTION_KEYS,
    OrientationTable,
    ProjectError,
)
from tests.unit.helpers.fanuc_va import VariablesController

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


def _write_project_file(folder: Path, text: str) -> Path:
    path = folder / "project.toml"
    path.write_text(text)
    return path


def test_a_project_is_read_in_si(tmp_path: Path) -> None:
    (tmp_path / "B.ls").touch()
    (tmp_path / "A.ls").touch()

    project = read_project(_write_project_file(tmp_path, PLAIN))

    tool = project.tools["1"]
    assert tool.entered[:3, 3].tolist() == [0.001, 0.002, 0.15]
    assert np.allclose(tool.entered[:3, :3], rotation_from("fanuc_wpr", np.deg2rad([10, 20, 30])))
    assert np.array_equal(tool.real, tool.entered)
    assert project.frames["2"][:3, 3].tolist() == [0.9, -0.2, 0.35]
    assert np.degrees(project.controller.lower_rad[0]) == pytest.approx(-100)
    assert project.identified is None
    assert [path.name for path in project.program_files()] == ["A.ls", "B.ls"]


@pytest.mark.parametrize(
    ("old", "new", "heading"),
    [
        ("[900, -200, 350]", "[0.9, -0.2, 0.35]", "[frames.2]"),
        ("[1, 2, 150]", "[0.001, 0.002, 0.15]", "[tools.1.entered]"),
        ("[frames.2]", "[tools.1.real]\nposition_mm = [0.001, 0.002, 0.151]\n[frames.2]", "[tools.1.real]"),
        (
            "[unsaid]",
            "[standing_tools.glue.entered]\nposition_mm = [1.2, 0, 0.8]\n[unsaid]",
            "[standing_tools.glue",
        ),
    ],
)
def test_positions_that_look_like_metres_are_doubted(
    tmp_path: Path, old: str, new: str, heading: str
) -> None:
    assert read_project(_write_project_file(tmp_path, PLAIN)).doubts == ()

    (doubt,) = read_project(_write_project_file(tmp_path, PLAIN.replace(old, new))).doubts

    assert heading in doubt
    assert "if these are metres, multiply them by 1000" in doubt


def test_a_projects_robot_may_hang_from_a_ceiling(tmp_path: Path) -> None:
    project = read_project(
        _write_project_file(tmp_path, PLAIN.replace('"fanuc_m6ib"', '"fanuc_m6ib@ceiling"'))
    )
    assert project.nominal.gravity_in_base == (0.0, 0.0, 1.0)
    assert project.controller.gravity_in_base == (0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("format = 1", "format = 2", "format 1"),
        ('serial = "E-1"', "", "serial and model"),
        ('"fanuc_m6ib"', '"fanuc_9"', "no model is called"),
        ("lower_deg", "lowest_deg", "unknown lowest_deg"),
        ("[-100, -80,", "[-80,", "6 finite numbers"),
        ("[1, 2, 150]", "[1, 2, nan]", "not a finite number"),
        ("fanuc_wpr_deg = [10, 20, 30]", "abb_quaternion = [1, 1, 0, 0]", "abb_quaternion"),
        ("[10, 20, 30]", "[10, 20, 30]\nkuka_abc_deg = [1, 2, 3]", "one orientation"),
        ("position_mm = [900, -200, 350]", "", "position_mm is missing"),
        ('["*.ls"]', '["/etc/*.ls"]', "relative"),
        ("[unsaid]", '[fixture]\nalignment = "no.json"\n[unsaid]', "cannot be read"),
        ('model = "fanuc_m6ib"', 'model = "fanuc_m6ib"\nparameters = "no.toml"', "cannot be read"),
        ("[frames.2]", "[frames.2", "cannot be read as a project"),
        ("[frames.2]", "[frames.0]", "that is the base itself"),
        ("[tools.1.entered]", "[tools.0.entered]", "that is the flange itself"),
    ],
)
def test_faults_of_a_project_are_named(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in PLAIN

    with pytest.raises(ProjectError, match=words):
        read_project(_write_project_file(tmp_path, PLAIN.replace(old, new)))


@pytest.mark.parametrize(
    ("old", "new", "sentence", "remedy"),
    [
        (
            "lower_deg",
            "lowest_deg",
            "[robot]: unknown lowest_deg; did you mean 'lower_deg'?",
            "Known here: arm",
        ),
        (
            "[unsaid]",
            "[unsayd]",
            "project.toml: unknown unsayd; did you mean 'unsaid'?",
            "Known here: fixture",
        ),
        ("[unsaid]", "[qqq]", "project.toml: unknown qqq.", "Known here: fixture"),
        ('serial = "E-1"', "serial = 1", "[robot]: serial is a text in quotes, not 1.", ""),
        ('serial = "E-1"', 'serial = ""', "[robot]: serial is a text in quotes, not ''.", ""),
        ("[-100, -80,", "[true, -80,", "[robot]: lower_deg is a list of finite numbers, not [True, -80", ""),
        (
            "[1, 2, 150]",
            "[1, 2]",
            "[tools.1.entered]: position_mm is a list of 3 finite numbers, not [1, 2]",
            "",
        ),
        (
            "fanuc_wpr_deg",
            "fanuc_wrp_deg",
            "[tools.1.entered]: unknown fanuc_wrp_deg; did you mean",
            "fanuc_wpr",
        ),
        (
            "[unsaid]",
            "[tools.real.real]\nsigma_mm = -1\n[unsaid]",
            "sigma_mm is a finite number, not below",
            "",
        ),
        ("[frames.2]", "[frames]\n2 = 5\n[frames.3]", "[frames]: 2 is a table, written [frames.2].", ""),
        ("[frames.2]", "[[track]]\n[frames.2]", "[[track]] 1: name is missing.", 'such as name = "rail"'),
        (
            "[frames.2]",
            "[[track]]\naxis = 3\n[frames.2]",
            "[[track]] 1: axis is a text in quotes, not 3.",
            "",
        ),
        ('["*.ls"]', '"*.ls"', "programs is a list of file names or patterns, not '*.ls'.", ""),
        ("[robot]", "[robots]", "unknown robots; did you mean 'robot'?", "serial and model"),
    ],
)
def test_a_fault_names_table_key_and_what_is_allowed(
    tmp_path: Path, old: str, new: str, sentence: str, remedy: str
) -> None:
    assert old in PLAIN

    with pytest.raises(ProjectError) as caught:
        read_project(_write_project_file(tmp_path, PLAIN.replace(old, new)))

    assert sentence in caught.value.message
    assert remedy in f"{caught.value.message} {caught.value.remedy}"


def test_all_faults_of_a_project_are_named_at_once(tmp_path: Path) -> None:
    text = (
        PLAIN.replace("lower_deg", "lowest_deg")
        .replace("[1, 2, 150]", "[1, 2]")
        .replace('tool = "1"', "tool = 1")
    )

    with pytest.raises(ProjectError) as caught:
        read_project(_write_project_file(tmp_path, text))

    lines = caught.value.message.splitlines()
    assert [line.split(":")[0].strip() for line in lines[1:]] == ["[robot]", "[tools.1.entered]", "[unsaid]"]


def test_keys_that_are_known_are_listed_once_a_kind_of_table(tmp_path: Path) -> None:
    text = PLAIN.replace("[unsaid]", "[unsaid]\nqqq = 1\nrrr = 2").replace("lower_deg", "lowest_deg")

    with pytest.raises(ProjectError) as caught:
        read_project(_write_project_file(tmp_path, text))

    lines = caught.value.message.splitlines()[1:]
    assert [line.count("Known here: ") for line in lines] == [1, 0, 1]
    assert all(f"unknown {key}" in caught.value.message for key in ("lowest_deg", "qqq", "rrr"))


def test_a_pose_has_a_key_for_each_convention() -> None:
    assert {*OrientationTable.model_fields} == {*CONVENTION_KEYS}
    assert {*CONVENTION_KEYS.values()} == {*CONVENTIONS}


@pytest.mark.parametrize(
    ("model", "base"),
    [("fanuc_m6ib", "0"), ("kuka_kr6_r900", "0"), ("abb_irb120", "wobj0"), ("ur10e", "base")],
)
def test_the_base_needs_no_entry_and_accepts_no_other(tmp_path: Path, model: str, base: str) -> None:
    project = read_project(_write_project_file(tmp_path, PLAIN.replace("fanuc_m6ib", model)))
    change = np.eye(4)
    change[0, 3] = 0.1

    assert np.array_equal(project.frame_named(base), np.eye(4))
    assert redefined_frame(project, base, change)[1] == ""
    assert "user frame 2 at X 1000.000" in redefined_frame(project, "2", change)[1]


def test_a_rotation_is_written_in_the_convention_of_the_make(tmp_path: Path) -> None:
    project = read_project(_write_project_file(tmp_path, PLAIN.replace("fanuc_m6ib", "yaskawa_ar2010")))
    turned = homogeneous_matrix(rotation_from("yaskawa_rpy", np.deg2rad([0.0, 0.0, 1.5])), np.zeros(3))

    described_frame = redefined_frame(project, "2", turned)[1]

    assert described_frame.endswith("Rx 0.0000, Ry 0.0000, Rz 1.5000 deg")


def test_a_program_of_another_make_is_refused(tmp_path: Path) -> None:
    project = read_project(_write_project_file(tmp_path, PLAIN.replace("fanuc_m6ib", "yaskawa_ar2010")))
    script = brand_named("universal_robots").read("a.script", b"def a():\n  movej([0,0,0,0,0,0])\nend\n")

    with pytest.raises(ProgramFileError, match="a program of universal_robots"):
        refuse_foreign(script, project)


@pytest.mark.parametrize("cell", ["cell_1", "cell_7"])
def test_the_examples_want_only_the_files_they_name(cell: str) -> None:
    path = Path(__file__).parents[3] / "deploy" / "example_projects" / cell / "project.toml"

    with pytest.raises(ProjectError, match=r"E-987\d\d.toml cannot be read"):
        read_project(path)


BACKED = """\
format = 1
[robot]
serial = "E-1"
model = "fanuc_m6ib"
backup = "saved"
[tools.1.real]
position_mm = [0.5, 2.0, 150.5]
sigma_mm = 0.05
"""


def _save_parameter_set(folder: Path) -> None:
    tool, frame = (1.0, 2.0, 150.0, 10.0, 20.0, 30.0), (900.0, -200.0, 350.0, 0.0, 0.0, 90.0)
    VariablesController(
        frames={2: frame}, tools={1: tool, 4: (0.0, 0.0, 80.0, 0.0, 0.0, 0.0)}
    ).save_variables(folder / "saved")


def test_tools_and_frames_come_from_the_controller_s_backup(tmp_path: Path) -> None:
    _save_parameter_set(tmp_path)
    project = read_project(_write_project_file(tmp_path, BACKED))
    tool = project.tools["1"]
    assert tool.entered[:3, 3] == pytest.approx([0.001, 0.002, 0.15])
    assert np.allclose(tool.entered[:3, :3], rotation_from("fanuc_wpr", np.deg2rad([10, 20, 30])))
    assert tool.real[:3, 3] == pytest.approx([0.0005, 0.002, 0.1505])
    assert (tool.measured, tool.sigma_m) == (True, 5e-5)
    assert project.tools["4"].entered[:3, 3] == pytest.approx([0, 0, 0.08])
    assert not project.tools["4"].measured
    assert project.frames["2"][:3, 3] == pytest.approx([0.9, -0.2, 0.35])
    assert np.allclose(project.frames["2"][:3, :3], rotation_from("fanuc_wpr", np.deg2rad([0, 0, 90])))
    written = BACKED + "[frames.2]\nposition_mm = [900.004, -200, 350]\nfanuc_wpr_deg = [0, 0, 90]\n"
    assert read_project(_write_project_file(tmp_path, written)).frames["2"][0, 3] == pytest.approx(0.900004)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "[tools.1.real]",
            "[frames.2]\nposition_mm = [900, -200, 350.5]\n[tools.1.real]",
            "0.500 mm and 90.000 deg",
        ),
        ("[tools.1.real]", "[tools.1.entered]\nposition_mm = [1, 2, 150]\n[tools.1.real]", "0.000 mm and"),
        ("[tools.1.real]", "[tools.99.real]", "position_mm is missing"),
        ('"saved"', '"nowhere"', "nowhere"),
        ('"saved"', '"empty"', "SYSFRAME.VA"),
        ('"fanuc_m6ib"', '"abb_irb120"', "abb_irb120"),
    ],
)
def test_a_backup_that_does_not_fit_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    _save_parameter_set(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "POSREG.VA").write_bytes((tmp_path / "saved" / "POSREG.VA").read_bytes())
    with pytest.raises(ProjectError, match=words) as caught:
        read_project(_write_project_file(tmp_path, BACKED.replace(old, new)))
    assert caught.value.remedy or "missing" in words
