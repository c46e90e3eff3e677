"""A payload that is changed within a series is named with its row; what only moves or scatters is not one."""

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.sag_change import find_sag_change
from cellcal.calibration.identification.selection import IdentificationOptions

COUNT = 70
TARGET_M = np.array([0.05, 0.03, 0.12])


def turned(angle):
    frame = np.eye(4)
    frame[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return frame


def joint_frames(model, angles):
    frame, frames = model.placements[0], []
    for angle, placement in zip(angles, model.placements[1:], strict=True):
        frames.append(frame @ turned(angle))
        frame = frames[-1] @ placement
    return frames, (frame @ np.append(TARGET_M, 1.0))[:3]


def sagging_tip(model, joints_rad, rad_per_metre):
    """Return the place of the target of an arm whose second and third joints give way to a weight at the target."""
    angles = joints_rad + model.theta0_rad
    frames, tip = joint_frames(model, angles)
    for joint in (1, 2):
        axis, origin = frames[joint][:3, 2], frames[joint][:3, 3]
        angles[joint] -= rad_per_metre * np.cross(axis, tip - origin)[2]
    return joint_frames(model, angles)[1]


@pytest.mark.parametrize(("times", "drift_m"), [(1.6, 0.0), (1.0, 0.0), (1.0, 1e-3)])
def test_a_payload_changed_half_way_is_named_and_a_device_that_drifts_is_none(times, drift_m):
    model, random = load_model("ur10"), np.random.default_rng(8)
    joints_rad = random.uniform(-2.0, 2.0, (COUNT, 6))
    sag = np.where(np.arange(COUNT) < COUNT // 2, 1.0, times) * 1e-3
    places_m = np.array([sagging_tip(model, row, each) for row, each in zip(joints_rad, sag, strict=True)])
    places_m += random.normal(0.0, 3e-5, (COUNT, 3)) + drift_m * np.linspace(0.0, 1.0, COUNT)[:, None]
    rows = PointObservations(joints_rad, places_m, np.full(COUNT, 3e-5), np.zeros(COUNT, dtype=int))
    found = identify_arm(model, rows, options=IdentificationOptions(judge=False, level=3, find_breaks=False))
    notes = find_sag_change(found, np.arange(100, 100 + COUNT))
    assert [note.code for note in notes] == (["payload"] if times > 1.0 else [])
    assert all(abs(note.rows[0] - 100 - COUNT // 2) <= 2 for note in notes)
