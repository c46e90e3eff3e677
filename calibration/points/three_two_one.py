r"""A workpiece frame from the faces of a corner, felt with a ball: three points, two, one, or more of each.

The 3-2-1 rule (Autodesk PowerInspect 2025, reference help, GUID-B9E4C498-6AA9-4D6E-AB61-7AF16C679D99: three points
fix a plane, two an axis, one a position): the first face gives z, the second turns the frame about it, the third
says where the origin lies along x. More points of a face are fitted by least squares, weighted by 1 / s^2.

Linearised at the solution, with the frame's shift t and turn w in its own axes, a surface point p misses

    z face:  t_z + w_x y - w_y x,     y face:  t_y + w_z x - w_x z,     x face:  t_x + w_y z - w_z y

and the faces are solved in this order, each with what the ones before it told: a linear estimate theta = G d of
the points' errors d along their normals, with covariance G diag(s^2) G^T. Derived here.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array, Pose, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.points.frames import MIN_DISTANCE_M, PointsDisagreeError
from cellcal.calibration.uncertainty import chi_square_limit

Triple = tuple[float, float, float]
FaceName = Literal["z", "y", "x"]
Corner = Literal["outside", "inside"]
FACES: tuple[FaceName, ...] = ("z", "y", "x")
LEAST: dict[FaceName, int] = {"z": 3, "y": 2, "x": 1}
_AXIS: dict[FaceName, int] = {"x": 0, "y": 1, "z": 2}
# of the six, those that a face's points tell, and those that they take from the faces before
_TELLS: dict[FaceName, tuple[int, ...]] = {"z": (2, 3, 4), "y": (1, 5), "x": (0,)}
WRONG_SIDE_RAD = math.radians(30.0)  # between a face that was found and the way from which it was felt
SQUARE_RAD = math.radians(1.0)  # by which faces may miss a right angle
_SLIM = 0.1  # of a face's points: second extent over the first, below which they are a line


@dataclass(frozen=True, slots=True)
class CornerFace:
    """The ball's centres at the contacts with one face, in the base."""

    centres_m: tuple[Triple, ...]
    outward: Triple  # unit vector against the approach: from the material to the tip
    sigma_m: tuple[float, ...]  # standard, of each along the normal


@dataclass(frozen=True, slots=True)
class CornerFrame:
    """The frame where the three planes meet, and how well its points tell it; in its own axes, shift before turn."""

    base_frame: Pose
    covariance: tuple[tuple[float, ...], ...]  # 6 x 6 [m^2, m rad, rad^2]
    misses_m: tuple[tuple[float, ...], ...]  # of each point from its plane: z face, y face, x face
    redundancy: int
    square_rad: tuple[
        float, ...
    ]  # by how much the y and x face miss their right angles, where points tell it

    @property
    def standard_uncertainties(self) -> tuple[float, ...]:
        """Standard uncertainties of shift [m] and turn [rad]."""
        return tuple(float(v) for v in np.sqrt(np.diag(self.covariance_matrix())))

    def covariance_matrix(self) -> Array:
        """Return the covariance (6, 6)."""
        return np.array(self.covariance)

    @property
    def rms_m(self) -> float:
        """Root mean square of what the points miss."""
        return float(np.sqrt(np.mean([miss**2 for face in self.misses_m for miss in face])))


def outward_in_frame(face: FaceName, corner: Corner) -> Array:
    """Return a face's outward normal (3,) seen from the frame: z up; x and y from the material of the corner."""
    sign = 1.0 if face == "z" or corner == "inside" else -1.0
    return np.asarray(sign * np.eye(3)[_AXIS[face]])


def three_two_one(faces: dict[FaceName, CornerFace], *, radius_m: float, corner: Corner) -> CornerFrame:
    """Return the frame at the corner where three faces meet: z from the first, x along the second.

    Parameters
    ----------
    faces : three faces
        Three or more points of "z", two or more of "y", one or more of "x", in the base frame [m].
    radius_m : float
        Of the ball, less the way it gives before the contact is seen. It is taken off along each outward normal.
    corner : "outside" or "inside"
        Whether the workpiece lies at +x and +y of the corner below z, or is a nest that opens to +x, +y, +z.

    Raises
    ------
    DegenerateDataError
        Too few points, points too near each other or on one line, a face that is not where it was felt for, or
        faces that are not square.
    PointsDisagreeError
        Points to spare miss their planes by more than their uncertainties explain at 99.9 %.

    Notes
    -----
    The squareness of a face is told only by points of it beyond the least: three of the y face not on one
    line, two of the x face.
    """
    for name in FACES:
        _refuse_bad(name, faces[name])
    matrix, square = _solve_corner(faces, radius_m, corner)
    surfaces = {name: _surface_points(matrix, faces[name], name, radius_m, corner) for name in FACES}
    misses = {name: surfaces[name][:, _AXIS[name]] for name in FACES}
    _refuse_misses(faces, misses)
    covariance = corner_covariance(surfaces, {name: faces[name].sigma_m for name in FACES})
    return CornerFrame(
        base_frame=Pose.from_matrix(matrix),
        covariance=tuple(tuple(float(v) for v in row) for row in covariance),
        misses_m=tuple(tuple(float(v) for v in misses[name]) for name in FACES),
        redundancy=sum(len(faces[name].centres_m) - LEAST[name] for name in FACES),
        square_rad=square,
    )


def corner_covariance(
    surfaces_m: dict[FaceName, Array], sigma_m: Mapping[FaceName, Sequence[float]]
) -> Array:
    """Return the covariance (6, 6) of the frame's shift and turn for points (N, 3) of each face seen from it."""
    estimate = corner_estimate(surfaces_m, sigma_m)
    variances = np.square(np.concatenate([np.asarray(sigma_m[name], dtype=float) for name in FACES]))
    return np.asarray((estimate * variances) @ estimate.T)


def corner_estimate(surfaces_m: dict[FaceName, Array], sigma_m: Mapping[FaceName, Sequence[float]]) -> Array:
    """Return G (6, N): what errors of the points along +z, +y, +x make of the frame's shift and turn."""
    count = {name: len(surfaces_m[name]) for name in FACES}
    estimate, first = np.zeros((6, sum(count.values()))), 0
    for name in FACES:
        rows, own = _face_rows(name, surfaces_m[name]), list(_TELLS[name])
        offsets = -rows @ estimate  # what the faces before it make these points miss
        offsets[:, first : first + count[name]] += np.eye(count[name])
        weights = 1.0 / np.asarray(sigma_m[name], dtype=float)[:, None]
        estimate[own] = np.linalg.pinv(rows[:, own] * weights) @ (offsets * weights)
        first += count[name]
    return estimate


def _face_rows(name: FaceName, at_m: Array) -> Array:
    """Return by how much a frame's shift and turn displace a plane of it at these points (N, 6)."""
    x, y, z = at_m.T
    rows = np.zeros((len(at_m), 6))
    rows[:, _AXIS[name]] = 1.0
    for column, lever in {"z": ((3, y), (4, -x)), "y": ((5, x), (3, -z)), "x": ((4, z), (5, -y))}[name]:
        rows[:, column] = lever
    return rows


def _solve_corner(
    faces: dict[FaceName, CornerFace], radius_m: float, corner: Corner
) -> tuple[Array, tuple[float, ...]]:
    z, z_at = _fit_plane(faces["z"])
    _refuse_wrong_side("z", z, faces["z"])
    flat = np.eye(3) - np.outer(z, z)
    out, y_at = _fit_line(faces["y"], flat)
    _refuse_wrong_side("y", out, faces["y"])
    y = out * outward_in_frame("y", corner)[1]
    x = np.cross(y, z)
    stop = x * outward_in_frame("x", corner)[0]
    _refuse_wrong_side("x", stop, faces["x"])
    square = _face_squareness(faces, (x, y, z))
    places = (_weighted_points(faces["x"])[1] @ stop, y_at @ out, z_at @ z)
    origin = sum((at - radius_m) * normal for at, normal in zip(places, (stop, out, z), strict=True))
    return homogeneous_matrix(np.column_stack([x, y, z]), np.asarray(origin)), square


def _fit_plane(face: CornerFace) -> tuple[Array, Array]:
    """Return the outward normal of the plane of least squares, and a point of it."""
    apart, middle, weights = _weighted_points(face)
    normal = np.linalg.svd(apart * weights)[2][2]
    return normal * (1.0 if normal @ np.array(face.outward) > 0 else -1.0), middle


def _fit_line(face: CornerFace, flat: Array) -> tuple[Array, Array]:
    """Return the outward normal, square to z, of a face's points as they are seen along z, and a point of it."""
    apart, middle, weights = _weighted_points(face)
    projected = apart @ flat
    along = np.linalg.svd(projected * weights)[2][0]
    if np.linalg.norm(projected @ along) < MIN_DISTANCE_M / 2:
        raise DegenerateDataError(
            "the points of the y face lie above each other: they do not tell its direction.",
            remedy="Feel for them 20 mm or more apart along the edge.",
        )
    out = flat @ np.array(face.outward)
    out = out - along * (along @ out)
    size = float(np.linalg.norm(out))
    return out / max(size, 1e-12), middle


def _weighted_points(face: CornerFace) -> tuple[Array, Array, Array]:
    """Return points from their weighted middle (N, 3), the middle, and their weights (N, 1)."""
    points, weights = np.array(face.centres_m), 1.0 / np.array(face.sigma_m)[:, None]
    middle = np.average(points, axis=0, weights=weights[:, 0] ** 2)
    return points - middle, middle, weights / weights.max()


def _face_squareness(
    faces: dict[FaceName, CornerFace], axes: tuple[Array, Array, Array]
) -> tuple[float, ...]:
    """Return by how much the y face leans from z and the x face from y, where their points tell it [rad]."""
    x, y, z = axes
    found: list[float] = []
    side, stop = np.array(faces["y"].centres_m), np.array(faces["x"].centres_m)
    height = side @ z - np.mean(side @ z)
    along = side @ x - np.mean(side @ x)
    columns = np.column_stack([along, height, np.ones(len(side))])
    if len(side) > 2 and np.linalg.svd(columns[:, :2])[1][-1] > MIN_DISTANCE_M / 2:
        found.append(math.atan(float(np.linalg.lstsq(columns, side @ y, rcond=None)[0][1])))
    across = stop @ y - np.mean(stop @ y)
    if np.ptp(across) > MIN_DISTANCE_M:
        found.append(math.atan(float(across @ (stop @ x) / (across @ across))))
    _refuse_crooked(found)
    return tuple(found)


def _refuse_crooked(found: Sequence[float]) -> None:
    worst = max(map(abs, found), default=0.0)
    if worst > SQUARE_RAD:
        raise DegenerateDataError(
            make_message(
                "two faces meet at {worst:.2f} deg instead of 90 deg: they tell no corner.",
                worst=90.0 - math.degrees(worst),
            ),
            remedy="See that burrs and chips are gone and that the points lie on the faces that are meant.",
        )


def _surface_points(
    matrix: Array, face: CornerFace, name: FaceName, radius_m: float, corner: Corner
) -> Array:
    """Return the touched points of the surface (N, 3), seen from the frame."""
    local = (np.array(face.centres_m) - matrix[:3, 3]) @ matrix[:3, :3]
    return np.asarray(local - radius_m * outward_in_frame(name, corner))


def _refuse_bad(name: FaceName, face: CornerFace) -> None:
    points = np.asarray(face.centres_m, dtype=float).reshape(-1, 3)
    sigma = np.asarray(face.sigma_m, dtype=float)
    if len(points) < LEAST[name] or len(sigma) != len(points):
        raise DegenerateDataError(
            make_message(
                "the {name} face needs {least} points or more, each with its sigma.",
                name=name,
                least=LEAST[name],
            )
        )
    if not np.isfinite([*points.ravel(), *sigma, *face.outward]).all() or (sigma <= 0).any():
        raise CalibrationError("touched points need finite coordinates and uncertainties above zero")
    if name == "x":
        return
    sizes = np.linalg.svd(points - points.mean(axis=0))[1]
    if sizes[0] < MIN_DISTANCE_M / 2:
        raise DegenerateDataError(
            make_message(
                "the points of the {name} face lie within {min_distance_m:.0f} mm of each other.",
                name=name,
                min_distance_m=MIN_DISTANCE_M * 1000.0,
            ),
            remedy="Feel for them farther apart: the frame turns by point error / distance.",
        )
    if name == "z" and sizes[1] < _SLIM * sizes[0]:
        raise DegenerateDataError(
            "the points of the z face lie nearly on one line.", remedy="Spread them over the face."
        )


def _refuse_wrong_side(name: FaceName, outward: Array, face: CornerFace) -> None:
    probe_direction = np.array(face.outward) / np.linalg.norm(face.outward)
    angle = math.acos(float(np.clip(outward @ probe_direction, -1.0, 1.0)))
    if angle > WRONG_SIDE_RAD:
        raise DegenerateDataError(
            make_message(
                "the {name} face looks {angle:.0f} deg away from where it was felt for.",
                name=name,
                angle=math.degrees(angle),
            ),
            remedy="See that the points lie on one face; check the frame as drawn and the kind of corner.",
        )


def _refuse_misses(faces: dict[FaceName, CornerFace], misses: dict[FaceName, Array]) -> None:
    spare = sum(len(faces[name].centres_m) - LEAST[name] for name in FACES)
    shares = {name: misses[name] / np.array(faces[name].sigma_m) for name in FACES}
    if spare and sum(float(share @ share) for share in shares.values()) > chi_square_limit(spare):
        worst = max(FACES, key=lambda name: float(np.abs(shares[name]).max()))
        most = int(np.argmax(np.abs(shares[worst])))
        raise PointsDisagreeError(
            make_message(
                "point {most} of the {worst} face misses it by {misses:.2f} mm, more than its "
                "uncertainty explains.",
                most=most + 1,
                worst=worst,
                misses=abs(misses[worst][most]) * 1000.0,
            ),
            remedy="Clean the faces; see that workpiece and probe are fixed, then feel for them in a new run.",
        )
