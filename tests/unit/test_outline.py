"""Dry runs and lists: from the cell file and the journal alone, with every cable pulled."""

import json
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.errors import CellError
from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.exit_codes import ExitCode
from cellcal.service.runs.run_preview import (
    ClassOutOfReachError,
    dry_run,
    list_procedures,
    refuse_class_out_of_reach,
)
from cellcal.service.runs.settings import spec_of

POINTER = {"frame_number": 2, "tip_in_flange_m": [0.0, 0.0, 0.1]}


@pytest.fixture
def config(tmp_path: Path) -> CellConfig:
    """A cell at whose address there is no listener."""
    return read_cell_file(write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=600.0))


def test_a_mastering_record_is_planned_with_every_cable_pulled(config: CellConfig) -> None:
    found = dry_run(config, "mastering_record", {"poses": 20})
    assert (found.lacks, found.problem) == ((), "")
    assert found.forecast is not None
    assert [pose.label for pose in found.forecast.poses] == [f"pose {k}" for k in range(1, 21)]
    joints = np.array([pose.joints_rad for pose in found.forecast.poses])
    assert np.isfinite(joints).all()
    assert 300 < found.forecast.duration_s < 7200
    turns, new_zero, *kits = found.forecast.predictions
    assert "motor exchanged" in new_zero.name
    assert all("kit" in kit.name and "by hand" in kit.sentence for kit in kits)
    assert "chance that all lost turns are found" in turns.sentence
    assert any("gears" in line for line in found.forecast.assumed)
    assert any("not checked" in line for line in found.forecast.not_checked)
    assert not config.cell.data_dir.exists()  # a dry run leaves nothing behind


def test_slower_means_longer(config: CellConfig) -> None:
    slow, fast = (
        dry_run(config, "mastering_record", {"poses": 20, "room": {"tip_speed_m_s": speed}}).forecast
        for speed in (0.02, 0.05)
    )
    assert slow is not None
    assert fast is not None
    assert slow.duration_s > 1.5 * fast.duration_s


def test_a_recovery_without_a_record_says_what_it_lacks(config: CellConfig) -> None:
    found = dry_run(config, "mastering_recovery", {})
    assert any("mastering record" in line for line in found.lacks)
    assert found.forecast is None
    assert "measurements decide" not in found.problem
    assert found.expected_steps > 30


def test_what_another_robot_of_the_cell_lacks(config: CellConfig) -> None:
    fanuc = {entry.name: entry.lacks for entry in list_procedures(config)}
    ur = {entry.name: entry.lacks for entry in list_procedures(config, "ur")}
    assert fanuc["mastering_record"] == ()
    assert ur["mastering_record"] is not None
    assert "access to encoder counts and mastering" in ur["mastering_record"]
    assert ur["six_point_tcp"] == ("access to the tool frames",)
    assert {entry.lacks for entry in list_procedures(None)} == {None}


def test_the_device_that_a_cell_has_is_the_one_that_measures(config: CellConfig) -> None:
    checked = dry_run(config, "accuracy_check", {})  # a draw-wire, no tracker
    assert (checked.settings["method"], checked.lacks) == ("wire", ())
    assert checked.forecast is not None
    assert dry_run(config, "accuracy_check", {"method": "tracker"}).lacks  # who asks for one is told


@pytest.mark.parametrize(
    ("room", "words"),
    [
        ({"wire_low": 0.9, "wire_high": 0.2}, r"\(room\): wire_low must be below wire_high"),
        (
            {"box_low_m": [0, 0, 1], "box_high_m": [1, 1, 0.5]},
            r"\(room\): box_low_m must be below box_high_m",
        ),
    ],
)
def test_a_margin_that_crosses_the_limits_is_refused(
    config: CellConfig, room: dict[str, object], words: str
) -> None:
    with pytest.raises(CellError, match=words):
        dry_run(config, "mastering_record", {"room": room})


def test_an_undo_needs_a_run_that_wrote(config: CellConfig) -> None:
    lacks = {entry.name: entry.lacks for entry in list_procedures(config)}
    assert lacks["mastering_undo"] == ("a mastering that an earlier run wrote",)


def test_more_touches_tell_more(config: CellConfig) -> None:
    few, many = (
        dry_run(config, "six_point_tcp", {"tool_number": 1, "max_touches": most, "arm_sigma_m": 0.0}).forecast
        for most in (4, 12)
    )
    assert few is not None
    assert many is not None
    assert many.predictions[0].expanded < 0.4 * few.predictions[0].expanded
    assert "C" in many.predictions[0].classes_in_reach()


def test_a_class_that_cannot_be_proved_is_refused_with_those_that_can(config: CellConfig) -> None:
    sharp = POINTER | {"sigma_m": 0.0001}
    refuse_class_out_of_reach(config, "three_point_frame", sharp)  # none was chosen
    refuse_class_out_of_reach(config, "three_point_frame", sharp | {"accuracy_class": "C"})
    with pytest.raises(ClassOutOfReachError, match="In reach: C"):
        refuse_class_out_of_reach(config, "three_point_frame", sharp | {"accuracy_class": "B"})
    own = {"origin_m": 0.001, "angle_rad": 0.01}
    refuse_class_out_of_reach(config, "three_point_frame", sharp | {"accuracy_class": "B", "limits": own})


def test_the_commands_print_it(config: CellConfig, capsys: pytest.CaptureFixture[str]) -> None:
    cell = str(config.path)
    words = ("run", "three_point_frame", "--cell", cell, "--set", "frame_number=2")
    tip = ("--set", "tip_in_flange_m=[0,0,0.1]")
    assert run_command_line([*words, *tip, "--dry-run"]) == ExitCode.PASS
    output = capsys.readouterr().out
    for part in ("No device was touched", "lacks nothing", "touch the origin", "Duration", "U = ", "Assumed"):
        assert part in output
    assert run_command_line([*words, *tip, "--dry-run", "--json"]) == ExitCode.PASS
    document = json.loads(capsys.readouterr().out)
    assert document["phases"][0] == {
        "name": "read the user frame",
        "repeats": None,
        "adaptive": False,
        "steps": 1,
    }
    assert run_command_line([*words, *tip, "--set", "accuracy_class=A"]) == ExitCode.REFUSED
    assert "cannot be proved" in " ".join(capsys.readouterr().err.split())
    assert run_command_line(["run", "mastering_recovery", "--cell", cell, "--dry-run"]) == ExitCode.REFUSED
    assert "lacks: a mastering record" in capsys.readouterr().out
    assert run_command_line(["procedures", "--cell", cell, "--json"]) == ExitCode.PASS
    document = json.loads(capsys.readouterr().out)
    listed = {row["name"]: row["lacks"] for row in document["procedures"]}
    assert listed["mastering_record"] == []
    assert listed["mastering_recovery"]
    assert "encoder counts and mastering: a lost position is seen" in document["watched"]["fanuc"]
    assert "a lost position is NOT seen" in document["watched"]["ur"]
    assert run_command_line(["procedures", "--cell", cell, "--robot", "ur"]) == ExitCode.PASS
    assert "`cellcal watch` sees of ur: its stops and faults only." in " ".join(
        capsys.readouterr().out.split()
    )
    assert run_command_line([*words, "--set", "tip_in_flange_m=[0,0,1e999]", "--dry-run"]) == ExitCode.USAGE


@pytest.mark.parametrize(
    "wrong",
    [
        {"frame_number": True},
        {"tip_in_flange_m": [0, 0, False]},
        {"limits": {"origin_m": True, "angle_rad": 1.0}},
    ],
)
def test_true_and_false_are_no_numbers_of_a_setting(wrong: dict[str, object]) -> None:
    right: dict[str, object] = {"frame_number": 1, "tip_in_flange_m": [0, 0, 0.2], "check_above": True}
    assert spec_of("three_point_frame", right).check_above
    with pytest.raises(CellError, match=f"{next(iter(wrong))}.*true and false are no numbers"):
        spec_of("three_point_frame", right | wrong)


def test_a_list_leaves_out_what_belongs_to_controllers_of_another_kind(
    config: CellConfig, tmp_path: Path
) -> None:
    mastering = {"mastering_recovery", "mastering_record", "mastering_undo"}
    at_pendant = {"position_cure", "position_record"}
    kuka = tmp_path / "kuka.toml"
    kuka.write_text(
        '[cell]\nname = "k"\ndata_dir = "k"\n[[robot]]\nname = "k"\ndriver = "kuka_variables"\naddress = "127.0.0.1"\n'
        'model = "kuka_kr10r1420"\nserial = "1"\nfastest_axis_deg_s = 410.0\nmotion = "observe"\n'
        "speed_limit_rad_s = 0.3\n"
    )
    for cell, robot, absent in (
        (config, "fanuc", at_pendant),
        (config, "ur", at_pendant),
        (read_cell_file(kuka), "k", mastering),
    ):
        rows = list_procedures(cell, robot)
        assert {row.name for row in rows if row.for_other_controllers} == absent
    assert not any(row.for_other_controllers for row in list_procedures(None))
