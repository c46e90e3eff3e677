"""One layout tells of several devices, targets and robots; the command fits them together."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.cells.levels import CellOptions
from cellcal.calibration.errors import CellError
from cellcal.calibration.geometry import (
    exp_rotation,
    homogeneous_matrix,
    inverse_transform,
    quaternion_from_rotation,
    rotation_from_quaternion,
)
from cellcal.calibration.identification.parameters import OFFSETS
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.identification.cell_identify import identify_cell_file
from cellcal.service.engineering.measured.cell_rows import read_cell
from cellcal.service.engineering.measured.cells import describes_a_cell, read_cell_layout
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from tests.unit.helpers.simulated_cell import REFLECTORS, TOOL, TRACKER, SimulatedWorld

LAYOUTS = Path(__file__).resolve().parents[2] / "deploy" / "layouts"
PLATE = LAYOUTS / "cells" / "tracker_plate_and_draw_wire.toml"
TWO = LAYOUTS / "cells" / "two_robots_one_tracker.toml"
ANCHOR, NEST = np.array([0.9, -0.7, -0.4]), np.array([0.6, 0.3, 0.2])
JOINTS = [f"J{i}" for i in range(1, 7)]


def write_table(path, names, rows):
    lines = [
        ",".join(names),
        *(",".join(v if isinstance(v, str) else f"{v:.7f}" for v in row) for row in rows),
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.fixture
def plate_file(tmp_path):
    world = SimulatedWorld(seed=1)
    joints = world.draw_joints(40)
    positions_by_target = [world.point_rows(offset=at, joints=joints).positions_m for at in REFLECTORS]
    wire = np.linalg.norm(world.tip_positions(joints, REFLECTORS[1]) - ANCHOR, axis=1) + world.draw_noise(40)
    names = [*JOINTS, *(f"{axis}{i}" for i in (1, 2, 3) for axis in "xyz"), "wire", "stop"]
    rows = np.column_stack(
        [np.rad2deg(joints), *(1e3 * s for s in positions_by_target), 1e3 * wire, np.arange(40.0)]
    )
    body = [list(row) for row in rows]
    body[3][6:9] = ["", "", ""]  # the tracker lost its target
    return write_table(tmp_path / "plate.csv", names, body)


def two_robots(path):
    left_world = SimulatedWorld(seed=2)
    right = SimulatedWorld(
        "abb_irb120", seed=3, base=homogeneous_matrix(exp_rotation(np.array([0, 0, 2.0])), [1.6, 0.4, 0.1])
    )
    rows = []
    for world, arm, reflector in ((left_world, "left", "A"), (right, "right", "B")):
        point_rows = world.point_rows(30)
        for joints, place in zip(point_rows.joints_rad, point_rows.positions_m, strict=True):
            rows.append([*np.rad2deg(joints), arm, "AT960", reflector, *(1e3 * place)])
    touched = left_world.at_pin(NEST, 6)
    rows += [[*np.rad2deg(joints), "left", "nest", "A", "", "", ""] for joints in touched.joints_rad]
    return write_table(path, [*JOINTS, "arm", "instrument", "reflector", "X", "Y", "Z"], rows), right.base


def test_a_plate_and_a_wire_give_tool_frame_and_j1(plate_file):
    report = identify_cell_file(plate_file, PLATE, "ur10", CellOptions(level=OFFSETS, judge=False))
    assert [series.rows for series in report.series] == [39, 40, 40, 40]
    assert report.measurements.left_out == (("first", 1),)
    frames = {frame.name: frame for frame in report.frames}
    plate = frames["plate"]
    assert np.linalg.norm(np.array(plate.position_m) - TOOL[:3, 3]) < 2e-3
    turned = rotation_from_quaternion(np.array(plate.quaternion)).T @ TOOL[:3, :3]
    assert np.abs(turned - np.eye(3)).max() < 0.02
    assert np.linalg.norm(np.array(frames["tracker"].position_m) - TRACKER[:3, 3]) < 5e-3
    assert "J1 offset" not in {item.parameter for item in report.identification.not_identified}
    assert len(report.identification.robust.problem.series) == 4


def test_rows_name_robot_device_and_target(tmp_path):
    path, base = two_robots(tmp_path / "two.csv")
    found = read_cell(path, read_cell_layout(TWO), "ur10")
    assert [series.device for series in found.cell.series] == ["AT960", "AT960", "nest"]
    assert [found.cell.robot_of(series.target).name for series in found.cell.series] == [
        "left",
        "right",
        "left",
    ]
    assert found.lines["touched"].tolist() == list(range(62, 68))
    report = identify_cell_file(path, TWO, "ur10", CellOptions(level=OFFSETS, judge=False))
    right = next(frame for frame in report.frames if frame.name == "right")
    assert right.seen_from == "left"
    error = inverse_transform(base)[:3, :3] @ (np.array(right.position_m) - base[:3, 3])
    assert np.linalg.norm(error) < 0.01


def test_the_command_fits_a_cell_and_prints_it(plate_file, capsys):
    words = ["identify", str(plate_file), "--robot", "ur10", "--layout", str(PLATE), "--level", "1"]
    assert run_command_line([*words, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [series["name"] for series in document["series"]] == ["first", "second", "third", "pulled"]
    assert document["series"][0]["held_out"]["n"] == 39
    assert document["left_out"] == {"first": 1}
    assert run_command_line(words) == 0
    printed = capsys.readouterr().out
    assert "mastering offsets" in printed
    assert "(a point)" in printed
    assert "not identified" in printed
    assert run_command_line([*words, "--train-rows", "20"]) != 0
    assert "train-rows" in capsys.readouterr().err


def with_one_reading(name, path):
    head, *readings = PLATE.read_text(encoding="utf-8").split("[[reading]]")
    path.write_text(head + "".join(f"[[reading]]{r}" for r in readings if f'name = "{name}"' in r), "utf-8")
    return path


def test_a_cell_leaves_a_set_a_description_pictures_and_points_behind(plate_file, tmp_path, capsys):
    out = tmp_path / "out"
    posture = SimulatedWorld(seed=1).draw_joints(40)[2:4]
    pose = load_model("ur10").base_flange(posture)
    rows = [["reflector 2", *(1e3 * p[:3, 3]), *quaternion_from_rotation(p[:3, :3])] for p in pose]
    poses = write_table(
        tmp_path / "poses.csv", ["target", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"], rows
    )
    words = ["identify", str(plate_file), "--robot", "ur10", "--layout", str(PLATE), "--level", "1", "--json"]
    words += [
        "--save",
        str(out / "sets"),
        "--serial",
        "4711",
        "--by",
        "Ada",
        "--urdf",
        str(tmp_path / "a.urdf"),
    ]
    words += ["--at", str(poses), "--limit", "20mm", "--accept-offset-sd", "0.5deg", "--plot", str(out)]
    assert run_command_line([*words, "--accept-offsets", "J2 offset"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert {series["verdict"]["verdict"] for series in document["series"]} == {"pass"}
    assert document["offsets"]["robot"]["offsets"][0]["parameter"] == "J2 offset"
    points = document["at"]["reflector 2"]["points"]
    assert np.array([point["joints_rad"] for point in points]) == pytest.approx(posture, abs=1e-6)
    truth = SimulatedWorld(seed=1).tip_positions(posture, REFLECTORS[1])
    assert np.abs(np.array([point["position_m"] for point in points]) - truth).max() < 3e-3
    saved = ParameterSets(out / "sets").load_set("4711")
    parameter_values = {item["name"]: item["value"] for item in document["parameters"]}
    assert saved.find_value("J2 offset").value == parameter_values["J2 offset"]
    assert "robot" in (tmp_path / "a.urdf").read_text(encoding="utf-8")
    names = {path.stem for path in out.glob("*.svg")}
    assert {"overview", "correlations", "residuals_by_row_pulled", "distribution_pulled"} <= names


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--start", "previous"], "starts from nominal arms"),
        (["--check", "x.csv"], "would need its own layout"),
        (["--residual-model"], "one arm's joints"),
        (["--save", "x", "--by", "Ada", "--serial", "left=1,right=2"], "one serial for each robot"),
    ],
)
def test_what_a_cell_cannot_do_is_reported_with_the_reason(plate_file, tmp_path, capsys, more, message):
    layout = tmp_path / "one.toml"  # the wire alone: quick
    text = PLATE.read_text(encoding="utf-8")
    layout.write_text(
        text[: text.index("[[reading]]")] + text[text.rindex("[[reading]]") :], encoding="utf-8"
    )
    words = ["identify", str(plate_file), "--robot", "ur10", "--layout", str(layout), "--level", "1"]
    assert run_command_line([*words, *more]) != 0
    assert message in " ".join(capsys.readouterr().err.split())


def test_a_device_that_was_moved_keeps_its_numbers_and_gets_another_place(tmp_path):
    world = SimulatedWorld(seed=5)
    anchors = ANCHOR, ANCHOR + np.array([0.2, 0.5, 0.1])
    rows = []
    for name, anchor in zip(("wire", "wire at noon"), anchors, strict=True):
        joints = world.draw_joints(60)
        lengths = (
            2e-3
            + np.linalg.norm(world.tip_positions(joints, REFLECTORS[0]) - anchor, axis=1)
            + world.draw_noise(60)
        )
        rows += [[*np.rad2deg(q), name, 1e3 * length] for q, length in zip(joints, lengths, strict=True)]
    path = write_table(tmp_path / "moved.csv", [*JOINTS, "gauge", "L"], rows)
    layout = tmp_path / "moved.toml"
    layout.write_text(MOVED, encoding="utf-8")
    report = identify_cell_file(path, layout, "ur10", CellOptions(level=OFFSETS, judge=False))
    frames = {frame.name: np.array(frame.position_m) for frame in report.frames}
    assert np.linalg.norm(frames["wire at noon"] - frames["wire"] - (anchors[1] - anchors[0])) < 5e-3
    assert [p.name for p in report.parameters if p.name.endswith("zero")] == ["wire zero"]
    layout.write_text(MOVED.replace('moved = "wire"', 'moved = "wire"\nzero_mm = 1.0'), encoding="utf-8")
    with pytest.raises(MeasurementError, match="are those of 'wire'"):
        identify_cell_file(path, layout, "ur10", CellOptions(level=OFFSETS, judge=False))


MOVED = """
[columns]
joints = ["J1", "J2", "J3", "J4", "J5", "J6"]
device = "gauge"

[[device]]
name = "wire"
place_mm = [900.0, -700.0, -400.0]
known_to_mm = 1.0

[[device]]
name = "wire at noon"
moved = "wire"

[[reading]]
name = "pulled"
kind = "length"
target = "hook"
columns = ["L"]
sigma_mm = 0.1
"""


def test_layouts_of_one_device_are_distinguished_from_those_of_a_cell():
    assert describes_a_cell(PLATE)
    assert not any(describes_a_cell(path) for path in LAYOUTS.glob("*.toml"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('kind = "length"', 'kind = "lenght"', "no kind 'lenght'"),
        ('columns = ["wire"]', "", "a length has 1 columns, not 0"),
        ("sigma_mm = 0.1", "", "sigma_mm is missing"),
        ("sigma_mm = 0.1", "sigma_mm = -1", "below zero"),
        ('joints = "deg"', 'joints = "grad"', "cannot be in 'grad'"),
        ('target = "reflector 2"\ncolumns = ["wire"]', 'columns = ["wire"]', "names no target"),
        ("place_mm = [900.0, -700.0, -400.0]", "place_mm = [900.0, -700.0]", "no list of 3 numbers"),
        ("place_mm = [900.0, -700.0, -400.0]", 'place_mm = [900.0, -700.0, "x"]', "no list of 3 numbers"),
        ("known_to_mm = 0.2", "known_to = 0.2", "knows no 'known_to'"),
        ('joints = ["J1", "J2", "J3", "J4", "J5", "J6"]', "", "names no joints"),
        ('columns = ["wire"]', 'columns = ["wires"]', "no column 'wires'"),
        ('tool = "plate"', 'tool = "dish"', "no tool 'dish'"),
        ('name = "wire"', 'name = "tracker"', "depends on its attitude"),
    ],
)
def test_what_a_layout_gets_wrong_is_reported(plate_file, tmp_path, old, new, message):
    text = PLATE.read_text(encoding="utf-8")
    assert old in text
    broken = tmp_path / "broken.toml"
    broken.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(CellError, match=message):
        identify_cell_file(plate_file, broken, "ur10", CellOptions(level=OFFSETS, judge=False))


def test_a_robot_that_the_layout_does_not_know_is_named(tmp_path):
    path, _ = two_robots(tmp_path / "two.csv")
    text = path.read_text(encoding="utf-8").replace(",right,", ",rigth,")
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MeasurementError, match="robot 'rigth'"):
        read_cell(path, read_cell_layout(TWO), "ur10")


@pytest.mark.parametrize("readings", [1, 2])  # one for both robots, or one for each
def test_a_target_that_rows_of_two_robots_name_is_a_point_of_each(tmp_path, readings):
    path, _ = two_robots(tmp_path / "two.csv")
    path.write_text(path.read_text(encoding="utf-8").replace(",B,", ",A,"), encoding="utf-8")
    layout = tmp_path / "two.toml"
    text = TWO.read_text(encoding="utf-8")
    tracked = '[[reading]]\nname = "tracked"\nkind = "point"\ncolumns = ["X", "Y", "Z"]\nsigma_mm = 0.05\n'
    assert tracked in text
    of_each = "".join(
        tracked.replace('"tracked"', f'"{arm}"') + f'where = {{ arm = "{arm}" }}\n'
        for arm in ("left", "right")
    )
    if readings == 2:
        text = text.replace(f'{tracked}where = {{ instrument = "AT960" }}\n', of_each)
    layout.write_text(text, encoding="utf-8")
    cell = read_cell(path, read_cell_layout(layout), "ur10").cell
    carried = {series.target: cell.robot_of(series.target).name for series in cell.series}
    assert carried == {"A (left)": "left", "A (right)": "right"}
    assert [len(series.observations) for series in cell.series] == [30, 30, 6]


def test_a_target_of_one_robot_is_not_taken_for_that_of_another(tmp_path):
    path, _ = two_robots(tmp_path / "two.csv")
    layout = tmp_path / "two.toml"
    layout.write_text(
        TWO.read_text(encoding="utf-8")
        + '\n[[tool]]\nname = "B"\nrobot = "left"\nplace_mm = [0.0, 0.0, 100.0]\n'
    )
    with pytest.raises(MeasurementError, match="rows of robot 'right' name target 'B'"):
        read_cell(path, read_cell_layout(layout), "ur10")


def test_every_kind_can_be_read(tmp_path):
    world = SimulatedWorld(seed=4)
    joints, other = np.rad2deg(world.draw_joints(12)), np.rad2deg(world.draw_joints(12))
    names = [*JOINTS, *(f"to{i}" for i in range(6)), "L", "rx", "ry", "rz", "X", "Y", "Z"]
    rows = np.column_stack([joints, other, np.full(12, 300.0), np.zeros((12, 3)), np.ones((12, 3))])
    path = write_table(tmp_path / "kinds.csv", names, [list(row) for row in rows])
    layout = read_cell_layout(PLATE)
    reading = replace(layout.readings[3], columns=("L",), target="tip", device="d")
    columns = {"pose": ("X", "Y", "Z"), "pin": (), "plane": (), "sphere": ()}
    for kind in ("pose", "length", "guided length", "bar", "plane", "sphere", "pin"):
        each = replace(
            reading,
            kind=kind,
            columns=columns.get(kind, ("L",)),
            rotation=("rx", "ry", "rz") if kind == "pose" else (),
            joints_to=tuple(names[6:12]) if kind == "bar" else (),
            nominal_m=0.025,
        )
        whole = replace(
            layout, readings=(each,), devices=(), tools=(), targets=(), names_in={}, convention="ros_rpy"
        )
        observations = read_cell(path, whole, "ur10").cell.series[0].observations
        assert (observations.kind, len(observations)) == (kind, 12)
        if kind == "sphere":
            assert observations.radii_m == pytest.approx(0.025)
        if kind in ("length", "bar"):
            assert observations.lengths_m == pytest.approx(0.3)
