"""A tool frame through points of the end-effector: where each was found in the flange, where it is from the tip.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, section 3.2: three
points that lie on no line give the whole tool frame; one gives x, y, z only.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.metres import MOST_OF_TOOL_M, refuse_not_metres
from cellcal.calibration.points.fixture import (
    PlacedPoints,
    Triple,
    place_points,
    placing_covariance,
    refuse_bad_points,
    worst_expanded_u,
)


@dataclass(frozen=True, slots=True)
class ToolThroughPoints:
    """A tool frame by its points, and how well it is known."""

    flange_tool: Pose
    tip_u_m: float  # k = 2, worst direction
    angle_u_rad: float  # k = 2, worst axis; 0 where it was not measured
    placed: PlacedPoints | None  # None with one point: the orientation is the rough frame's


def refuse_tool_points(points_in_tool_m: Sequence[Triple]) -> None:
    """Refuse points that do not tell a tool frame: two, or three and more (nearly) on one line.

    Raises
    ------
    CalibrationError
        With what to measure instead.
    """
    refuse_not_metres(points_in_tool_m, "points on the end-effector", MOST_OF_TOOL_M)
    if len(points_in_tool_m) == 2:
        raise CalibrationError(
            "two points leave the turn about their line open.",
            remedy="Give three points that lie on no line, or one for x, y, z only.",
        )
    if len(points_in_tool_m) > 2:
        refuse_bad_points(points_in_tool_m, "points on the end-effector")


def points_in_flange(rough_flange_tool: Pose, points_in_tool_m: Sequence[Triple]) -> tuple[Triple, ...]:
    """Return where the points roughly are in the flange [m]."""
    found = np.array(points_in_tool_m) @ rough_flange_tool.rotation_matrix().T + np.array(
        rough_flange_tool.position_m
    )
    return tuple((float(x), float(y), float(z)) for x, y, z in found)


def tool_through(
    rough_flange_tool: Pose,
    points_in_tool_m: Sequence[Triple],
    found_in_flange_m: Sequence[Triple],
    covariance_m2: Array,
    sigma_point_m: float,
) -> ToolThroughPoints:
    """Fit the tool frame to where its points were found; with one point, its place only.

    Parameters
    ----------
    covariance_m2 : (3n, 3n)
        Of the points found, x y z one after the other [m^2].
    sigma_point_m : float
        Standard uncertainty of drawing and seat, of one coordinate of one point [m].
    """
    if len(points_in_tool_m) > 1:
        placed = place_points(points_in_tool_m, found_in_flange_m, covariance_m2, sigma_point_m=sigma_point_m)
        return ToolThroughPoints(placed.outer_inner, placed.origin_u_m, placed.angle_u_rad, placed)
    away = rough_flange_tool.rotation_matrix() @ np.array(points_in_tool_m[0])
    x, y, z = (float(v) for v in np.array(found_in_flange_m[0]) - away)
    tip_u_m, _ = tool_u(rough_flange_tool, points_in_tool_m, covariance_m2, sigma_point_m)
    return ToolThroughPoints(Pose((x, y, z), rough_flange_tool.quaternion), tip_u_m, 0.0, None)


def tool_u(
    flange_tool: Pose, points_in_tool_m: Sequence[Triple], covariance_m2: Array, sigma_point_m: float
) -> tuple[float, float]:
    """Return U (k = 2) of tip [m] and axes [rad] as `tool_through` would state it; of the axes 0 with one point."""
    if len(points_in_tool_m) == 1:
        return worst_expanded_u(covariance_m2 + sigma_point_m**2 * np.eye(3)), 0.0
    covariance = placing_covariance(flange_tool, points_in_tool_m, covariance_m2, sigma_point_m)
    return worst_expanded_u(covariance[:3, :3]), worst_expanded_u(covariance[3:, 3:])
