"""Tag files in, calibrated parts out: what exports look like, what commands write, what journalled runs keep."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.urdf import bare_urdf, read_urdf
from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.geometry import Pose
from cellcal.calibration.points.tag_points import TagPath
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.measured.tag_files import TagOptions, read_tags, tags_of_setting
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.exit_codes import ExitCode
from cellcal.service.runs.settings import spec_of
from tests.unit.helpers.tag_paths import FIXTURE_BASE, OFFSETS_DEG, TIP, robot_tags, two_paths


def write_tags(
    folder: Path, name: str, tags: TagPath, *, unit: float = 1e3, head: str = "Name,X,Y,Z"
) -> Path:
    """Write tags as a simulation exports them, in millimetres and degrees."""
    rows = [head + "".join(f",J{k + 1}" for k in range(len(tags.joints_rad[0]) if tags.joints_rad else 0))]
    for row in range(len(tags)):
        joints = np.degrees(tags.joints_rad[row]) if tags.joints_rad else []
        numbers = [*(v * unit for v in tags.positions_m[row]), *joints]
        rows.append(",".join([tags.tag_label(row), *(f"{float(v):.9f}" for v in numbers)]))
    path = folder / name
    path.write_text("\n".join(rows) + "\n")
    return path


def test_a_path_is_read_as_it_was_written(tmp_path: Path) -> None:
    tags = robot_tags().robot
    found = read_tags(write_tags(tmp_path, "tags.csv", tags))
    assert found.path.names == tags.names
    assert np.allclose(found.path.to_positions(), tags.to_positions(), atol=1e-9)
    assert np.allclose(found.path.joints_rad, tags.joints_rad, atol=1e-9)
    assert "position taken as mm" in found.guesses
    assert "joints taken as deg" in found.guesses


def test_units_columns_and_attitudes_are_read_as_they_are_named(tmp_path: Path) -> None:
    path = tmp_path / "tags.txt"
    path.write_text(
        "Point;X [m];Y [m];Z [m];W;P;R\nA;0,1;0,2;0,3;0;0;90\nB;1,0;0,0;0,5;90;0;0\nC;1,0;2,0;0,5;0;0;0\n"
    )
    plain = read_tags(path)
    assert plain.path.quaternions == ()
    assert any("no convention" in guess for guess in plain.guesses)
    turned = read_tags(path, TagOptions(convention="fanuc_wpr", units={"rotation": "deg"}))
    assert turned.path.positions_m[0] == (0.1, 0.2, 0.3)
    assert turned.path.quaternions[0] == pytest.approx((math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))
    assert turned.path.names == ("A", "B", "C")


def test_files_that_are_no_tags_are_refused_with_what_helps(tmp_path: Path) -> None:
    good = write_tags(tmp_path, "good.csv", two_paths(FIXTURE_BASE)[0])
    bad = tmp_path / "bad.csv"
    bad.write_text(good.read_text().replace("\nP3,", "\nP3,?", 1))
    with pytest.raises(MeasurementError, match="line 4: column 'X' holds"):
        read_tags(bad)
    with pytest.raises(MeasurementError, match="there is no file"):
        read_tags(tmp_path / "none.csv")
    with pytest.raises(MeasurementError, match="cannot be in 'yard'"):
        read_tags(good, TagOptions(units={"position": "yard"}))
    for setting in (5, {"columns": {}}, {"file": "x.csv", "colour": "red"}):
        with pytest.raises(MeasurementError, match="names no file of tags"):
            tags_of_setting(setting, "simulated")


def test_settings_that_name_files_become_a_spec(tmp_path: Path) -> None:
    simulated, measured = (
        write_tags(tmp_path, name, tags) for name, tags in zip("ab", two_paths(FIXTURE_BASE), strict=True)
    )
    spec = spec_of(
        "simulation_cell", {"part": "base", "simulated": str(simulated), "measured": str(measured)}
    )
    assert len(spec.simulated) == len(spec.measured) == 8
    with pytest.raises(CellError, match="description"):
        spec_of(
            "simulation_cell",
            {
                "part": "robot",
                "simulated": str(simulated),
                "measured": str(measured),
                "description": "none.urdf",
            },
        )


def test_a_base_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [
        str(write_tags(tmp_path, f"{name}.csv", tags))
        for name, tags in zip("ab", two_paths(FIXTURE_BASE), strict=True)
    ]
    out = tmp_path / "out"
    assert run_command_line(["simulate-cell", "base", *files, "--out", str(out), "--json"]) == ExitCode.PASS
    output = json.loads(capsys.readouterr().out)
    assert output["judgement"]["word"] == "pass"
    found = Pose(**output["result"]["found"]["outer_inner"])
    assert np.allclose(found.to_matrix(), FIXTURE_BASE, atol=5e-4)
    assert json.loads((out / "base.json").read_text()) == output["result"]
    text = (out / "base.txt").read_text()
    assert "fanuc_wpr: W " in text
    assert "the fixture in the robot's base" in text
    assert text.count("mm after") == 8


def test_a_missing_file_is_named_before_the_other_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    unreadable = tmp_path / "a.csv"
    unreadable.write_text("no tags at all\n")
    command = ["simulate-cell", "robot", str(unreadable), str(tmp_path / "none.csv"), "--model", "ur10"]
    assert run_command_line(command) != ExitCode.PASS
    assert "there is no file" in capsys.readouterr().err
    # Neither is a robot without a serial number.
    assert run_command_line([*command, "--save", str(tmp_path / "sets")]) != ExitCode.PASS
    assert "--save needs --serial and --by." in capsys.readouterr().err


def test_a_workpiece_by_the_command_and_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn, touched = two_paths(FIXTURE_BASE, 3, sigma_m=1e-5)
    files = [str(write_tags(tmp_path, f"{name}.csv", tags)) for name, tags in (("a", drawn), ("b", touched))]
    command = ["simulate-cell", "workpiece", *files, "--method", "three_points"]
    assert run_command_line(command) != ExitCode.PASS
    assert "sigma_m" in capsys.readouterr().err
    assert run_command_line([*command, "--sigma-mm", "0.05"]) == ExitCode.PASS
    assert "the workpiece in the robot's base, by three points on 3 tags" in capsys.readouterr().out
    assert run_command_line([*command, "--sigma-mm", "5"]) == ExitCode.REFUSED
    assert "UNDECIDED" in capsys.readouterr().err


def test_a_robot_by_the_command_with_its_description_and_parameter_set(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tags = robot_tags(40, sigma_m=3e-5, name="ur10e")
    files = [str(write_tags(tmp_path, f"{n}.csv", t)) for n, t in (("a", tags.robot), ("b", tags.device))]
    description = tmp_path / "ur10e.urdf"
    description.write_text(bare_urdf(load_model("ur10e")))
    out, sets = tmp_path / "out", tmp_path / "sets"
    command = [
        "simulate-cell",
        "robot",
        *files,
        "--urdf",
        str(description),
        "--tip-link",
        "flange",
        "--out",
        str(out),
    ]
    saving = ["--save", str(sets), "--serial", "R-1", "--by", "anna"]
    assert run_command_line([*command, *saving]) == ExitCode.PASS
    output = capsys.readouterr().out
    assert "mm RMS at tags that were not fitted" in output
    assert "not known: J1 offset" in output
    assert "J1 offset: " not in output
    saved = ParameterSets(sets).load_set("R-1")
    assert saved.made_by == "anna"
    calibrated = read_urdf((out / "robot.urdf").read_text(), tip_link="flange").model
    joints = np.random.default_rng(5).uniform(-1.2, 1.2, (20, 6))
    errors = np.zeros((6, 5))
    errors[:, 0] = np.radians(OFFSETS_DEG)
    truth = tags.model.with_dh_errors(errors).tip_positions(joints, TIP)
    before, after = (_misfit_m(arm.tip_positions(joints, TIP), truth) for arm in (tags.model, calibrated))
    assert after < 2e-4
    assert before > 1e-3


def _misfit_m(one: np.ndarray, other: np.ndarray) -> float:
    """Return what is left when one set of places may be moved as a whole: J1's zero is the device's place."""
    a, b = one - one.mean(axis=0), other - other.mean(axis=0)
    u, _, vt = np.linalg.svd(b.T @ a)
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return float(np.sqrt(((a @ rotation.T - b) ** 2).sum(axis=1).mean()))


def test_a_description_without_its_flange_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tags = robot_tags(20)
    files = [str(write_tags(tmp_path, f"{n}.csv", t)) for n, t in (("a", tags.robot), ("b", tags.device))]
    description = tmp_path / "arm.urdf"
    description.write_text(bare_urdf(load_model("ur10e")))
    assert run_command_line(["simulate-cell", "robot", *files, "--urdf", str(description)]) != ExitCode.PASS
    assert "tip_link" in capsys.readouterr().err
    assert run_command_line(["simulate-cell", "robot", *files]) != ExitCode.PASS
    assert "Name a model" in capsys.readouterr().err
    save = ["--model", "fanuc_m6ib", "--save", str(tmp_path / "sets")]
    assert run_command_line(["simulate-cell", "robot", *files, *save]) == ExitCode.USAGE


def test_another_procedures_run_has_no_simulated_cell() -> None:
    from cellcal.service.engineering.parameters.simulated_cells import result_of_run

    with pytest.raises(CalibrationError, match="three_point_frame"):
        result_of_run("three_point_frame", {})
