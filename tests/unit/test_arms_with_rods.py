"""Rods that drive axis 3: the coupling of a parallelogram is exact, and what it lacks is stated, not hidden."""

import numpy as np
import pytest
from scipy.optimize import brentq

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.model_references import is_linkage
from cellcal.service.engineering.identification.identify import identify_file
from cellcal.service.engineering.identification.row_fit import IdentifyOptions
from tests.unit.helpers.hidden_arm import NOISE_M

ROBOT = "abb_irb2400"
UPPER_ARM_M, LEVER_M = 0.705, 0.25  # the second is a guess: no document tells it


def forearm_rad(motor_2, motor_3, longer_rod_m):
    """Return the forearm's angle to the upper arm (N,): a four-bar of motor lever, rod, forearm lever, upper arm.

    The lever of motor 3 keeps its direction to the base; with rod and levers equal the forearm is parallel to it.
    """
    found = []
    for q2, q3 in zip(motor_2, motor_3, strict=True):
        elbow = UPPER_ARM_M * np.array([np.sin(q2), np.cos(q2)])  # leaning forward, from axis 2
        behind = LEVER_M * np.array([-np.cos(q3), np.sin(q3)])  # of the motor's lever, backwards at zero

        def miss(turn, elbow=elbow, behind=behind):
            lever = LEVER_M * np.array([-np.cos(turn), np.sin(turn)])
            return np.linalg.norm(elbow + lever - behind) - UPPER_ARM_M - longer_rod_m

        found.append(brentq(miss, q3 - 0.05, q3 + 0.05, xtol=1e-14) - q2)
    return np.array(found)


def postures(model, count, seed):
    dice, low, high = np.random.default_rng(seed), 0.9 * model.lower_rad, 0.9 * model.upper_rad
    drawn = dice.uniform(low, high, (40 * count, model.axis_count))
    crossing = (
        np.pi / 2 + drawn[:, 2] - drawn[:, 1]
    )  # between lever and rod: no arm goes near to a dead centre
    return drawn[(crossing > 0.6) & (crossing < np.pi - 0.6)][:count]


def real_tips(model, joints, longer_rod_m):
    """Return where the target is (N, 3), the forearm turned by rods and not by the coupling of the model."""
    turned = joints.copy()
    turned[:, 2] = forearm_rad(joints[:, 1], joints[:, 2], longer_rod_m) + joints[:, 1]
    return model.tip_positions(turned, np.array([0.05, 0.03, 0.15]))


def test_a_parallelogram_is_the_coupling_of_the_catalogue():
    model = load_model(ROBOT)
    joints = postures(model, 30, 1)
    forearm = forearm_rad(joints[:, 1], joints[:, 2], 0.0)
    assert np.allclose(forearm, (model.joint_coupling @ joints.T)[2], atol=1e-9)
    assert np.allclose(model.joint_coupling[2], (0, -1, 1, 0, 0, 0))


@pytest.mark.parametrize("robot", ["abb_irb2400", "abb_irb4400l_30_243", "fanuc_m900ib700"])
def test_arms_with_rods_are_known(robot):
    assert is_linkage(robot)


def test_other_arms_have_none():
    assert not is_linkage("abb_irb6640")
    assert not is_linkage("ur10e@wall")


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """Identify an arm of exact rods, and one whose rod is half a millimetre long; both have the same tracker."""
    model, folder = load_model(ROBOT), tmp_path_factory.mktemp("rods")
    found = {}
    for longer_m in (0.0, 5e-4):
        joints = postures(model, 160, 2)
        noise = np.random.default_rng(3).normal(size=(len(joints), 3)) * NOISE_M
        table = np.column_stack([np.degrees(joints), (real_tips(model, joints, longer_m) + noise) * 1e3])
        path = folder / f"{longer_m * 1e6:.0f}.csv"
        heads = ",".join([*(f"J{i + 1} (deg)" for i in range(6)), "x (mm)", "y (mm)", "z (mm)"])
        np.savetxt(path, table, delimiter=",", header=heads, comments="", fmt="%.7f")
        found[longer_m] = identify_file(path, ROBOT, IdentifyOptions(train_rows=80))
    return found


def test_what_rods_leave_over_is_in_the_errors_held_out(reports):
    noise = NOISE_M * np.sqrt(3.0)
    assert reports[0.0].held_out.rmse_m < 1.1 * noise
    assert reports[5e-4].held_out.rmse_m > 1.5 * noise
    assert reports[5e-4].before.rmse_m > reports[5e-4].held_out.rmse_m


def test_it_is_said_that_rods_are_there_and_what_it_means(reports):
    for report in reports.values():
        (lint,) = [lint for lint in report.lints if lint.code == "linkage"]
        assert "accuracy that is left" in lint.message
