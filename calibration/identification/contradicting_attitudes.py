"""Attitudes that a file holds beside measured places, and that were not measured with them."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.joint_kinds import PRISMATIC
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, log_rotation, mean_rotation
from cellcal.calibration.identification.cross_validation import (
    Grouping,
    assign_folds,
    compare_models,
    held_out_errors,
)
from cellcal.calibration.identification.estimator import FitProblem, errors_m
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.level_fit import fit_level
from cellcal.calibration.identification.lints import UNREPEATABLE_M, Lint
from cellcal.calibration.identification.observations import (
    Observations,
    PoseObservations,
    Rows,
    points_of_poses,
)
from cellcal.calibration.identification.parameters import GEOMETRY, Priors
from cellcal.calibration.identification.quick_fit import spread_rows
from cellcal.calibration.message import make_message

_MOST_ROWS = 120
_FOLDS = 5
_GAIN = 0.4  # of the held-out errors of places, without the attitudes
_ROUNDED = 1.5  # times what rounding leaves
_FINEST_RAD = 2e-5  # finer than an instrument reads, or an arm keeps to its nominal model
_COARSEST_RAD = 2e-4  # rounding beyond that hides what an arm does
_UNIFORM = 1 / np.sqrt(12.0)  # standard deviation of rounding, in steps
_ALTERNATIONS = 30


@dataclass(frozen=True, slots=True)
class AttitudeSteps:
    """To what joints and attitudes of a file are rounded."""

    joints_rad: Array  # (n,)
    attitude_rad: float


def contradicting_attitudes(
    model: RobotModel, observations: Observations, groups: Rows, steps: AttitudeSteps
) -> list[Lint]:
    """Say why attitudes cannot belong to the measured places; empty where they may.

    The nominal arm calculates them from the joints to within their rounding, or places of rows that were not fitted
    are predicted far better without the attitudes: those are of a controller, or of other rows.
    """
    if not isinstance(observations, PoseObservations):
        return []
    rows = spread_rows(len(observations), _MOST_ROWS)
    some = observations.select_rows(rows)
    if _are_calculated(model, some, steps):
        return [
            Lint(
                "attitudes",
                "the attitudes were left out: the nominal arm calculates them from the joints, to the last digit. No "
                "device reads that: they are the controller's own.",
            )
        ]
    try:
        with_them, without = (
            _predicted_m(model, each, groups[rows]) for each in (some, points_of_poses(some))
        )
    except (CalibrationError, np.linalg.LinAlgError):
        return []
    if np.median(with_them) < UNREPEATABLE_M:
        return []  # what is exact is rounded only: no row contradicts another
    better = compare_models(("", with_them), ("", without), groups[rows], least_gain=_GAIN).better
    if not better or np.median(without) > (1.0 - _GAIN) * np.median(with_them):
        return []
    both = [float(np.sqrt(np.mean(each**2))) * 1e3 for each in (without, with_them)]
    return [
        Lint(
            "attitudes",
            make_message(
                "the attitudes were left out: with them held-out places are predicted to {with_them:.3f} mm (RMSE), "
                "without them to {without:.3f} mm. They contradict the places: see whether they are the "
                "controller's, or of other rows.",
                with_them=both[1],
                without=both[0],
            ),
        )
    ]


def _are_calculated(model: RobotModel, poses: PoseObservations, steps: AttitudeSteps) -> bool:
    turning = np.array([kind != PRISMATIC for kind in model.kinds])
    squares = float((steps.joints_rad[turning] ** 2).sum()) + 3.0 * steps.attitude_rad**2
    rounding = float(np.sqrt(squares)) * _UNIFORM
    if rounding > _COARSEST_RAD:
        return False
    try:
        device_base = first_guess(model, points_of_poses(poses))[0].devices[0].device_base
    except CalibrationError:
        return False
    residual_rad = _attitudes_left_rad(
        device_base[:3, :3], model.base_flange(poses.joints_rad)[:, :3, :3], poses.rotations
    )
    return bool(np.median(residual_rad) < max(_ROUNDED * rounding, _FINEST_RAD))


def _attitudes_left_rad(device: Array, base_flange: Array, measured: Array) -> Array:
    """Return what turns of device and tool leave of attitudes (N, 3, 3) beside those of the arm (N,) [rad].

    ``device`` is where the device's turn is looked for from.
    """
    tool = np.eye(3)
    try:
        for _ in range(_ALTERNATIONS):
            tool = mean_rotation(np.swapaxes(device @ base_flange, 1, 2) @ measured)
            device = mean_rotation(measured @ np.swapaxes(base_flange @ tool, 1, 2))
    except CalibrationError:
        return np.full(len(measured), np.pi)
    residual_rad: Array = np.linalg.norm(
        log_rotation(np.swapaxes(device @ base_flange @ tool, 1, 2) @ measured), axis=1
    )
    return residual_rad


def _predicted_m(model: RobotModel, observations: Observations, groups: Rows) -> Array:
    """Return errors of places (N,) [m] by fits of the geometry to other rows."""
    places, priors = first_guess(model, observations)[0], Priors()
    folds = assign_folds(Grouping(np.unique(groups, return_inverse=True)[1], ""), _FOLDS, 0)

    def errors_without(training: Rows, held_rows: Rows) -> Array:
        state = fit_level(model, observations.select_rows(training), places, GEOMETRY, priors).fit.state
        return errors_m(state, FitProblem.from_observations(state, observations.select_rows(held_rows)))

    return held_out_errors(folds, errors_without)
