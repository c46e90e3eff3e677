"""All postures of an arm of six joints that reach given poses: up to eight, in closed form.

Two families cover the arms of this trade: joints 2 and 3 parallel with a wrist whose axes meet in one point, and
joints 2, 3 and 4 parallel (Universal Robots). Nothing is known of the arm but its axes at zero, so that signs,
couplings and frames of any maker are met alike.

References
----------
M. Brandstötter, A. Angerer, M. Hofbaur, An Analytical Solution of the Inverse Kinematics Problem of Industrial
Serial Manipulators with an Ortho-parallel Basis and a Spherical Wrist, Austrian Robotics Workshop, 2014.
K. P. Hawkins, Analytic Inverse Kinematics for the Universal Robots UR-5/UR-10 Arms, Georgia Tech, 2013.
Written here with rotations about the axes at zero: R. M. Murray, Z. Li, S. S. Sastry, A Mathematical Introduction
to Robotic Manipulation, 1994, section 3.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel, frames_of_placements
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.calibration.message import make_message

BRANCHES = 8
_PARALLEL = 1e-6  # of unit vectors' products
_MEET_M = 1e-6
_TOUCHES = 1e-9  # how far beyond its reach a pose may be by rounding, as a cosine


@dataclass(frozen=True, eq=False)
class AxesAtZero:
    """The axes of an arm with all DH angles zero, seen from the base."""

    model: RobotModel
    axes: Array  # (6, 3) unit
    origins_m: Array  # (6, 3) a point of each
    base_flange: Array  # (4, 4)
    centre_m: Array  # (3,) where the wrist's axes meet: 4, 5 and 6, or 5 and 6
    parallel_wrist: bool  # joint 4 is parallel to 2 and 3

    @classmethod
    def from_model(cls, model: RobotModel) -> Self:
        """Find the axes of a nominal arm, and the family it is of.

        Raises
        ------
        CalibrationError
            An arm of neither family.
        """
        refuse_other_joints(model)
        rotations, origins = frames_of_placements(model.placements, np.zeros((6, 1)))
        axes, points = rotations[:-1, :, 2, 0], origins[:-1, :, 0]
        base_flange = np.eye(4)
        base_flange[:3, :3], base_flange[:3, 3] = rotations[-1, :, :, 0], origins[-1, :, 0]
        square = [abs(axes[i] @ axes[j]) for i, j in ((0, 1), (3, 4), (4, 5))]
        in_line = [float(np.linalg.norm(np.cross(axes[1], axes[j]))) for j in (2, 3)]
        if max(*square, in_line[0]) > _PARALLEL:
            raise _unknown_family_error(model)
        parallel_wrist = in_line[1] <= _PARALLEL
        centre, apart = _nearest_point(points[4], axes[4], points[5], axes[5])
        off_fourth = float(np.linalg.norm(np.cross(centre - points[3], axes[3])))
        if apart > _MEET_M or (not parallel_wrist and off_fourth > _MEET_M):
            raise _unknown_family_error(model)
        return cls(model, axes, points, base_flange, centre, parallel_wrist)


def refuse_other_joints(model: RobotModel) -> None:
    """Refuse an arm that has not six joints that turn.

    Raises
    ------
    CalibrationError
        With what it has, and where such an arm can be used.
    """
    if model.axis_count == 6 and model.sliding is None:
        return
    slides = int(np.sum(model.sliding)) if model.sliding is not None else 0
    raise CalibrationError(
        make_message(
            "points of programs are changed for arms of six joints that turn; {model_name} has {joints}, of which "
            "{slides} slide.",
            model_name=model.label,
            joints=model.axis_count,
            slides=slides,
        ),
        remedy="Change this program at its controller: nothing of it was written. A track under an arm of six joints "
        "is no joint of the model; state it as [[track]]. `cellcal identify` and `cellcal poses` take any arm.",
    )


def all_branches(zero: AxesAtZero, base_flange: Array) -> Array:
    """Return every posture that brings the flange to given poses.

    Parameters
    ----------
    zero : AxesAtZero
        Of the nominal arm; an arm near to it is met by a step or two from here.
    base_flange : (N, 4, 4)
        Finite rigid transforms [m].

    Returns
    -------
    joints_rad : (8, N, 6)
        What the controller shows, each DH angle within half a turn of its zero; NaN where a branch does not reach.
        In a singularity one posture of the many.
    """
    target_poses = base_flange @ inverse_transform(zero.base_flange)
    centre = target_poses[:, :3, :3] @ zero.centre_m + target_poses[:, :3, 3]
    angles = np.empty((BRANCHES, 6, len(base_flange)))
    with np.errstate(invalid="ignore"):
        for i, first in enumerate(_first_angles(zero, centre)):
            block = angles[4 * i : 4 * i + 4]
            block[:, 0] = first
            solve = _parallel_arm if zero.parallel_wrist else _wristed_arm
            solve(zero, target_poses, _RemainingMotion(zero.axes[0], first), centre, block)
    centred = np.remainder(angles - zero.model.theta0_rad[:, None] + np.pi, 2 * np.pi) - np.pi
    back = np.linalg.inv(zero.model.joint_coupling)
    return np.ascontiguousarray((back @ centred).swapaxes(1, 2))


def branch_numbers(zero: AxesAtZero, joints_rad: Array) -> NDArray[np.intp]:
    """Return by which of the eight branches an arm stands (N,), as ``all_branches`` numbers them.

    Parameters
    ----------
    zero : AxesAtZero
        Of the nominal arm.
    joints_rad : (N, 6)
        Finite. In a singularity, where branches meet, the number is that of one of them.
    """
    branches = all_branches(zero, zero.model.base_flange(joints_rad))
    apart = np.abs(np.remainder(branches - joints_rad + np.pi, 2 * np.pi) - np.pi).sum(axis=2)
    return np.asarray(np.argmin(np.where(np.isfinite(apart), apart, np.inf), axis=0), dtype=np.intp)


class _RemainingMotion:
    """The rest of a motion when a turn before it is taken back."""

    def __init__(self, axis: Array, angle: Array) -> None:
        self._axis, self._cos, self._sin = axis, np.cos(angle)[:, None], np.sin(angle)[:, None]

    def rotate_back(self, vectors: Array) -> Array:
        """Return directions (N, 3) turned back, by Rodrigues' formula."""
        x, y, z = self._axis
        across = vectors @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # axis x vector, turned back
        along = (vectors @ self._axis)[:, None] * (1.0 - self._cos)
        turned: Array = self._cos * vectors + self._sin * across + along * self._axis
        return turned

    def move_back(self, point: Array, places: Array) -> Array:
        """Return places (N, 3) turned back about a line through a point."""
        turned: Array = self.rotate_back(places - point) + point
        return turned


def _wristed_arm(
    zero: AxesAtZero, target_poses: Array, first: _RemainingMotion, centre: Array, out: Array
) -> None:
    """Solve joints 2 to 6 of an arm with a wrist; ``out`` is (4, 6, N)."""
    fifth, sixth = (first.rotate_back(target_poses[:, :3, :3] @ zero.axes[k]) for k in (4, 5))
    end = first.move_back(zero.origins_m[0], centre)
    for i, (second, third) in enumerate(_two_links(zero, end, zero.centre_m)):
        before = _RemainingMotion(zero.axes[1], second + third * (zero.axes[1] @ zero.axes[2]))
        for j, wrist in enumerate(
            _wrist_angles(zero.axes[3], zero, before.rotate_back(fifth), before.rotate_back(sixth))
        ):
            out[2 * i + j, 1], out[2 * i + j, 2] = second, third
            out[2 * i + j, 3:] = wrist


def _parallel_arm(
    zero: AxesAtZero, target_poses: Array, first: _RemainingMotion, centre: Array, out: Array
) -> None:
    """Solve joints 2 to 6 of an arm with three parallel joints; ``out`` is (4, 6, N)."""
    e, signs = zero.axes[1], zero.axes[1:4] @ zero.axes[1]
    axis_directions = [first.rotate_back(target_poses[:, :3, :3] @ zero.axes[k]) for k in (4, 5)]
    for i, (whole, fifth, sixth) in enumerate(_wrist_angles(e, zero, *axis_directions)):
        # The elbow's end follows from the flange when joints 6 and 5 are turned back.
        inner = _back_through_wrist(zero, fifth, sixth)
        end = first.move_back(
            zero.origins_m[0], (target_poses[:, :3, :3] @ inner[:, :, None])[:, :, 0] + target_poses[:, :3, 3]
        )
        for j, (second, third) in enumerate(_two_links(zero, end, zero.origins_m[3])):
            row = out[2 * i + j]
            row[1], row[2], row[4], row[5] = second, third, fifth, sixth
            row[3] = (whole - signs[0] * second - signs[1] * third) * signs[2]


def _back_through_wrist(zero: AxesAtZero, fifth: Array, sixth: Array) -> Array:
    """Return where the origin of joint 4 is before joints 5 and 6 turned: (E5 E6)^-1 o4, (N, 3)."""
    start = np.broadcast_to(zero.origins_m[3], (len(fifth), 3))
    point = _RemainingMotion(zero.axes[4], fifth).move_back(zero.origins_m[4], start)
    return _RemainingMotion(zero.axes[5], sixth).move_back(zero.origins_m[5], point)


def _first_angles(zero: AxesAtZero, centre: Array) -> tuple[Array, Array]:
    """Return the two turns of joint 1 that bring the wrist's centre into the plane in which joints 2 and 3 move."""
    z, e, start = zero.axes[0], zero.axes[1], zero.origins_m[0]
    beside = float(e @ (zero.centre_m - start))
    away = centre - start
    along, across = away @ e, away @ np.cross(z, e)
    half = _arc_cosine(beside / np.hypot(along, across))
    middle = np.arctan2(across, along)
    return middle + half, middle - half


def _two_links(zero: AxesAtZero, end: Array, end_at_zero: Array) -> tuple[tuple[Array, Array], ...]:
    """Return both ways in which joints 2 and 3 bring the end of the second link to places (N, 3)."""
    e = zero.axes[1]
    x = zero.axes[0]  # square to e
    plane = np.stack([x, np.cross(e, x)])
    shoulder, elbow, tip = (plane @ p for p in (zero.origins_m[1], zero.origins_m[2], end_at_zero))
    upper, fore = elbow - shoulder, tip - elbow
    lengths = float(np.linalg.norm(upper)), float(np.linalg.norm(fore))
    away = end @ plane.T - shoulder
    reach = (away**2).sum(axis=1)
    bend = _arc_cosine((reach - lengths[0] ** 2 - lengths[1] ** 2) / (2 * lengths[0] * lengths[1]))
    bent_at_zero = np.arctan2(upper[0] * fore[1] - upper[1] * fore[0], upper @ fore)
    sign = float(zero.axes[2] @ e)
    found = []
    for angle in (bend, -bend):
        turned = angle - bent_at_zero
        cos, sin = np.cos(turned), np.sin(turned)
        span = np.stack([upper[0] + cos * fore[0] - sin * fore[1], upper[1] + sin * fore[0] + cos * fore[1]])
        second = np.arctan2(away[:, 1], away[:, 0]) - np.arctan2(span[1], span[0])
        found.append((second, turned * sign))
    return tuple(found)


def _wrist_angles(first: Array, zero: AxesAtZero, seen_5: Array, seen_6: Array) -> tuple[Array, Array]:
    """Return both (3, N) triples of turns about ``first``, axis 5 and axis 6 that make a rotation.

    ``seen_5`` and ``seen_6`` (N, 3) are where the rotation takes axes 5 and 6.
    """
    z5, z6 = zero.axes[4], zero.axes[5]
    side = np.cross(z5, first)
    opening = np.arctan2(np.hypot(seen_6 @ side, seen_6 @ z5), seen_6 @ first)
    at_zero = np.arctan2(float(z6 @ side), float(z6 @ first))
    found = []
    for angle, sign in ((opening, 1.0), (-opening, -1.0)):
        fourth = np.arctan2(sign * (seen_6 @ z5), sign * (seen_6 @ side))
        fifth = angle - at_zero
        rest = _RemainingMotion(z5, fifth).rotate_back(_RemainingMotion(first, fourth).rotate_back(seen_5))
        found.append(np.stack([fourth, fifth, np.arctan2(rest @ np.cross(z6, z5), rest @ z5)]))
    return found[0], found[1]


def _arc_cosine(value: Array) -> Array:
    """Return the arc cosine; NaN beyond rounding, where the arm does not reach."""
    return np.arccos(np.where(np.abs(value) <= 1 + _TOUCHES, np.clip(value, -1.0, 1.0), np.nan))


def _nearest_point(p: Array, a: Array, q: Array, b: Array) -> tuple[Array, float]:
    """Return the point of line (p, a) nearest to line (q, b), and their distance; the lines are square."""
    point = p + a * (a @ (q - p))
    return point, float(np.linalg.norm(np.cross(point - q, b)))


def _unknown_family_error(model: RobotModel) -> CalibrationError:
    return CalibrationError(
        f"{model.label}: its postures cannot be told apart in closed form: joints 2 and 3 are not "
        "parallel, or the wrist is of neither family.",
        remedy="Give the joints of every position: a program that holds joints only needs none of this.",
    )
