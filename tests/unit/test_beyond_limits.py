"""Joints far beyond their limits are named: another zero of an outer joint does not show in a fit."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.identification.lints import beyond_limits
from tests.unit.helpers.simulated_arm import random_joints

SCARA = load_model("mitsubishi_rh6frh5520")


def limit_messages(model, joints):
    return [lint.message for lint in beyond_limits(model, joints)]


@pytest.mark.parametrize("name", ["ur10e", "kuka_lbr_iiwa14_r820", "mitsubishi_rh6frh5520", "fanuc_m6ib"])
def test_joints_within_their_limits_and_a_little_beyond_are_not_named(name: str) -> None:
    model = load_model(name)
    joints = random_joints(model, np.random.default_rng(1), 30, reach=9.0)
    overrun = np.where(model.upper_rad > 1.0, np.deg2rad(5.0), 0.0)
    assert limit_messages(model, joints) == []
    assert limit_messages(model, np.stack([model.upper_rad + overrun, model.lower_rad - overrun])) == []


def test_a_last_joint_with_another_zero_is_named_with_its_rows() -> None:
    model = load_model("kuka_lbr_iiwa14_r820")
    joints = np.zeros((10, 7))
    joints[3:, 6] = np.deg2rad(190.0)
    (lint,) = beyond_limits(model, joints)
    assert lint.rows == tuple(range(3, 10))
    assert "from 0.0 to 190.0 deg" in lint.message


def test_a_slide_beyond_its_travel_is_named_in_millimetres() -> None:
    joints = np.tile([0.0, 0.0, 0.4, 0.0], (5, 1))
    (message,) = limit_messages(SCARA, joints)
    assert "400.0 mm" in message
    assert "133.0 and 333.0" in message


def test_coupled_joints_are_not_judged() -> None:
    model = load_model("fanuc_m6ib")
    joints = np.zeros((4, 6))
    joints[:, 2] = 6.0
    assert limit_messages(model, joints) == []
    assert limit_messages(replace(model, joint_coupling=np.eye(6)), joints) != []


def test_joints_counted_from_0_to_360_degrees_are_those_within_the_limits() -> None:
    model = load_model("yaskawa_gp7")
    joints = random_joints(model, np.random.default_rng(1), 30, reach=2.0) % (2 * np.pi)
    assert limit_messages(model, joints) == []
