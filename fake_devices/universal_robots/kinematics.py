"""Where the controller believes its tool is, and which joints put it there.

Imitates
    Forward and inverse kinematics of a Universal Robots controller with its factory calibration.
Source
    The maker's DH page: Rz(theta + q) Tz(d) Tx(a) Rx(alpha). A pose captured from URSim 5.8 is the test. In
    real calibrations d of the nearly parallel joints 2 to 4 may be hundreds of metres that cancel, and theta of
    joints 2 and 3 far from nominal; alpha, and theta of the others, are near nominal.
Modelled
    Six-axis UR geometry; eight closed-form solutions of the nominal arm, refined on the calibrated one.
Not modelled
    Singularity handling of movel beyond "no solution"; more than one turn in the answers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import acos, atan2, cos, hypot, pi, sin

import numpy as np
from numpy.typing import NDArray

from cellcal.fake_devices.universal_robots.frames import (
    IDENTITY,
    Frame,
    Vector,
    frame_difference,
    invert_frame,
    multiply_frames,
    origin_of,
)

_SMALL = 1e-9


@dataclass(frozen=True)
class FactoryDh:
    """Absolute DH of this one arm as the primary interface tells it."""

    theta_rad: Vector
    a_m: Vector
    d_m: Vector
    alpha_rad: Vector
    checksum: tuple[int, ...] = (0xFFFFFFFF,) * 6
    status: int = 2  # linearised


def factory_calibration(chain: NDArray[np.float64]) -> FactoryDh:
    """Turn rows theta, d, a, alpha, beta into plain DH: a tilt beta becomes a distant common normal."""
    origin, rows = np.eye(4), []
    end = np.eye(4)
    for theta, d, a, alpha, beta in chain[:5]:
        end = end @ _link_matrix(theta, d, a, alpha, beta)
        row = _common_normal(np.linalg.inv(origin) @ end, a)
        origin = origin @ _link_matrix(*row, 0.0)
        rows.append(row)
    theta, d, a, alpha, _ = chain[5]
    slip = np.linalg.inv(origin) @ end  # about and along the axis of joint 6 only
    rows.append((theta + atan2(slip[1, 0], slip[0, 0]), d + slip[2, 3], a, alpha))
    columns = [tuple(float(row[k]) for row in rows) for k in range(4)]
    sums = tuple(hash((round(row[1], 9), round(row[3], 9))) & 0xFFFFFFFF for row in rows)
    return FactoryDh(columns[0], columns[2], columns[1], columns[3], sums)


def _link_matrix(theta: float, d: float, a: float, alpha: float, beta: float) -> NDArray[np.float64]:
    c, s, ca, sa, cb, sb = cos(theta), sin(theta), cos(alpha), sin(alpha), cos(beta), sin(beta)
    turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    shape = np.array([[cb, 0, sb, a], [sa * sb, ca, -sa * cb, 0], [-ca * sb, sa, ca * cb, d], [0, 0, 0, 1.0]])
    return np.asarray(turn @ shape)


def _common_normal(link: NDArray[np.float64], a: float) -> tuple[float, float, float, float]:
    """Return theta, d, a, alpha that lead to the next joint's axis.

    Of the two directions of the normal it takes the one on the side of the drawn link's x axis: the other one
    gives a mirrored table, with alpha of the wrong sign and a last theta of half a turn, for the same pose.
    """
    u, p = link[:3, 2], link[:3, 3]
    across = hypot(u[0], u[1])
    if across < _SMALL:  # parallel: any height would do, so keep the drawing's
        length = hypot(p[0], p[1])
        if length < _SMALL:
            return atan2(link[1, 0], link[0, 0]), float(p[2]), 0.0, 0.0
        return (
            (atan2(p[1], p[0]), float(p[2]), length, 0.0)
            if a > 0
            else (atan2(-p[1], -p[0]), float(p[2]), -length, 0.0)
        )
    n = np.array([-u[1], u[0], 0.0]) / across
    if n @ link[:3, 0] < 0.0:
        n = -n
    m = np.array([n[1], -n[0], 0.0])
    along = -float(p @ m) / float(u @ m)
    d = float(p[2] + along * u[2])
    return atan2(n[1], n[0]), d, float(p @ n), atan2(float(u @ m), float(u[2]))


class UrArmKinematics:
    """Forward and inverse kinematics of one calibrated arm."""

    def __init__(self, calibration: FactoryDh, nominal: NDArray[np.float64]) -> None:
        self.calibration, self.nominal = calibration, nominal
        c = calibration
        self._rows = [
            (c.theta_rad[i], c.d_m[i], c.a_m[i], cos(c.alpha_rad[i]), sin(c.alpha_rad[i])) for i in range(6)
        ]

    def link_frames(self, joints_rad: Sequence[float]) -> list[Frame]:
        """Return base_link_i for i = 0 to 6."""
        frames, last = [IDENTITY], IDENTITY
        for (theta, d, a, ca, sa), q in zip(self._rows, joints_rad, strict=True):
            c, s = cos(theta + q), sin(theta + q)
            last = multiply_frames(
                last, ((c, -s * ca, s * sa, a * c), (s, c * ca, -c * sa, a * s), (0.0, sa, ca, d))
            )
            frames.append(last)
        return frames

    def base_flange(self, joints_rad: Sequence[float]) -> Frame:
        """Return base_flange."""
        return self.link_frames(joints_rad)[6]

    def elbow_position(self, joints_rad: Sequence[float]) -> tuple[float, float, float]:
        """Return the elbow of the drawing; the calibrated frame there may lie hundreds of metres away."""
        rows = self.nominal
        return origin_of(
            multiply_frames(_dh_frame(rows[0], joints_rad[0]), _dh_frame(rows[1], joints_rad[1]))
        )

    def tip_jacobian(self, joints_rad: Sequence[float], tip: Sequence[float]) -> NDArray[np.float64]:
        """Return (6, 6): velocity of ``tip`` (base coordinates), then angular velocity, per joint."""
        columns = np.empty((6, 6))
        for i, frame in enumerate(self.link_frames(joints_rad)[:6]):
            zx, zy, zz = frame[0][2], frame[1][2], frame[2][2]
            rx, ry, rz = tip[0] - frame[0][3], tip[1] - frame[1][3], tip[2] - frame[2][3]
            columns[:, i] = (zy * rz - zz * ry, zz * rx - zx * rz, zx * ry - zy * rx, zx, zy, zz)
        return columns

    def solve_nearby(self, goal: Frame, start_rad: Sequence[float], rounds: int = 12) -> Vector | None:
        """Return joints that put the flange on ``goal``, found by Newton's method from close by."""
        joints = tuple(start_rad)
        for _ in range(rounds):
            here = self.base_flange(joints)
            error = frame_difference(here, goal)
            if max(map(abs, error)) < 1e-11:
                return joints
            jacobian = self.tip_jacobian(joints, origin_of(here))
            step = _solve_damped(jacobian, np.array(error))
            joints = tuple(q + float(s) for q, s in zip(joints, step, strict=True))
        return joints if max(map(abs, frame_difference(self.base_flange(joints), goal))) < 1e-8 else None

    def solve_closest(self, goal: Frame, near_rad: Sequence[float]) -> Vector | None:
        """Return the joints on ``goal`` closest to ``near_rad``, or None when it is out of reach."""
        starts = [*self._closed_form(goal), tuple(near_rad)]
        found = [joints for start in starts if (joints := self.solve_nearby(goal, start)) is not None]
        wrapped = [_wrap_joints(joints, near_rad) for joints in found]
        return min(wrapped, key=lambda q: _squared_distance(q, near_rad), default=None)

    def _closed_form(self, goal: Frame) -> list[Vector]:
        """Return up to eight joint sets of the nominal arm."""
        d = self.nominal[:, 1]
        x, y, z = origin_of(goal)
        wx, wy = x - d[5] * goal[0][2], y - d[5] * goal[1][2]
        reach = hypot(wx, wy)
        if reach < abs(d[3]) or not np.isfinite(reach + z):
            return []
        lean = acos(d[3] / reach)
        return [
            solution
            for q1 in (atan2(wy, wx) + lean + pi / 2.0, atan2(wy, wx) - lean + pi / 2.0)
            for solution in self._wrist_solutions(goal, q1)
        ]

    def _wrist_solutions(self, goal: Frame, q1: float) -> list[Vector]:
        d = self.nominal[:, 1]
        s1, c1 = sin(q1), cos(q1)
        x, y, _ = origin_of(goal)
        cosine = (x * s1 - y * c1 - d[3]) / d[5]
        if abs(cosine) > 1.0 + 1e-3:
            return []
        solutions: list[Vector] = []
        for q5 in (acos(max(-1.0, min(1.0, cosine))), -acos(max(-1.0, min(1.0, cosine)))):
            sign = 1.0 if sin(q5) >= 0.0 else -1.0
            q6 = 0.0
            if abs(sin(q5)) > 1e-7:
                q6 = atan2(
                    sign * (-goal[0][1] * s1 + goal[1][1] * c1), sign * (goal[0][0] * s1 - goal[1][0] * c1)
                )
            solutions += self._elbow_solutions(goal, q1, q5, q6)
        return solutions

    def _elbow_solutions(self, goal: Frame, q1: float, q5: float, q6: float) -> list[Vector]:
        rows = self.nominal
        wrist = multiply_frames(_dh_frame(rows[4], q5), _dh_frame(rows[5], q6))
        middle = multiply_frames(
            multiply_frames(invert_frame(_dh_frame(rows[0], q1)), goal), invert_frame(wrist)
        )
        px, py, _ = origin_of(middle)
        a2, a3 = rows[1, 2], rows[2, 2]
        cosine = (px * px + py * py - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
        if abs(cosine) > 1.0 + 1e-3:
            return []
        whole = atan2(middle[1][0], middle[0][0])
        solutions: list[Vector] = []
        for q3 in (acos(max(-1.0, min(1.0, cosine))), -acos(max(-1.0, min(1.0, cosine)))):
            q2 = atan2(py, px) - atan2(a3 * sin(q3), a2 + a3 * cos(q3))
            solutions.append((q1, q2, q3, whole - q2 - q3, q5, q6))
        return solutions


def _dh_frame(row: NDArray[np.float64], q: float) -> Frame:
    theta, d, a, alpha = (float(value) for value in row[:4])
    c, s, ca, sa = cos(theta + q), sin(theta + q), cos(alpha), sin(alpha)
    return (c, -s * ca, s * sa, a * c), (s, c * ca, -c * sa, a * s), (0.0, sa, ca, d)


def _solve_damped(jacobian: NDArray[np.float64], error: NDArray[np.float64]) -> NDArray[np.float64]:
    """Damped only where the arm is singular, so that a regular solution converges to the last digit."""
    try:
        step = np.linalg.solve(jacobian, error)
    except np.linalg.LinAlgError:
        step = np.full(6, np.inf)
    if np.all(np.abs(step) < 0.5):
        return np.asarray(step)
    damped = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-4 * np.eye(6), error)
    return np.clip(damped, -0.3, 0.3)


def _wrap_joints(joints: Sequence[float], near_rad: Sequence[float]) -> Vector:
    turns = (round((n - q) / (2.0 * pi)) for q, n in zip(joints, near_rad, strict=True))
    return tuple(q + 2.0 * pi * k for q, k in zip(joints, turns, strict=True))


def _squared_distance(a: Sequence[float], b: Sequence[float]) -> float:
    return sum((x - y) ** 2 for x, y in zip(a, b, strict=True))
