"""Poses and rotations. Right-handed frames, quaternions (w, x, y, z), metres and radians."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.errors import CalibrationError

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Pose:
    """A frame seen from another: ``base_flange`` is the flange seen from the base.

    Frozen tuples, so that a pose compares, hashes, prints and serialises; arrays stay in ``calibration``.
    """

    position_m: tuple[float, float, float]
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)  # w, x, y, z; unit length

    def __post_init__(self) -> None:
        values = np.array([*self.position_m, *self.quaternion], dtype=float)
        if values.shape != (7,) or not np.isfinite(values).all():
            raise CalibrationError("a pose needs three finite coordinates and a finite quaternion")
        if abs(float(np.linalg.norm(values[3:])) - 1.0) > 1e-6:
            raise CalibrationError("the quaternion of a pose must have unit length")

    def __matmul__(self, other: "Pose") -> "Pose":
        """Chain frames: ``base_tip = base_flange @ flange_tip``."""
        return Pose.from_matrix(self.to_matrix() @ other.to_matrix())

    def inverse(self) -> "Pose":
        """Return the other frame seen from this one: ``flange_base = base_flange.inverse()``."""
        rotation = self.rotation_matrix()
        return Pose.from_matrix(homogeneous_matrix(rotation.T, -rotation.T @ np.array(self.position_m)))

    def rotation_matrix(self) -> Array:
        """Return the (3, 3) rotation matrix."""
        return rotation_from_quaternion(np.array(self.quaternion))

    def to_matrix(self) -> Array:
        """Return the (4, 4) homogeneous matrix."""
        return homogeneous_matrix(self.rotation_matrix(), np.array(self.position_m))

    @classmethod
    def from_matrix(cls, matrix: Array) -> "Pose":
        """Build from a (4, 4) homogeneous matrix; its rotation must be orthonormal within 1e-6."""
        rotation = np.asarray(matrix, dtype=float)[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
            raise CalibrationError("not a rotation: the matrix is not orthonormal and right-handed")
        x, y, z = (float(v) for v in matrix[:3, 3])
        w, qx, qy, qz = (float(v) for v in quaternion_from_rotation(rotation))
        return cls((x, y, z), (w, qx, qy, qz))


def homogeneous_matrix(rotation: Array, translation_m: Array) -> Array:
    """Assemble (…, 4, 4) from rotations (…, 3, 3) and translations (…, 3)."""
    rotation, translation_m = np.asarray(rotation), np.asarray(translation_m)
    shape = np.broadcast_shapes(rotation.shape[:-2], translation_m.shape[:-1])
    matrix = np.zeros((*shape, 4, 4))
    matrix[..., :3, :3] = rotation
    matrix[..., :3, 3] = translation_m
    matrix[..., 3, 3] = 1.0
    return matrix


def rotation_from_quaternion(quaternion: Array) -> Array:
    """Return (…, 3, 3) rotations from (…, 4) unit quaternions w, x, y, z."""
    quaternion = np.asarray(quaternion, dtype=float)
    w, v = quaternion[..., :1, None], quaternion[..., 1:]
    turn = skew_matrix(v)
    rotation: Array = np.eye(3) + 2.0 * (w * turn + turn @ turn)
    return rotation


def quaternion_from_rotation(rotation: Array) -> Array:
    """Return (…, 4) unit quaternions with w >= 0 from (…, 3, 3) rotations.

    The largest of the four squared components is found first, so no case loses digits.
    References: S. W. Shepperd, Quaternion from rotation matrix, J. Guidance and Control 1 (1978) 223.
    """
    r = np.asarray(rotation, dtype=float)
    trace = np.trace(r, axis1=-2, axis2=-1)
    diagonal = np.diagonal(r, axis1=-2, axis2=-1)
    squares = np.concatenate([(1 + trace)[..., None], 1 + 2 * diagonal - trace[..., None]], axis=-1)
    products = np.empty((*r.shape[:-2], 4, 4))
    off = {(0, 1): r[..., 2, 1] - r[..., 1, 2], (0, 2): r[..., 0, 2] - r[..., 2, 0],
           (0, 3): r[..., 1, 0] - r[..., 0, 1], (1, 2): r[..., 0, 1] + r[..., 1, 0],
           (1, 3): r[..., 0, 2] + r[..., 2, 0], (2, 3): r[..., 1, 2] + r[..., 2, 1]}  # fmt: skip
    for i in range(4):
        products[..., i, i] = squares[..., i]
    for (i, j), value in off.items():
        products[..., i, j] = products[..., j, i] = value
    best = np.argmax(squares, axis=-1)
    quaternion = np.take_along_axis(products, best[..., None, None], axis=-2)[..., 0, :]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    unique: Array = np.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    return unique


def adjoint_matrix(transform: Array) -> Array:
    """Return (6, 6): twists (v, w) seen through a rigid transform, ``T exp(x) = exp(Ad x) T``."""
    rotation, position = transform[:3, :3], transform[:3, 3]
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = rotation
    matrix[:3, 3:] = skew_matrix(position) @ rotation
    return matrix


def inverse_transform(matrix: Array) -> Array:
    """Return the inverses of rigid transforms (…, 4, 4)."""
    matrix = np.asarray(matrix, dtype=float)
    transposed = np.swapaxes(matrix[..., :3, :3], -1, -2)
    return homogeneous_matrix(transposed, -(transposed @ matrix[..., :3, 3:])[..., 0])


def is_rigid(matrix: Array, *, tolerance: float = 1e-6) -> bool:
    """Return whether all of (…, 4, 4) are finite, orthonormal, right-handed and end in 0 0 0 1."""
    matrix = np.asarray(matrix, dtype=float)
    if matrix.shape[-2:] != (4, 4) or not np.isfinite(matrix).all():
        return False
    return bool(np.abs(matrix[..., 3, :] - [0.0, 0.0, 0.0, 1.0]).max() <= tolerance) and is_rotation(
        matrix[..., :3, :3], tolerance=tolerance
    )


def is_rotation(rotation: Array, *, tolerance: float = 1e-6) -> bool:
    """Return whether all of (…, 3, 3) are finite, orthonormal and right-handed."""
    rotation = np.asarray(rotation, dtype=float)
    if rotation.shape[-2:] != (3, 3) or not np.isfinite(rotation).all():
        return False
    defect = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max()
    return bool(defect <= tolerance) and bool((np.linalg.det(rotation) > 0).all())


def skew_matrix(vector: Array) -> Array:
    """Return (…, 3, 3) with ``skew(v) @ w == v x w``."""
    vector = np.asarray(vector, dtype=float)
    matrix = np.zeros((*vector.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[..., k, j] = vector[..., i]
        matrix[..., j, k] = -vector[..., i]
    return matrix


def exp_rotation(vector_rad: Array) -> Array:
    """Return (…, 3, 3) rotations from (…, 3) rotation vectors [rad]."""
    vector = np.asarray(vector_rad, dtype=float)
    half = 0.5 * np.sqrt((vector * vector).sum(axis=-1, keepdims=True))
    # np.sinc(x) is sin(pi x) / (pi x): right down to zero.
    return rotation_from_quaternion(
        np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * vector], axis=-1)
    )


def log_rotation(rotation: Array) -> Array:
    """Return (…, 3) rotation vectors [rad], at most pi long; at pi, the first non-zero one is positive."""
    quaternion = quaternion_from_rotation(rotation)
    w, xyz = quaternion[..., :1], quaternion[..., 1:]
    sine = np.linalg.norm(xyz, axis=-1, keepdims=True)
    # 2 atan2(s, w) / s tends to 2 / w, and w to 1, where s vanishes.
    factor = np.where(sine > 1e-12, 2 * np.arctan2(sine, w) / np.where(sine > 1e-12, sine, 1.0), 2.0)
    first = np.take_along_axis(xyz, np.argmax(np.abs(xyz) > 1e-9, axis=-1)[..., None], axis=-1)
    return np.where((w < 1e-15) & (first < 0), -1.0, 1.0) * factor * xyz


def exp_twist(twist: Array) -> Array:
    """Return (…, 4, 4) rigid transforms from twists (…, 6): v [m], then w [rad].

    References
    ----------
    R. M. Murray, Z. Li, S. S. Sastry, A Mathematical Introduction to Robotic Manipulation, 1994, eq. 2.36.
    """
    twist = np.asarray(twist, dtype=float)
    v, w = twist[..., :3], twist[..., 3:]
    angle = np.sqrt((w * w).sum(axis=-1))[..., None, None]
    cross = skew_matrix(w)
    twice = cross @ cross
    # np.sinc(x) is sin(pi x) / (pi x): right down to zero.
    sine, first = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    small = angle < 1e-3
    second = np.where(small, 1 / 6 - angle**2 / 120, (1.0 - sine) / np.where(small, 1.0, angle) ** 2)
    v_matrix = np.eye(3) + first * cross + second * twice
    return homogeneous_matrix(np.eye(3) + sine * cross + first * twice, (v_matrix @ v[..., None])[..., 0])


def log_transform(matrix: Array) -> Array:
    """Return twists (…, 6) with ``exp_twist(twist) == matrix``, for angles below pi."""
    matrix = np.asarray(matrix, dtype=float)
    w = log_rotation(matrix[..., :3, :3])
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    cross = skew_matrix(w)
    small = angle < 1e-3
    safe = np.where(small, 1.0, angle)
    second = np.where(small, 1 / 12 + angle**2 / 720, 1 / safe**2 - 1 / (2 * safe * np.tan(0.5 * safe)))
    inverse_left = np.eye(3) - 0.5 * cross + second * (cross @ cross)
    return np.concatenate([(inverse_left @ matrix[..., :3, 3:])[..., 0], w], axis=-1)


def mean_rotation(rotations: Array) -> Array:
    """Return the (3, 3) rotation nearest to all of (N, 3, 3): the chordal mean.

    References
    ----------
    R. Hartley et al., Rotation Averaging, Int. J. Computer Vision 103 (2013) 267, section 5.
    """
    return nearest_rotation(np.mean(np.asarray(rotations, dtype=float), axis=0))


def nearest_rotation(matrix: Array) -> Array:
    """Return the rotation nearest to a (3, 3) matrix in the least-squares sense.

    References
    ----------
    S. Umeyama, Least-squares estimation of transformation parameters between two point patterns, IEEE Trans.
    PAMI 13 (1991) 376.
    """
    u, singular, vt = np.linalg.svd(matrix)
    if singular[1] < 1e-9 * max(singular[0], 1e-300):
        raise CalibrationError("no rotation is nearest to this matrix")
    u[:, 2] *= np.sign(np.linalg.det(u @ vt))
    rotation: Array = u @ vt
    return rotation
