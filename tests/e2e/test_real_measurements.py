"""Files of real robots, as their owners published them, through the command and with nothing told but the robot."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.machine_speed import stretched_s

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared" / "data"
COPIES = ROOT / "tests" / "data"
JOINT_SERIES = "ipa_ur10/series_b_joint_configurations.csv"
RANDOM_SERIES = "ipa_ur10/series_c_random_poses_first_1400.csv"
KEYS = [
    "robot",
    "level",
    "rows",
    "before",
    "fit",
    "held_out",
    "check",
    "breaks",
    "rejected",
    "not_identified",
    "seconds",
]

# file, robot, options, largest held-out RMSE and mean (mm)
CASES = [
    (JOINT_SERIES, "ur10", ["--train-rows", "600"], None, 0.335),
    (RANDOM_SERIES, "ur10", ["--train-rows", "600", "--seed", "1"], None, 0.435),
    ("robotcali/abb_irb120_draw_wire.csv", "abb_irb120", [], 0.275, None),
    ("figaroh_ur10/calibration.csv", "ur10e", [], 4.3, None),  # half a minute: in `make soak`
]


def locate_file(name):
    """Only the UR10 series may be copied; the others are read where they lie, if they are there."""
    return next((folder / name for folder in (SHARED, COPIES) if (folder / name).is_file()), None)


def identify_file(path, robot, *options):
    command = [sys.executable, "-m", "cellcal", "identify", str(path), "--robot", robot, *options, "--json"]
    done = subprocess.run(
        command,
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=stretched_s(280.0),
        check=False,
        env=dict(os.environ),
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("name", "robot", "options", "rmse_mm", "mean_mm"),
    [
        pytest.param(*case, marks=[pytest.mark.soak] if case[0].startswith("figaroh") else [])
        for case in CASES
        if locate_file(case[0])
    ],
)
def test_held_out_rows_of_a_real_robot_are_predicted(name, robot, options, rmse_mm, mean_mm):
    found = identify_file(locate_file(name), robot, *options)
    assert list(found)[: len(KEYS)] == KEYS
    assert found["held_out"]["n"] == found["before"]["n"]
    if options:
        assert found["held_out"]["n"] == found["rows"] - 600
        assert found["fit"]["n"] <= 600
    if rmse_mm is not None:
        assert found["held_out"]["rmse_m"] <= rmse_mm * 1e-3
    if mean_mm is not None:
        assert found["held_out"]["mean_m"] <= mean_mm * 1e-3
        assert found["held_out"]["mean_m"] < 0.5 * found["before"]["mean_m"]
    if "draw_wire" in name:
        assert {140, 506} <= set(found["breaks"])
        notes = {lint["code"]: lint for lint in found["lints"]}
        assert {744, 939} <= set(notes["sign"]["rows"])
        assert 950 in notes["controller_rows"]["rows"]
        assert len({(fold["level"], *fold["breaks"]) for fold in found["folds"]}) > 1
        assert "J1 offset" in {item["parameter"] for item in found["not_identified"]}
    if "figaroh" in name:
        assert found["level"] == 0  # no model improves the position of rows that it has not seen
        # The choice itself is judged, too: without some rows it is another one, and no better.
        assert 0.9 * found["before"]["rmse_m"] < found["held_out"]["rmse_m"]


def test_the_finished_model_is_checked_on_another_series():
    found = identify_file(
        locate_file(JOINT_SERIES), "ur10", "--level", "3", "--check", str(locate_file(RANDOM_SERIES))
    )
    assert found["check"]["n"] == 1400
    assert found["check"]["mean_m"] < 0.75e-3
    assert found["check"]["mean_m"] < found["before"]["mean_m"]
    assert "extrapolation" in {lint["code"] for lint in found["lints"]}
