"""User frames: from three points, from six, from many; and what a moved frame does to recorded points.

Letters of the textbook: R base, UF user frame, UF' the same frame after the move or in the second cell,
Fix fixture.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import (
    Array,
    Pose,
    exp_twist,
    homogeneous_matrix,
    inverse_transform,
    log_transform,
    skew_matrix,
)
from cellcal.calibration.message import make_message
from cellcal.calibration.metres import refuse_not_metres
from cellcal.calibration.registration import RigidFit, best_fit_transform
from cellcal.calibration.uncertainty import chi_square_limit

Triple = tuple[float, float, float]

MIN_DISTANCE_M = 0.02
_SURELY_DOWN = 0.5  # of the vertical: a frame on a slope is no mistake
MIN_OPENING_RAD = math.radians(5.0)


@dataclass(frozen=True, slots=True)
class TaughtFrame:
    """A frame constructed from points, with the uncertainty that the points' own gives it."""

    base_frame: Pose
    opening_rad: float  # angle between the x direction and the direction to the third point
    x_length_m: float  # from the first point to the one on x
    origin_sigma_m: Triple  # standard, along the frame's axes; zeros where the points' sigma was not given
    rotation_sigma_rad: Triple  # standard, about the frame's axes
    rms_m: float = 0.0  # of what the points miss their line and plane by; zero with three
    redundancy: int = 0  # how many points there are to spare, as degrees of freedom


def frame_from_three_points(
    origin_m: Sequence[float],
    on_x_m: Sequence[float],
    on_xy_m: Sequence[float],
    *,
    above_m: Sequence[float] | None = None,
    origin_at_m: Sequence[float] | None = None,
    sigma_m: float = 0.0,
) -> TaughtFrame:
    """Construct a frame from its origin, a point on +x and a point in the half plane of +y.

    Parameters
    ----------
    origin_m, on_x_m, on_xy_m : points
        In the base frame [m].
    above_m : point, optional
        Any point known to lie on the +z side: catches two points taught in the wrong order.
    origin_at_m : point, optional
        Where the origin shall be, keeping the axes (the makers' four-point method).
    sigma_m : float
        Standard uncertainty of one coordinate of one point [m].

    Raises
    ------
    DegenerateDataError
        Points closer than `MIN_DISTANCE_M`, or within `MIN_OPENING_RAD` of one line.
    CalibrationError
        The check point lies below the plane, or a coordinate is not finite.

    Notes
    -----
    Independent errors of the points are carried through the construction by its Jacobian.
    """
    points = _check_points(origin_m, on_x_m, on_xy_m, *(() if origin_at_m is None else (origin_at_m,)))
    x, side = points[1] - points[0], points[2] - points[0]
    length, reach = float(np.linalg.norm(x)), float(np.linalg.norm(side))
    if min(length, reach) < MIN_DISTANCE_M:
        raise DegenerateDataError(
            make_message("two points are only {length:.1f} mm apart.", length=min(length, reach) * 1000.0),
            remedy="Teach points far apart: the frame turns by point error / distance.",
        )
    opening = math.atan2(float(np.linalg.norm(np.cross(x, side))), float(x @ side))
    if min(opening, math.pi - opening) < MIN_OPENING_RAD:
        raise DegenerateDataError(
            make_message(
                "the three points lie on one line: opening {opening:.1f} degrees.",
                opening=math.degrees(opening),
            ),
            remedy="Teach the third point well away from the x axis.",
            condition=1.0 / max(math.sin(opening), 1e-300),
        )
    matrix = _three_point_matrix(points)
    if above_m is not None:
        _refuse_below(matrix, above_m)
    return _construct_frame(_three_point_matrix, points, sigma_m, opening, length)


def is_pointing_down(base_frame: Pose, up_in_base: Sequence[float]) -> bool:
    """Return whether +z of a frame points against a direction that is up, by 30 degrees or more below the horizontal.

    Where z is known to be up, two of the three points that made such a frame are swapped: each swap turns z over.
    """
    up = np.asarray(up_in_base, dtype=float)
    upward = float(base_frame.rotation_matrix()[:, 2] @ up) / max(float(np.linalg.norm(up)), 1e-12)
    return upward < -_SURELY_DOWN


class PointsDisagreeError(CalibrationError):
    """Points miss the line and the plane that they should lie on."""


def frame_from_more_points(
    origins_m: Sequence[Sequence[float]],
    on_x_m: Sequence[Sequence[float]],
    in_plane_m: Sequence[Sequence[float]],
    *,
    above_m: Sequence[float] | None = None,
    sigma_m: float,
) -> TaughtFrame:
    """Fit a frame to touches of its origin, of points on +x and of its x-y plane by least squares.

    A touch of the origin misses (0, 0, 0), a point on x misses y = z = 0, a point of the plane misses
    z = 0; the squares of all misses are made least by Gauss-Newton from the frame of three of the points.

    Parameters
    ----------
    origins_m, on_x_m, in_plane_m : points
        In the base frame, one or more each; the first of them as for `frame_from_three_points` [m].
    above_m : point, optional
        Any point known to lie on the +z side.
    sigma_m : float
        Standard uncertainty of one coordinate of one point [m], above zero.

    Raises
    ------
    DegenerateDataError
        The first three points fix no frame.
    PointsDisagreeError
        The points miss line and plane by more than ``sigma_m`` explains at 99.9 %.
    CalibrationError
        One on +x is behind the origin.
    """
    first = frame_from_three_points(origins_m[0], on_x_m[0], in_plane_m[0], sigma_m=sigma_m)
    points = _check_points(*origins_m, *on_x_m, *in_plane_m)
    line = slice(len(origins_m), len(origins_m) + len(on_x_m))
    misses = np.zeros((len(points), 3), dtype=bool)
    misses[:, 2] = True
    misses[: line.stop, 1] = True
    misses[: line.start, 0] = True
    matrix = first.base_frame.to_matrix()
    for _ in range(20):
        local = (points - matrix[:3, 3]) @ matrix[:3, :3]
        jacobian = miss_rows(local)[misses]
        covariance = np.linalg.inv(jacobian.T @ jacobian)
        step = -covariance @ jacobian.T @ local[misses]
        matrix = matrix @ exp_twist(step)
        if np.abs(step).max() < 1e-13:
            break
    local = (points - matrix[:3, 3]) @ matrix[:3, :3]
    _refuse_misses(local, misses, line, sigma_m)
    if above_m is not None:
        _refuse_below(matrix, above_m)
    sigma = [float(v) for v in np.sqrt(np.diag(covariance)) * sigma_m]
    return TaughtFrame(
        base_frame=Pose.from_matrix(matrix),
        opening_rad=first.opening_rad,
        x_length_m=first.x_length_m,
        origin_sigma_m=(sigma[0], sigma[1], sigma[2]),
        rotation_sigma_rad=(sigma[3], sigma[4], sigma[5]),
        rms_m=float(np.sqrt(np.mean(local[misses] ** 2))),
        redundancy=int(misses.sum()) - 6,
    )


def miss_rows(local_m: Array) -> Array:
    """Return how points (..., 3) seen from a frame move by the frame's twist, its shift first (..., 3, 6)."""
    shift = np.broadcast_to(-np.eye(3), (*local_m.shape, 3))
    return np.concatenate([shift, skew_matrix(local_m)], axis=-1)


def frame_from_six_points(
    plane_m: Sequence[Sequence[float]],
    line_m: Sequence[Sequence[float]],
    stop_m: Sequence[float],
    *,
    above_m: Sequence[float],
    sigma_m: float = 0.0,
) -> TaughtFrame:
    """Construct a frame from 3-2-1 points: three on z = 0, two on y = 0 in the order of +x, one on x = 0.

    ``above_m`` is any point on the +z side. Points are in the base frame [m].

    Raises
    ------
    DegenerateDataError
        The plane's points lie on one line, or the line's points on one normal of the plane.
    """
    points = _check_points(*plane_m, *line_m, stop_m, above_m)
    if len(points) != 7:
        raise CalibrationError("the six-point method takes three points, two points and one point")
    normal = np.cross(points[1] - points[0], points[2] - points[0])
    sides = [np.linalg.norm(points[i] - points[j]) for i, j in ((0, 1), (1, 2), (2, 0))]
    along = points[4] - points[3]
    if np.linalg.norm(normal) < 0.05 * max(sides) ** 2:
        raise DegenerateDataError("the plane's points lie on one line.", remedy="Spread them over the plane.")
    flat = np.linalg.norm(np.cross(along, normal)) / np.linalg.norm(normal)
    if flat < MIN_DISTANCE_M:
        raise DegenerateDataError("the line's points are too close.", remedy="Take them 20 mm or more apart.")
    opening = math.asin(float(np.linalg.norm(normal)) / (sides[0] * sides[2]))
    return _construct_frame(_six_point_matrix, points, sigma_m, opening, float(np.linalg.norm(along)))


def frame_from_many_points(
    points_in_frame_m: Sequence[Sequence[float]],
    points_in_base_m: Sequence[Sequence[float]],
    *,
    sigma_m: float | None = None,
) -> RigidFit:
    """Fit a frame to points whose places in it a drawing tells: ``fit.target_source`` is base_frame."""
    return best_fit_transform(points_in_frame_m, points_in_base_m, sigma_m=sigma_m)


def frame_offset(base_frame: Pose, base_frame_moved: Pose) -> Pose:
    """Return the moved frame seen from the old one: ``UF_T_UF' = (R_T_UF)^-1 R_T_UF'``."""
    return base_frame.inverse() @ base_frame_moved


def moved_point(frame_offset_pose: Pose, frame_tcp: Pose) -> Pose:
    """Return a recorded point for the moved workpiece, in the old frame: Eq. 7 with Eq. 8.

    ``UF_T_TCP1' = UF_T_UF' UF'_T_TCP1'`` where ``UF'_T_TCP1' = UF_T_TCP1``: the part carried the point along.
    """
    return frame_offset_pose @ frame_tcp


def base_to_base(base_fixture: Pose, other_base_fixture: Pose) -> Pose:
    """Return the first robot's base seen from the other's, by a fixture both measured: Eq. 9.

    ``R'_T_R = R'_T_Fix' (R_T_Fix)^-1``.
    """
    return other_base_fixture @ base_fixture.inverse()


def clone_frame_change(base_frame: Pose, other_base_frame: Pose, other_base_base: Pose) -> Pose:
    """Return the master's user frame seen from the clone's: Eq. 11, to be put before every point (Eq. 12).

    ``UF'_T_UF = (R'_T_UF')^-1 R'_T_R R_T_UF`` and ``UF'_T_TCP1' = UF'_T_UF UF_T_TCP1``.
    """
    return other_base_frame.inverse() @ other_base_base @ base_frame


def _three_point_matrix(points: Array) -> Array:
    x = points[1] - points[0]
    z = np.cross(x, points[2] - points[0])
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    return homogeneous_matrix(
        np.column_stack([x, np.cross(z, x), z]), points[3] if len(points) == 4 else points[0]
    )


def _six_point_matrix(points: Array) -> Array:
    z = np.cross(points[1] - points[0], points[2] - points[0])
    z = z / np.linalg.norm(z) * np.sign(z @ (points[6] - points[0]))
    along = points[4] - points[3]
    x = along - z * (along @ z)
    x = x / np.linalg.norm(x)
    y = np.cross(z, x)
    return homogeneous_matrix(
        np.column_stack([x, y, z]), x * (x @ points[5]) + y * (y @ points[3]) + z * (z @ points[0])
    )


def _construct_frame(
    construct: Callable[[Array], Array], points: Array, sigma_m: float, opening: float, length: float
) -> TaughtFrame:
    """Carry the points' uncertainty through the construction with central differences of its twist."""
    matrix = construct(points)
    inverse, step = inverse_transform(matrix), 1e-6
    variance = np.zeros(6)
    for index in np.ndindex(*points.shape):
        shift = np.zeros_like(points)
        shift[index] = step
        twist = log_transform(inverse @ construct(points + shift)) - log_transform(
            inverse @ construct(points - shift)
        )
        variance += (twist / (2 * step) * sigma_m) ** 2
    sigma = [float(v) for v in np.sqrt(variance)]
    return TaughtFrame(
        base_frame=Pose.from_matrix(matrix),
        opening_rad=opening,
        x_length_m=length,
        origin_sigma_m=(sigma[0], sigma[1], sigma[2]),
        rotation_sigma_rad=(sigma[3], sigma[4], sigma[5]),
    )


def _refuse_misses(local: Array, misses: NDArray[np.bool_], line: slice, sigma_m: float) -> None:
    if (local[line, 0] <= 0).any():
        raise CalibrationError(
            "a point on the +x axis lies behind the origin.", remedy="Touch points on one side of the origin."
        )
    spare = int(misses.sum()) - 6
    if spare and float((local[misses] ** 2).sum()) / sigma_m**2 > chi_square_limit(spare):
        worst = int(np.argmax(np.abs(local * misses).max(axis=1)))
        raise PointsDisagreeError(
            make_message(
                "point {worst} misses its line or plane by {local:.2f} mm, more than touches of "
                "{sigma_mm:.2f} mm explain.",
                worst=worst + 1,
                local=np.abs(local * misses).max() * 1000.0,
                sigma_mm=sigma_m * 1000.0,
            ),
            remedy="Touch that point again; see that pointer and workpiece are whole.",
        )


def _refuse_below(matrix: Array, above_m: Sequence[float]) -> None:
    height = float((np.asarray(above_m, dtype=float) - matrix[:3, 3]) @ matrix[:3, 2])
    if not height > 0:
        raise CalibrationError(
            make_message(
                "the check point lies {height:.1f} mm below the frame: z points the wrong way.",
                height=-height * 1000.0,
            ),
            remedy="Two of the points are swapped (origin and x, or x and y), or +y is on the other side.",
        )


def _check_points(*values: Sequence[float]) -> Array:
    points = np.asarray(values, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise CalibrationError("points need three finite coordinates each")
    refuse_not_metres(points, "touched points")
    return points
