"""Measurements of an arm with known errors, for tests of the identification."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import exp_twist, homogeneous_matrix
from cellcal.calibration.identification.observations import (
    DevicePlacement,
    LengthObservations,
    PointObservations,
    pose_from_points,
)
from cellcal.calibration.identification.parameters import ArmState, nominal_state

TOOL = homogeneous_matrix(np.eye(3), np.array([0.05, -0.04, 0.12]))
TRACKER = exp_twist(np.array([1.5, -0.8, 0.3, 0.2, -0.4, 1.1]))
ANCHOR = np.array([0.9, -0.7, -0.4])


@dataclass(frozen=True, eq=False)
class SimulatedMeasurements:
    """Observations and the truth behind them."""

    model: RobotModel
    observations: object
    truth: ArmState
    tips_m: np.ndarray


def dh_errors(model, rng, *, length_m=4e-4, angle_deg=0.03, offset_deg=0.15):
    return rng.standard_normal((model.axis_count, 5)) * np.array(
        [np.deg2rad(offset_deg), length_m, length_m, np.deg2rad(angle_deg), np.deg2rad(angle_deg)]
    )


def random_joints(model, rng, count, *, reach=2.0):
    low, high = np.maximum(model.lower_rad, -reach), np.minimum(model.upper_rad, reach)
    return rng.uniform(low, high, (count, model.axis_count))


def true_state(model, rng, devices):
    state = nominal_state(model, devices, TOOL)
    return ArmState(model, dh_errors(model, rng), (), np.zeros(0), state.flange_tool, devices)


def tracker_points(robot="ur10", count=100, *, seed=1, sigma_m=5e-5, joints=None):
    model, rng = load_model(robot), np.random.default_rng(seed)
    truth = true_state(model, rng, (DevicePlacement(TRACKER, np.zeros(3)),))
    joints = random_joints(model, rng, count) if joints is None else joints
    tips = truth.seen_from(0).base_flange(joints)[:, :3, 3]
    measured_m = tips + sigma_m * rng.standard_normal(tips.shape)
    once = np.zeros(len(joints), dtype=np.intp)
    return SimulatedMeasurements(
        model, PointObservations(joints, measured_m, np.full(len(joints), sigma_m), once), truth, tips
    )


def tracker_poses(robot="ur10", count=60, *, seed=1, sigma_m=5e-5, sigma_rad=1e-4):
    points = tracker_points(robot, count, seed=seed, sigma_m=sigma_m)
    rng = np.random.default_rng(seed + 1000)
    frames = points.truth.seen_from(0).base_flange(points.observations.joints_rad)
    twists = np.concatenate([np.zeros((count, 3)), sigma_rad * rng.standard_normal((count, 3))], axis=1)
    rotations = frames[:, :3, :3] @ exp_twist(twists)[:, :3, :3]
    observations = pose_from_points(points.observations, rotations, np.full(count, sigma_rad))
    return SimulatedMeasurements(points.model, observations, points.truth, points.tips_m)


def wire_lengths(robot="fanuc_m6ib", count=120, *, seed=1, sigma_m=5e-5, anchors=(ANCHOR,), breaks=()):
    model, rng = load_model(robot), np.random.default_rng(seed)
    devices = tuple(DevicePlacement(np.eye(4), np.asarray(anchor)) for anchor in anchors)
    truth = true_state(model, rng, devices)
    joints = random_joints(model, rng, count, reach=1.2)
    tips = truth.seen_from(0).base_flange(joints)[:, :3, 3]
    mounting = np.searchsorted(np.asarray(breaks), np.arange(count), side="right")
    places = np.array([device.anchor_in_base_m for device in devices])[mounting]
    lengths = np.linalg.norm(places - tips, axis=1) + sigma_m * rng.standard_normal(count)
    once = np.zeros(count, dtype=np.intp)
    return SimulatedMeasurements(
        model, LengthObservations(joints, lengths, np.full(count, sigma_m), once), truth, tips
    )
