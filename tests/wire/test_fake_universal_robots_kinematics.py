"""The fake controller's own kinematics against a pose captured from the maker's simulator."""

import math

import numpy as np
import pytest

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.arm_models import MODELS
from cellcal.fake_devices.universal_robots.frames import (
    frame_difference,
    frame_of,
    invert_frame,
    multiply_frames,
    pose_of,
    rotation_matrix,
    rotation_vector,
)
from cellcal.fake_devices.universal_robots.kinematics import UrArmKinematics, factory_calibration

# URSim 5.8, UR5e: joints and the TCP pose it reported
URSIM_JOINTS = (-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031)
URSIM_POSE = (
    -0.14396865671352163,
    -0.43562006080319216,
    0.2020300254283846,
    -0.0012213596815925638,
    3.1162765284819756,
    0.038891915636886834,
)


def test_forward_kinematics_agree_with_the_makers_simulator() -> None:
    chain = MODELS["ur5e"].dh_table()
    chain[:, 3] = np.round(chain[:, 3], 9)  # the controller writes pi/2 with ten digits
    arm = UrArmKinematics(factory_calibration(chain), chain)
    assert pose_of(arm.base_flange(URSIM_JOINTS)) == pytest.approx(URSIM_POSE, abs=1e-11)


@pytest.mark.parametrize("model", ["ur3e", "ur5e", "ur10", "ur10e"])
def test_the_calibration_with_distant_normals_is_the_same_arm(model: str) -> None:
    real = SimulatedArm.from_model(model, 11)
    arm = UrArmKinematics(factory_calibration(real.known_dh), real.nominal_dh)
    assert max(map(abs, arm.calibration.d_m)) > 5.0
    joints = np.random.default_rng(5).uniform(-6.0, 6.0, (50, 6))
    for q, expected_flange in zip(joints, real.believed_flange(joints), strict=True):
        assert np.array(arm.base_flange(q)) == pytest.approx(expected_flange[:3], abs=1e-10)


def test_inverse_kinematics_find_the_joints_back_and_know_what_is_out_of_reach() -> None:
    real = SimulatedArm.from_model("ur10e", 4)
    arm = UrArmKinematics(factory_calibration(real.known_dh), real.nominal_dh)
    for q in np.random.default_rng(6).uniform(-3.0, 3.0, (100, 6)):
        found = arm.solve_closest(arm.base_flange(q), tuple(q + 0.02))
        assert found is not None
        assert max(map(abs, frame_difference(arm.base_flange(found), arm.base_flange(q)))) < 1e-8
    assert arm.solve_closest(frame_of((5.0, 0.0, 0.0, 0.0, 0.0, 0.0)), (0.0,) * 6) is None


def test_the_jacobian_is_the_derivative() -> None:
    real = SimulatedArm.from_model("ur5e", 4)
    arm = UrArmKinematics(factory_calibration(real.known_dh), real.nominal_dh)
    q, h = np.array([0.3, -1.2, 1.4, -0.9, 1.1, 0.4]), 1e-6
    here = arm.base_flange(q)
    numeric = np.array([frame_difference(here, arm.base_flange(q + h * row)) for row in np.eye(6)]).T / h
    assert arm.tip_jacobian(q, [here[i][3] for i in range(3)]) == pytest.approx(numeric, abs=1e-5)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, 1e-3, 1.0, 3.0, math.pi - 1e-7, math.pi])
def test_rotation_vectors_survive_the_way_there_and_back(angle: float) -> None:
    for axis in ((1.0, 0.0, 0.0), (0.6, -0.8, 0.0), (2 / 3, 1 / 3, -2 / 3)):
        frame = rotation_matrix([angle * value for value in axis])
        back = rotation_matrix(rotation_vector(frame))
        assert np.array(multiply_frames(invert_frame(frame), back)) == pytest.approx(np.eye(4)[:3], abs=2e-8)
