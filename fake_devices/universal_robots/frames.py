"""Rigid frames as rows of a 3 x 4 matrix, and poses: x, y, z with a rotation vector.

Imitates
    pose_trans, pose_inv and interpolate_pose of URScript.
Source
    The maker's script manual: poses are x, y, z and a rotation vector.
Modelled
    Plain Python floats, because a controller step must stay below a millisecond.
Not modelled
    Roll, pitch, yaw and the other notations of the teach pendant.
"""

from collections.abc import Sequence
from math import atan2, cos, sin, sqrt

Vector = tuple[float, ...]
Row = tuple[float, float, float, float]
Frame = tuple[Row, Row, Row]

IDENTITY: Frame = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))


def multiply_frames(a: Frame, b: Frame) -> Frame:
    """Return a . b."""
    (b00, b01, b02, b03), (b10, b11, b12, b13), (b20, b21, b22, b23) = b
    rows = [
        (
            x * b00 + y * b10 + z * b20,
            x * b01 + y * b11 + z * b21,
            x * b02 + y * b12 + z * b22,
            x * b03 + y * b13 + z * b23 + w,
        )
        for x, y, z, w in a
    ]
    return rows[0], rows[1], rows[2]


def invert_frame(a: Frame) -> Frame:
    """Return the inverse of a rigid frame."""
    p = origin_of(a)
    columns = [(a[0][i], a[1][i], a[2][i]) for i in range(3)]
    rows = [(*c, -(c[0] * p[0] + c[1] * p[1] + c[2] * p[2])) for c in columns]
    return rows[0], rows[1], rows[2]


def origin_of(a: Frame) -> tuple[float, float, float]:
    """Return the origin of a frame."""
    return a[0][3], a[1][3], a[2][3]


def rotation_matrix(vector: Sequence[float], at_m: Sequence[float] = (0.0, 0.0, 0.0)) -> Frame:
    """Return the frame turned by a rotation vector (Rodrigues) whose origin is ``at_m``."""
    x, y, z = vector
    angle = sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return (1.0, -z, y, at_m[0]), (z, 1.0, -x, at_m[1]), (-y, x, 1.0, at_m[2])
    x, y, z = x / angle, y / angle, z / angle
    c, s = cos(angle), sin(angle)
    v = 1.0 - c
    return (
        (c + x * x * v, x * y * v - z * s, x * z * v + y * s, at_m[0]),
        (y * x * v + z * s, c + y * y * v, y * z * v - x * s, at_m[1]),
        (z * x * v - y * s, z * y * v + x * s, c + z * z * v, at_m[2]),
    )


def rotation_vector(a: Frame) -> tuple[float, float, float]:
    """Return the rotation vector of a frame, its length within 0 and pi."""
    trace = a[0][0] + a[1][1] + a[2][2]
    raw = (a[2][1] - a[1][2], a[0][2] - a[2][0], a[1][0] - a[0][1])
    sine2 = sqrt(raw[0] ** 2 + raw[1] ** 2 + raw[2] ** 2)  # 2 sin(angle)
    if sine2 < 1e-5 and trace > 0.0:
        return raw[0] / 2.0, raw[1] / 2.0, raw[2] / 2.0
    angle = atan2(sine2, trace - 1.0)
    x, y, z = _half_turn_axis(a, raw) if sine2 < 1e-5 else (raw[0] / sine2, raw[1] / sine2, raw[2] / sine2)
    return x * angle, y * angle, z * angle


def _half_turn_axis(a: Frame, raw: Sequence[float]) -> tuple[float, float, float]:
    """Return the axis where the antisymmetric part only gives its sign."""
    axis = [sqrt(max(0.0, (a[i][i] + 1.0) / 2.0)) for i in range(3)]
    lead = axis.index(max(axis))
    for i in range(3):
        if i != lead:
            axis[i] = (a[lead][i] + a[i][lead]) / (4.0 * axis[lead])
    sign = -1.0 if raw[lead] < 0.0 else 1.0
    return sign * axis[0], sign * axis[1], sign * axis[2]


def frame_of(pose: Sequence[float]) -> Frame:
    """Return the frame of a pose x, y, z, rx, ry, rz."""
    return rotation_matrix(pose[3:6], pose[0:3])


def pose_of(a: Frame) -> Vector:
    """Return the pose x, y, z, rx, ry, rz of a frame."""
    return (*origin_of(a), *rotation_vector(a))


def frame_difference(start: Frame, end: Frame) -> Vector:
    """Return how far ``end`` is from ``start``, in base axes: translation, then rotation vector."""
    turn = rotation_vector(multiply_frames(_rotation_only(end), invert_frame(_rotation_only(start))))
    p, r = origin_of(start), origin_of(end)
    return (r[0] - p[0], r[1] - p[1], r[2] - p[2], *turn)


def move_frame(start: Frame, by: Sequence[float], part: float = 1.0) -> Frame:
    """Return ``start`` moved by a part of a difference."""
    p = origin_of(start)
    turn = multiply_frames(rotation_matrix([part * value for value in by[3:6]]), _rotation_only(start))
    at = [p[i] + part * by[i] for i in range(3)]
    return (*turn[0][:3], at[0]), (*turn[1][:3], at[1]), (*turn[2][:3], at[2])


def _rotation_only(a: Frame) -> Frame:
    return (*a[0][:3], 0.0), (*a[1][:3], 0.0), (*a[2][:3], 0.0)
