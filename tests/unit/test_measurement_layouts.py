"""Layout files say what guessing cannot know; what was understood can be printed as one; results leave the house."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import CellError
from cellcal.calibration.orientation import values_from
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.measured.layouts import (
    layout_document,
    layout_text,
    overlay_options,
    read_layout,
)
from cellcal.service.engineering.measured.measurements import ReadOptions, read_measurements
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from tests.unit.helpers.simulated_arm import tracker_points, tracker_poses, wire_lengths

LAYOUTS = Path(__file__).resolve().parents[2] / "deploy" / "layouts"
SCALES = {"deg": np.rad2deg(1.0), "rad": 1.0, "mm": 1e3, "m": 1.0}
ROBOTS = {"fanuc_geometric_joints": "fanuc_m6ib", "kuka_positions": "kuka_kr6_r900"}


def columns_of(options, robot):
    """Return what an instrument with this layout would write, SI, by column name."""
    model = load_model(robot)
    simulated = wire_lengths(robot, 40) if "length" in options.columns else tracker_poses(robot, 40)
    rows = simulated.observations
    written = {"controller": model.base_flange(rows.joints_rad)[:, :3, 3]}
    written["joints"] = rows.joints_rad
    if options.joint_coupling == "geometric":
        written["joints"] = rows.joints_rad @ model.joint_coupling.T
    if "length" in options.columns:
        written["length"] = rows.lengths_m[:, None]
    else:
        written["position"] = rows.positions_m
        if "rotation" in options.columns:
            written["rotation"] = values_from(options.convention, rows.rotations)
    written["group"] = np.repeat(np.arange(8.0), 5)[:, None]
    found = {}
    for meaning, names in options.columns.items():
        scaled = written[meaning] * SCALES.get(options.units.get(meaning, ""), 1.0)
        found.update(zip(names, scaled.T, strict=True))
    return rows, found


@pytest.mark.parametrize("path", sorted(LAYOUTS.glob("*.toml")), ids=lambda path: path.stem)
def test_the_layout_of_an_instrument_reads_its_file(path, tmp_path):
    robot = ROBOTS.get(path.stem, "ur10")
    options = read_layout(path)
    rows, columns = columns_of(options, robot)
    table = tmp_path / "series.csv"
    names = ["decoy 1", *reversed(columns)]
    body = zip(np.arange(40.0), *(columns[name] for name in names[1:]), strict=True)
    table.write_text(
        "\n".join([";".join(names), *(";".join(f"{value:.9f}" for value in row) for row in body)]),
        encoding="utf-8",
    )
    found = read_measurements(table, load_model(robot), options)
    assert np.allclose(found.observations.joints_rad, rows.joints_rad, atol=1e-8)
    if "length" in options.columns:
        assert np.allclose(found.observations.lengths_m, rows.lengths_m, atol=1e-8)
    else:
        assert np.allclose(found.observations.positions_m, rows.positions_m, atol=1e-8)
    if "rotation" in options.columns:
        assert np.allclose(found.observations.rotations, rows.rotations, atol=1e-7)
    # Each is listed, and what was understood is the same layout again.
    assert path.name in (LAYOUTS / "README.md").read_text(encoding="utf-8")
    shown = tmp_path / "shown.toml"
    shown.write_text(layout_text(layout_document(found, options)), encoding="utf-8")
    again = read_layout(shown)
    assert dict(again.columns) == dict(options.columns)
    assert dict(options.units).items() <= dict(again.units).items()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[colums]\njoints=['a']", "colums"),
        ("[columns]\njoint=['a']", "joint"),
        ("[units]\njoints=3", "joints"),
        ("[columns]\njoints=[1, 2]", "list of names"),
        ("columns = 3", "no table"),
        ("[columns", "no TOML"),
        ("frame = 'x'", "frame"),
    ],
)
def test_a_layout_that_cannot_be_meant_is_refused(tmp_path, text, message):
    path = tmp_path / "layout.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MeasurementError, match=message) as refused:
        read_layout(path)
    assert refused.value.remedy


def test_a_coupling_that_does_not_exist_is_refused(tmp_path):
    path = file_of(tmp_path)
    with pytest.raises(CellError, match="sideways"):
        read_measurements(path, load_model("ur10"), ReadOptions(joint_coupling="sideways"))


def test_the_command_line_goes_before_the_file():
    below = ReadOptions({"joints": ("a",)}, {"joints": "deg"}, "kuka_abc", "one", "geometric")
    above = ReadOptions({"position": ("x", "y", "z")}, {"joints": "rad"}, "", "two")
    found = overlay_options(below, above)
    assert found == ReadOptions(
        {"joints": ("a",), "position": ("x", "y", "z")}, {"joints": "rad"}, "kuka_abc", "two", "geometric"
    )


def file_of(folder):
    rows = tracker_points("ur10", 100).observations
    path = folder / "points.csv"
    names = [*(f"q{i}" for i in range(1, 7)), "x", "y", "z"]
    table = np.concatenate([np.rad2deg(rows.joints_rad), rows.positions_m * 1e3], axis=1)
    text = [",".join(names), *(",".join(f"{value:.7f}" for value in row) for row in table)]
    path.write_text("\n".join(text), encoding="utf-8")
    return path


def test_the_command_shows_a_layout_that_it_then_reads(tmp_path, capsys):
    path, layout = file_of(tmp_path), tmp_path / "layout.toml"
    assert run_command_line(["identify", str(path), "--robot", "ur10", "--show-layout"]) == 0
    layout.write_text(capsys.readouterr().out, encoding="utf-8")
    assert tomllib.loads(layout.read_text(encoding="utf-8"))["units"] == {"joints": "deg", "position": "mm"}
    command = ["identify", str(path), "--robot", "ur10", "--layout", str(layout), "--show-layout", "--json"]
    assert run_command_line(command) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["usable"] == 100
    assert shown["columns"]["position"] == ["x", "y", "z"]


def test_the_result_is_saved_as_a_version_and_written_as_a_description(tmp_path, capsys):
    path, urdf, sets = file_of(tmp_path), tmp_path / "arm.urdf", tmp_path / "sets"
    command = ["identify", str(path), "--robot", "ur10", "--level", "2", "--train-rows", "70", "--json"]
    outputs = ["--save", str(sets), "--serial", "R-7", "--by", "A. B.", "--urdf", str(urdf)]
    assert run_command_line([*command, *outputs]) == 0
    values = {item["name"]: item["value"] for item in json.loads(capsys.readouterr().out)["parameters"]}
    saved = ParameterSets(sets).load_set("R-7")
    assert (saved.version, saved.made_by) == (1, "A. B.")
    assert {item.name: item.value for item in saved.values} == pytest.approx(values)
    arm = pinocchio.buildModelFromXML(urdf.read_text(encoding="utf-8"))
    nominal = load_model("ur10")
    at = nominal.base_flange(np.zeros((1, 6)))[0, :3, 3]
    data = arm.createData()
    pinocchio.framesForwardKinematics(arm, data, np.zeros(6))
    moved = data.oMf[arm.getFrameId("flange")].translation - at
    assert 1e-5 < float(np.linalg.norm(moved)) < 2e-2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--level", "2", "--save", "sets"], "--serial"),
        (["--level", "0", "--save", "sets", "--serial", "R", "--by", "A"], "nothing to save"),
        (["--level", "0", "--urdf", "arm.urdf"], "nothing to save"),
    ],
)
def test_what_cannot_be_saved_is_refused(tmp_path, capsys, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    path = file_of(tmp_path)
    assert run_command_line(["identify", str(path), "--robot", "ur10", "--train-rows", "70", *options]) != 0
    printed = capsys.readouterr()
    assert message in " ".join(printed.err.split())
    assert ("RMSE" in printed.out) == (message == "nothing to save")  # what was computed is not lost
    assert not (tmp_path / "sets").exists()
    assert not (tmp_path / "arm.urdf").exists()
