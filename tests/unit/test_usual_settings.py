"""[robot.usual]: what the cell file answers to settings, in every place where settings are asked for or told."""

import json
from pathlib import Path

import numpy as np
import pytest

from cellcal.procedures.fixture_alignment import FixtureAlignment
from cellcal.procedures.six_point_tcp import SixPointTcp
from cellcal.service.cli.app import run_command_line as main
from cellcal.service.configuration.cell_file import ConfigError, read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.runs.run_preview import ClassOutOfReachError, refuse_class_out_of_reach
from cellcal.service.runs.settings import build_spec, chosen_by_cell
from tests.unit.helpers.usual_settings_file import with_usual

POINTS = [[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [0.0, 0.4, 0.0], [0.3, 0.2, 0.3]]
USUAL = f"""
[robot.usual.six_point_tcp]
tool_number = 3
arm_sigma_m = 0.0001
accuracy_class = "A"
[robot.usual.fixture_alignment]
fixture = "door jig"
points_in_fixture_m = {POINTS}
rough_base_fixture = {{ position_m = [0.9, -0.2, -0.1] }}
rules = {{ samples = 30 }}
"""


@pytest.fixture
def plain_cell_file(tmp_path: Path) -> Path:
    return write_cell_file(tmp_path, "127.0.0.9", seed=3, time_factor=50.0)


@pytest.fixture
def demo_cell_file(plain_cell_file: Path) -> Path:
    """The demo's cell file, whose first robot has usual settings."""
    return with_usual(plain_cell_file, USUAL)


def test_a_run_takes_what_the_cell_file_says_and_its_own_word_goes_first(demo_cell_file: Path) -> None:
    config = read_cell_file(demo_cell_file)
    usual = build_spec(config, "fanuc", "six_point_tcp", {})
    assert isinstance(usual, SixPointTcp)
    assert (usual.tool_number, usual.arm_sigma_m, usual.accuracy_class) == (3, 0.0001, "A")
    spec = build_spec(config, "fanuc", "six_point_tcp", {"tool_number": 4})
    assert (spec.tool_number, spec.arm_sigma_m) == (4, 0.0001)


def test_a_partly_stated_group_keeps_the_procedures_other_defaults(demo_cell_file: Path) -> None:
    config = read_cell_file(demo_cell_file)
    spec = build_spec(config, "fanuc", "fixture_alignment", {})
    assert isinstance(spec, FixtureAlignment)
    np.testing.assert_allclose(spec.rough_base_fixture.position_m, [0.9, -0.2, -0.1])
    typed = build_spec(config, "fanuc", "fixture_alignment", {"rules": {"samples": 30}})
    assert spec.rules == typed.rules


def test_another_robot_has_its_own(demo_cell_file: Path) -> None:
    config = read_cell_file(demo_cell_file)
    assert "tool_number" not in chosen_by_cell(config, "ur", "six_point_tcp")


@pytest.mark.parametrize(
    ("tables", "key", "says"),
    [
        ("[robot.usual.six_point_tpc]\ntool_number = 3", "six_point_tpc", "did you mean 'six_point_tcp'?"),
        ("[robot.usual.six_point_tcp]\ntool_numbr = 3", "tool_numbr", "did you mean 'tool_number'?"),
        ("[robot.usual.six_point_tcp]\ntool_number = true", "tool_number", "no numbers"),
        ("[robot.usual.six_point_tcp]\narm_sigma_m = nan", "arm_sigma_m", "finite"),
        ("[robot.usual.six_point_tcp]\narm_sigma_m = 3.0", "arm_sigma_m", "0.01"),
        ("[robot.usual.six_point_tcp]\nwrite_anyway = 'because'", "write_anyway", "one run"),
        ("[robot.usual.mastering_recovery]\nlast_counts = [0, 0, 0, 0, 0, 0]", "last_counts", "one run"),
        ("[robot.usual.simulation_cell]\nmeasured = 'x.csv'", "measured", "file of one run"),
        ("[robot.usual]\nsix_point_tcp = 3", "usual", "[robot.usual.PROCEDURE]"),
    ],
)
def test_nonsense_is_named_with_its_key(plain_cell_file: Path, tables: str, key: str, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_cell_file(with_usual(plain_cell_file, tables))
    ((where, sentence),) = caught.value.faults
    assert where.startswith("robot[0].usual")
    assert where.endswith(key)
    assert says in sentence


def test_a_class_of_the_file_must_be_within_reach_as_one_that_is_typed(demo_cell_file: Path) -> None:
    with pytest.raises(ClassOutOfReachError):
        refuse_class_out_of_reach(read_cell_file(demo_cell_file), "six_point_tcp", {})


def test_the_terminal_shows_the_defaults_of_the_cell(
    demo_cell_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["procedures", "six_point_tcp", "--cell", str(demo_cell_file), "--json"]) == 0
    default_by_name = {
        each["name"]: each["default"] for each in json.loads(capsys.readouterr().out)["settings"]
    }
    assert (default_by_name["tool_number"], default_by_name["arm_sigma_m"]) == ("3", "0.0001")
