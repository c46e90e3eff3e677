"""Any chain of turning joints as rows of a DH table, with what stands before the first and behind the last."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.robot_model import RobotModel, chain_frames
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, inverse_transform

_PARALLEL = 1e-9
_ONE_LINE_M = 1e-9


@dataclass(frozen=True, eq=False)
class ChainTable:
    """``base_flange(q) = base  prod(rows at joint_coupling @ q)  flange``."""

    rows: Array  # (n, 4): theta, d, a, alpha [rad, m]
    base: Array  # (4, 4)
    flange: Array  # (4, 4)


def dh_of_chain(model: RobotModel) -> ChainTable:
    """Return the rows that the axes of a model make, found from where they lie with all joints at zero.

    Raises
    ------
    CalibrationError
        A joint slides.
    """
    if model.sliding is not None:
        raise CalibrationError(f"{model.label}: a joint slides, and rows are of joints that turn")
    if model.dh is not None:
        return ChainTable(model.dh.to_rows()[:, :4], model.placements[0].copy(), np.eye(4))
    rotations, origins = chain_frames(model, np.zeros((1, model.axis_count)))
    axes, points = rotations[:, :, 2, 0], origins[:, :, 0]
    frame = _frame(rotations[0, :, 0, 0], axes[0], points[0])
    base, rows = frame, np.zeros((model.axis_count, 4))
    for k in range(model.axis_count - 1):
        following = _next_frame(frame, axes[k + 1], points[k + 1])
        rows[k] = _row(inverse_transform(frame) @ following)
        frame = following
    return ChainTable(
        rows, base, inverse_transform(frame) @ model.base_flange(np.zeros((1, model.axis_count)))[0]
    )


def _next_frame(frame: Array, axis: Array, point: Array) -> Array:
    """Return the frame on the next axis, its x along the common normal from this frame's z."""
    z, origin = frame[:3, 2], frame[:3, 3]
    normal = np.cross(z, axis)
    size = float(np.linalg.norm(normal))
    if size > _PARALLEL:
        # From a point of the next axis back along it to where it is nearest to this one.
        along = np.dot(np.cross(z, origin - point), normal) / size**2
        return _frame(normal / size, axis, point + along * axis)
    beside = point - origin - np.dot(point - origin, z) * z
    far = float(np.linalg.norm(beside))
    return _frame(beside / far if far > _ONE_LINE_M else frame[:3, 0], axis, point)


def _row(step: Array) -> Array:
    """Return theta, d, a, alpha of ``Rot(z, theta) Trans(z, d) Trans(x, a) Rot(x, alpha)``."""
    theta = np.arctan2(step[1, 0], step[0, 0])
    a = step[:3, 3] @ step[:3, 0]
    return np.array([theta, step[2, 3], a, np.arctan2(step[2, 1], step[2, 2])])


def _frame(x: Array, z: Array, origin: Array) -> Array:
    frame = np.eye(4)
    x = x - np.dot(x, z) * z
    x = x / np.linalg.norm(x)
    frame[:3, 0], frame[:3, 1], frame[:3, 2], frame[:3, 3] = x, np.cross(z, x), z, origin
    return frame
