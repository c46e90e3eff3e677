"""Tables of external axes that cannot be used: one sentence that names the table, the cause and the cure."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.service.engineering.programs.project import read_project
from cellcal.service.engineering.programs.project_poses import ProjectError
from tests.programs.external.brands import BRANDS
from tests.programs.external.cells import HandCell, pose_text, rail, table
from tests.programs.external.hand_geometry import pose

TRACK = """[[track]]
name = "rail"
axis = "E1"
kind = "prismatic"
direction = [1, 0, 0]
coordinated = true
"""
TABLE = """[[positioner]]
name = "table"
axis = "E2"
kind = "revolute"
position_mm = [500, 0, 100]
coordinated = false
frames = ["2"]
"""


def read(tmp_path: Path, lines: str) -> object:
    path = tmp_path / "project.toml"
    path.write_text(HandCell(BRANDS["kuka"], ()).project_text() + lines, encoding="utf-8")
    return read_project(path).axes


def test_the_tables_themselves_are_right(tmp_path: Path) -> None:
    read(tmp_path, TRACK + TABLE)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('name = "rail"\n', "", "[[track]] 1: name is missing"),
        ('axis = "E1"', 'axis = "eax_a"', "no axis 'eax_a'"),
        ('axis = "E1"', 'axis = "E7"', "E1 to E6"),
        ('kind = "prismatic"', 'kind = "linear"', "prismatic for an axis that slides"),
        ('kind = "prismatic"\n', "", "kind is missing"),
        ("direction = [1, 0, 0]", "direction = [1, 1, 0]", "length 1.414, not 1"),
        ("direction = [1, 0, 0]", "direction = [0, 0, 0]", "length 0, not 1"),
        ("direction = [1, 0, 0]", "direction = [1, 0]", "3 finite numbers"),
        ("direction = [1, 0, 0]", "direction = [nan, 0, 0]", "not a finite number"),
        ("direction = [1, 0, 0]\n", "", "direction is missing"),
        ("coordinated = true", 'coordinated = "yes"', "neither true nor false"),
        ("coordinated = true\n", "", "coordinated is missing"),
        ("coordinated = true", "coordinated = true\nsign = 0", "1 or -1"),
        ("coordinated = true", "coordinated = true\nsign = true", "1 or -1"),
        ("coordinated = true", "coordinated = true\nlower_mm = 9\nupper_mm = 1", "Exchange the two"),
        ("coordinated = true", "coordinated = true\nlower_mm = 5\nupper_mm = 5", "is not below"),
        ("coordinated = true", "coordinated = true\nlower_deg = 5", "does not fit an axis of kind prismatic"),
        ("coordinated = true", "coordinated = true\nzero_deg = 5", "Write zero_mm"),
        ("coordinated = true", "coordinated = true\nzero_mm = inf", "finite number"),
        ("coordinated = true", "coordinated = true\npulses_per_mm = 0", "is zero"),
        ("coordinated = true", "coordinated = true\npulses_per_deg = 8", "Write pulses_per_mm"),
        ("coordinated = true", 'coordinated = true\nframes = ["2"]', "carries the robot"),
        ("coordinated = true", "coordinated = true\nspeed = 3", "unknown speed"),
        ("coordinated = true", 'coordinated = true\nidentified = "none.toml"', "cannot be read"),
        ("coordinated = true", "coordinated = true\nreal = { scale = 2.0 }", "no error of an axis"),
        ('axis = "E2"', 'axis = "e1"', "two external axes have the axis E1"),
        ('name = "table"', 'name = "rail"', "two external axes have the name rail"),
        ('frames = ["2"]\n', "", "frames is missing"),
        ('frames = ["2"]', "frames = [2]", "list of user frames"),
        ('coordinated = false\nframes = ["2"]', 'coordinated = true\nframes = ["7"]', "[frames.7]"),
        ('coordinated = false\nframes = ["2"]', 'coordinated = true\nframes = ["*"]', "names none"),
        ("[[positioner]]", "[positioner]", "list of tables"),
    ],
)
def test_a_table_that_cannot_be_used(old: str, new: str, says: str, tmp_path: Path) -> None:
    lines = TRACK + TABLE
    assert old in lines
    with pytest.raises(ProjectError) as refused:
        read(tmp_path, lines.replace(old, new, 1))
    assert says in f"{refused.value.message} {refused.value.remedy}"
    assert "project.toml" in refused.value.message or "none.toml" in refused.value.message


def test_an_axis_in_the_unit_of_the_other_kind_leaves_its_points(tmp_path: Path) -> None:
    from cellcal.drivers.program_registry import brand_named
    from cellcal.service.engineering.programs.move import move_transfer

    spelling = BRANDS["fanuc"]
    cell = HandCell(spelling, (rail(spelling),))
    text = spelling.write(cell.points([{"E1": 100.0}]), spelling.frame).replace("100.000000 mm", "100.0 deg")
    brand = brand_named("fanuc")
    program = brand.read(spelling.file, text.encode())
    result = move_transfer(cell.project(tmp_path), np.eye(4), brand.configurations).transfer_programs(
        [program]
    )[0]
    assert "in deg" in result.reason[0]
    assert "prismatic" in result.reason[0]


def test_a_table_turns_a_frame_that_the_project_states_from_its_axis(tmp_path: Path) -> None:
    spelling = BRANDS["kuka"]
    axis = table(spelling)
    project = HandCell(spelling, (axis,), frame=axis.frame).project(tmp_path)
    assert np.allclose(project.frames["2"], axis.frame)
    assert np.allclose(project.table_frames["2"], axis.frame)


@pytest.mark.parametrize("heading", ["track", "positioner"])
@pytest.mark.parametrize("key", ["position", "orientation", "direction", "both", "zero"])
def test_what_is_not_stated_of_an_identified_axis_is_as_entered(
    tmp_path: Path, heading: str, key: str
) -> None:
    """A place alone took the axes of the cell for its own, and a turn alone the origin: up to 300 mm at a point."""
    entered_pose, real_pose = (
        pose((0.6, 0.05, 0.1), (0.1, -0.2, 0.4)),
        pose((0.601, 0.05, 0.1), (0.1, -0.2, 0.402)),
    )
    place, turn = pose_text(real_pose).splitlines()
    slides = heading == "track"
    lines = f'[[{heading}]]\nname = "axis"\naxis = "E1"\nkind = "{"prismatic" if slides else "revolute"}"\n'
    lines += f"{pose_text(entered_pose)}direction = [0, 0.6, 0.8]\ncoordinated = false\n"
    lines += "" if slides else 'frames = ["2"]\n'
    lines += f"[{heading}.real]\n"
    lines += {
        "position": place,
        "orientation": turn,
        "direction": "direction = [0, 0.64, 0.76837490]",
        "both": f"{place}\n{turn}",
        "zero": f"zero_{'mm' if slides else 'deg'} = 0.5",
    }[key]
    (axis,) = read(tmp_path, lines + "\n").axes  # type: ignore[attr-defined]

    frame = entered_pose.copy()
    if key in ("position", "both"):
        frame[:3, 3] = real_pose[:3, 3]
    if key in ("orientation", "both"):
        frame[:3, :3] = real_pose[:3, :3]
    direction = np.array([0, 0.64, 0.76837490]) if key == "direction" else np.array([0, 0.6, 0.8])
    assert np.allclose(axis.real.origin_m, frame[:3, 3], atol=1e-12)
    assert np.allclose(axis.real.direction, frame[:3, :3] @ direction, atol=1e-6)
    assert axis.real.zero == pytest.approx(0.0 if key != "zero" else 0.5e-3 if slides else np.radians(0.5))


def test_an_identified_axis_that_points_elsewhere_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ProjectError) as refused:
        read(tmp_path, TRACK + "real = { direction = [0, 1, 0] }\n")
    assert "[[track]] 1 (rail): the identified axis points 90.0 deg away" in str(refused.value)
