"""Where known points are: a fixture in a robot's base, a tool on its flange, one robot's base in another's.

Points found by measurement come with one covariance for all of them, because they share the wire and the arm;
the pose that carries the drawing's points onto them uses all of it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array, Pose, adjoint_matrix, exp_twist, skew_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.metres import refuse_not_metres
from cellcal.calibration.registration import best_fit_transform
from cellcal.calibration.uncertainty import chi_square_limit, coverage_in_space

Triple = tuple[float, float, float]
Covariance6 = tuple[tuple[float, ...], ...]

COVERAGE = 2.0  # k of every U stated here
MIN_DISTANCE_M = 0.05
MIN_SPREAD = 0.15  # second extent of the points by the first: below, a turn about their line is badly known
MIRROR_CHI_SQUARE = 25.0  # a mirror image that fits worse than this is excluded


class UncertainFrame:
    """The uncertainty of a frame; the covariance is a field of the dataclass that derives from this."""

    __slots__ = ()
    covariance: Covariance6  # of the right twist (v, w) [m, rad]

    @property
    def origin_u_m(self) -> float:
        """U (k = 2) of the frame's origin in its worst direction [m]."""
        return worst_expanded_u(np.array(self.covariance)[:3, :3])

    @property
    def angle_u_rad(self) -> float:
        """U (k = 2) of the turn about the worst axis [rad]."""
        return worst_expanded_u(np.array(self.covariance)[3:, 3:])


@dataclass(frozen=True, slots=True)
class PlacedPoints(UncertainFrame):
    """A frame fitted to its points: ``outer_inner`` with the covariance of its right twist (v, w) [m, rad]."""

    outer_inner: Pose
    covariance: Covariance6
    residuals_m: tuple[Triple, ...]  # found minus fitted, outer axes
    rms_m: float
    chi_square: float
    degrees_of_freedom: int
    worst_pair: tuple[int, int]  # whose distance differs most from the drawing's, counted from 0 …
    worst_gap_m: float  # … by this much, found minus drawn …
    worst_deviation: float  # … and by how many deviations

    def worst_gap_arguments(self) -> dict[str, object]:
        """Return the arguments of a message about the worst pair; points are counted from 1."""
        i, j = self.worst_pair
        return {
            "i": i + 1,
            "j": j + 1,
            "worst_gap_mm": abs(self.worst_gap_m) * 1000.0,
            "detail": "further from" if self.worst_gap_m > 0 else "nearer to",
            "worst_deviation": self.worst_deviation,
        }

    @property
    def most_chi_square(self) -> float:
        """The 99.9 % limit of chi square where the points have the drawing's shape."""
        return chi_square_limit(self.degrees_of_freedom)

    def is_consistent(self) -> bool:
        """Return whether the points found have the drawing's shape at 99.9 %."""
        return self.chi_square <= self.most_chi_square


@dataclass(frozen=True, slots=True)
class MirrorPoint:
    """The other place that a point's lengths allow, and how much worse it fits them (chi square)."""

    at_m: Triple
    chi_square: float

    @property
    def is_excluded(self) -> bool:
        """Whether the lengths tell the two places apart."""
        return self.chi_square > MIRROR_CHI_SQUARE


@dataclass(frozen=True, slots=True)
class BaseToBase(UncertainFrame):
    """One robot's base seen from another's, with the covariance of its right twist."""

    other_base_base: Pose
    covariance: Covariance6

    @property
    def origin_axes_u_m(self) -> Triple:
        """U (k = 2) of the origin along x, y and z of the base it is seen from [m]."""
        return _to_triple(COVERAGE * np.sqrt(np.diag(self._seen_from()[:3, :3])))

    @property
    def angle_axes_u_rad(self) -> Triple:
        """U (k = 2) of the turns about x, y and z of the base it is seen from [rad]."""
        return _to_triple(COVERAGE * np.sqrt(np.diag(self._seen_from()[3:, 3:])))

    @property
    def origin_space_u_m(self) -> float:
        """Radius of the ball around the origin found that holds the true one with 95 % [m]."""
        variances = np.maximum(np.linalg.eigvalsh(np.array(self.covariance)[:3, :3]), 0.0)
        return coverage_in_space([float(v) for v in variances]) * math.sqrt(float(variances.sum()))

    def _seen_from(self) -> Array:
        turn = np.kron(np.eye(2), self.other_base_base.rotation_matrix())
        rotated: Array = turn @ np.array(self.covariance) @ turn.T
        return rotated


def worst_expanded_u(covariance: Array) -> float:
    """Return ``2 sqrt`` of the largest variance in any direction."""
    return COVERAGE * math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))


def refuse_bad_points(points_m: Sequence[Sequence[float]], what: str = "alignment points") -> None:
    """Refuse points that cannot fix a frame, before anything is measured.

    Parameters
    ----------
    points_m : n points
        In their own frame [m].
    what : str
        What they are called in the message.

    Raises
    ------
    DegenerateDataError
        Fewer than three, two closer than 50 mm, or (nearly) on one line; the remedy says how far off the line a
        point would have to be.
    CalibrationError
        A coordinate is not finite.
    """
    points = np.asarray(points_m, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise CalibrationError(make_message("the {what} need three finite coordinates each", what=what))
    refuse_not_metres(points, what)
    if len(points) < 3:
        raise DegenerateDataError(
            make_message("{point_count} {what} do not fix a frame.", point_count=len(points), what=what),
            remedy="Use three that lie on no line, better four.",
        )
    i, j = min(combinations(range(len(points)), 2), key=lambda ij: math.dist(points[ij[0]], points[ij[1]]))
    if math.dist(points[i], points[j]) < MIN_DISTANCE_M:
        raise DegenerateDataError(
            make_message(
                "{what} {i} and {j} are {dist:.0f} mm apart.",
                what=what,
                i=i + 1,
                j=j + 1,
                dist=math.dist(points[i], points[j]) * 1000.0,
            ),
            remedy="Choose points far apart: the frame turns by point error / distance.",
        )
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if extents[1] < MIN_SPREAD * extents[0]:
        longest = max(math.dist(a, b) for a, b in combinations(points, 2))
        raise DegenerateDataError(
            make_message(
                "the {what} lie nearly on one line: the frame's turn about it would be a guess.", what=what
            ),
            remedy=make_message(
                "Add a point {longest:.0f} mm or more beside the line.", longest=longest / 3 * 1000.0
            ),
            condition=float(extents[0] / max(extents[1], 1e-300)),
        )


def place_points(
    points_in_inner_m: Sequence[Sequence[float]],
    found_in_outer_m: Sequence[Sequence[float]],
    covariance_m2: Array,
    *,
    sigma_point_m: float,
) -> PlacedPoints:
    r"""Fit the frame of known points to where they were found: generalised least squares.

    ``found_k = T p_k + e``, ``cov(e) = C + sigma_point^2``; Gauss-Newton on the right twist of T.

    Parameters
    ----------
    points_in_inner_m : n >= 3 points
        From the drawing, inner frame [m].
    found_in_outer_m : n points
        As measured, outer frame [m].
    covariance_m2 : (3n, 3n)
        Of the points found, x y z one after the other [m^2].
    sigma_point_m : float
        Standard uncertainty of drawing and seat, of one coordinate of one point [m].

    Returns
    -------
    PlacedPoints
        Pose, covariance, and how well the points found have the drawing's shape.

    Raises
    ------
    DegenerateDataError
        Points that cannot fix a frame.
    CalibrationError
        Numbers of points that differ, or one set mirrored.

    References
    ----------
    C. R. Rao, Linear statistical inference, 1973, 4a: the best linear unbiased estimate.
    """
    refuse_bad_points(points_in_inner_m, "points")
    points, found = np.asarray(points_in_inner_m, dtype=float), np.asarray(found_in_outer_m, dtype=float)
    matrix = best_fit_transform(points.tolist(), found.tolist()).target_source.to_matrix()
    total = covariance_m2 + sigma_point_m**2 * np.eye(len(covariance_m2))
    weight = np.linalg.inv(total)
    for _ in range(20):
        residual, jacobian = _frame_misfit(matrix, points, found)
        covariance = np.asarray(np.linalg.inv(jacobian.T @ weight @ jacobian), dtype=np.float64)
        step = covariance @ jacobian.T @ weight @ residual
        matrix = matrix @ exp_twist(step)
        if np.abs(step).max() < 1e-13:
            break
    residual, _ = _frame_misfit(matrix, points, found)
    pair, gap, deviation = _worst_pair(points, found, total)
    return PlacedPoints(
        outer_inner=Pose.from_matrix(matrix),
        covariance=_to_rows(covariance),
        residuals_m=tuple((float(x), float(y), float(z)) for x, y, z in residual.reshape(-1, 3)),
        rms_m=float(np.sqrt(np.mean(residual**2))),
        chi_square=float(residual @ weight @ residual),
        degrees_of_freedom=len(residual) - 6,
        worst_pair=pair,
        worst_gap_m=gap,
        worst_deviation=deviation,
    )


def placing_covariance(
    outer_inner: Pose,
    points_in_inner_m: Sequence[Sequence[float]],
    covariance_m2: Array,
    sigma_point_m: float,
) -> Array:
    """Return the (6, 6) covariance that `place_points` would state, before anything is measured."""
    points = np.asarray(points_in_inner_m, dtype=float)
    _, jacobian = _frame_misfit(outer_inner.to_matrix(), points, points)
    total = covariance_m2 + sigma_point_m**2 * np.eye(len(covariance_m2))
    covariance: Array = np.linalg.inv(jacobian.T @ np.linalg.solve(total, jacobian))
    return covariance


def base_through_fixture(
    base_fixture: Pose, covariance: Array, other_base_fixture: Pose, other_covariance: Array
) -> BaseToBase:
    r"""Return a base seen from another one through a fixture that both measured: Eq. 9, with its uncertainty.

    ``R'_T_R = R'_T_Fix (R_T_Fix)^-1``. With right twists a of the one and b of the other,
    ``A exp(a) exp(-b) B^-1 = A B^-1 exp(Ad_B (a - b))``: the covariances add and are carried into the base.

    Parameters
    ----------
    base_fixture, other_base_fixture : Pose
        The fixture seen from either base.
    covariance, other_covariance : (6, 6)
        Of their right twists [m, rad]; the two alignments are taken as independent.

    Returns
    -------
    BaseToBase
        ``other_base_base`` and the covariance of its right twist.

    References
    ----------
    F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, Eq. 9.
    """
    twist_adjoint = adjoint_matrix(base_fixture.to_matrix())
    total = twist_adjoint @ (np.asarray(covariance) + np.asarray(other_covariance)) @ twist_adjoint.T
    return BaseToBase(other_base_fixture @ base_fixture.inverse(), _to_rows((total + total.T) / 2.0))


def mirror_image(stations_m: Array, place_m: Sequence[float], sigma_m: float) -> MirrorPoint:
    """Return the rival of a place found from its distances to stations: its image in the stations' plane, refined.

    Parameters
    ----------
    stations_m : (N, 3)
        Where the distances were measured from [m].
    place_m : (3,)
        The place found [m].
    sigma_m : float
        Standard uncertainty of one distance [m].

    Returns
    -------
    Mirror
        The other place and its chi square against the distances of the first.

    Raises
    ------
    DegenerateDataError
        Fewer than three stations.
    """
    stations, place = np.asarray(stations_m, dtype=float), np.asarray(place_m, dtype=float)
    if len(stations) < 3:
        raise DegenerateDataError(
            make_message("{station_count} lengths fix no point.", station_count=len(stations)),
            remedy="Measure from three places or more.",
        )
    centre = stations.mean(axis=0)
    normal = np.linalg.svd(stations - centre)[2][-1]
    height = float((place - centre) @ normal)
    rival = place - 2.0 * height * normal
    lengths = np.linalg.norm(stations - place, axis=1)
    for _ in range(30):
        away = rival - stations
        distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        normal_matrix = (away / distance[:, None]).T @ (away / distance[:, None]) + 1e-9 * np.eye(3)
        step = np.linalg.solve(normal_matrix, (away / distance[:, None]).T @ (lengths - distance))
        reach = abs(height)  # it may not walk back to the place itself
        rival = rival + step * min(1.0, 0.2 * reach / max(float(np.linalg.norm(step)), 1e-12))
    gaps = (np.linalg.norm(stations - rival, axis=1) - lengths) / sigma_m
    if np.linalg.norm(rival - place) < 0.5 * abs(height):
        return MirrorPoint(_to_triple(rival), math.inf)  # it walked back: there is no second place
    return MirrorPoint(_to_triple(rival), float(gaps @ gaps))


def mirror_gaps(stations_m: Array, place_m: Sequence[float], mirror: MirrorPoint) -> Array:
    """Return (N,) [m]: by how much a distance from each station differs between a place and its mirror image."""
    stations = np.asarray(stations_m, dtype=float).reshape(-1, 3)
    here = np.linalg.norm(stations - np.asarray(place_m), axis=1)
    gaps: Array = np.abs(np.linalg.norm(stations - np.array(mirror.at_m), axis=1) - here)
    return gaps


def _frame_misfit(matrix: Array, points: Array, found: Array) -> tuple[Array, Array]:
    rotation = matrix[:3, :3]
    residual = (found - points @ rotation.T - matrix[:3, 3]).ravel()
    columns = [np.broadcast_to(rotation, (len(points), 3, 3)), -rotation @ skew_matrix(points)]
    return residual, np.concatenate(columns, axis=2).reshape(-1, 6)


def _worst_pair(points: Array, found: Array, covariance: Array) -> tuple[tuple[int, int], float, float]:
    worst: tuple[tuple[int, int], float, float] = ((0, 1), 0.0, 0.0)
    for i, j in combinations(range(len(points)), 2):
        away = found[i] - found[j]
        length = float(np.linalg.norm(away))
        along = np.zeros(len(covariance))
        along[3 * i : 3 * i + 3], along[3 * j : 3 * j + 3] = away / length, -away / length
        gap = length - math.dist(points[i], points[j])
        deviation = abs(gap) / math.sqrt(float(along @ covariance @ along))
        if deviation > worst[2]:
            worst = ((i, j), gap, deviation)
    return worst


def _to_rows(matrix: Array) -> Covariance6:
    return tuple(tuple(float(v) for v in row) for row in matrix)


def _to_triple(values: Array) -> Triple:
    x, y, z = (float(v) for v in values)
    return (x, y, z)
