"""How surely the tool's tip is where it is shown: an ellipsoid from what the journal keeps, for one posture.

Two parts add up: the taught tip in the flange (from its touches), and the arm's own parameters (from its
calibration). A part that was not measured is named, never guessed.
"""

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import numpy as np
from pydantic import TypeAdapter

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.message import make_message
from cellcal.calibration.poses.arm_fit import predict_from_fit
from cellcal.calibration.poses.measurement_prediction import TestPoses
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.stored_results import JournalledResult, newest_stored_result
from cellcal.service.review.arm_review import ArmSeries, fit_of
from cellcal.service.review.review_models import ReviewError, TipUncertainty
from cellcal.service.review.reviewer import Reviewer

COVERAGE = 2.0
TOOL, ARM = "tool", "arm"


def tip_uncertainty(
    config: CellConfig, reviewer: Reviewer, robot: str, joints_rad: Sequence[float]
) -> TipUncertainty:
    """Return what is known of the tool's tip at a posture.

    Raises
    ------
    ReviewError
        As many joints as the robot does not have.
    """
    entry = config.robot_named(robot)
    model, joints = load_model(entry.model), np.asarray(joints_rad, dtype=float)
    if joints.shape != (model.axis_count,) or not np.isfinite(joints).all():
        raise ReviewError(
            make_message("{robot} has {axis_count} joints.", robot=robot, axis_count=model.axis_count),
            remedy="Load the page again.",
        )
    tool = newest_stored_result(config, entry.serial, "tool_frame")
    arm = newest_stored_result(config, entry.serial, "parameter_set")
    tip = _tip_in_flange(tool, arm)
    found: dict[str, Array] = {}
    if tool is not None:
        turn = model.base_flange(joints[None])[0][:3, :3]
        found[TOOL] = turn @ _tip_covariance(tool.value) @ turn.T
    if arm is not None:
        found[ARM] = _of_arm(reviewer, arm, joints, tip)
    shape: EllipsoidShape = _ellipsoid_to_json(sum(found.values(), np.zeros((3, 3)))) if found else {}
    runs = tuple(result.run_id for result in (tool, arm) if result is not None)
    return TipUncertainty(tuple(joints.tolist()), tip, tuple(found), runs=runs, **shape)


def _tip_in_flange(tool: JournalledResult | None, arm: JournalledResult | None) -> tuple[float, float, float]:
    """Return the tip in the flange; without a taught tool the target that the arm was calibrated with."""
    if tool is not None:
        x, y, z = tool.value["flange_tool"]["position_m"]
    elif arm is not None:
        x, y, z = arm.value["target_in_flange_m"]
    else:
        x, y, z = 0.0, 0.0, 0.0
    return float(x), float(y), float(z)


def _tip_covariance(tool: Mapping[str, Any]) -> Array:
    """Return the covariance (3, 3) of a tool's tip in the flange, whichever procedure found it [m^2]."""
    if "tip" in tool:
        return np.array(tool["tip"]["tip_covariance_m2"])
    if tool["placed"] is None:  # only its worst direction is told
        return np.asarray(np.eye(3) * (tool["tip_u_m"] / COVERAGE) ** 2)
    pose: Pose = TypeAdapter(Pose).validate_python(tool["flange_tool"])
    turn = pose.rotation_matrix()  # the covariance is along the tool's own axes
    found: Array = turn @ np.array(tool["placed"]["covariance"])[:3, :3] @ turn.T
    return found


def _of_arm(
    reviewer: Reviewer, arm: JournalledResult, joints: Array, tip: tuple[float, float, float]
) -> Array:
    """Return the covariance (3, 3) of the tip by the arm's parameters, among the postures of the work [m^2]."""
    series = reviewer.load_series(arm.run_id)
    assert isinstance(series, ArmSeries)
    prediction = predict_from_fit(series.task, fit_of(series, series.signed_choice()))
    postures = np.vstack([series.tests_rad, joints])
    rows = TestPoses(postures, tip).tool_point_rows(prediction)[:, :, -1]
    found: Array = rows.T @ np.linalg.inv(prediction.information) @ rows
    return found


class EllipsoidShape(TypedDict, total=False):
    """Semi-axes [m] of an ellipsoid, and their directions in the base as a matrix, row by row."""

    semi_axes_m: tuple[float, ...]
    base_ellipsoid: tuple[float, ...]


def _ellipsoid_to_json(covariance_m2: Array) -> EllipsoidShape:
    values, axes = np.linalg.eigh(covariance_m2)
    axes = axes[:, ::-1]
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    sizes = COVERAGE * np.sqrt(np.maximum(values[::-1], 0.0))
    return {
        "semi_axes_m": tuple(float(size) for size in sizes),
        "base_ellipsoid": tuple(float(v) for v in axes.ravel()),
    }
