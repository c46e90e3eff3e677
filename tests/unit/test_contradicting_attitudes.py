"""Attitudes beside measured places that are the controller's own, or of another arm, take no part."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import exp_rotation, log_rotation, quaternion_from_rotation
from cellcal.calibration.identification.contradicting_attitudes import (
    AttitudeSteps,
    contradicting_attitudes,
)
from cellcal.service.engineering.identification.identify import IdentifyOptions, identify_file
from tests.unit.helpers.simulated_arm import TOOL, TRACKER, tracker_poses

NAME = "abb_irb120"
MODEL = load_model(NAME)
EXACT = AttitudeSteps(np.zeros(MODEL.axis_count), 0.0)


def nominal_turns(poses):
    return TRACKER[:3, :3] @ MODEL.base_flange(poses.joints_rad)[:, :3, :3] @ TOOL[:3, :3]


def notes(poses, steps=EXACT):
    return [lint.message for lint in contradicting_attitudes(MODEL, poses, np.arange(len(poses)), steps)]


@pytest.mark.parametrize("count", [8, 14, 40, 150])
def test_measured_attitudes_stay(count: int) -> None:
    for seed in (1, 2, 3):
        assert notes(tracker_poses(NAME, count, seed=seed).observations) == []


@pytest.mark.parametrize("noise_deg", [0.05, 0.5, 1.5])
def test_coarsely_measured_attitudes_stay(noise_deg: float) -> None:
    assert notes(tracker_poses(NAME, 40, sigma_rad=float(np.deg2rad(noise_deg))).observations) == []


@pytest.mark.parametrize("count", [8, 40])
def test_attitudes_that_the_nominal_arm_calculates_are_left_out(count: int) -> None:
    poses = tracker_poses(NAME, count).observations
    (message,) = notes(replace(poses, rotations=nominal_turns(poses)))
    assert "the nominal arm calculates them" in message


def test_attitudes_calculated_before_rounding_are_left_out() -> None:
    poses, step = tracker_poses(NAME, 40).observations, float(np.deg2rad(0.01))
    joints = np.round(poses.joints_rad / step) * step
    rounded = replace(poses, joints_rad=joints, rotations=nominal_turns(poses))
    (message,) = notes(rounded, AttitudeSteps(np.full(MODEL.axis_count, step), 0.0))
    assert "the nominal arm calculates them" in message


def test_attitudes_of_an_arm_with_other_errors_are_left_out() -> None:
    poses, other = (tracker_poses(NAME, 40, seed=seed) for seed in (1, 7))
    turns = other.truth.seen_from(0).base_flange(poses.observations.joints_rad)[:, :3, :3]
    (message,) = notes(replace(poses.observations, rotations=turns))
    assert "contradict the places" in message


def test_exact_attitudes_that_are_rounded_stay() -> None:
    for seed in range(6):
        true = tracker_poses(NAME, 60, seed=seed)
        poses = true.truth.seen_from(0).base_flange(true.observations.joints_rad)
        turns = np.array([exp_rotation(np.round(log_rotation(turn), 7)) for turn in poses[:, :3, :3]])
        places = np.round(poses[:, :3, 3], 9)
        assert notes(replace(true.observations, positions_m=places, rotations=turns)) == []


def test_a_file_with_the_controllers_attitudes_is_fitted_to_its_places(tmp_path: Path) -> None:
    poses = tracker_poses(NAME, 40).observations
    numbers = [
        np.rad2deg(poses.joints_rad),
        poses.positions_m * 1e3,
        quaternion_from_rotation(nominal_turns(poses)),
    ]
    path = tmp_path / "rows.csv"
    rows = [",".join(f"{number:.6f}" for number in row) for row in np.column_stack(numbers)]
    heading = ",".join([*(f"J{i}" for i in range(1, 7)), *"XYZ", "qw", "qx", "qy", "qz"])
    path.write_text("\n".join([heading, *rows, ""]), encoding="utf-8")
    found = identify_file(path, NAME, IdentifyOptions(level=2))
    assert [lint.code for lint in found.lints] == ["attitudes"]
    assert found.measurements.convention == ""
    assert found.held_out.rmse_m < 1.6 * 5e-5 * np.sqrt(3)
