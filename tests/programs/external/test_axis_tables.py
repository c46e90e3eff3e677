"""Tables of external axes that cannot be used: one sentence that names the table, the cause and the cure."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.service.engineering.programs.project import read_project
from cellcal.service.engineering.programs.project_poses import ProjectError
from tests.programs.external.brands import BRANDS
from tests.programs.external.cells import HandCell, rail, table

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
