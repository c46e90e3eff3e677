"""How each maker writes an orientation, by name.

``rotation_from("fanuc_wpr", values)`` and ``values_from("fanuc_wpr", rotation)`` work on one or on many;
angles are radians, rotations turn vectors of the inner frame into the outer one.

Where three angles lose one freedom (gimbal lock, within 1e-9 rad), the *leftmost* factor of the product is
set to zero and the rightmost angle carries the whole turn: FANUC's W 180, P -90, R 0 at all joints zero.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import (
    Array,
    exp_rotation,
    is_rotation,
    log_rotation,
    quaternion_from_rotation,
    rotation_from_quaternion,
)
from cellcal.calibration.message import make_message

LOCK_RAD = 1e-9


@dataclass(frozen=True, slots=True)
class OrientationConvention:
    """One way to write an orientation as numbers."""

    name: str
    fields: tuple[str, ...]  # in the order in which the maker writes them
    formula: str
    to_rotation: Callable[[Array], Array]
    from_rotation: Callable[[Array], Array]


def rotation_from(convention: str, values: Array) -> Array:
    """Return (…, 3, 3) rotations from (…, k) numbers written in a named convention [rad or 1].

    Raises
    ------
    CalibrationError
        Unknown convention, wrong count, a number that is not finite, a quaternion that is not of unit length.
    """
    rule = _find_convention(convention)
    numbers = np.asarray(values, dtype=float)
    if numbers.ndim == 0 or numbers.shape[-1] != len(rule.fields):
        raise CalibrationError(
            f"{convention} has the fields {', '.join(rule.fields)}, not shape {numbers.shape}"
        )
    if not np.isfinite(numbers).all():
        raise CalibrationError(f"{convention}: the numbers must be finite")
    return rule.to_rotation(numbers)


def values_from(convention: str, rotation: Array) -> Array:
    """Return (…, k) numbers as a maker writes them, from (…, 3, 3) rotations.

    Raises
    ------
    CalibrationError
        Unknown convention, or a matrix that is not a right-handed rotation within 1e-6.
    """
    rule = _find_convention(convention)
    matrix = np.asarray(rotation, dtype=float)
    if not is_rotation(matrix):
        raise CalibrationError(f"{convention}: not a finite, orthonormal, right-handed rotation")
    return rule.from_rotation(matrix)


def euler_rotation(axes: str, angles_rad: Array) -> Array:
    """Return the product of elementary rotations, leftmost first: ``zyx`` is ``Rz(a) Ry(b) Rx(c)``."""
    angles = np.asarray(angles_rad, dtype=float)
    first, second, third = (elementary_rotation(axis, angles[..., i]) for i, axis in enumerate(axes))
    return first @ second @ third


def euler_angles(axes: str, rotation: Array) -> Array:
    """Return (…, 3) angles (a, b, c) with ``euler_rotation(axes, angles) == rotation``.

    The leftmost angle is found first and turned back before the others are read, so that its noise close to
    gimbal lock is made up for by the last one and the product keeps all its digits. Three different axes give
    -pi/2 <= b <= pi/2, a repeated axis gives 0 <= b <= pi.
    """
    rotation = np.asarray(rotation, dtype=float)
    i, j = "xyz".index(axes[0]), "xyz".index(axes[1])
    k = 3 - i - j
    parity = 1.0 if (j - i) % 3 == 1 else -1.0
    repeated = axes[0] == axes[2]
    # The last turn leaves its own axis where it is; the image of that axis shows the other two.
    image = rotation[..., i if repeated else k]
    bearing = (
        (image[..., j], -parity * image[..., k]) if repeated else (-parity * image[..., j], image[..., k])
    )
    a = np.where(np.hypot(*bearing) < LOCK_RAD, 0.0, np.arctan2(*bearing))
    rest = np.swapaxes(elementary_rotation(axes[0], a), -1, -2) @ rotation
    image = rest[..., i if repeated else k]
    tilt = (-parity * image[..., k], image[..., i]) if repeated else (parity * image[..., i], image[..., k])
    b = np.arctan2(*tilt)
    turn = np.swapaxes(elementary_rotation(axes[1], b), -1, -2) @ rest
    p, q = ("xyz".index(axes[2]) + 1) % 3, ("xyz".index(axes[2]) + 2) % 3
    return np.stack([a, b, np.arctan2(turn[..., q, p], turn[..., p, p])], axis=-1)


def elementary_rotation(axis: str, angle_rad: Array) -> Array:
    """Return (…, 3, 3): the right-handed turn about x, y or z by (…) angles."""
    angle = np.asarray(angle_rad, dtype=float)
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    rotation = np.zeros((*angle.shape, 3, 3))
    rotation[..., i, i] = 1.0
    rotation[..., j, j] = rotation[..., k, k] = np.cos(angle)
    rotation[..., k, j] = np.sin(angle)
    rotation[..., j, k] = -rotation[..., k, j]
    return rotation


def _angle_convention(name: str, fields: str, product: str) -> OrientationConvention:
    """``fields`` in the maker's order; ``product`` such as "Rz(R) Ry(P) Rx(W)"."""
    names = tuple(fields.split())
    factors = [(factor[1], factor[3:-1]) for factor in product.split()]
    axes = "".join(axis for axis, _ in factors)
    order = [names.index(field) for _, field in factors]
    back = [order.index(i) for i in range(3)]
    return OrientationConvention(
        name,
        names,
        product,
        lambda values: euler_rotation(axes, values[..., order]),
        lambda rotation: euler_angles(axes, rotation)[..., back],
    )


def _quaternion_convention(name: str, fields: str, order: list[int]) -> OrientationConvention:
    def to_rotation(values: Array) -> Array:
        if np.abs(np.linalg.norm(values, axis=-1) - 1.0).max(initial=0.0) > 1e-3:
            raise CalibrationError(
                f"{name}: a quaternion must have unit length, within the digits that are printed"
            )
        wxyz = values[..., order]
        return rotation_from_quaternion(wxyz / np.linalg.norm(wxyz, axis=-1, keepdims=True))

    back = [order.index(i) for i in range(4)]
    return OrientationConvention(
        name,
        tuple(fields.split()),
        "quaternion",
        to_rotation,
        lambda r: quaternion_from_rotation(r)[..., back],
    )


def _find_convention(name: str) -> OrientationConvention:
    if name not in CONVENTIONS:
        raise CalibrationError(
            make_message("no orientation is called {name!r}.", name=name),
            remedy=make_message("Known: {conventions}.", conventions=", ".join(CONVENTIONS)),
        )
    return CONVENTIONS[name]


_ALL = (
    # Checked on real controllers' data (FANUC backups, UR and ABB programs) or in the maker's own manual:
    _angle_convention("fanuc_wpr", "W P R", "Rz(R) Ry(P) Rx(W)"),
    OrientationConvention("ur_rotation_vector", ("rx", "ry", "rz"), "exp([r]x)", exp_rotation, log_rotation),
    _angle_convention("ur_rpy", "RX RY RZ", "Rz(RZ) Ry(RY) Rx(RX)"),
    _quaternion_convention("abb_quaternion", "q1 q2 q3 q4", [0, 1, 2, 3]),
    _angle_convention("abb_euler_zyx", "EZ EY EX", "Rz(EZ) Ry(EY) Rx(EX)"),
    # By pairs of joints and pose of real controllers (drivers/kuka/README.md, drivers/yaskawa/README.md):
    _angle_convention("kuka_abc", "A B C", "Rz(A) Ry(B) Rx(C)"),
    _angle_convention("yaskawa_rpy", "Rx Ry Rz", "Rz(Rz) Ry(Ry) Rx(Rx)"),
    # Common knowledge of the trade; no real controller's pair of joints and pose was recomputed here:
    _angle_convention("staubli_rxryrz", "Rx Ry Rz", "Rx(Rx) Ry(Ry) Rz(Rz)"),
    _angle_convention("kawasaki_oat", "O A T", "Rz(O) Ry(A) Rz(T)"),
    _angle_convention("comau_zyz", "A E R", "Rz(A) Ry(E) Rz(R)"),
    _angle_convention("mitsubishi_abc", "A B C", "Rz(C) Ry(B) Rx(A)"),
    _angle_convention("denso_rpy", "Rx Ry Rz", "Rz(Rz) Ry(Ry) Rx(Rx)"),
    _angle_convention("epson_uvw", "U V W", "Rz(U) Ry(V) Rx(W)"),
    _angle_convention("doosan_zyz", "A B C", "Rz(A) Ry(B) Rz(C)"),
    # Not a robot maker's:
    _angle_convention("ros_rpy", "roll pitch yaw", "Rz(yaw) Ry(pitch) Rx(roll)"),
    _quaternion_convention("ros_quaternion", "x y z w", [3, 0, 1, 2]),
    _angle_convention("instrument_xyz", "Rx Ry Rz", "Rx(Rx) Ry(Ry) Rz(Rz)"),
    _angle_convention("instrument_zyx", "Rx Ry Rz", "Rz(Rz) Ry(Ry) Rx(Rx)"),
)
CONVENTIONS: Mapping[str, OrientationConvention] = MappingProxyType({c.name: c for c in _ALL})
