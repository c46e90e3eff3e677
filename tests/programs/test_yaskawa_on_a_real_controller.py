"""Yaskawa's angles and RCONF against 20 postures of a real robot: an AR2010 with a YRC1000.

Source: icors2/Yaskawa-Job-Helper (public), the postures of its calibration steps: jobs taught as pulses and saved
once more as X Y Z Rx Ry Rz with RCONF. Pulses per degree are the limits in pulses of that controller's RC.PRM over
the limits in degrees; tool 0 is from its TOOL.CND.
"""

import csv
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import homogeneous_matrix, inverse_transform
from cellcal.calibration.orientation import rotation_from
from cellcal.calibration.programs.branches import AxesAtZero, all_branches
from cellcal.drivers.yaskawa.program_files.configuration import JobConfigurations

POSTURES = Path(__file__).parents[1] / "data" / "yaskawa_ar2010_yrc1000.csv"
ROWS = list(csv.DictReader(POSTURES.read_text(encoding="utf-8").splitlines()))
MODEL = load_model("yaskawa_ar2010")
PULSES_PER_DEG = np.array([241449, 295690, 254863, 204573, 147036, 206914]) / [180, 155, 160, 200, 150, 455]
PULSES = np.array([[float(row[axis]) for axis in "SLURBT"] for row in ROWS])
JOINTS = np.deg2rad(PULSES / PULSES_PER_DEG)
SHOWN = np.array([[float(row[name]) for name in ("X", "Y", "Z", "Rx", "Ry", "Rz")] for row in ROWS])
TOOL_DEG, TOOL_MM = (0.0, -45.0, 0.0), (-88.687, 0.981, 463.147)
TEXTS = [",".join([*row["RCONF"].split(), *["0"] * 18]) for row in ROWS]


def controller_poses(convention: str, degrees, places_mm) -> np.ndarray:
    return homogeneous_matrix(rotation_from(convention, np.deg2rad(degrees)), np.asarray(places_mm) * 1e-3)


def flange_tool(convention: str = "yaskawa_rpy") -> np.ndarray:
    return controller_poses(convention, [TOOL_DEG], [TOOL_MM])[0]


def test_pulses_of_both_limits_agree_on_the_scale():
    """The controller's limits on the other side, for the axes whose sides differ."""
    assert np.allclose(np.array([200306, 136989]) / [105, 86], PULSES_PER_DEG[1:3], rtol=1e-4)


def test_joints_and_pose_are_one_posture():
    reached = MODEL.base_flange(JOINTS) @ flange_tool()
    shown = controller_poses("yaskawa_rpy", SHOWN[:, 3:], SHOWN[:, :3])
    assert np.abs(reached - shown)[:, :3, 3].max() < 1e-5
    assert np.rad2deg(np.abs(reached - shown)[:, :3, :3].max()) < 1e-3


@pytest.mark.parametrize("convention", ["staubli_rxryrz", "instrument_xyz"])
def test_no_other_order_of_the_same_angles_fits(convention):
    reached = MODEL.base_flange(JOINTS) @ flange_tool(convention)
    shown = controller_poses(convention, SHOWN[:, 3:], SHOWN[:, :3])
    assert np.rad2deg(np.abs(reached - shown)[:, :3, :3].max()) > 10


def test_rconf_says_each_posture_and_no_other_one():
    rule = JobConfigurations()
    assert rule.matches_postures(MODEL, JOINTS, TEXTS).all()
    assert rule.write_configurations(MODEL, JOINTS, TEXTS) == tuple(TEXTS)
    base_flange = controller_poses("yaskawa_rpy", SHOWN[:, 3:], SHOWN[:, :3]) @ inverse_transform(
        flange_tool()
    )
    branches = all_branches(AxesAtZero.from_model(MODEL), base_flange)
    for row, text in enumerate(TEXTS):
        some = branches[np.isfinite(branches[:, row]).all(axis=1), row]
        right = some[rule.matches_postures(MODEL, some, [text] * len(some), turns=False)]
        off = np.abs(np.angle(np.exp(1j * (right - JOINTS[row])))).max(axis=1)
        assert len(some) >= 4, "there is a choice"
        assert off.min() < np.deg2rad(0.02), ROWS[row]["posture"]
        rear = text.split(",")[2] == "1"  # where upper and lower arm are not told apart
        assert len(off) == 1 or (rear and len(off) == 2) or off.max() < np.deg2rad(0.02), ROWS[row]["posture"]


def test_an_older_controller_tells_flip_by_axis_r():
    rule, wrist = JobConfigurations(), JOINTS[:1]
    assert rule.matches_postures(MODEL, wrist, ["0,0,0,0,0,0,0,0"]).all()  # R near 0 is flip
    assert not rule.matches_postures(MODEL, wrist, ["1,0,0,0,0,0,0,0"]).any()
