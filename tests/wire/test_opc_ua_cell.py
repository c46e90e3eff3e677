"""A cell with a robot of any maker: what `cellcal check` says of it, and what it is not offered for."""

from pathlib import Path

import pytest

from cellcal.procedures.catalogue import DEFINITIONS
from cellcal.procedures.procedure_definition import missing_needs
from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.runs.open_cell import offline_cell
from cellcal.service.watching.watch_coverage import describe_coverage
from tests.wire.fake_devices_process import run_fakes

CELL = """\
[cell]
name = "any maker"
data_dir = "{folder}"

[[robot]]
name = "any_maker"
driver = "opc_ua"
address = "{address}"
model = "fanuc_m6ib"
motion = "observe"
serial = "ER-230817"
deadline_s = 4.0
still_s = 0.1

[fake]
seed = 1
control_port = 0
"""


def test_check_shows_what_stands_behind_each_ability_and_what_was_not_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with run_fakes(tmp_path, CELL) as (path, _):
        assert run_command_line(["check", str(path)]) == 0
        table = " ".join(capsys.readouterr().err.split())
        assert run_command_line(["check", str(path), "--json"]) == 0
        text = capsys.readouterr().out
    assert "any_maker: 0 of 9 abilities are confirmed on a robot." in table
    assert "Example Robotics ER-16 ER-16/2.0, serial ER-230817, MotionWare 2.7.1." in text
    assert "the joints were not compared with the model" in text


def test_no_procedure_that_compares_joints_with_a_model_is_offered(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(CELL.format(folder=tmp_path, address="127.0.0.1"), encoding="utf-8")
    config = read_cell_file(path)
    cell = offline_cell(config)
    lacks = {entry.name: missing_needs(entry, cell) for entry in DEFINITIONS}
    for name in (
        "robot_calibration",
        "accuracy_check",
        "drift_check",
        "fixture_alignment",
        "end_effector_points",
    ):
        assert "a controller that shows where its flange is" in lacks[name]
    for name in (
        "mastering_record",
        "mastering_recovery",
        "position_cure",
        "six_point_tcp",
        "three_point_frame",
    ):
        assert lacks[name]
    assert "a lost position is NOT seen" in describe_coverage(config.robot_named().capabilities)
