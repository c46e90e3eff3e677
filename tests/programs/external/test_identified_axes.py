"""A track or a positioner is identified from points, written as tables of a project, and programs are moved with it."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellcal.calibration.arm.kinematics import load_model
from cellcal.service.cli.app import run_command_line
from tests.programs.external.brands import KUKA_TURN, WrittenPoint, read_kuka, write_kuka
from tests.programs.external.cells import pose_text
from tests.programs.external.hand_geometry import Array, pose
from tests.unit.helpers.hidden_arm import NOISE_M, HiddenArm

DESCRIPTIONS = Path(__file__).parents[2] / "data" / "descriptions"
TRACK = f"{DESCRIPTIONS}/arm_on_track.urdf?base=world&tip=tool0"
POSITIONER = f"{DESCRIPTIONS}/positioner.urdf?base=base&tip=plate"
TOOL = pose((0.05, 0.06, 0.12))  # where the hidden arm has its target
FRAME = pose((0.6, -0.5, 0.4), (0.0, 0.1, 0.3))
HOME_DEG = (0.0, 20.0, 10.0, 15.0, -40.0, 0.0)
OWNER = ["--serial", "T1", "--by", "me"]


def measured(path: Path, robot: str, hidden: HiddenArm, count: int, base: Array | None = None) -> Path:
    """Write joints and places of so many postures; with a base, the places seen from it."""
    joints, slides = hidden.postures(count), hidden.slides()
    places = hidden.measured(joints)
    if base is not None:
        places = (places - base[:3, 3]) @ base[:3, :3]
    heads = [f"J{i + 1} ({'mm' if slide else 'deg'})" for i, slide in enumerate(slides)]
    table = np.column_stack([np.where(slides, joints * 1e3, np.degrees(joints)), places * 1e3])
    np.savetxt(
        path,
        table,
        delimiter=",",
        header=",".join([*heads, "x (mm)", "y (mm)", "z (mm)"]),
        comments="",
        fmt="%.7f",
    )
    return path


def carriage_flange(joints: Array) -> Array:
    """Return the nominal arm on its carriage (4, 4), joint by joint, as its drawing has it."""
    found = np.eye(4)
    for place, axis, angle in zip(
        ([0.1, 0, 0.3], [0.15, 0, 0.35], [0, 0, 0.7], [0.2, 0, 0.1], [0.5, 0, 0], [0.1, 0, 0]),
        ([0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]),
        joints,
        strict=True,
    ):
        found = found @ pose(place) @ pose(rotvec=np.array(axis) * angle)
    return found @ pose((0.05, 0, 0), (0, np.pi / 2, 0))


def joints_for(target: Array, near: Array) -> Array:
    """Return the joints (6,) by Newton's method with differences."""
    joints = near.copy()
    for _ in range(40):
        here = carriage_flange(joints)
        missed = np.r_[
            target[:3, 3] - here[:3, 3], Rotation.from_matrix(target[:3, :3] @ here[:3, :3].T).as_rotvec()
        ]
        if np.abs(missed).max() < 1e-11:
            return joints
        columns = []
        for step in 1e-7 * np.eye(6):
            ahead = carriage_flange(joints + step)
            turn = Rotation.from_matrix(ahead[:3, :3] @ here[:3, :3].T).as_rotvec()
            columns.append(np.r_[ahead[:3, 3] - here[:3, 3], turn] / 1e-7)
        joints = joints + np.clip(np.linalg.solve(np.array(columns).T, missed), -0.3, 0.3)
    raise AssertionError("no joints")


def joints_of(points: list[WrittenPoint], near: Array) -> Array:
    """Return rail and joints (N, 7) to which a controller goes that knows the drawing only."""
    found = []
    for point, start in zip(points, near, strict=True):
        rail = point.axes["E1"] / 1e3
        assert point.tip is not None
        target = np.linalg.inv(pose((0.0, rail, 0.0))) @ FRAME @ point.tip @ np.linalg.inv(TOOL)
        found.append(np.r_[rail, joints_for(target, start)])
    return np.array(found)


def program_points() -> tuple[list[WrittenPoint], Array]:
    """Return points that are near each other in space, each from another place of the rail, and their joints."""
    dice, points, postures = np.random.default_rng(5), [], []
    for rail in np.linspace(-0.5, 0.5, 12):
        place = dice.uniform(-0.1, 0.1, 3) + np.array([1.15, 0.0, 0.8])
        target = pose(place, dice.normal(size=3) * 0.2) @ pose(rotvec=(0, np.pi / 2, 0))
        at = np.linalg.inv(pose((0.0, rail, 0.0))) @ target @ np.linalg.inv(TOOL)
        joints = joints_for(at, np.radians(HOME_DEG))
        points.append(WrittenPoint(np.linalg.inv(FRAME) @ target, None, {"E1": rail * 1e3}))
        postures.append(joints)
    return points, np.array(postures)


def written(points: list[WrittenPoint]) -> str:
    """Return a data list of poses that name no configuration: the starting posture tells the branch."""
    return write_kuka(points, "2").replace(f",S 2,T {KUKA_TURN}", "")


def project(folder: Path, axes: str, robot: str) -> Path:
    path = folder / "project.toml"
    path.write_text(
        f'format = 1\nname = "cell"\n{robot}\nstarting_posture_deg = {list(HOME_DEG)}\nsmallest_sigma = 1e-6\n'
        f"[tools.1.entered]\n{pose_text(TOOL)}[frames.2]\n{pose_text(FRAME)}{axes}",
        encoding="utf-8",
    )
    return path


def completed(text: str) -> str:
    """Return the tables as a person completes them."""
    for key in ("axis", "coordinated"):
        text = text.replace(f"# {key} = ", f"{key} = ")
    return text


def misfit_after_moving(tmp_path: Path, name: str, axes: str, robot: str, hidden: HiddenArm) -> float:
    """Return how far the real tips after `program move` are from the moved shape of those before [m, RMS]."""
    folder = tmp_path / name
    folder.mkdir()
    points, postures = program_points()
    (folder / "rail.dat").write_text(written(points))
    words = ["program", "move", str(folder / "rail.dat"), "--project", str(project(folder, axes, robot))]
    assert run_command_line([*words, "--offset", "-120,90,-60,5,-4,12", "--out", str(folder / "new")]) == 0
    moved = read_kuka((folder / "new" / "rail.dat").read_text())
    before = hidden.tips(joints_of(points, postures))
    after = hidden.tips(joints_of(moved, postures))
    assert np.linalg.norm(after - before, axis=1).min() > 0.1
    one, other = before - before.mean(axis=0), after - after.mean(axis=0)
    turn, _ = Rotation.align_vectors(other, one)
    return float(np.sqrt(np.mean(np.sum((turn.apply(one) - other) ** 2, axis=1))))


def test_a_track_that_was_identified_moves_programs_as_the_real_arm_stands(tmp_path: Path) -> None:
    """The written tables and the arm's set are enough: the real tips are where the move of the work asks for them."""
    hidden = HiddenArm(load_model(TRACK), 2, geometry=3.0)
    path = measured(tmp_path / "points.csv", TRACK, hidden, 60)
    out = tmp_path / "identified"
    assert (
        run_command_line(["identify", str(path), "--robot", TRACK, "--project-axes", str(out), *OWNER]) == 0
    )
    text = (out / "axes.toml").read_text()
    robot = "\n".join(line.removeprefix("# ") for line in text.splitlines()[1:5])
    robot = robot.replace('"arm.toml"', f'"{out}/arm.toml"')
    table = tomllib.loads(text)["track"][0]
    assert table["direction"] == [0.0, 1.0, 0.0]
    real = misfit_after_moving(tmp_path, "real", completed(text), robot, hidden)
    described = text[: text.index("[track.real]")]
    without = misfit_after_moving(tmp_path, "without", completed(described), robot, hidden)
    assert real < 2.5 * NOISE_M
    assert without > 4 * real


def test_what_a_person_has_to_complete_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = measured(tmp_path / "points.csv", TRACK, HiddenArm(load_model(TRACK), 2), 40)
    out = tmp_path / "identified"
    assert (
        run_command_line(["identify", str(path), "--robot", TRACK, "--project-axes", str(out), *OWNER]) == 0
    )
    (tmp_path / "rail.dat").write_text(written(program_points()[0]))
    robot = f'[robot]\nserial = "T1"\nmodel = "{DESCRIPTIONS}/arm_on_track.urdf?base=carriage&tip=tool0"'
    file = project(tmp_path, (out / "axes.toml").read_text(), robot)
    words = ["program", "move", str(tmp_path / "rail.dat"), "--project", str(file), "--offset", "1,2,3,0,0,0"]
    assert run_command_line([*words, "--out", str(tmp_path / "new")]) != 0
    said = capsys.readouterr().err
    assert 'axis = "E1"' in said
    assert "coordinated" in said
    (out / "axes.toml").write_text("completed by a person")
    assert (
        run_command_line(["identify", str(path), "--robot", TRACK, "--project-axes", str(out), *OWNER]) != 0
    )
    assert "Name another folder" in " ".join(capsys.readouterr().err.split())
    assert (out / "axes.toml").read_text() == "completed by a person"


def test_a_positioner_that_was_identified_stands_where_it_turns(tmp_path: Path) -> None:
    """Seen from the frame of its description: the tilting axis and the table's axis, both at zero."""
    hidden = HiddenArm(load_model(POSITIONER), 3)
    world = tracker_of(hidden)
    path = measured(tmp_path / "points.csv", POSITIONER, hidden, 60, world)
    out = tmp_path / "identified"
    words = ["identify", str(path), "--robot", POSITIONER, "--level", "2", "--project-axes", str(out)]
    assert run_command_line(words) == 0
    tables = tomllib.loads((out / "axes.toml").read_text())["positioner"]
    assert [table["kind"] for table in tables] == ["revolute", "revolute"]
    for number, table in enumerate(tables):
        other = np.zeros((3, 2))
        other[:, number] = (0.0, 0.7, 1.4)
        circle = (hidden.tips(other) - world[:3, 3]) @ world[:3, :3]
        normal = np.cross(circle[1] - circle[0], circle[2] - circle[0])
        normal /= np.linalg.norm(normal)
        along = np.array(table["real"]["direction"])
        assert np.degrees(np.arccos(np.clip(abs(normal @ along), 0, 1))) < 0.03
        radii = np.linalg.norm(np.cross(circle - np.array(table["real"]["position_mm"]) / 1e3, along), axis=1)
        assert np.ptp(radii) < 2 * NOISE_M


def tracker_of(hidden: HiddenArm) -> Array:
    """Return the frame of the description's base as the tracker sees it."""
    dice = np.random.default_rng([hidden.seed, 2])
    dice.normal(size=(hidden.nominal.axis_count + 1, 6))
    return pose((2.5, 0.7, 0.3), dice.normal(size=3))


def test_a_positioner_measured_in_another_frame_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = measured(tmp_path / "points.csv", POSITIONER, HiddenArm(load_model(POSITIONER), 3), 60)
    out = tmp_path / "identified"
    words = ["identify", str(path), "--robot", POSITIONER, "--level", "2", "--project-axes", str(out)]
    assert run_command_line(words) != 0
    assert "Set the instrument's frame to the robot's base" in " ".join(capsys.readouterr().err.split())
    assert not out.exists()


@pytest.mark.parametrize(
    ("robot", "words", "why"),
    [
        ("ur10", OWNER, "has no external axis"),
        (f"{DESCRIPTIONS}/scara.urdf?tip=flange", OWNER, "has no external axis"),
        (TRACK, [], "--serial"),
        (TRACK, ["--level", "1", *OWNER], "--level 2"),
        (TRACK, ["--residual-model", *OWNER], "--residual-model"),
    ],
)
def test_what_cannot_become_a_table_is_refused(
    robot: str, words: list[str], why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = measured(tmp_path / "points.csv", robot, HiddenArm(load_model(robot), 1), 40)
    out = tmp_path / "identified"
    assert (
        run_command_line(["identify", str(path), "--robot", robot, "--project-axes", str(out), *words]) != 0
    )
    assert why in " ".join(capsys.readouterr().err.split())
    assert not out.exists()
