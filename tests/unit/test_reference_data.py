"""Shipped reference problems: made again by an independent solver, met by ours, in any unit, world and order."""

import numpy as np
import pytest

from calibration.compensation import compensate
from calibration.errors import CalibrationError
from calibration.frames import frame_from_six_points, frame_from_three_points
from calibration.geometry import Pose, exp_rotation, homogeneous
from calibration.kinematics import DhTable, RobotModel
from calibration.reference_data import load_reference, reference_names
from calibration.registration import best_fit_transform
from calibration.tool_point import locate_tool_point
from tests.unit.helpers import reference_solver

WORLD = homogeneous(exp_rotation(np.array([0.4, -1.9, 1.2])), np.array([2.5, -1.5, 0.7]))


def numbers(value):
    return np.array(value, dtype=float)


def carried(points, world=WORLD):
    return (numbers(points) @ world[:3, :3].T + world[:3, 3]).tolist()


def reference(name):
    document = load_reference(name)
    return document["given"], {k: numbers(v) for k, v in document["answers"].items()}, document["tolerance"]


def arm(rows):
    turn = np.full(6, 2 * np.pi)
    return RobotModel.from_dh(
        DhTable.from_rows(numbers(rows)), name="reference", lower_rad=-turn, upper_rad=turn
    )


def test_every_file_is_made_and_no_other():
    assert set(reference_names()) == set(reference_solver._SOLVERS)
    with pytest.raises(CalibrationError, match="no reference data set"):
        load_reference("../robot_models/ur10")


@pytest.mark.parametrize("name", reference_names())
def test_the_independent_solver_makes_the_answers_again(name):
    document = load_reference(name)
    again = reference_solver.answers(name, document["given"])
    assert again.keys() == document["answers"].keys()
    for key, value in again.items():
        assert np.abs(numbers(value) - numbers(document["answers"][key])).max() < 1e-20 or (
            value == document["answers"][key]
        )


def test_frames_on_points():
    given, answers, tolerance = reference("plane")
    three = frame_from_three_points(*given["three_points_m"]).base_frame.matrix()
    six = six_point_frame(given["six_points_m"])
    assert np.abs(three - answers["three_point_frame"]).max() < tolerance
    assert np.abs(six - answers["six_point_frame"]).max() < tolerance


def six_point_frame(points):
    return frame_from_six_points(points[:3], points[3:5], points[5], above_m=points[6]).base_frame.matrix()


def test_frames_follow_the_unit_and_the_world():
    given, answers, _ = reference("plane")
    metres = six_point_frame(given["six_points_m"])
    millimetres = six_point_frame((numbers(given["six_points_m"]) * 1e3).tolist())
    assert np.allclose(millimetres[:3, 3], metres[:3, 3] * 1e3, atol=1e-9)
    assert np.allclose(millimetres[:3, :3], metres[:3, :3], atol=1e-12)
    turned = frame_from_three_points(*carried(given["three_points_m"])).base_frame.matrix()
    assert np.allclose(turned, WORLD @ answers["three_point_frame"], atol=1e-12)
    assert np.allclose(six_point_frame(carried(given["six_points_m"])), WORLD @ metres, atol=1e-12)


def test_best_fit_of_noisy_points():
    given, answers, tolerance = reference("registration")
    fit = best_fit_transform(given["source_m"], given["target_m"])
    assert np.abs(fit.target_source.matrix() - answers["target_source"]).max() < tolerance
    assert fit.rms_m == pytest.approx(float(answers["rms_m"]), rel=1e-9)


def test_best_fit_in_another_unit_world_and_order():
    given, answers, _ = reference("registration")
    source, target = numbers(given["source_m"]), numbers(given["target_m"])
    order = np.random.default_rng(1).permutation(len(source))
    mixed = best_fit_transform(source[order].tolist(), target[order].tolist())
    assert np.allclose(mixed.target_source.matrix(), answers["target_source"], atol=1e-12)
    large = best_fit_transform((source * 1e3).tolist(), (target * 1e3).tolist())
    assert large.rms_m == pytest.approx(float(answers["rms_m"]) * 1e3, rel=1e-9)
    assert np.allclose(large.target_source.rotation(), answers["target_source"][:3, :3], atol=1e-12)
    turned = best_fit_transform(source.tolist(), carried(target))
    assert np.allclose(turned.target_source.matrix(), WORLD @ answers["target_source"], atol=1e-12)


def test_tool_point_of_noisy_touches():
    given, answers, tolerance = reference("tool_point")
    found = locate_tool_point([Pose.from_matrix(numbers(touch)) for touch in given["touches"]])
    assert np.abs(np.array(found.tip_in_flange_m) - answers["tip_in_flange_m"]).max() < tolerance
    assert np.abs(np.array(found.pin_in_base_m) - answers["pin_in_base_m"]).max() < tolerance
    assert found.rms_m == pytest.approx(float(answers["rms_m"]), rel=1e-9)


def test_tool_point_in_another_unit_world_and_order():
    given, answers, _ = reference("tool_point")
    touches = numbers(given["touches"])
    turned = locate_tool_point([Pose.from_matrix(WORLD @ touch) for touch in touches[::-1]])
    assert np.allclose(turned.tip_in_flange_m, answers["tip_in_flange_m"], atol=1e-12)
    assert np.allclose(
        turned.pin_in_base_m, WORLD[:3, :3] @ answers["pin_in_base_m"] + WORLD[:3, 3], atol=1e-12
    )
    scaled = touches.copy()
    scaled[:, :3, 3] *= 1e3
    large = locate_tool_point([Pose.from_matrix(touch) for touch in scaled])
    assert np.allclose(large.tip_in_flange_m, answers["tip_in_flange_m"] * 1e3, atol=1e-9)


def test_flange_of_a_dh_chain_with_beta():
    given, answers, tolerance = reference("dh")
    flanges = arm(given["rows"]).base_flange(numbers(given["joints_rad"]))
    for i, flange in enumerate(flanges):
        assert np.abs(flange - answers[f"flange_{i}"]).max() < tolerance


def test_compensated_joints():
    given, answers, tolerance = reference("compensation")
    real, nominal, joints = arm(given["real"]), arm(given["nominal"]), numbers(given["joints_rad"])
    done = compensate(real, nominal, joints)
    expected = np.array([answers[f"joints_{i}"] for i in range(len(joints))])
    assert done.converged.all()
    assert np.abs(done.joints_rad - expected).max() < tolerance
    assert np.abs(joints - expected).max() > 1e-3, "the problem is worth solving"
    # The answers put the real flange where the nominal one is.
    apart = np.abs(real.base_flange(expected) - nominal.base_flange(joints)).max()
    assert apart < 1e-14


def test_compensated_joints_do_not_depend_on_the_unit_of_length():
    given, answers, tolerance = reference("compensation")
    scale = np.array([1, 10, 10, 1, 1])
    real, nominal = arm(numbers(given["real"]) * scale), arm(numbers(given["nominal"]) * scale)
    done = compensate(real, nominal, numbers(given["joints_rad"])[::-1])
    expected = np.array([answers[f"joints_{i}"] for i in range(len(done.joints_rad))])[::-1]
    assert np.abs(done.joints_rad - expected).max() < tolerance
