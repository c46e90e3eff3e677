"""The tool frame that a calibration found beside the arm: from the places of its points in the same fit."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Pose
from cellcal.calibration.identification.robust import RobustFit
from cellcal.calibration.points.end_effector import tool_through
from cellcal.calibration.points.fixture import PlacedPoints, Triple
from cellcal.calibration.poses.arm_fit import (
    ArmTask,
    errors_at,
    further_target_points,
    point_covariance,
    predict_from_fit,
    predicted_sigma,
    reading_sigma,
)
from cellcal.procedures.arm.arm_bench import ArmCapture, observations_of, of_target
from cellcal.procedures.arm.predicted_errors import PredictedErrors
from cellcal.procedures.arm.tool_plan import ToolGoal


@dataclass(frozen=True, slots=True)
class PointChecks(PredictedErrors):
    """Errors of readings of the points at poses that took no part in the fit, a coordinate [m]."""

    captures: int
    rms_m: float
    max_m: float
    chi_square: float  # against what was predicted
    degrees_of_freedom: int


@dataclass(frozen=True, slots=True)
class FoundTool:
    """The tool frame in the flange as the controller has it, with all that may be believed of it."""

    flange_tool: Pose
    covariance: tuple[
        tuple[float, ...], ...
    ]  # of its right twist (v, w) [m, rad]; with one point of its place only
    tip_u_m: float  # k = 2, worst direction
    angle_u_rad: float  # k = 2, worst axis; 0 where it was not measured
    placed: PlacedPoints | None  # None with one point: the orientation is the rough frame's
    points_in_flange_m: tuple[Triple, ...]
    captures: tuple[int, ...]  # of each point
    checks: PointChecks


def find_tool(
    task: ArmTask,
    goal: ToolGoal,
    robust: RobustFit,
    captures: tuple[ArmCapture, ...],
    checks: tuple[ArmCapture, ...],
) -> FoundTool:
    """Return the tool frame through the points as the fit of everything has them."""
    points, covariance = (
        further_target_points(robust.fit.state),
        point_covariance(predict_from_fit(task, robust)),
    )
    tool = tool_through(goal.rough_flange_tool, goal.points_in_tool_m, points, covariance, goal.point_sigma_m)
    alone = covariance + goal.point_sigma_m**2 * np.eye(len(covariance))
    turn = tool.flange_tool.rotation_matrix()
    own = turn.T @ alone @ turn if tool.placed is None else np.array(tool.placed.covariance)
    return FoundTool(
        flange_tool=tool.flange_tool,
        covariance=tuple(tuple(float(v) for v in row) for row in own),
        tip_u_m=tool.tip_u_m,
        angle_u_rad=tool.angle_u_rad,
        placed=tool.placed,
        points_in_flange_m=points,
        captures=tuple(len(of_target(captures, k)) for k in range(1, 1 + len(points))),
        checks=_check_points(task, robust, checks),
    )


def _check_points(task: ArmTask, robust: RobustFit, checks: tuple[ArmCapture, ...]) -> PointChecks:
    observations = observations_of(task, checks)
    errors = errors_at(robust.fit.state, observations)
    variances = np.zeros(len(observations))
    for target in np.unique(observations.mounting):
        rows = observations.mounting == target
        variances[rows] = predicted_sigma(robust.fit, task, observations.joints_rad[rows], int(target))
    sigma = np.hypot(variances, reading_sigma(task, robust))
    return PointChecks(
        captures=len(checks),
        rms_m=float(np.sqrt(np.mean(errors**2))),
        max_m=float(np.linalg.norm(errors, axis=0).max()),
        chi_square=float(((errors / sigma) ** 2).sum()),
        degrees_of_freedom=int(errors.size),
    )
