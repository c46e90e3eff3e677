"""Simulated calibrations by one device, as `cellcal identify` does them: one function a kind."""

import numpy as np

from cellcal.calibration.geometry import Array, exp_rotation
from cellcal.calibration.identification.estimator import FitProblem, estimate_arm
from cellcal.calibration.identification.frame_fits import fit_frames
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.observations import (
    DevicePlacement,
    LengthObservations,
    Observations,
    PointObservations,
    PoseObservations,
)
from cellcal.calibration.identification.parameters import GEOMETRY, ArmState, ParameterLayout
from cellcal.calibration.identification.robust import fit_robustly
from cellcal.calibration.identification.tip_uncertainty import predict_tips
from cellcal.calibration.uncertainty import coverage_factor
from tests.soak.coverage_arms import (
    ANCHOR,
    CHECKED,
    PRIORS,
    SIGMA_RAD,
    TOOL,
    TRACKER,
    Calibration,
    CalibrationScore,
    DrawnArm,
    DrawnNoise,
    small_difference,
)


def point(rng: np.random.Generator, found: bool) -> CalibrationScore:
    """Positions of one target in the frame of a tracker."""
    arm, noise = DrawnArm.draw(rng), DrawnNoise.draw(rng, found)
    truth = ArmState(arm.model, arm.errors, (), np.zeros(0), TOOL, (DevicePlacement(TRACKER, np.zeros(3)),))
    joints = arm.draw_joints(rng, 20)
    measured_m = truth.seen_from(0).base_flange(joints)[:, :3, 3] + noise(len(joints), 3)
    return _score_alone(
        truth, PointObservations(joints, measured_m, *noise.stated_rows(len(joints))), rng, found
    )


def pose(rng: np.random.Generator, found: bool) -> CalibrationScore:
    """Full poses of one target in the frame of a camera."""
    arm, noise = DrawnArm.draw(rng), DrawnNoise.draw(rng, found)
    truth = ArmState(arm.model, arm.errors, (), np.zeros(0), TOOL, (DevicePlacement(TRACKER, np.zeros(3)),))
    joints = arm.draw_joints(rng, 12)
    there = truth.seen_from(0).base_flange(joints)
    turned = exp_rotation(noise(len(joints), 3, sigma=SIGMA_RAD)) @ there[:, :3, :3]
    positions = there[:, :3, 3] + noise(len(joints), 3)
    stated = noise.stated_rows(len(joints))
    observations = PoseObservations(joints, positions, *stated, turned, np.full(len(joints), SIGMA_RAD))
    return _score_alone(truth, observations, rng, found)


def length(rng: np.random.Generator, found: bool) -> CalibrationScore:
    """Lengths of one draw-wire whose anchor, zero and scale are unknown."""
    arm, noise = DrawnArm.draw(rng), DrawnNoise.draw(rng, found)
    zero, scale = rng.standard_normal(2) * [PRIORS.wire_zero_m, PRIORS.wire_scale]
    device = DevicePlacement(np.eye(4), ANCHOR, float(zero), 1.0 + float(scale))
    truth = ArmState(arm.model, arm.errors, (), np.zeros(0), TOOL, (device,))
    joints = arm.draw_joints(rng, 60)
    free = np.linalg.norm(arm.true_tips(joints) - device.anchor_in_base_m, axis=1)
    lengths = device.zero_m + device.scale * free + noise(len(joints))
    return _score_alone(
        truth, LengthObservations(joints, lengths, *noise.stated_rows(len(joints))), rng, found
    )


KINDS: dict[str, Calibration] = {"length": length, "point": point, "pose": pose}


def _score_alone(
    truth: ArmState, observations: Observations, rng: np.random.Generator, found: bool
) -> CalibrationScore:
    """Fit one device's rows, and score parameters and tips."""
    start = fit_frames(truth.nominal, observations, ()).state
    layout = make_layout(truth.nominal, observations.kind, 1, level=GEOMETRY, priors=PRIORS)
    problem, factor = FitProblem.from_observations(start, observations), 2.0
    if found:
        robust = fit_robustly(layout, start, problem)
        fit, factor = robust.fit, coverage_factor(robust.degrees_of_freedom)
    else:
        fit = estimate_arm(layout, start, problem)
    off = layout.prior_deviations(truth) - layout.prior_deviations(fit.state)
    _put_values(
        off, layout, "base", small_difference(fit.state.devices[0].device_base, truth.devices[0].device_base)
    )
    _put_values(
        off, layout, "anchor", truth.devices[0].anchor_in_base_m - fit.state.devices[0].anchor_in_base_m
    )
    _put_values(off, layout, "tool", small_difference(fit.state.flange_tool, truth.flange_tool))
    joints = rng.uniform(-1.2, 1.2, (CHECKED, truth.nominal.axis_count))
    predicted_tips, there = (
        predict_tips(fit, joints, mounting=0),
        truth.seen_from(0).base_flange(joints)[:, :3, 3],
    )
    spread = np.sqrt(np.diagonal(predicted_tips.covariance_m2, axis1=1, axis2=2))
    return CalibrationScore(
        tuple(parameter.name for parameter in layout.parameters),
        off / np.sqrt(np.diag(fit.covariance)),
        ((there - predicted_tips.positions_m) / spread).reshape(-1),
        factor,
    )


def _put_values(off: Array, layout: ParameterLayout, role: str, values: Array) -> None:
    at = [i for i, parameter in enumerate(layout.parameters) if parameter.role == role]
    off[at] = values[: len(at)]
