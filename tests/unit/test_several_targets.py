"""Several targets on one flange in one fit: where they are, how surely, and what that is worth for a tool frame."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array, Pose, homogeneous_matrix
from cellcal.calibration.identification.layouts import make_layout, with_further
from cellcal.calibration.identification.parameters import GEOMETRY, ArmState, Priors
from cellcal.calibration.mastering.pose_design import candidate_joints
from cellcal.calibration.motion.motion_check import MotionLimits
from cellcal.calibration.points.end_effector import points_in_flange, refuse_tool_points, tool_through, tool_u
from cellcal.calibration.poses.arm_fit import (
    ArmTask,
    errors_at,
    fit_arm,
    further_target_points,
    point_covariance,
    predict_from_fit,
    predict_task,
    target_expanded_u,
    with_readings,
)
from cellcal.calibration.poses.measurement_prediction import TestPoses

POINTS = ((0.10, 0.0, 0.20), (-0.05, 0.08, 0.20), (-0.05, -0.08, 0.25))
WIRE = ArmTask("fanuc_m6ib", "length", 1e-4, (0.06, 0.05, 0.12), (0.9, -0.7, -0.45))
TRACKER = replace(WIRE, kind="point", anchor_in_base_m=(0.0, 0.0, 0.0))
JOINTS = candidate_joints(WIRE.nominal_model(), MotionLimits(), 90, seed=4)[:85]
TARGETS = np.array([0] * 40 + [1] * 15 + [2] * 15 + [3] * 15)


def _true_state(task: ArmTask, rng: np.random.Generator) -> ArmState:
    """Return an arm as its maker may build it, its device and targets a few millimetres off."""
    before = predict_task(task, JOINTS[:0])
    places = [p.role in ("tool", "anchor", "base") for p in before.layout.parameters]
    sizes = np.where(places, 0.004, before.layout.prior_sigmas)
    return before.layout.apply_step(before.state, sizes * rng.normal(size=len(before.layout)))


def _as_the_controller_has_it(state: ArmState) -> Array:
    """Return the further targets in the flange of the drawing, which turns with the true last axis (k, 3)."""
    drawn = state.nominal
    turn = state.arm_model.theta0_rad[-1] - drawn.theta0_rad[-1]
    about = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    last = (
        np.linalg.inv(drawn.placements[-1])
        @ homogeneous_matrix(about, np.zeros(3))
        @ state.arm_model.placements[-1]
    )
    return np.array([(last @ target)[:3, 3] for target in state.further])


@pytest.mark.parametrize("plain", [WIRE, TRACKER], ids=["wire", "tracker"])
def test_the_points_lie_within_the_stated_uncertainty(plain: ArmTask) -> None:
    task, rng, square = replace(plain, points_in_flange_m=POINTS), np.random.default_rng(7), []
    for _ in range(6):
        true = _true_state(task, rng)
        nothing = task.to_observations(JOINTS, np.zeros((len(JOINTS), task.channel_count)), TARGETS)
        values = -errors_at(true, nothing) + task.sigma_m * rng.normal(size=(task.channel_count, len(JOINTS)))
        robust = fit_arm(task, task.to_observations(JOINTS, values.T, TARGETS))
        off = (np.array(further_target_points(robust.fit.state)) - _as_the_controller_has_it(true)).ravel()
        covariance = point_covariance(predict_from_fit(task, robust))
        square.append(float(off @ np.linalg.solve(covariance, off)))
        assert np.sqrt(np.diag(covariance)).max() < 3e-4
    assert 0.2 < np.mean(square) / 9.0 < 2.0


def test_one_fit_knows_arm_and_points_no_worse_than_one_after_the_other() -> None:
    task, tests = replace(WIRE, points_in_flange_m=POINTS), TestPoses(JOINTS[::4])
    flange = with_readings(predict_task(task, JOINTS[:0]), JOINTS[:40], TARGETS[:40])
    together = with_readings(flange, JOINTS[40:], TARGETS[40:])
    assert target_expanded_u(together, tests)[0] < target_expanded_u(flange, tests)[0]
    alone = with_readings(predict_task(task, JOINTS[:0]), JOINTS[40:], TARGETS[40:])
    tool = Pose((0.0, 0.0, 0.2))
    joint, separate = (
        tool_u(tool, POINTS, point_covariance(each_fit), 2e-5) for each_fit in (together, alone)
    )
    assert joint[0] < separate[0]
    assert joint[1] < separate[1]


def test_several_targets_before_a_device_that_moves_are_refused() -> None:
    moved = make_layout(WIRE.nominal_model(), "length", 2, level=GEOMETRY)
    with pytest.raises(CalibrationError, match="one device that stays"):
        with_further(moved, 1, Priors())


def test_points_that_tell_no_frame_are_refused() -> None:
    refuse_tool_points(POINTS[:1])
    refuse_tool_points(POINTS)
    with pytest.raises(CalibrationError, match="two points"):
        refuse_tool_points(POINTS[:2])
    with pytest.raises(DegenerateDataError, match="nearly on one line"):
        refuse_tool_points(((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.005, 0.0)))


def test_one_point_moves_the_tool_and_does_not_turn_it() -> None:
    rough, point = Pose((0.0, 0.0, 0.2), (0.8, 0.0, 0.6, 0.0)), (0.03, 0.0, 0.01)
    found = tuple(v + 0.001 for v in points_in_flange(rough, (point,))[0])
    tool = tool_through(rough, (point,), (found,), np.eye(3) * 1e-8, 2e-5)
    assert tool.flange_tool.position_m == pytest.approx((0.001, 0.001, 0.201))
    assert (tool.flange_tool.quaternion, tool.placed, tool.angle_u_rad) == (rough.quaternion, None, 0.0)
    assert tool.tip_u_m == pytest.approx(2.0 * np.hypot(1e-4, 2e-5))
