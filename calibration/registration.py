"""Fit one set of points onto another, and find a point from its distances to known ones."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array, Pose, homogeneous_matrix, nearest_rotation, skew_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.metres import MOST_OF_HALL_M, refuse_not_metres
from cellcal.calibration.point_order import refuse_other_order

Triple = tuple[float, float, float]
_LEAST_FOR_SCALE = 4  # points: of three, the residuals of a scale are too few to judge it by


@dataclass(frozen=True, slots=True)
class RigidFit:
    """A frame found from points: ``target_source`` is the source frame seen from the target frame."""

    target_source: Pose
    rms_m: float  # per coordinate
    max_m: float  # the largest distance between a pair
    worst_pair: int  # counted from 0
    residuals_m: tuple[Triple, ...]  # fitted minus given, target axes
    degrees_of_freedom: int
    sigma_m: float  # of one coordinate: as given, or from the residuals
    covariance: tuple[tuple[float, ...], ...]  # 6 x 6 of the right twist (v, w) [m, rad]

    def sigma_at(self, point_in_source_m: Sequence[float]) -> float:
        """Return the standard uncertainty (3-D, root of the trace) [m] of a point carried through the fit."""
        jacobian = np.hstack([np.eye(3), -skew_matrix(np.array(point_in_source_m, dtype=float))])
        return float(np.sqrt(np.trace(jacobian @ np.array(self.covariance) @ jacobian.T)))


@dataclass(frozen=True, slots=True)
class PointScale:
    """The scale between two sets of points, and its standard uncertainty from the residuals."""

    value: float
    sigma: float


@dataclass(frozen=True, slots=True)
class Trilateration:
    """A point found from its distances to known points."""

    point_m: Triple
    zero_m: float  # added to every length: 0 unless it was asked for
    rms_m: float
    max_m: float
    worst_length: int  # counted from 0
    residuals_m: tuple[float, ...]  # computed minus measured
    degrees_of_freedom: int
    sigma_m: float
    point_covariance_m2: tuple[Triple, Triple, Triple]
    point_sigma_m: Triple


def best_fit_transform(
    source_m: Sequence[Sequence[float]], target_m: Sequence[Sequence[float]], *, sigma_m: float | None = None
) -> RigidFit:
    """Find the rigid transform that carries source points onto target points, in the least-squares sense.

    Parameters
    ----------
    source_m, target_m : n >= 3 points each
        The same points seen from two frames, in the same order [m].
    sigma_m : float, optional
        Standard uncertainty of one coordinate [m]. Without it, the residuals tell.

    Raises
    ------
    DegenerateDataError
        Fewer than three pairs, or points (nearly) on one line.
    CalibrationError
        Different numbers of points, numbers that are not finite or cannot be metres, points in another order, or
        one set is a mirror image of the other.

    References
    ----------
    W. Kabsch, A solution for the best rotation to relate two sets of vectors, Acta Cryst. A32 (1976) 922.
    S. Umeyama, IEEE Trans. PAMI 13 (1991) 376, for the sign of the determinant.
    """
    source, target = _check_points(source_m), _check_points(target_m)
    refuse_not_metres(source, "points", MOST_OF_HALL_M)
    refuse_not_metres(target, "points", MOST_OF_HALL_M)
    if len(source) != len(target):
        raise CalibrationError(
            make_message("{count} points cannot be paired with {other}", count=len(source), other=len(target))
        )
    _refuse_line(source)
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    covariance = b.T @ a
    try:
        rotation = nearest_rotation(covariance)
    except CalibrationError:  # two corners of a rectangle that changed places leave none
        refuse_other_order(a, b, b)
        raise DegenerateDataError(
            "these points fit no rotation of the others.",
            remedy="See which point is which, and measure again.",
        ) from None
    refuse_other_order(a, b, a @ rotation.T - b)
    _refuse_mirror(covariance, a, b, rotation)
    residuals = a @ rotation.T - b
    freedom = 3 * len(source) - 6
    sigma = math.sqrt(float((residuals**2).sum()) / freedom) if sigma_m is None else sigma_m
    translation = target.mean(axis=0) - rotation @ source.mean(axis=0)
    jacobian = np.concatenate([np.broadcast_to(np.eye(3), (len(source), 3, 3)), -skew_matrix(source)], axis=2)
    twist_covariance = np.linalg.inv(np.einsum("nij,nik->jk", jacobian, jacobian)) * sigma**2
    distances = np.linalg.norm(residuals, axis=1)
    return RigidFit(
        target_source=Pose.from_matrix(homogeneous_matrix(rotation, translation)),
        rms_m=float(np.sqrt((residuals**2).mean())),
        max_m=float(distances.max()),
        worst_pair=int(distances.argmax()),
        residuals_m=tuple(_to_triple(r) for r in residuals),
        degrees_of_freedom=freedom,
        sigma_m=sigma,
        covariance=tuple(tuple(float(v) for v in row) for row in twist_covariance),
    )


def scale_of_points(source_m: Array, target_m: Array) -> PointScale | None:
    """Return by how much the target is larger than the source (n, 3 each) [m]; None with fewer than four points.

    References
    ----------
    S. Umeyama, IEEE Trans. PAMI 13 (1991) 376: the scale of the least-squares similarity.
    """
    freedom = 3 * len(source_m) - 7
    if len(source_m) < _LEAST_FOR_SCALE:
        return None
    a, b = source_m - source_m.mean(axis=0), target_m - target_m.mean(axis=0)
    turned = a @ nearest_rotation(b.T @ a).T
    square = float((a**2).sum())
    value = float((b * turned).sum()) / square
    return PointScale(value, math.sqrt(float(((b - value * turned) ** 2).sum()) / freedom / square))


def trilaterate_point(
    stations_m: Sequence[Sequence[float]],
    lengths_m: Sequence[float],
    *,
    fit_zero: bool = False,
    near_m: Sequence[float] | None = None,
    sigma_m: float | None = None,
) -> Trilateration:
    """Find a point from its distances to known stations: a wire's anchor from the hook's places, for example.

    Parameters
    ----------
    stations_m : n points
        Known places [m]; at least three, and one more for the wire's zero.
    lengths_m : n lengths
        Measured distances [m].
    fit_zero : bool
        Whether the device has an unknown zero, ``length = distance + zero``.
    near_m : point, optional
        Chooses between two mirror images when the stations lie in one plane.
    sigma_m : float, optional
        Standard uncertainty of one length [m]. Without it, the residuals tell.

    Raises
    ------
    DegenerateDataError
        Too few stations, stations on one line, two mirror images and no ``near_m``, or a zero that the
        stations cannot tell from a shift of the point.

    References
    ----------
    Start values: the intersection of spheres seen in the stations' own plane; refined by Gauss-Newton.
    """
    stations, lengths = _check_points(stations_m), np.asarray(lengths_m, dtype=float)
    unknowns = 4 if fit_zero else 3
    if lengths.shape != (len(stations),) or not (np.isfinite(lengths).all() and (lengths > 0).all()):
        raise CalibrationError("every station needs one positive, finite length")
    refuse_not_metres(stations, "stations", MOST_OF_HALL_M)
    refuse_not_metres(lengths, "lengths", MOST_OF_HALL_M)
    if len(stations) < unknowns:
        raise DegenerateDataError(
            make_message(
                "{count} lengths cannot fix {unknowns} unknowns.", count=len(stations), unknowns=unknowns
            ),
            remedy="Measure more.",
        )
    _refuse_line(stations)
    fits = [_refine_guess(stations, lengths, start, fit_zero) for start in _first_guesses(stations, lengths)]
    freedom = len(stations) - unknowns
    fits.sort(key=lambda fit: float((fit[1] ** 2).sum()))
    best = _choose_fit(fits, near_m, freedom, sigma_m)
    return _make_trilateration(stations, best, freedom, sigma_m)


def _first_guesses(stations: Array, lengths: Array) -> list[Array]:
    """Return first guesses: from all stations linearly, and the two sides of their plane."""
    centre = stations.mean(axis=0)
    _, _, axes = np.linalg.svd(stations - centre)
    local = (stations - centre) @ axes.T
    squares = lengths**2 - (local**2).sum(axis=1)
    flat = np.column_stack([-2 * local[:, :2], np.ones(len(local))])
    (x, y, total), *_ = np.linalg.lstsq(flat, squares, rcond=None)
    height = math.sqrt(max(total - x * x - y * y, 1e-6))
    local_starts = [np.array([x, y, height]), np.array([x, y, -height])]
    if len(stations) > 3:
        full = np.column_stack([-2 * local, np.ones(len(local))])
        local_starts.append(np.linalg.lstsq(full, squares, rcond=1e-6)[0][:3])
    return [centre + axes.T @ start for start in local_starts]


def _refine_guess(
    stations: Array, lengths: Array, start: Array, fit_zero: bool
) -> tuple[Array, Array, Array]:
    """Return (x, y, z[, zero]), residuals and the Jacobian after damped Gauss-Newton steps."""
    unknown = np.concatenate([start, [0.0]]) if fit_zero else start.copy()
    damping = 1e-6
    residuals, jacobian = _length_residuals(stations, lengths, unknown)
    for _ in range(100):
        normal = jacobian.T @ jacobian
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), -jacobian.T @ residuals)
        trial = unknown + step
        new_residuals, new_jacobian = _length_residuals(stations, lengths, trial)
        if (new_residuals**2).sum() > (residuals**2).sum():
            damping *= 10
        else:
            unknown, residuals, jacobian, damping = trial, new_residuals, new_jacobian, damping / 10
        if np.abs(step).max() < 1e-13 or damping > 1e12:
            break
    return unknown, residuals, jacobian


def _length_residuals(stations: Array, lengths: Array, unknown: Array) -> tuple[Array, Array]:
    difference = unknown[:3] - stations
    distance = np.maximum(np.linalg.norm(difference, axis=1), 1e-12)
    jacobian = difference / distance[:, None]
    if len(unknown) == 4:
        return distance + unknown[3] - lengths, np.column_stack([jacobian, np.ones(len(lengths))])
    return distance - lengths, jacobian


def _choose_fit(
    fits: list[tuple[Array, Array, Array]],
    near_m: Sequence[float] | None,
    freedom: int,
    sigma_m: float | None,
) -> tuple[Array, Array, Array]:
    """Choose among local minima; equally good ones need a hint."""
    best = fits[0]
    least = float((best[1] ** 2).sum())
    noise = max(sigma_m or 0.0, math.sqrt(least / freedom) if freedom else 0.0, 1e-9)
    alike = [fit for fit in fits if float((fit[1] ** 2).sum()) <= least + 9 * noise**2]
    far = [fit for fit in alike if np.linalg.norm(fit[0][:3] - best[0][:3]) > 1e-6]
    if not far:
        return best
    if near_m is None:
        places = " and ".join(str(np.round(fit[0][:3], 4).tolist()) for fit in (best, far[0]))
        raise DegenerateDataError(
            make_message("the lengths fit two places: {places} m.", places=places),
            remedy="Name a point near the right one, or measure from a station outside the plane.",
        )
    return min(alike, key=lambda fit: float(np.linalg.norm(fit[0][:3] - np.array(near_m, dtype=float))))


def _make_trilateration(
    stations: Array, fit: tuple[Array, Array, Array], freedom: int, sigma_m: float | None
) -> Trilateration:
    unknown, residuals, jacobian = fit
    singular = np.linalg.svd(jacobian, compute_uv=False)
    condition = float(singular[0] / max(singular[-1], 1e-300))
    if condition > 1e4:
        raise DegenerateDataError(
            make_message(
                "the stations do not determine the point (condition {condition:.3g}).", condition=condition
            ),
            remedy="Spread the stations, and leave the plane that holds them and the point.",
            condition=condition,
        )
    estimated = math.sqrt(float((residuals**2).sum()) / freedom) if freedom else math.nan
    sigma = estimated if sigma_m is None else sigma_m
    if math.isnan(sigma):
        raise DegenerateDataError(
            "as many lengths as unknowns leave no residual to judge by.",
            remedy="Give sigma_m, or measure once more.",
        )
    covariance = np.linalg.inv(jacobian.T @ jacobian)[:3, :3] * sigma**2
    return Trilateration(
        point_m=_to_triple(unknown[:3]),
        zero_m=float(unknown[3]) if len(unknown) == 4 else 0.0,
        rms_m=float(np.sqrt((residuals**2).mean())),
        max_m=float(np.abs(residuals).max()),
        worst_length=int(np.abs(residuals).argmax()),
        residuals_m=tuple(float(r) for r in residuals),
        degrees_of_freedom=freedom,
        sigma_m=sigma,
        point_covariance_m2=(_to_triple(covariance[0]), _to_triple(covariance[1]), _to_triple(covariance[2])),
        point_sigma_m=_to_triple(np.sqrt(np.diag(covariance))),
    )


def _check_points(values: Sequence[Sequence[float]]) -> Array:
    points = np.asarray(values, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise CalibrationError("points need three finite coordinates each")
    return points


def _refuse_line(points: Array) -> None:
    """Refuse fewer than three points, and points whose second extent is under a hundredth of the first."""
    if len(points) < 3:
        raise DegenerateDataError(
            make_message("{count} points are too few.", count=len(points)),
            remedy="Measure three or more points.",
        )
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not extents[1] > 0.01 * extents[0]:
        raise DegenerateDataError(
            "the points lie on one line, or on top of each other.",
            remedy="Add a point well away from the line.",
            condition=float(extents[0] / max(extents[1], 1e-300)),
        )


def _refuse_mirror(covariance: Array, a: Array, b: Array, rotation: Array) -> None:
    """Refuse points that a reflection fits far better than any rotation: a sign or two points are swapped."""
    u, singular, vt = np.linalg.svd(covariance)
    if np.linalg.det(u @ vt) > 0 or singular[2] < 1e-6 * singular[0]:
        return
    mirrored = float(((a @ (u @ vt).T - b) ** 2).sum())
    if mirrored < 0.01 * float(((a @ rotation.T - b) ** 2).sum()):
        raise CalibrationError(
            "one set of points is the mirror image of the other.",
            remedy="Check the signs of the axes and the order of the points.",
        )


def _to_triple(values: Array) -> Triple:
    x, y, z = (float(v) for v in values)
    return (x, y, z)
