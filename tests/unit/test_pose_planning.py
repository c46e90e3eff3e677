"""``cellcal poses`` as people type it: plans, acceptances, obstacles, next poses, and files."""

import csv
import json

import numpy as np
import pytest
from cyclopts import App

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.urdf import bare_urdf
from cellcal.calibration.errors import CellError
from cellcal.calibration.motion.cell_shapes import BoxObstacle, PlaneObstacle, SphereObstacle
from cellcal.calibration.motion.collision import CollisionCheck
from cellcal.service.cli.poses import poses
from cellcal.service.configuration.cell_shapes import CellShapeError, read_cell_shape
from cellcal.service.engineering.identification.pose_planning import read_joints, visiting_order
from cellcal.service.exit_codes import ExitCode

MODEL = load_model("abb_irb120")
BASIC = ("--robot", "abb_irb120", "--sigma-mm", "0.1", "--tool-mm", "40", "25", "100", "--candidates", "200")
SHAPES = """
link_radius_mm = 40
margin_mm = 30
[[box]]
name = "table"
centre_in_base_mm = [500, 0, -100]
size_mm = [400, 400, 200]
rpy_deg = [0, 0, 45]
[[sphere]]
name = "lamp"
centre_in_base_mm = [0, 500, 900]
radius_mm = 120
[[plane]]
name = "wall"
point_in_base_mm = [-450, 0, 0]
normal_in_base = [1, 0, 0]
"""


@pytest.fixture
def run_plan(capsys):
    app = App(name="cellcal", result_action="return_value")
    app.command(poses)

    def call_command(*words, code=0):
        capsys.readouterr()
        assert app(["poses", *BASIC, *map(str, words)], exit_on_error=False, print_error=False) == code
        return capsys.readouterr().out

    return call_command


def joints_of(document):
    return np.deg2rad(document["poses_deg"])


def test_a_plan_promises_more_than_chance_and_names_what_it_did_not_check(run_plan):
    found = json.loads(run_plan("--count", 15, "--json"))
    assert len(found["poses_deg"]) == 15
    assert found["prediction"]["tip_rms_m"] < found["random"]["tip_rms_m"] < found["before"]["tip_rms_m"]
    assert 0.5 < found["efficiency"] <= 1.0
    assert any("no obstacles known" in words for words in found["not_checked"])
    assert sorted(found["ranks"]) == list(range(1, 16))


def test_an_acceptance_gives_the_fewest_poses_or_an_exit_code(run_plan):
    found = json.loads(run_plan("--count", 60, "--accept-tip-mm", 0.2, "--json"))
    assert found["reachable"]
    assert 6 < len(found["poses_deg"]) < 60
    assert found["prediction"]["tip_rms_m"] <= 0.2e-3 / 1.2
    refused = json.loads(
        run_plan("--count", 30, "--accept-tip-mm", 0.001, "--json", code=ExitCode.OUT_OF_TOLERANCE)
    )
    assert not refused["reachable"]
    assert refused["poses_deg"] == []
    assert "too coarse" in refused["reason"]


def test_printed_poses_come_in_degrees_with_their_rank(run_plan):
    words = run_plan(
        "--count",
        8,
        "--level",
        1,
        "--accept-offset-deg",
        0.05,
        "--offsets",
        "J2 offset",
        "--offsets",
        "J3 offset",
    )
    assert "poses are predicted to be enough" in words
    assert "not checked" in words
    assert "J1 offset" in words
    assert "not identified" in words


def test_poses_go_into_a_file_and_come_back_as_test_poses(run_plan, tmp_path):
    out = tmp_path / "plan.csv"
    found = json.loads(run_plan("--count", 10, "--csv", out, "--json"))
    assert np.allclose(read_joints(out, 6), joints_of(found), atol=1e-6)
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["rank"]) for row in rows] == found["ranks"]
    assert {row["way_checked"] for row in rows} <= {"free", "blocked"}
    own = json.loads(run_plan("--count", 10, "--tests", out, "--json"))
    assert own["prediction"]["tip_rms_m"] != found["prediction"]["tip_rms_m"]
    with pytest.raises(CellError, match="there already"):
        run_plan("--count", 10, "--csv", out)


def test_obstacles_are_kept_clear_of(run_plan, tmp_path):
    file = tmp_path / "cell.toml"
    file.write_text(SHAPES)
    found = json.loads(run_plan("--count", 12, "--shape", file, "--json"))
    shape = read_cell_shape(file, MODEL, tip_in_flange_m=(0.04, 0.025, 0.1))
    check = CollisionCheck.from_model(MODEL, shape)
    assert check.is_free(joints_of(found)).all()
    assert found["ways_free"][1:] == check.is_path_free(joints_of(found)).tolist()
    assert not any("no obstacles" in words for words in found["not_checked"])
    without = json.loads(run_plan("--count", 12, "--json"))
    assert not check.is_free(joints_of(without)).all()


def test_shapes_of_a_description_are_kept_clear_too(run_plan, tmp_path):
    shape = '<collision><geometry><sphere radius="0.25"/></geometry></collision>'
    text = bare_urdf(MODEL).replace('<link name="flange" />', f'<link name="flange">{shape}</link>')
    file, obstacles = tmp_path / "arm.urdf", tmp_path / "cell.toml"
    file.write_text(text)
    obstacles.write_text(SHAPES)
    found = json.loads(run_plan("--count", 12, "--description", file, "--shape", obstacles, "--json"))
    flange = MODEL.base_flange(joints_of(found))[:, :3, 3]
    assert (np.linalg.norm(flange - [0, 0.5, 0.9], axis=1) > 0.12 + 0.25 + 0.03 - 1e-6).all()
    assert (flange[:, 0] > -0.45 + 0.25 + 0.03 - 1e-6).all()
    assert any("in the description" in words for words in found["not_checked"])
    with pytest.raises(CellError, match="does not move"):
        run_plan("--count", 5, "--description", file, "--tip-link", "link_3")


def test_a_wire_is_planned_within_its_range(run_plan):
    words = ("--kind", "length", "--anchor-mm", 500, -500, 100, "--wire-range-mm", 1200, "--count", 20)
    found = json.loads(run_plan(*words, "--json"))
    tips = MODEL.tip_positions(joints_of(found), np.array([0.04, 0.025, 0.1]))
    lengths = np.linalg.norm(tips - [0.5, -0.5, 0.1], axis=1)
    assert lengths.max() <= 0.97 * 1.2
    assert lengths.min() >= 0.03 * 1.2
    assert not any("no draw-wire" in words for words in found["not_checked"])
    with pytest.raises(CellError, match="range"):
        run_plan("--kind", "length", "--count", 20)


def test_the_next_poses_go_on_from_measurements(run_plan, tmp_path):
    rng = np.random.default_rng(4)
    joints = 0.3 + 0.25 * rng.normal(size=(40, 6))
    tips = MODEL.tip_positions(joints, np.array([0.04, 0.025, 0.1])) + 1e-4 * rng.normal(size=(40, 3))
    file = tmp_path / "measured.csv"
    with file.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow([*(f"q{i + 1}_deg" for i in range(6)), "x_mm", "y_mm", "z_mm"])
        writer.writerows(np.column_stack([np.rad2deg(joints), tips * 1e3]).tolist())
    found = json.loads(run_plan("--after", file, "--count", 6, "--json"))
    assert found["before"]["tip_rms_m"] < 0.05
    assert found["prediction"]["tip_rms_m"] < 0.5 * found["before"]["tip_rms_m"]
    assert len(found["poses_deg"]) == 6
    with pytest.raises(CellError, match="points"):
        run_plan("--after", file, "--kind", "pose", "--count", 6)


def test_each_pose_is_visited_once_by_short_ways():
    rng = np.random.default_rng(1)
    joints = rng.uniform(-2, 2, (30, 6))
    order = visiting_order(MODEL, joints)
    assert sorted(order) == list(range(30))

    def travel_time_s(rows):
        return (np.abs(np.diff(joints[list(rows)], axis=0)) / MODEL.max_speed_rad_s).max(axis=1).sum()

    assert travel_time_s(order) < 0.8 * travel_time_s(range(30))


def test_shapes_are_read_in_millimetres_and_degrees(tmp_path):
    file = tmp_path / "cell.toml"
    file.write_text(SHAPES)
    shape = read_cell_shape(file, MODEL)
    table, lamp, wall = shape.obstacles
    assert isinstance(table, BoxObstacle)
    assert isinstance(lamp, SphereObstacle)
    assert isinstance(wall, PlaneObstacle)
    assert table.size_m == (0.4, 0.4, 0.2)
    assert np.allclose(table.base_box[:3, 0], [np.sqrt(0.5), np.sqrt(0.5), 0.0])
    assert lamp.centre_in_base_m == (0.0, 0.5, 0.9)
    assert wall.point_in_base_m[0] == -0.45
    assert shape.margin_m == 0.03
    assert {capsule.radius_m for capsule in shape.arm} == {0.04}


def test_measured_links_replace_the_assumed_ones(tmp_path):
    file = tmp_path / "cell.toml"
    file.write_text(
        '[[capsule]]\nname = "upper arm"\nlink = 2\nstart_mm = [0, 0, 0]\nend_mm = [-270, 0, 0]\nradius_mm = 70\n'
    )
    shape = read_cell_shape(file, MODEL)
    assert [(c.name, c.link, c.end_m, c.radius_m) for c in shape.arm] == [
        ("upper arm", 2, (-0.27, 0.0, 0.0), 0.07)
    ]
    assert shape.assumed == ()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("size_mm = [400, 400, 200]", "size_mm = [400, 400]", "three finite numbers"),
        ("size_mm = [400, 400, 200]", "size_mm = [400, 400, -1]", "not below zero"),
        ("size_mm = [400, 400, 200]", "size = [400, 400, 200]", "lacks"),
        ("radius_mm = 120", 'radius_mm = "120"', "finite number"),
        ("radius_mm = 120", "radius_mm = inf", "finite number"),
        ("[[sphere]]", "[[spheres]]", "unknown"),
        ("[[sphere]]", "[sphere]", r"\[\[sphere\]\]"),
        ("normal_in_base = [1, 0, 0]", "normal_in_base = [0, 0, 0]", "not below zero"),
        ("margin_mm = 30", "margin_mm = [", "cannot be read"),
    ],
)
def test_a_file_of_shapes_that_is_wrong_is_refused(tmp_path, old, new, words):
    assert old in SHAPES
    file = tmp_path / "cell.toml"
    file.write_text(SHAPES.replace(old, new))
    with pytest.raises(CellShapeError, match=words):
        read_cell_shape(file, MODEL)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("q1_deg,q2_deg\n1,2\n", "q6_deg"),
        ("", "q6_deg|no rows"),
        (
            ",".join(f"q{i}_deg" for i in range(1, 7)) + "\n1,2,3,4,5,nan\n",
            "'nan' cannot be read as a number",
        ),
    ],
)
def test_test_poses_that_cannot_be_read_are_refused(tmp_path, content, words):
    file = tmp_path / "tests.csv"
    file.write_text(content)
    with pytest.raises(CellError, match=words):
        read_joints(file, 6)


def test_wishes_that_make_no_sense_are_refused(run_plan):
    for words, match in (
        (("--criterion", "luck"), "no criterion"),
        (("--kind", "photo"), "point, pose or length"),
        (("--count", 500), "cannot be chosen"),
        (("--accept-offset-deg", 1, "--offsets", "J9 offset"), "no J9 offset"),
    ):
        with pytest.raises(CellError, match=match):
            run_plan(*words)
