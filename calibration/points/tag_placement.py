"""Where a robot's base or a workpiece is, from tags known on both sides: two parts of calibrating a simulated cell.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, 5.2 and 5.3.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import (
    Array,
    Pose,
    exp_twist,
    inverse_transform,
    log_rotation,
    log_transform,
    skew_matrix,
)
from cellcal.calibration.message import make_message
from cellcal.calibration.points.deleted_residuals import deleted_residuals
from cellcal.calibration.points.frames import frame_from_six_points, frame_from_three_points
from cellcal.calibration.points.tag_points import TagPairs, Triple, refuse_other_size
from cellcal.calibration.registration import best_fit_transform
from cellcal.calibration.uncertainty import chi_square_limit, coverage_in_space

Method = Literal["three_points", "six_points", "least_squares"]
Covariance6 = tuple[tuple[float, ...], ...]

STRAY = 0.001
_STEP_M = 1e-6


@dataclass(frozen=True, slots=True)
class TagSigmas:
    """Standard uncertainties of one tag against its counterpart: of one coordinate, of the turn about one axis."""

    position_m: float | None = None  # None: the residuals tell
    rotation_rad: float | None = None  # None: attitudes are not used


@dataclass(frozen=True, slots=True)
class SpatialUncertainty:
    """A standard uncertainty in space, and the factor to 95 %."""

    standard: float
    coverage: float

    @property
    def expanded_uncertainty(self) -> float:
        """U (95 %)."""
        return self.standard * self.coverage


@dataclass(frozen=True, slots=True)
class PlacedTags:
    """A frame placed by its tags: ``outer_inner``, with the covariance of its right twist (v, w) [m, rad]."""

    method: Method
    outer_inner: Pose
    covariance: Covariance6
    degrees_of_freedom: float | None  # of the scale of the covariance; None where the uncertainty was stated
    tags: tuple[str, ...]
    unpaired: tuple[str, ...]
    residuals_m: tuple[Triple, ...]  # placed minus measured, outer axes
    before_m: tuple[float, ...]  # distances at the nominal place; empty where none was given
    turned_rad: float | None  # RMS of what the attitudes miss; None without attitudes

    @property
    def after_m(self) -> tuple[float, ...]:
        """Distances of the placed tags from the measured ones [m]."""
        return tuple(math.hypot(*residual) for residual in self.residuals_m)

    @property
    def origin_uncertainty(self) -> SpatialUncertainty:
        """The uncertainty of the origin [m]."""
        return spatial_uncertainty(np.array(self.covariance)[:3, :3], self.degrees_of_freedom)

    @property
    def angle_uncertainty(self) -> SpatialUncertainty:
        """The uncertainty of the turn, about any axis [rad]."""
        return spatial_uncertainty(np.array(self.covariance)[3:, 3:], self.degrees_of_freedom)


def spatial_uncertainty(covariance: Array, degrees_of_freedom: float | None) -> SpatialUncertainty:
    """Return how well a vector of this covariance (3, 3) is known, whatever the direction."""
    variances = np.linalg.eigvalsh(covariance).clip(0.0)
    if not variances.sum() > 0:
        return SpatialUncertainty(0.0, 2.0)
    freedom = math.inf if degrees_of_freedom is None else degrees_of_freedom
    return SpatialUncertainty(
        math.sqrt(float(variances.sum())), coverage_in_space(variances.tolist(), freedom)
    )


def place_by_tags(
    pairs: TagPairs,
    method: Method = "least_squares",
    *,
    sigmas: TagSigmas = TagSigmas(),
    nominal: Pose | None = None,
    near_m: float = 0.05,
) -> PlacedTags:
    """Place the frame of ``pairs.one`` so that its tags lie on those of ``pairs.other``: ``outer_inner``.

    Parameters
    ----------
    pairs : Pairs
        The same tags seen from the inner frame and from the outer one [m].
    method : str
        ``three_points``: origin, a point on x, a point of the x-y plane, kept exactly in this order;
        ``six_points``: three on a plane, two on a line, one stop: measured anywhere on the same faces;
        ``least_squares``: three or more, all alike.
    sigmas : Sigmas
        Stated uncertainties; three and six points need that of a coordinate.
    nominal : Pose, optional
        Where the frame was taken to be, for "before".
    near_m : float
        With six points, how far a tag may lie from where it was drawn along its face [m].

    Raises
    ------
    DegenerateDataError
        Too few tags, or tags on one line.
    CalibrationError
        Another unit, a mirror image, tags in another order, a stray tag, another shape, or no uncertainty where
        nothing else tells it.

    References
    ----------
    Least squares: `registration`; with attitudes by Gauss-Newton on the right twist. Three and six points: `frames`.
    """
    inner, outer = pairs.one.to_positions(), pairs.other.to_positions()
    if method != "six_points":
        refuse_other_size(inner, outer, (pairs.one.source, pairs.other.source))
    if method == "least_squares":
        matrix, covariance, freedom = _least_squares(pairs, inner, outer, sigmas)
    else:
        matrix, covariance = _construct_place(pairs, method, sigmas, near_m)
        freedom = None
    return PlacedTags(
        method=method,
        outer_inner=Pose.from_matrix(matrix),
        covariance=tuple(tuple(float(v) for v in row) for row in (covariance + covariance.T) / 2.0),
        degrees_of_freedom=freedom,
        tags=tuple(pairs.one.tag_label(row) for row in range(len(pairs.one))),
        unpaired=pairs.unpaired,
        residuals_m=tuple(
            (float(x), float(y), float(z)) for x, y, z in _transform_points(matrix, inner) - outer
        ),
        before_m=() if nominal is None else _tag_distances(nominal.to_matrix(), inner, outer),
        turned_rad=_turned_rad(matrix, pairs),
    )


def _least_squares(
    pairs: TagPairs, inner: Array, outer: Array, sigmas: TagSigmas
) -> tuple[Array, Array, float | None]:
    matrix = best_fit_transform(inner.tolist(), outer.tolist()).target_source.to_matrix()
    sigma, freedom = sigmas.position_m, 3 * len(inner) - 6
    jacobian = np.concatenate([np.broadcast_to(np.eye(3), (len(inner), 3, 3)), -skew_matrix(inner)], axis=2)
    residuals = (outer - _transform_points(matrix, inner)) @ matrix[:3, :3]
    _refuse_stray(pairs, jacobian, residuals)
    square = float((residuals**2).sum())
    if sigma is None:
        sigma = math.sqrt(square / freedom)
    elif square > sigma**2 * chi_square_limit(freedom):
        worst = int(np.linalg.norm(residuals, axis=1).argmax())
        raise CalibrationError(
            make_message(
                "the tags miss each other by {sqrt:.3f} mm a coordinate, more than {sigma:.3f} mm "
                "explain; worst tag {tag_label}.",
                sqrt=math.sqrt(square / freedom) * 1000.0,
                sigma=sigma * 1000.0,
                tag_label=pairs.one.tag_label(worst),
            ),
            remedy="See that both paths hold the same points; state the uncertainty that they really have.",
        )
    scale = max(sigma, 1e-9)
    unlimited = sigmas.position_m is not None
    if sigmas.rotation_rad is None or not (pairs.one.quaternions and pairs.other.quaternions):
        rows = jacobian.reshape(-1, 6) / scale
        plain = np.asarray(np.linalg.inv(rows.T @ rows), dtype=np.float64)
        return matrix, plain, None if unlimited else float(freedom)
    matrix, covariance = _with_attitudes(matrix, pairs, jacobian / scale, (scale, sigmas.rotation_rad))
    return matrix, covariance, None if unlimited else float(freedom)


def _with_attitudes(
    matrix: Array, pairs: TagPairs, places: Array, sigmas: tuple[float, float]
) -> tuple[Array, Array]:
    """Return the place and its covariance with the attitudes of the tags, too."""
    inner, outer = pairs.one.to_positions(), pairs.other.to_positions()
    turns, other_rotations = pairs.one.to_rotations(), pairs.other.to_rotations()
    attitudes = np.zeros((len(inner), 3, 6))
    attitudes[:, :, 3:] = np.swapaxes(turns, 1, 2) / sigmas[1]
    rows = np.concatenate([places.reshape(-1, 6), attitudes.reshape(-1, 6)])
    covariance = np.asarray(np.linalg.inv(rows.T @ rows), dtype=np.float64)
    for _ in range(20):
        rotation = matrix[:3, :3]
        misses = (outer - _transform_points(matrix, inner)) @ rotation / sigmas[0]
        turned = log_rotation(np.swapaxes(rotation @ turns, 1, 2) @ other_rotations) / sigmas[1]
        step = covariance @ rows.T @ np.concatenate([misses.ravel(), turned.ravel()])
        matrix = matrix @ exp_twist(step)
        if np.abs(step).max() < 1e-13:
            break
    return matrix, covariance


def _refuse_stray(pairs: TagPairs, jacobian: Array, residuals: Array) -> None:
    basis = np.linalg.qr(jacobian.reshape(-1, 6))[0].reshape(-1, 3, 6)
    deleted = deleted_residuals(basis, residuals)
    if deleted.probability < STRAY:
        raise CalibrationError(
            make_message(
                "tag {tag_label} is {sizes_mm:.2f} mm from where the other tags have it.",
                tag_label=pairs.one.tag_label(deleted.stray),
                sizes_mm=deleted.sizes_m[deleted.stray] * 1000.0,
            ),
            remedy="Measure it again, or leave it out of both files; see that no two tags are exchanged.",
        )


def _construct_place(
    pairs: TagPairs, method: Method, sigmas: TagSigmas, near_m: float
) -> tuple[Array, Array]:
    """Return the place from a construction on both sides, and its covariance by central differences."""
    construct, count = (_three_point_frame, 3) if method == "three_points" else (_six_point_frame, 6)
    inner, outer, sigma = pairs.one.to_positions(), pairs.other.to_positions(), sigmas.position_m
    if len(inner) != count:
        raise CalibrationError(
            make_message(
                "the method {method} takes {count} tags, in their order; there are {given}.",
                method=method,
                count=count,
                given=len(inner),
            ),
            remedy="Use least_squares for any other number.",
        )
    if sigma is None:
        raise CalibrationError(
            make_message("{count} points leave nothing that tells how good they are.", count=count),
            remedy="State sigma_m, the standard uncertainty of one coordinate of one tag.",
        )
    inner_frame = inverse_transform(construct(inner))
    matrix = construct(outer) @ inner_frame
    apart = _tag_distances(matrix, inner, outer)
    limit = 4.0 * math.sqrt(2.0) * sigma if method == "three_points" else near_m
    worst = int(np.argmax(apart))
    if apart[worst] > limit:
        raise CalibrationError(
            make_message(
                "tag {tag_label} is {apart:.2f} mm from its place; {limit:.2f} mm would be explained.",
                tag_label=pairs.one.tag_label(worst),
                apart=apart[worst] * 1000.0,
                limit=limit * 1000.0,
            ),
            remedy="See that the tags are in the same order in both files, none mirrored, and sigma_m is true.",
        )
    twists = np.zeros((6, outer.size))
    for column, index in enumerate(np.ndindex(*outer.shape)):
        twists[:, column] = _place_slope(lambda points: construct(points) @ inner_frame, outer, index)
    return matrix, sigma**2 * twists @ twists.T


def _place_slope(place: Callable[[Array], Array], points: Array, index: tuple[int, ...]) -> Array:
    shift = np.zeros_like(points)
    shift[index] = _STEP_M
    slope: Array = log_transform(inverse_transform(place(points - shift)) @ place(points + shift)) / (
        2.0 * _STEP_M
    )
    return slope


def _three_point_frame(points: Array) -> Array:
    return frame_from_three_points(*points.tolist()).base_frame.to_matrix()


def _six_point_frame(points: Array) -> Array:
    """Construct the 3-2-1 frame; the order of the plane's points tells which side is up, on both sides alike."""
    up = points[0] + np.cross(points[1] - points[0], points[2] - points[0])
    taught = frame_from_six_points(
        points[:3].tolist(), points[3:5].tolist(), points[5].tolist(), above_m=up.tolist()
    )
    return taught.base_frame.to_matrix()


def _transform_points(matrix: Array, points: Array) -> Array:
    transformed: Array = points @ matrix[:3, :3].T + matrix[:3, 3]
    return transformed


def _tag_distances(matrix: Array, inner: Array, outer: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in np.linalg.norm(_transform_points(matrix, inner) - outer, axis=1))


def _turned_rad(matrix: Array, pairs: TagPairs) -> float | None:
    if not (pairs.one.quaternions and pairs.other.quaternions):
        return None
    gap = log_rotation(
        np.swapaxes(matrix[:3, :3] @ pairs.one.to_rotations(), 1, 2) @ pairs.other.to_rotations()
    )
    return float(np.sqrt((gap**2).sum(axis=1).mean()))
