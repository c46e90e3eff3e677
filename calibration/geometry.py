"""Poses and rotations. Right-handed frames, quaternions (w, x, y, z), metres and radians."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Pose:
    """A frame seen from another: ``base_flange`` is the flange seen from the base.

    Frozen tuples, so that a pose compares, hashes, prints and serialises; arrays live inside ``calibration`` only.
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
        return Pose.from_matrix(self.matrix() @ other.matrix())

    def inverse(self) -> "Pose":
        """Return the other frame seen from this one: ``flange_base = base_flange.inverse()``."""
        rotation = self.rotation()
        return Pose.from_matrix(homogeneous(rotation.T, -rotation.T @ np.array(self.position_m)))

    def rotation(self) -> Array:
        """Return the (3, 3) rotation matrix."""
        return rotation_from_quaternion(np.array(self.quaternion))

    def matrix(self) -> Array:
        """Return the (4, 4) homogeneous matrix."""
        return homogeneous(self.rotation(), np.array(self.position_m))

    @classmethod
    def from_matrix(cls, matrix: Array) -> "Pose":
        """Build from a (4, 4) homogeneous matrix; its rotation must be orthonormal within 1e-6."""
        rotation = np.asarray(matrix, dtype=float)[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
            raise CalibrationError("not a rotation: the matrix is not orthonormal and right-handed")
        x, y, z = (float(v) for v in matrix[:3, 3])
        w, qx, qy, qz = (float(v) for v in quaternion_from_rotation(rotation))
        return cls((x, y, z), (w, qx, qy, qz))


def homogeneous(rotation: Array, translation_m: Array) -> Array:
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
    w, x, y, z = np.moveaxis(np.asarray(quaternion, dtype=float), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


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
    return np.where(quaternion[..., :1] < 0, -quaternion, quaternion)
